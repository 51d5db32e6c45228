// The oscilloscope: the last minute of every signal, drawn as four strips over one time axis.
//
// Samples lie in rings. A view is a span of time: the newest (roll), or round the last trigger. Of
// more samples than pixels the least and the greatest in each pixel are drawn, so that no peak is
// lost. What is saved are the samples themselves, of exactly the time that is shown.

import { looks } from "./plane.js";
import { noNumber, number } from "./words.js";

const KEPT = 1 << 17; // samples of each signal
const DRAW_MS = 40;
const SIGNALS = [
  { name: "position_m", title: "position", unit: "mm", scale: 1e3, least: 0.02, digits: 4 },
  { name: "velocity_m_per_s", title: "velocity", unit: "mm/s", scale: 1e3, least: 1, digits: 2 },
  { name: "force_n", title: "force", unit: "N", scale: 1, least: 0.05, digits: 4 },
  { name: "active_damping_ns_per_m", title: "damping", unit: "N s/m", scale: 1, least: 1, digits: 3, zero: true },
];
const get = (id) => document.getElementById(id);

export class Scope {
  constructor(tell) {
    this.tell = tell;
    this.rings = Object.fromEntries(["time_s", ...SIGNALS.map((one) => one.name)].map((name) => [name, new Float64Array(KEPT)]));
    this.clear();
    this.paused = false;
    this.strips = SIGNALS.map((signal) => new Strip(signal, get("strips"), (range) => this.select(range)));
    for (const signal of SIGNALS) get("source").add(new Option(signal.title, signal.name));
    for (const id of ["trigger", "source", "edge", "threshold", "pre", "span", "holdoff"]) {
      get(id).addEventListener("input", () => this.arm());
    }
    get("pause").addEventListener("click", () => this.pause(!this.paused));
    get("measure").addEventListener("click", () => this.measure(get("measure").ariaPressed !== "true"));
    get("save").addEventListener("click", () => this.save());
    new ResizeObserver(() => this.resize()).observe(get("strips"));
    this.arm();
    setInterval(() => this.draw(), DRAW_MS);
  }

  clear() {
    this.count = 0; // samples taken in this life of the servo
    this.triggered = null; // time of the trigger that is shown, and of the next sample looked at
    this.looked = 0;
    this.range = null;
  }

  take(header, columns) {
    if (header.restarted) this.clear();
    this.simulated = header.simulated;
    if (this.paused) return; // what is shown stays whole
    for (let row = 0; row < header.n; row += 1) {
      const place = (this.count + row) % KEPT;
      for (const name in this.rings) this.rings[name][place] = columns[name][row];
    }
    this.count += header.n;
    if (this.mode) this.look();
  }

  // --- trigger ---------------------------------------------------------------------------------

  arm() {
    this.mode = get("trigger").value;
    get("trigger-bar").dataset.mode = this.mode;
    this.signal = SIGNALS.find((one) => one.name === get("source").value);
    this.span_s = Number(get("span").value);
    this.pre = Number(get("pre").value);
    this.edge = Number(get("edge").value);
    this.holdoff_s = Number(get("holdoff").value);
    this.threshold = number(get("threshold").value.trim()) / this.signal.scale; // nothing crosses NaN
    get("threshold-unit").textContent = this.signal.unit;
    this.triggered = null;
    this.looked = this.count;
    this.pause(false);
  }

  // A trigger counts once all that is to be shown after it is there, and not within the hold-off
  // of the one before.
  look() {
    const ring = this.rings[this.signal.name];
    const time = this.rings.time_s;
    const newest_s = time[(this.count - 1) % KEPT];
    for (let place = Math.max(this.looked, 1, this.count - KEPT + 1); place < this.count; place += 1) {
      const at_s = time[place % KEPT];
      if (at_s + (1 - this.pre) * this.span_s > newest_s) break;
      this.looked = place + 1;
      const before = this.edge * (ring[(place - 1) % KEPT] - this.threshold);
      const after = this.edge * (ring[place % KEPT] - this.threshold);
      if (before < 0 && after >= 0 && !(at_s - this.triggered < this.holdoff_s)) {
        this.triggered = at_s;
        if (this.mode === "single") {
          this.pause(true);
          return;
        }
      }
    }
  }

  pause(paused) {
    this.paused = paused;
    get("pause").ariaPressed = String(paused);
    get("pause").textContent = paused ? "Run" : "Pause";
    if (!paused) this.range = null;
  }

  // --- what is shown ---------------------------------------------------------------------------

  // {from_s, to_s, zero_s}: ends of what is shown, and where 0 of the axis is; null without data.
  view() {
    if (!this.count) return null;
    if (!this.mode) {
      const to_s = this.rings.time_s[(this.count - 1) % KEPT];
      return { from_s: to_s - this.span_s, to_s, zero_s: to_s };
    }
    if (this.triggered === null) return null;
    const from_s = this.triggered - this.pre * this.span_s;
    return { from_s, to_s: from_s + this.span_s, zero_s: this.triggered };
  }

  // [first, after]: numbers of the samples from one time to another.
  between(from_s, to_s) {
    const oldest = Math.max(0, this.count - KEPT);
    const place = (wanted_s) => {
      let low = oldest;
      let high = this.count;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (this.rings.time_s[middle % KEPT] < wanted_s) low = middle + 1;
        else high = middle;
      }
      return low;
    };
    return [place(from_s), place(to_s + 1e-6)]; // Unix time as float64 has steps of 0.24 us
  }

  draw() {
    const view = this.view();
    get("scope-note").textContent = this.note(view);
    if (!this.count || document.hidden) return;
    for (const strip of this.strips) strip.now(this.rings[strip.signal.name][(this.count - 1) % KEPT]);
    if (!view) return;
    const [first, after] = this.between(view.from_s, view.to_s);
    for (const strip of this.strips) {
      strip.draw(this.rings.time_s, this.rings[strip.signal.name], first, after, view);
    }
    if (get("measure").ariaPressed === "true") this.measured(view);
  }

  note(view) {
    if (this.mode && Number.isNaN(this.threshold)) return noNumber("at", get("threshold").value, this.signal.unit);
    if (this.mode && this.triggered === null) return `waits for ${this.signal.title} ${this.edge > 0 ? "above" : "below"} ${get("threshold").value} ${this.signal.unit}`;
    if (!view) return "";
    const zero = this.mode ? "0 s is the trigger" : "0 s is now";
    const more = this.range ? `; selected ${seconds(this.range[1] - this.range[0])}, ${(1 / (this.range[1] - this.range[0])).toPrecision(4)} Hz` : "";
    return `${zero}${more}`;
  }

  resize() {
    for (const strip of this.strips) strip.resize();
  }

  recolour() {
    for (const strip of this.strips) strip.build();
  }

  // --- measuring and saving --------------------------------------------------------------------

  measure(on) {
    get("measure").ariaPressed = String(on);
    if (!on) for (const strip of this.strips) strip.tell("");
    if (!on) this.range = null;
  }

  // A stretch [from, to] of the axis was dragged over; a click alone ends it.
  select(range) {
    this.range = range;
    if (range) this.measure(true);
    if (range && !this.mode) this.pause(true);
  }

  measured(view) {
    const [from_s, to_s] = this.range ? this.range.map((one) => one + view.zero_s) : [view.from_s, view.to_s];
    const [first, after] = this.between(from_s, to_s);
    for (const strip of this.strips) strip.tell(statistics(this.rings[strip.signal.name], first, after, strip.signal));
  }

  save() {
    const view = this.view();
    if (!view) return this.tell("refused", "nothing is shown that could be saved");
    const [first, after] = this.between(view.from_s, view.to_s);
    const lines = [
      `# hapticd ${get("instance").textContent}, ${get("board").textContent}: ${get("device").textContent}`,
      `# time 0 is ${new Date(view.zero_s * 1e3).toISOString()}; what the page's scope showed, every sample`,
      `time_s,${SIGNALS.map((one) => one.name).join(",")}`,
    ];
    for (let place = first; place < after; place += 1) {
      const row = place % KEPT;
      const values = SIGNALS.map((one) => this.rings[one.name][row]);
      lines.push([(this.rings.time_s[row] - view.zero_s).toFixed(6), ...values].join(","));
    }
    download(`hapticd-${new Date(view.zero_s * 1e3).toISOString().replace(/[:.]/g, "")}.csv`, `${lines.join("\n")}\n`);
    this.tell("done", `${after - first} samples saved, ${seconds(this.span_s)}`);
  }
}

class Strip {
  constructor(signal, parent, select) {
    this.signal = signal;
    this.last = signal === SIGNALS.at(-1); // the one with the numbers of the time axis
    this.select = select;
    this.box = document.createElement("div");
    this.box.className = "strip";
    this.box.innerHTML = `<div class="strip-head"><b>${signal.title}</b><span class="value"></span><span class="measured"></span></div><div class="plot"></div>`;
    parent.append(this.box);
    [this.value, this.statistics] = this.box.querySelectorAll(".value, .measured");
    this.place = this.box.querySelector(".plot");
    this.limits = [-signal.least, signal.least];
    this.data = [[], []];
    this.build();
  }

  build() {
    this.plot?.destroy();
    const { colour, rem, axis } = looks();
    const options = {
      width: Math.max(50, this.place.clientWidth), height: Math.max(30, this.place.clientHeight),
      padding: [0.4 * rem, 0.6 * rem, this.last ? 0 : 0.4 * rem, 0], legend: { show: false },
      cursor: { sync: { key: "scope" }, drag: { x: true, y: false, setScale: false }, points: { show: false }, y: false },
      scales: { x: { time: false, range: () => this.span ?? [-1, 0] }, y: { range: () => this.limits } },
      axes: [
        { ...axis, size: this.last ? 1.3 * rem : 0, gap: 0.1 * rem, space: 5 * rem, values: this.last ? undefined : () => [] },
        { ...axis, size: 4.2 * rem, gap: 0.3 * rem, splits: (_plot, _axis, low, high) => [low, between(low, high), high], values: (_plot, ticks) => ticks.map((one) => Number(one.toPrecision(6))) },
      ],
      series: [{}, { stroke: colour("--trace"), width: Math.max(1.2, 0.09 * rem), points: { show: false } }],
      hooks: { setSelect: [(plot) => this.dragged(plot)] },
    };
    this.plot = new uPlot(options, this.data, this.place);
  }

  resize() {
    this.build();
  }

  dragged(plot) {
    const { left, width } = plot.select;
    this.select(width > 2 ? [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")] : null);
  }

  draw(time, ring, first, after, view) {
    this.data = thinned(time, ring, first, after, view.zero_s, this.signal.scale, Math.round(this.plot.bbox.width / 2));
    this.span = [view.from_s - view.zero_s, view.to_s - view.zero_s];
    this.fit(this.data[1]);
    this.plot.setData(this.data);
  }

  // The newest value, whatever span is shown: a trigger holds the trace, not the number.
  now(value) {
    const newest = value * this.signal.scale;
    this.value.textContent = Number.isFinite(newest) ? `${fixed(newest, this.signal.digits)} ${this.signal.unit}` : "unknown";
  }

  // Limits that hold all values, round, and do not follow every wobble: they grow at once and
  // shrink when less than a third is used.
  fit(values) {
    let low = Infinity;
    let high = -Infinity;
    for (const one of values) {
      if (one < low) low = one;
      if (one > high) high = one;
    }
    if (!(low <= high)) return;
    if (this.signal.zero) low = Math.min(low, 0);
    const [bottom, top] = this.limits;
    const fits = low >= bottom && high <= top;
    if (fits && high - low > (top - bottom) / 3) return;
    const wanted = rounded(low, high, this.signal);
    if (!fits || wanted[1] - wanted[0] < 0.8 * (top - bottom)) this.limits = wanted;
  }

  tell(text) {
    this.statistics.textContent = text;
  }
}

// What stands between the ends of an axis: 0, if that is far enough from both.
function between(low, high) {
  const share = -low / (high - low);
  return share > 0.3 && share < 0.7 ? 0 : (low + high) / 2;
}

function rounded(low, high, signal) {
  const spread = Math.max(high - low, signal.least);
  const middle = (low + high) / 2;
  const step = 10 ** Math.floor(Math.log10(spread)) / 2;
  const bottom = signal.zero ? 0 : Math.floor((middle - 0.6 * spread) / step) * step;
  return [bottom, Math.ceil((middle + 0.6 * spread) / step) * step];
}

// [times, values] of samples first..after, at most two for each of `pixels`.
function thinned(time, ring, first, after, zero_s, scale, pixels) {
  const times = [];
  const values = [];
  const step = Math.max(1, Math.ceil((after - first) / Math.max(1, pixels)));
  if (step <= 2) {
    for (let place = first; place < after; place += 1) {
      times.push(time[place % KEPT] - zero_s);
      values.push(ring[place % KEPT] * scale);
    }
    return [times, values];
  }
  for (let start = first - (first % step); start < after; start += step) {
    let low = Math.max(start, first);
    let high = low;
    for (let place = low; place < Math.min(start + step, after); place += 1) {
      if (ring[place % KEPT] < ring[low % KEPT]) low = place;
      if (ring[place % KEPT] > ring[high % KEPT]) high = place;
    }
    for (const place of low <= high ? [low, high] : [high, low]) {
      times.push(time[place % KEPT] - zero_s);
      values.push(ring[place % KEPT] * scale);
    }
  }
  return [times, values];
}

function statistics(ring, first, after, signal) {
  let low = Infinity;
  let high = -Infinity;
  let sum = 0;
  let squares = 0;
  for (let place = first; place < after; place += 1) {
    const one = ring[place % KEPT] * signal.scale;
    low = Math.min(low, one);
    high = Math.max(high, one);
    sum += one;
    squares += one * one;
  }
  const count = after - first;
  if (!count) return "";
  const mean = sum / count;
  const deviation = Math.sqrt(Math.max(0, squares / count - mean * mean));
  const show = (one) => String(Number(Number(one.toPrecision(3)).toFixed(signal.digits)));
  return `mean ${show(mean)}  sd ${show(deviation)}  ${show(low)}…${show(high)}  p-p ${show(high - low)}`;
}

const fixed = (value, digits) => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);
const seconds = (value) => `${Number(value.toPrecision(4))} s`;

function download(name, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
