// The operators' page: what comes from the daemon goes to the parts that show it.
// Lamps and numbers show the daemon's state, never a button's wish; what is older than half a
// second is no data.

import { Controls } from "./controls.js";
import { Impedance } from "./impedance.js";
import { Link } from "./link.js";
import { Leases, Recorder, Timing } from "./panels.js";
import { Plane } from "./plane.js";
import { Scope } from "./scope.js";
import { Stop } from "./stop.js";
import { ofPage } from "./words.js";

const NO_DATA_MS = 500;
const LOOK_MS = 100;
const MOST_LINES = 50;
const get = (id) => document.getElementById(id);
const root = document.documentElement;

let came_ms = -Infinity;

function tell(kind, text, outcome = "") {
  const line = document.createElement("li");
  line.className = kind;
  const time = document.createElement("time");
  time.textContent = new Date().toTimeString().slice(0, 8);
  const words = document.createElement("span");
  words.textContent = ofPage(kind === "refused" && outcome !== "refused" ? `refused: ${text}` : text); // the guard says so itself
  line.append(time, words);
  get("log").prepend(line);
  while (get("log").children.length > MOST_LINES) get("log").lastChild.remove();
}

function lamp(state) {
  const words = state === "nodata" ? "NO DATA" : state;
  if (root.dataset.state !== state) root.dataset.state = state;
  if (get("lamp").textContent !== words) get("lamp").textContent = words;
}

function board(simulated) {
  const words = simulated ? "SIMULATED" : "REAL BOARD";
  if (get("board").textContent !== words) get("board").textContent = words;
}

const handlers = {
  frame(header, columns) {
    const silent_ms = performance.now() - came_ms;
    if (silent_ms > NO_DATA_MS && silent_ms < Infinity) introduce(); // perhaps to another gateway
    came_ms = performance.now();
    lamp(header.now.state);
    stop.seen(header.now.state);
    board(header.simulated);
    for (const part of [scope, timing]) part.take(header, columns);
    for (const part of [controls, plane, impedance]) part.show(header.now);
  },
  state(told) {
    controls.fault(told);
    for (const part of [timing, leases]) part.state(told);
  },
  board: (told) => controls.board(told),
  plane: (told) => plane.take(told),
  impedance: (told) => impedance.take(told),
  recorder: (told) => recorder.take(told),
  guard(told) {
    for (const part of [controls, plane]) part.guard(told);
  },
  event(told) {
    if (told.kind !== "answer") tell(["stopped", "fault"].includes(told.state) ? "error" : told.kind === "warning" ? "warning" : "event", told.words);
  },
};

// --- the parts ---------------------------------------------------------------------------------

function theme(name) {
  root.dataset.theme = name;
  localStorage.setItem("theme", name);
}

theme(localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
const link = new Link(handlers, introduce);
const controls = new Controls(link, tell);
const ask = (...words) => controls.ask(...words);
const scope = new Scope(tell);
const plane = new Plane();
const impedance = new Impedance(ask);
const timing = new Timing();
const leases = new Leases(link, ask);
const recorder = new Recorder(ask, tell);
const stop = new Stop(get("stop"), get("not-stopped"), link, tell, () => leases.actor);
get("theme").addEventListener("click", () => {
  theme(root.dataset.theme === "dark" ? "light" : "dark");
  for (const part of [...scope.strips, plane, impedance]) part.build();
});
setInterval(() => performance.now() - came_ms > NO_DATA_MS && lamp("nodata"), LOOK_MS);

// Each connection is another client of the daemon, and of each of its gateways: with its own number,
// and what it may ask.
async function introduce() {
  const hello = await link.ask("hello", { name: "page" });
  if (!hello.ok) return;
  controls.limits = hello.result.limits;
  leases.actor = hello.result.actor;
}
