// Loop timing, leases and the recorder.

import { plain } from "./controls.js";

const get = (id) => document.getElementById(id);
const KEPT = 4000; // ticks of which the timing is told
const RENEW_MS = 1000; // a lease ends after 5 s without a request

// How late the servo wakes and how long a tick's work takes, over the last ticks.
export class Timing {
  constructor() {
    this.rows = { wake_ns: new Float64Array(KEPT), work_ns: new Float64Array(KEPT) };
    this.count = 0;
    setInterval(() => this.draw(), 500);
  }

  take(header, columns) {
    for (let row = 0; row < header.n; row += 1) {
      for (const name in this.rows) this.rows[name][(this.count + row) % KEPT] = columns[name][row];
    }
    this.count += header.n;
    this.now = header.now;
  }

  state(told) {
    this.told = told;
  }

  draw() {
    const kept = Math.min(this.count, KEPT);
    if (!kept || document.documentElement.dataset.state === "nodata") return;
    Object.values(this.rows).forEach((ring, place) => {
      const sorted = ring.slice(0, kept).sort();
      const cells = get("timing").rows[place + 1].cells;
      [0.5, 0.99, 1].forEach((share, column) => {
        cells[column + 1].textContent = (sorted[Math.min(kept - 1, Math.floor(share * kept))] / 1e3).toFixed(0);
      });
    });
    const { lost_slots } = this.now;
    const { rate_hz = NaN, counters = {}, delay_us = -1, delay_spread_us } = this.told ?? {};
    const delay = delay_us < 0 ? "d unknown: no frame has come"
      : `d = ${plain(delay_us * 1e-6 * rate_hz)} periods, ${delay_us} µs, spread ${delay_spread_us} µs`;
    get("delay").textContent = `${delay}\n${counters.late_events ?? "–"} late ticks, ${lost_slots} lost, at ${plain(rate_hz)} Hz`;
  }
}

// Who alone may change what. A lease that this page holds is renewed while it is open; it ends with it.
export class Leases {
  constructor(link, ask) {
    this.link = link;
    this.leases = {};
    get("lease-take").addEventListener("click", () => this.click(ask));
    get("lease-what").addEventListener("change", () => this.draw());
    setInterval(() => this.renew(), RENEW_MS);
  }

  state(told) {
    this.leases = told.leases ?? {};
    this.draw();
  }

  mine(held) {
    return held && held.actor === this.actor;
  }

  draw() {
    const what = get("lease-what").value;
    const held = this.leases[what];
    get("lease-take").textContent = !held ? "Lease" : this.mine(held) ? "Release" : "Take over";
    const words = Object.entries(this.leases).map(([name, one]) => `${name}: ${this.mine(one) ? "this page" : `${one.name} (${one.actor})`}`);
    get("lease-holder").textContent = words.join("; ") || "none";
    get("lease-holder").title = get("lease-holder").textContent;
  }

  click(ask) {
    const what = get("lease-what").value;
    const held = this.leases[what];
    if (this.mine(held)) ask("lease", { what, action: "release" }, `${what} may be changed by any client`);
    else ask("lease", held ? { what, take_over: true } : { what }, `${what} is this page's alone`);
  }

  renew() {
    for (const [what, held] of Object.entries(this.leases)) {
      if (this.mine(held)) this.link.ask("lease", { what, action: "renew" });
    }
  }
}

// `hapticd record` behind a button, with the operator's words.
export class Recorder {
  constructor(ask, tell) {
    this.tell = tell;
    this.recording = false;
    get("recorder").addEventListener("submit", async (event) => {
      event.preventDefault();
      const ends = this.recording;
      if (await ask("record", { start: !ends, note: get("note").value }) && ends) this.pack();
    });
  }

  // It has ended, and its file is packed: nothing to press until that is told.
  pack() {
    if (!this.recording) return;
    get("record").textContent = "packing…";
    get("record").disabled = true;
  }

  take(told) {
    const ended = this.recording && !told.recording;
    this.recording = told.recording;
    get("record").disabled = false;
    get("record").ariaPressed = String(told.recording);
    get("record").textContent = told.recording ? "End recording" : "Record";
    if (told.recording) this.tell("event", `recording into ${told.file}`);
    else if (ended) this.tell("done", told.text);
  }
}
