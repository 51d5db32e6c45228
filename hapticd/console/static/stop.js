// STOP: a request of its own, and a message over the live connection beside it. Both are sent again
// until the servo has taken the stop, a record says that the device is stopped, or the operator
// dismisses the notice. A server that stands still answers nothing, so each request has a time-out;
// over the connection, which loses nothing, a stop is sent anew only once it was answered or the
// connection was made anew. Nothing but stops is ever sent from here.
//
// Space and Esc press it wherever the focus is; only in a line of words does a space stay a space. It
// names this page's own actor, who may reset it at once, and nobody else for a second.

const AGAIN_MS = 250;
const TIMEOUT_MS = 750; // an operator knows within a second
const PATIENCE_MS = 900; // with a servo that was pressed and has not taken it
const STOPPED = ["stopped", "fault"];
const REMEDY = "Use the emergency stop, or: hapticd stop";

export class Stop {
  constructor(button, notice, link, tell, actor) {
    Object.assign(this, { button, notice, link, tell, actor });
    this.trying = null; // the press that nobody has taken yet
    this.asked = false; // over the connection, without an answer
    button.addEventListener("pointerdown", () => this.press());
    button.addEventListener("click", () => this.press());
    notice.querySelector("button").addEventListener("click", () => this.dismiss());
    this.listen();
  }

  listen() {
    const isStop = (event) => event.key === "Escape" || (event.key === " " && !writing(event.target));
    const swallow = (event) => {
      if (!isStop(event)) return false;
      event.preventDefault(); // a focused button must not be clicked by this key
      event.stopImmediatePropagation();
      return true;
    };
    addEventListener("keydown", (event) => swallow(event) && this.press(), true);
    addEventListener("keyup", swallow, true);
  }

  async press() {
    if (this.trying) return;
    const press = { begun_ms: performance.now(), told: false };
    this.trying = press;
    while (this.trying === press) {
      this.askByLink();
      const answer = await asked(this.actor());
      if (this.trying === press) this.take(answer);
      if (this.trying === press) await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }

  async askByLink() {
    if (this.asked) return;
    this.asked = true;
    const answer = await this.link.ask("stop", { actor: this.actor() ?? null });
    this.asked = false;
    if (this.trying && taken(answer)) this.end();
  }

  // What a request was answered with.
  take(answer) {
    if (taken(answer)) this.end();
    else if (!answer.ok) this.warn(answer.text);
    else if (performance.now() - this.trying.begun_ms > PATIENCE_MS) this.warn("the servo has not taken it");
  }

  // A record came with this state.
  seen(state) {
    if (this.trying && STOPPED.includes(state)) this.end();
  }

  warn(problem) {
    if (this.trying.told) return;
    this.trying.told = true;
    this.tell("error", `NOT STOPPED: ${problem}. ${REMEDY}`);
    this.notice.querySelector("span").textContent = `${problem}. ${REMEDY}. This page goes on sending it.`;
    this.show(true);
  }

  dismiss() {
    if (!this.trying) return;
    this.end();
    this.tell("warning", "STOP is not sent again; whether the device is stopped is not known");
  }

  end() {
    this.trying = null;
    this.show(false);
  }

  show(failed) {
    this.button.classList.toggle("failed", failed);
    this.notice.hidden = !failed;
  }
}

// The answer {ok, states, text} to a request.
async function asked(actor) {
  try {
    const answer = await fetch(`/stop?actor=${actor ?? ""}`, {
      method: "POST",
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    return await answer.json();
  } catch {
    return { ok: false, text: "the page's server does not answer" };
  }
}

// Whether every servo that was pressed has taken it, and no force acts.
const taken = (answer) => answer.ok && answer.states.every((state) => state === "stopped");

const writing = (element) => element.classList?.contains("words");
