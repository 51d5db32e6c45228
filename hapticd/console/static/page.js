// The operators' page: what comes from the daemon goes to the parts that show it.
// Lamps and numbers show the daemon's state, never a button's wish; what is older than half a
// second is no data.

import { Controls } from "./controls.js";
import { Link } from "./link.js";
import { Scope } from "./scope.js";
import { stopButton } from "./stop.js";

const NO_DATA_MS = 500;
const LOOK_MS = 100;
const MOST_LINES = 50;
const get = (id) => document.getElementById(id);
const root = document.documentElement;

let came_ms = -Infinity;

function tell(kind, text) {
  const line = document.createElement("li");
  line.className = kind;
  line.title = text;
  const time = document.createElement("time");
  time.textContent = new Date().toTimeString().slice(0, 8);
  line.append(time, kind === "refused" ? `refused: ${text}` : text);
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
    came_ms = performance.now();
    lamp(header.now.state);
    board(header.simulated);
    scope.take(header, columns);
    controls.show(header.now);
  },
  state(told) {
    controls.fault(told);
  },
  guard(told) {
    controls.guard(told);
  },
  event(told) {
    if (told.text && told.kind !== "answer") tell(told.kind === "warning" ? "warning" : "event", told.text);
  },
};

function theme(name) {
  root.dataset.theme = name;
  localStorage.setItem("theme", name);
  scope?.recolour();
}

let scope = null;
theme(localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
scope = new Scope(tell);
const link = new Link(handlers);
const controls = new Controls(link, tell);
stopButton(get("stop"), tell);
get("theme").addEventListener("click", () => theme(root.dataset.theme === "dark" ? "light" : "dark"));
setInterval(() => performance.now() - came_ms > NO_DATA_MS && lamp("nodata"), LOOK_MS);
link.socket.addEventListener("open", async () => {
  const hello = await link.ask("hello", { name: "page" });
  if (hello.ok) controls.limits = hello.result.limits;
});
