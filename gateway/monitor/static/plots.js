// Curves of one drive over the last minute: speed, load torque with its band, probability of loss
// over a strip of what the adhesion flag said. Drawn only while they can be seen.

import { element } from "./parts.js";

const SPAN_S = [10, 60]; // shown at least and at most
const LEFT = 52;

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

function axes(last) {
  const common = { stroke: () => colour("soft"), grid: { stroke: () => colour("grid"), width: 1 },
    ticks: { show: false }, font: "11px system-ui, sans-serif" };
  return [
    { ...common, size: last ? 22 : 0, gap: 2, space: 60,
      values: (_, splits) => splits.map((t) => (last ? `${t} s` : "")) },
    { ...common, size: LEFT, gap: 4, space: 26 },
  ];
}

function span(low, high) {
  return high - Math.min(Math.max(high - low, SPAN_S[0]), SPAN_S[1]);
}

// At least `least` high, so that noise is not blown up to fill the plot.
function range(least) {
  return (_, low, high) => {
    if (low === null || high === null) return [0, least];
    const middle = (low + high) / 2;
    const half = Math.max((high - low) * 0.55, least / 2);
    return [middle - half, middle + half];
  };
}

const LINE = { stroke: () => colour("curve"), width: 1.6, spanGaps: false, points: { show: false } };
const HIDDEN = { stroke: "transparent", width: 0, spanGaps: false, points: { show: false } };

class Plot {
  constructor(parent, { title, last = false, series, bands, y, hooks = {} }) {
    parent.append(element("h3", "", title));
    this.box = element("div", last ? "plot last" : "plot");
    this.box.setAttribute("role", "img");
    parent.append(this.box);
    this.options = {
      width: 300, height: last ? 108 : 92, series: [{}, ...series], bands, hooks,
      legend: { show: false }, cursor: { show: false }, axes: axes(last),
      padding: [6, 8, last ? 0 : 4, 0],
      scales: { x: { time: false, range: (_, low, high) => [span(low, high), high] }, y: { range: y } },
    };
    this.uplot = null;
  }

  draw(data) {
    const width = this.box.clientWidth;
    if (width < 80) return;
    if (!this.uplot) {
      this.uplot = new uPlot({ ...this.options, width }, data, this.box);
    } else {
      if (this.uplot.width !== width) this.uplot.setSize({ width, height: this.options.height });
      this.uplot.setData(data);
    }
  }

  // Colours have changed.
  forget() {
    this.uplot?.destroy();
    this.uplot = null;
  }
}

export class Curves {
  constructor(parent, node) {
    this.trace = { t_s: [], speed_rad_s: [], load_nm: [], load_sigma_nm: [], loss_probability: [],
      adhesion: [] };
    this.seen = false;
    this.changed = false;
    this.speed = new Plot(parent, { title: "speed, rad/s", series: [LINE], y: range(4) });
    this.load = new Plot(parent, {
      title: "load torque, Nm; band: ±2 standard deviations",
      series: [LINE, HIDDEN, HIDDEN], y: range(4),
      bands: [{ series: [2, 3], fill: () => colour("band") }],
    });
    this.loss = new Plot(parent, {
      title: "", last: true, series: [LINE], y: () => [0, 1],
      hooks: { drawClear: [(u) => this.strip(u)] },
    });
    const title = this.loss.box.previousElementSibling;
    title.append("probability of loss; flag: ", element("span", "key lost"), " lost, ",
      element("span", "key unknown"), " unknown");
    const names = { speed: "Speed", load: "Load torque", loss: "Probability of loss" };
    for (const [key, text] of Object.entries(names)) {
      this[key].box.setAttribute("aria-label", `${text} of drive ${node} over the last minute`);
    }
    new IntersectionObserver((entries) => {
      this.seen = entries.at(-1).isIntersecting;
      this.draw();
    }).observe(parent);
    new ResizeObserver(() => { this.changed = true; this.draw(); }).observe(parent);
  }

  take(t_s, points, fresh) {
    const given = { ...points, t_s };
    for (const [name, kept] of Object.entries(this.trace)) {
      if (fresh) kept.length = 0;
      kept.push(...given[name]);
      if (kept.length > 600) kept.splice(0, kept.length - 600);
    }
    this.changed = true;
  }

  draw() {
    if (!this.seen || !this.changed) return;
    this.changed = false;
    const { t_s, speed_rad_s, load_nm, load_sigma_nm, loss_probability } = this.trace;
    const edge = (sign) => load_nm.map((load, k) => (load === null || load_sigma_nm[k] === null
      ? null : load + sign * 2 * load_sigma_nm[k]));
    this.speed.draw([t_s, speed_rad_s]);
    this.load.draw([t_s, load_nm, edge(1), edge(-1)]);
    this.loss.draw([t_s, loss_probability]);
  }

  recolour() {
    for (const plot of [this.speed, this.load, this.loss]) plot.forget();
    this.changed = true;
    this.draw();
  }

  // Hatched where the flag said lost, dotted where unknown.
  strip(u) {
    const { t_s, adhesion } = this.trace;
    const { left, top, height, width } = u.bbox;
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(left, top, width, height);
    u.ctx.clip();
    for (let k = 0; k < t_s.length;) {
      let end = k + 1;
      while (end < t_s.length && adhesion[end] === adhesion[k]) end += 1;
      const from = u.valToPos(t_s[k], "x", true);
      const to = u.valToPos(t_s[Math.min(end, t_s.length - 1)], "x", true);
      if (adhesion[k] !== "Adhering" && to > left) {
        fill(u.ctx, adhesion[k] === "AdhesionLost", Math.max(from, left), top, to, height);
      }
      k = end;
    }
    u.ctx.restore();
  }
}

function fill(ctx, lost, from, top, to, height) {
  const step = 8 * devicePixelRatio;
  ctx.save();
  ctx.beginPath();
  ctx.rect(from, top, to - from, height);
  ctx.clip();
  ctx.strokeStyle = colour("bad");
  ctx.fillStyle = colour("soft");
  ctx.lineWidth = 2 * devicePixelRatio;
  // On a raster of the picture, so that it does not crawl as time goes on.
  if (lost) {
    ctx.beginPath();
    for (let x = Math.floor((from - height) / step) * step; x < to; x += step) {
      ctx.moveTo(x, top + height);
      ctx.lineTo(x + height, top);
    }
    ctx.stroke();
  } else {
    const size = 1.5 * devicePixelRatio;
    for (let x = Math.ceil(from / step) * step; x < to; x += step) {
      for (let y = top + step / 2; y < top + height; y += step) ctx.fillRect(x, y, size, size);
    }
  }
  ctx.restore();
}
