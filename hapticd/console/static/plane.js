// The K-B plane: which B each K withstands, without and with active damping, and where we are in it.
// The edges are the guard's own judgement; the page draws them and the live point.

import { plain } from "./controls.js";

const OUTSIDE = { off: "not judged", warn: "not passive", clamp: "clamped", refuse: "refused", follow: "refused" };
const get = (id) => document.getElementById(id);

export class Plane {
  constructor() {
    this.place = document.querySelector("#plane .plot");
    this.edges = null;
    this.now = null;
    this.build();
    new ResizeObserver(() => this.build()).observe(this.place);
  }

  build() {
    this.plot?.destroy();
    const { colour, rem, axis } = looks();
    const options = {
      width: Math.max(50, this.place.clientWidth), height: Math.max(50, this.place.clientHeight),
      padding: [0.4 * rem, 1.3 * rem, 0, 0], legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, range: () => this.limits("K") }, y: { range: () => this.limits("B") } },
      axes: [
        { ...axis, space: 3.4 * rem, size: 1.2 * rem, label: "K, N/m", labelSize: 1.1 * rem, labelFont: axis.font, labelGap: 0 },
        { ...axis, space: 1.3 * rem, size: 2 * rem, label: "B, N s/m", labelSize: 1.1 * rem, labelFont: axis.font, labelGap: 0 },
      ],
      series: [{}, { show: false }],
      hooks: { drawClear: [(plot) => this.regions(plot, colour)], draw: [(plot) => this.point(plot, colour)] },
    };
    this.plot = new uPlot(options, [[0, 1], [0, 0]], this.place);
  }

  limits(name) {
    if (!this.edges) return name === "K" ? [0, 100] : [-1, 1];
    return name === "K" ? [0, this.edges.K.at(-1)] : this.edges.B;
  }

  take(told) {
    this.edges = told.plane;
    get("plane-note").textContent = told.plane ? `by ${told.basis}, M ${plain(told.M)} kg` : told.text;
    if (told.plane) get("plane-level").textContent = `D = ${plain(told.plane.with.level)}`;
    this.plot.redraw();
  }

  show(now) {
    const before = this.now;
    this.now = now;
    if (before?.stiffness_n_per_m === now.stiffness_n_per_m && before?.virtual_damping_ns_per_m === now.virtual_damping_ns_per_m) return;
    this.plot.redraw(false);
  }

  guard() {
    get("plane-outside").textContent = OUTSIDE[get("policy").value] ?? "not passive";
  }

  regions(plot, colour) {
    const { left, top, width, height } = plot.bbox;
    if (!this.edges) return;
    plot.ctx.fillStyle = colour("--unsafe");
    plot.ctx.fillRect(left, top, width, height);
    this.region(plot, this.edges.with, colour("--panel"), colour("--damped"), colour("--amber"));
    this.region(plot, this.edges.without, colour("--panel"), colour("--safe"), colour("--green"));
  }

  region(plot, edges, paper, fill, line) {
    const columns = this.edges.K.map((_, place) => place).filter((place) => edges.low[place] !== null);
    if (!columns.length) return;
    const x = (place) => plot.valToPos(this.edges.K[place], "x", true);
    const y = (value) => plot.valToPos(value, "y", true);
    const path = new Path2D();
    columns.forEach((place, first) => path[first ? "lineTo" : "moveTo"](x(place), y(edges.high[place])));
    for (const place of columns.toReversed()) path.lineTo(x(place), y(edges.low[place]));
    path.closePath();
    const { ctx } = plot;
    ctx.save();
    for (const style of [paper, fill]) {
      ctx.fillStyle = style;
      ctx.fill(path);
    }
    ctx.strokeStyle = line;
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.stroke(path);
    ctx.restore();
  }

  point(plot, colour) {
    if (!this.now) return;
    const { left, top, width, height } = plot.bbox;
    const inside = (at, low, size) => Math.min(low + size, Math.max(low, at));
    const x = inside(plot.valToPos(this.now.stiffness_n_per_m, "x", true), left, width);
    const y = inside(plot.valToPos(this.now.virtual_damping_ns_per_m, "y", true), top, height);
    const { ctx } = plot;
    ctx.save();
    ctx.beginPath();
    ctx.arc(x, y, 0.38 * parseFloat(getComputedStyle(document.documentElement).fontSize) * devicePixelRatio, 0, 2 * Math.PI);
    ctx.fillStyle = colour("--ink");
    ctx.strokeStyle = colour("--panel");
    ctx.lineWidth = 2 * devicePixelRatio;
    ctx.fill();
    ctx.stroke();
    ctx.restore();
  }
}

// Colours and sizes of this theme, and what all axes have in common.
export function looks() {
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  const rem = parseFloat(style.fontSize);
  const axis = {
    stroke: colour("--soft"), font: `${Math.round(0.8 * rem)}px system-ui, "DejaVu Sans", sans-serif`,
    grid: { stroke: colour("--grid"), width: 1 }, ticks: { show: false }, space: 2.2 * rem, gap: 0.15 * rem,
    values: (_plot, ticks) => ticks.map((one) => Number(one.toPrecision(6))),
  };
  return { colour, rem, axis };
}
