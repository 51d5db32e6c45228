// State lamp, buttons, damping switch and the values of what is rendered. Every lamp and number
// shows what the daemon says; a button only asks.

import { noNumber, number, ofPage } from "./words.js";

const get = (id) => document.getElementById(id);
const NAMES = { K: "stiffness_n_per_m", B: "virtual_damping_ns_per_m", M: "mass_kg", level: "active_damping_asked_ns_per_m" };
const UNITS = { K: "N/m", B: "N s/m", M: "kg", level: "N s/m" };
// Fifty times a second: what stays as it is costs nothing.
const put = (id, text) => get(id).textContent === text || (get(id).textContent = text);
const DAMPED = 1e-6; // N s/m: less is off

export class Controls {
  constructor(link, tell) {
    this.link = link;
    this.tell = tell;
    this.limits = {};
    this.damped = null;
    this.missing = ""; // why there is no board, as `hapticd status` says it
    this.told = { fault: "none" };
    for (const cmd of ["enable", "disable", "reset", "home", "zero"]) get(cmd).addEventListener("click", () => this.ask(cmd));
    get("dump").addEventListener("click", () => this.ask("dump", {}, "the flight recording is being written"));
    get("damping-switch").addEventListener("click", () => this.toggle());
    get("damping-auto").addEventListener("click", () => this.ask("damping", { value: "auto" }));
    get("policy").addEventListener("change", () => this.ask("guard", { policy: get("policy").value }));
    get("values").addEventListener("submit", (event) => {
      event.preventDefault();
      this.set();
    });
    for (const name in NAMES) {
      get(name).addEventListener("input", () => get(name).classList.toggle("changed", get(name).value !== ""));
    }
  }

  // Ask, and tell what became of it; `done` are the words for what has no receipt.
  async ask(cmd, fields, done) {
    const answer = await this.link.ask(cmd, fields);
    this.tell(answer.ok ? "done" : "refused", answer.text ?? done ?? `${cmd}: done`, answer.outcome);
    if (answer.warning) this.tell("warning", answer.warning);
    return answer.ok;
  }

  toggle() {
    this.ask("damping", { value: this.damped ? "off" : "on" });
  }

  // All that was typed, at once: all of it or nothing.
  async set() {
    const fields = {};
    for (const name in NAMES) {
      const text = get(name).value.trim();
      const asked = name === "level" ? "active_damping" : name;
      if (text === "") continue;
      fields[asked] = number(text);
      if (!Number.isFinite(fields[asked])) return this.tell("refused", noNumber(asked, text, UNITS[name]));
    }
    if (!Object.keys(fields).length) return this.tell("refused", "nothing to set: type a value beside K, B, M or D first");
    if (await this.ask("set", fields)) {
      for (const name in NAMES) {
        get(name).value = "";
        get(name).classList.remove("changed");
      }
    }
  }

  // --- what the daemon says --------------------------------------------------------------------

  show(now) {
    for (const [name, field] of Object.entries(NAMES)) put(`${name}-now`, plain(now[field]));
    const effect = now.active_damping_effect_ns_per_m;
    this.damped = effect === null ? now.active_damping_asked_ns_per_m > DAMPED : effect > DAMPED;
    const known = effect !== null;
    const checked = known ? String(this.damped) : "mixed";
    if (get("damping-switch").ariaChecked !== checked) get("damping-switch").ariaChecked = checked;
    put("damping-word", known ? (this.damped ? `ON ${effect.toFixed(2)}` : "OFF") : "unknown");
    put("damping-board", known
      ? `board reports ${now.damping_count} counts = ${plain(effect)} N\u202fs/m`
      : "this board does not report its damping");
    const { proxy_m, proxy_held, lease_control } = now;
    const name = this.told.actors?.[lease_control] ?? "client";
    const by = lease_control ? `, by ${name} (${lease_control})` : "";
    const place = `proxy ${proxy_held ? "held" : "moves"}: ${plain(1e3 * proxy_m)} mm`;
    put("proxy", proxy_m || proxy_held ? place + by : "");
  }

  fault(told) {
    this.told = told;
    const [name, words] = get("fault").children;
    const well = told.fault === "none";
    name.textContent = well ? this.missing : `${told.fault}: ${told.cause}`;
    const leave = well ? "" : `To leave: ${ofPage(told.remedy)}.`;
    words.textContent = this.missing && !well ? `${leave} Now ${this.missing}` : leave && `${leave} (${told.action})`;
    words.title = words.textContent;
  }

  board(told) {
    if (told.text === this.missing) return;
    this.missing = told.text;
    this.tell(told.text ? "error" : "event", told.text || "the board answers");
    this.fault(this.told);
  }

  guard(told) {
    const verdict = told.verdict ?? {};
    if (document.activeElement !== get("policy")) get("policy").value = told.policy;
    const margin = verdict.margin_ns_per_m;
    const safe = verdict.safe;
    get("margin").className = safe === true ? "safe" : safe === false ? "unsafe" : "unknown";
    get("margin").textContent = margin === null || margin === undefined ? "margin unknown"
      : margin < 0 ? `short ${three(-margin)} N\u202fs/m` : safe ? `spare ${three(margin)} N\u202fs/m` : "not safe";
    get("verdict").textContent = verdict.text ?? "nothing was judged yet";
    for (const name of ["K", "B", "M"]) get(`${name}-range`).textContent = this.range(name, verdict.allowed?.[name], verdict.allowed);
    const least = verdict.least_active_damping_ns_per_m;
    const most = this.limits.active_damping?.high;
    const needs = least === null || least === undefined ? "" : `needs at least ${plain(least)}`;
    get("level-range").textContent = [needs, most === undefined ? "" : `takes 0 to ${plain(most)}`].filter(Boolean).join(", ");
  }

  range(name, allowed, known) {
    const limit = this.limits[name];
    const limits = limit ? `takes ${plain(limit.low)} to ${plain(limit.high)}` : "";
    const passive = allowed ? `passive ${three(allowed[0])} to ${three(allowed[1])}`
      : known && Object.keys(known).length ? `no ${name} alone is passive` : "passive: unknown";
    return `${passive}${limits && `; ${limits}`}`;
  }
}

const three = (value) => plain(Number(value.toPrecision(3)));

// A number as people read it: four digits, no exponent for what is common.
export function plain(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(2).replace("-", "−");
  return String(Number(value.toPrecision(4))).replace("-", "−");
}
