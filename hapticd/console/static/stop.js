// STOP: a request of its own, sent again until it is taken, or until the records say that the device
// is stopped. A server that stands still answers nothing, so each request has a time-out. Space and
// Esc press it wherever the focus is; only in a line of words does a space stay a space. It names this
// page's own actor, who may reset it at once, and nobody else for a second.

const AGAIN_MS = 250;
const TIMEOUT_MS = 750; // with AGAIN_MS: an operator knows within a second
const STOPPED = ["stopped", "fault"];

export function stopButton(button, tell, actor) {
  let sending = false;

  async function press() {
    if (sending) return;
    sending = true;
    for (let first = true; ; first = false) {
      const problem = await sent(actor());
      button.classList.toggle("failed", Boolean(problem));
      if (!problem || STOPPED.includes(document.documentElement.dataset.state)) break;
      if (first) tell("error", `NOT STOPPED: ${problem}. Use the emergency stop, or: hapticd stop`);
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
    button.classList.remove("failed");
    sending = false;
  }

  button.addEventListener("pointerdown", press);
  button.addEventListener("click", press);
  const isStop = (event) => event.key === "Escape" || (event.key === " " && !writing(event.target));
  const swallow = (event) => {
    if (!isStop(event)) return false;
    event.preventDefault(); // a focused button must not be clicked by this key
    event.stopImmediatePropagation();
    return true;
  };
  addEventListener("keydown", (event) => swallow(event) && press(), true);
  addEventListener("keyup", swallow, true);
}

// Why it was not taken, or "".
async function sent(actor) {
  try {
    const answer = await fetch(`/stop?actor=${actor ?? ""}`, {
      method: "POST",
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    return answer.ok ? "" : (await answer.json()).text;
  } catch {
    return "the page's server does not answer";
  }
}

const writing = (element) => element.classList?.contains("words");
