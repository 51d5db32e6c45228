// Live impedance: what the probe stream of the last seconds shows. A running estimate, no verdict.
import { looks } from "./plane.js";

const get = (id) => document.getElementById(id);
const LOWEST_HZ = 8;
const HIGHEST_HZ = 500;

export class Impedance {
  constructor(ask) {
    this.place = document.querySelector("#impedance .plot");
    this.data = [[LOWEST_HZ, HIGHEST_HZ], ...Array(4).fill([null, null])];
    this.limits = [-1, 1];
    this.build();
    new ResizeObserver(() => this.build()).observe(this.place);
    get("excite").addEventListener("click", () => ask("excite", { on: get("excite").ariaPressed !== "true" }));
  }

  build() {
    this.plot?.destroy();
    const { colour, rem, axis } = looks();
    const series = (stroke, width, dash) => ({ stroke: colour(stroke), width: width * 0.1 * rem, dash, points: { show: false } });
    const options = {
      width: Math.max(50, this.place.clientWidth), height: Math.max(40, this.place.clientHeight),
      padding: [0.4 * rem, 0.8 * rem, 0, 0], legend: { show: false }, cursor: { show: false },
      scales: { x: { time: false, distr: 3, range: [LOWEST_HZ, HIGHEST_HZ] }, y: { range: () => this.limits } },
      axes: [
        { ...axis, size: 1.3 * rem, values: (_plot, ticks) => ticks.map((one) => (one === null ? "" : `${one}`)), filter: (_plot, ticks) => ticks.map((one) => ([10, 20, 50, 100, 200, 500].includes(one) ? one : null)) },
        { ...axis, size: 3 * rem },
      ],
      series: [{}, series("--trace", 1.6), series("--trace", 0.5), series("--trace", 0.5), series("--trace-2", 1, [0.4 * rem, 0.3 * rem])],
      bands: [{ series: [2, 3], fill: colour("--band") }],
      hooks: { drawAxes: [(plot) => zeroLine(plot, colour("--soft"))] },
    };
    this.plot = new uPlot(options, this.data, this.place);
  }

  // told: {note} or {frequency_hz, real, sd, size, seconds, lost, coherence}
  take(told) {
    if (told.note) {
      get("impedance-note").textContent = told.note;
      this.data = [[LOWEST_HZ, HIGHEST_HZ], ...Array(4).fill([null, null])];
    } else {
      const beside = (sign) => told.real.map((one, place) => (one === null ? null : one + sign * 2 * told.sd[place]));
      this.data = [told.frequency_hz, told.real, beside(1), beside(-1), told.size];
      get("impedance-note").innerHTML = `<span class="real">&mdash; Re Z &plusmn; 2 sd</span> <span class="size">- - |Z|</span> ${told.lost ? `${told.lost} samples lost` : "N&#8239;s/m, Hz"}`;
      this.limits = around(this.data.slice(1).flat());
    }
    this.plot.setData(this.data);
  }

  show(now) {
    get("excite").ariaPressed = String(Boolean(now.perturbing));
  }
}

function around(values) {
  const known = values.filter((one) => one !== null);
  if (!known.length) return [-1, 1];
  const top = Math.max(1, ...known);
  const bottom = Math.min(0, ...known);
  return [bottom - 0.06 * (top - bottom), top + 0.06 * (top - bottom)];
}

function zeroLine(plot, stroke) {
  const { left, width } = plot.bbox;
  const y = plot.valToPos(0, "y", true);
  plot.ctx.save();
  plot.ctx.strokeStyle = stroke;
  plot.ctx.beginPath();
  plot.ctx.moveTo(left, y);
  plot.ctx.lineTo(left + width, y);
  plot.ctx.stroke();
  plot.ctx.restore();
}
