// Plots beside the picture: uPlot draws them once, a line over them shows the time.

import uPlot from "uplot";
import { LINES, LINES_OF_ONE, MEANING, OKABE, themed } from "./colors.js";
import { css, h, short } from "./dom.js";
import { decode, decodeTimes, indexAt } from "./series.js";
import { exponentOf, prefixed, quantity } from "./units.js";

const HEIGHT = 150;
const OBSERVED = /observed energy/i; // plots in which the region below zero has a meaning
const MOST_SIGNALS = 12; // of a run in one plot
const MOST_PLOTS = 24; // at first; a button shows more

/** Signals of all runs that belong in one plot: plots of equal title and unit are drawn together. */
export function joinPlots(runs) {
  const plots = new Map();
  runs.forEach((run, number) => {
    for (const plot of run.raw.plots ?? []) {
      const key = JSON.stringify([plot.title, plot.unit]);
      if (!plots.has(key)) plots.set(key, { title: String(plot.title), unit: String(plot.unit ?? ""), signals: [] });
      for (const [k, signal] of (plot.signals ?? []).entries())
        plots.get(key).signals.push({ run: number, index: k, label: String(signal.label), raw: signal });
    }
  });
  return [...plots.values()];
}

/** Times and values of a signal. */
export async function load(signal) {
  signal.times ??= await decodeTimes(signal.raw.time);
  signal.values ??= await decode(signal.raw.value);
  return signal;
}

/** Times without repetition, since a join keeps one value of each time: repeated times are moved by 1e-12 s. */
function rising(times) {
  if (times.every((t, i) => i === 0 || t > times[i - 1])) return times;
  const result = Float64Array.from(times);
  for (let i = 1; i < result.length; i++) if (!(result[i] > result[i - 1])) result[i] = result[i - 1] + 1e-12;
  return result;
}

/** uPlot expects one list of times: null is a gap, undefined has no sample of the signal. */
function align(signals) {
  const distinct = [...new Set(signals.map((s) => s.times))];
  const gaps = (values) => (values.some((v) => v !== v) ? Array.from(values, (v) => (v === v ? v : null)) : values);
  if (distinct.length === 1) return [distinct[0], ...signals.map((s) => gaps(s.values.subarray(0, s.times.length)))];
  return uPlot.join(
    signals.map((s) => {
      const n = Math.min(s.times.length, s.values.length);
      return [rising(s.times.subarray(0, n)), gaps(s.values.subarray(0, n))];
    }),
    // Gaps of a signal stay gaps where another signal has a sample.
    signals.map(() => [0, 2]),
  );
}

/** Range of the values' axis; a constant is in its middle. */
function rangeOf(low, high) {
  if (low === null || high === null) return [0, 1];
  const half = 0.1 * Math.abs(low) || 1;
  return low === high ? [low - half, high + half] : uPlot.rangeNum(low, high, 0.1, true);
}

class Plot {
  constructor(plot, owner) {
    this.owner = owner;
    this.title = plot.title;
    this.unit = plot.unit;
    this.signals = plot.signals.filter((s) => s.index < MOST_SIGNALS);
    const hidden = plot.signals.length - this.signals.length;
    this.unitShown = h("span", { class: "unit", text: plot.unit });
    this.legend = h("div", { class: "signals" });
    this.body = h("div", { class: "plot-body", role: "img", "aria-label": `Plot of ${short(plot.title)} over time` });
    this.element = h(
      "section",
      { class: "plot", "aria-label": short(plot.title) },
      h("h3", { title: plot.title }, h("span", { text: short(plot.title) }), this.unitShown),
      this.legend,
      hidden > 0 && h("p", { class: "note", text: `${hidden} more signals are not drawn; they are in the CSV file.` }),
      this.body,
    );
    this.body.style.minHeight = `${HEIGHT}px`;
  }

  /** Decode and draw; called when the plot comes into view. */
  async build() {
    if (this.building) return this.building;
    this.building = this.construct();
    return this.building;
  }

  async construct() {
    const { owner } = this;
    await Promise.all(this.signals.map(load));
    this.signals = this.signals.filter((s) => s.times.length && s.values.length);
    if (!this.signals.length) {
      this.body.append(h("p", { class: "note", text: "No values are recorded." }));
      return;
    }
    const one = owner.runs.length === 1;
    const series = [{}];
    for (const signal of this.signals) {
      const colors = one ? LINES_OF_ONE : LINES[signal.run % 2];
      const dash = signal.index < colors.length ? [] : [6, 3];
      signal.color = colors[signal.index % colors.length];
      const stroke = () => (signal.color === OKABE.blue ? css("--blue") : signal.color);
      const number = series.length;
      series.push({ label: signal.label, stroke, width: 1.5, dash, points: { show: false } });
      signal.output = h("output", { class: "value", title: owner.runs[signal.run].label });
      signal.number = number;
    }
    this.addLegend();
    const axis = { stroke: () => css("--muted"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui, sans-serif" };
    const [from, to] = owner.window;
    this.chart = new uPlot(
      {
        width: Math.max(120, this.body.clientWidth),
        height: HEIGHT,
        padding: [8, 12, 0, 0],
        legend: { show: false },
        cursor: {
          x: false,
          y: false,
          points: { show: false },
          drag: { x: true, y: false, setScale: true, click: () => {} },
          bind: { dblclick: () => () => owner.setWindow(...owner.extent) },
        },
        scales: { x: { time: false, min: from, max: to, range: (u, low, high) => [low, high] }, y: { range: (u, low, high) => rangeOf(low, high) } },
        series,
        axes: [
          { ...axis, size: 28, space: 60 },
          {
            ...axis,
            size: 48,
            values: (u, splits) => {
              const exponent = exponentOf(Math.max(...splits.map((v) => Math.abs(v))));
              this.unitShown.textContent = prefixed(this.unit, exponent);
              return splits.map((v) => String(Number((v / 10 ** exponent).toPrecision(6))));
            },
          },
        ],
        hooks: {
          setScale: [(u, key) => key === "x" && owner.setWindow(u.scales.x.min, u.scales.x.max)],
          drawClear: [(u) => this.shade(u)],
        },
      },
      align(this.signals),
      this.body,
    );
    this.line = h("div", { class: "now" });
    this.chart.over.append(this.line);
    let pressed = 0;
    this.chart.over.addEventListener("pointerdown", (event) => (pressed = event.clientX));
    this.chart.over.addEventListener("click", (event) => {
      if (Math.abs(event.clientX - pressed) > 3) return;
      owner.seek(this.chart.posToVal(event.clientX - this.chart.over.getBoundingClientRect().left, "x"));
    });
    new ResizeObserver(() => {
      const width = this.body.clientWidth;
      if (width > 60 && width !== this.chart.width) this.chart.setSize({ width, height: HEIGHT });
      this.moveTo(owner.time);
    }).observe(this.body);
    this.moveTo(owner.time);
    this.showValues(owner.time);
  }

  /** One entry for each label: the lines and values of all runs; a click shows or hides them. */
  addLegend() {
    const entries = new Map();
    for (const signal of this.signals) entries.set(signal.label, [...(entries.get(signal.label) ?? []), signal]);
    for (const [label, signals] of entries) {
      const flip = (event) => {
        const button = event.currentTarget;
        const show = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", String(show));
        for (const { number } of signals) this.chart.setSeries(number, { show });
      };
      const lines = signals.flatMap((signal) => {
        const swatch = h("i", { class: "swatch" });
        swatch.style.background = themed(signal.color);
        return [swatch, signal.output];
      });
      const name = h("span", { class: "name", text: short(label, 60) });
      const button = h("button", { type: "button", title: `Show or hide ${short(label, 60)}`, "aria-pressed": "true", onclick: flip });
      if (signals.length > 1) button.append(name, ...lines);
      else button.append(lines[0], name, lines[1]);
      this.legend.append(button);
    }
  }

  /** Shade the times at which passivity control acts, and mark faults and stops. */
  shade(u) {
    const { ctx } = u;
    const { left, top, width, height } = u.bbox;
    const { runs } = this.owner;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    const one = runs.length === 1;
    const strip = 5 * devicePixelRatio; // of two runs, each has a strip at the top
    runs.forEach((run, k) => {
      for (const mark of run.marks) {
        if (mark.kind === "base sample") continue;
        const x = u.valToPos(mark.time, "x", true);
        if (mark.kind === "passivity control" && mark.until !== null) {
          const until = u.valToPos(mark.until, "x", true);
          ctx.fillStyle = MEANING.passivity + (one ? "30" : "b0");
          ctx.fillRect(x, one ? top : top + k * (strip + 1), Math.max(1, until - x), one ? height : strip);
        } else if (mark.kind === "fault" || mark.kind === "stop") {
          ctx.fillStyle = MEANING.fault + (mark.kind === "stop" ? "ff" : "90");
          ctx.fillRect(x - 1, top, 2, height);
        }
      }
    });
    // Zero matters: an observed energy below it is generated energy.
    const zero = u.valToPos(0, "y", true);
    if (zero > top && zero < top + height) {
      if (OBSERVED.test(this.title)) {
        ctx.fillStyle = MEANING.fault + "1c";
        ctx.fillRect(left, zero, width, top + height - zero);
        ctx.fillStyle = css("--warn");
        ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
        ctx.textBaseline = "bottom";
        ctx.fillText("below 0: the port generates energy", left + 6 * devicePixelRatio, top + height - 3 * devicePixelRatio);
      }
      ctx.fillStyle = css("--muted");
      ctx.fillRect(left, Math.round(zero), width, 1);
    }
    ctx.restore();
  }

  moveTo(t) {
    if (!this.chart) return;
    const { min, max } = this.chart.scales.x;
    const x = ((t - min) / (max - min)) * this.chart.over.clientWidth;
    this.line.style.display = t >= min && t <= max ? "" : "none";
    this.line.style.transform = `translateX(${x}px)`;
  }

  showValues(t) {
    if (!this.chart) return;
    for (const signal of this.signals) {
      const i = indexAt(signal.times, t);
      signal.output.textContent = t < signal.times[0] ? "–" : quantity(signal.values[i], this.unit);
    }
  }

  setWindow(from, to) {
    if (!this.chart) return;
    const { min, max } = this.chart.scales.x;
    if (min !== from || max !== to) this.chart.setScale("x", { min: from, max: to });
    this.moveTo(this.owner.time);
  }
}

export class Plots {
  /**
   * @param {any[]} runs
   * @param {[number, number]} extent first and last time
   * @param {(t: number) => void} seek is called when a time is clicked
   */
  constructor(runs, extent, seek) {
    this.runs = runs;
    this.extent = extent;
    this.window = extent;
    this.seek = seek;
    this.time = extent[0];
    this.joined = joinPlots(runs);
    this.plots = [];
    this.visible = new Set();
    this.element = h("div", { class: "plots" });
    this.observer = new IntersectionObserver(
      (entries) => {
        for (const { target, isIntersecting } of entries) {
          const plot = this.plots.find((p) => p.element === target);
          if (isIntersecting) {
            this.visible.add(plot);
            plot.build().then(() => {
              plot.moveTo(this.time);
              plot.showValues(this.time);
            });
          } else this.visible.delete(plot);
        }
      },
      { rootMargin: "200px" },
    );
    this.more = h("button", { type: "button", class: "more", onclick: () => this.show() });
    this.element.append(this.more);
    this.show();
    if (!this.joined.length) this.element.append(h("p", { class: "note", text: "This run has no signals to plot." }));
  }

  show() {
    const next = this.joined.slice(this.plots.length, this.plots.length + MOST_PLOTS);
    for (const raw of next) {
      const plot = new Plot(raw, this);
      this.plots.push(plot);
      this.more.before(plot.element);
      this.observer.observe(plot.element);
    }
    const left = this.joined.length - this.plots.length;
    this.more.hidden = left === 0;
    this.more.textContent = `Show more plots (${left} left)`;
  }

  /** Move the lines; the plots are not drawn again. */
  moveTo(t, values) {
    this.time = t;
    for (const plot of this.visible) {
      plot.moveTo(t);
      if (values) plot.showValues(t);
    }
  }

  setWindow(from, to) {
    if (!(to > from) || (this.window[0] === from && this.window[1] === to)) return;
    this.window = [from, to];
    for (const plot of this.plots) plot.setWindow(from, to);
    this.onwindow?.(from, to);
  }

  redraw() {
    for (const plot of this.plots) plot.chart?.redraw(false, true);
  }
}
