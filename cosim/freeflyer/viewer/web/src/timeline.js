// Play, pause, speed, the time slider, and the marks above it.

import { MEANING } from "./colors.js";
import { css, h, icon, setIcon, short } from "./dom.js";

const SPEEDS = [0.01, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 25, 100];
const LANE = 16;
const MOST_EVENTS = 200;
const KINDS = { "base sample": "base samples", "passivity control": "passivity control acts", fault: "fault", stop: "stop" };

export class Timeline {
  /**
   * @param {any[]} runs
   * @param {any} clock {start, stop, time, playing, speed, seek(t), toggle(), changed()}
   */
  constructor(runs, clock) {
    this.runs = runs;
    this.clock = clock;
    const duration = clock.stop - clock.start;
    this.digits = Math.min(4, Math.max(1, Math.ceil(3 - Math.log10(Math.max(duration, 1e-3)))));
    const button = (name, label, keys, onclick) =>
      h("button", { type: "button", class: "icon", "aria-label": label, title: `${label} (${keys})`, onclick }, icon(name));
    this.playButton = button("play", "Play", "Space", () => clock.toggle());
    this.playButton.classList.add("main");
    this.speed = h(
      "select",
      { "aria-label": "Speed", title: "Speed (< and >)", onchange: () => (clock.speed = Number(this.speed.value)) },
      ...SPEEDS.map((s) => h("option", { value: s, text: `×${s}`, selected: s === 1 })),
    );
    this.readout = h("output", { class: "time", "aria-label": "Time" });
    this.slider = h("input", {
      type: "range",
      min: clock.start,
      max: clock.stop > clock.start ? clock.stop : clock.start + 1,
      step: "any",
      "aria-label": "Time",
      oninput: () => clock.seek(Number(this.slider.value)),
      onkeydown: (event) => this.sliderKey(event),
    });
    this.canvas = h("canvas", { class: "marks", role: "img", "aria-label": "Marks on the time axis; the list of events has their texts" });
    this.tip = h("div", { class: "tip", hidden: true });
    this.scrub = h("div", { class: "scrub" }, this.canvas, this.slider, this.tip);
    this.all = runs.flatMap((run, k) => run.marks.map((mark) => ({ ...mark, run: k })));
    this.all.sort((p, q) => p.time - q.time);
    this.events = this.all.filter((mark) => mark.kind !== "base sample");
    this.element = h(
      "footer",
      { class: "timeline", "aria-label": "Time" },
      h(
        "div",
        { class: "transport" },
        button("start", "First sample", "Home", () => clock.seek(clock.start)),
        button("back", "Previous mark", ",", () => this.jump(-1)),
        this.playButton,
        button("forward", "Next mark", ".", () => this.jump(1)),
        button("end", "Last sample", "End", () => clock.seek(clock.stop)),
        this.speed,
        this.readout,
      ),
      this.scrub,
      h("div", { class: "below" }, this.key(), this.list()),
    );
    this.canvas.style.height = `${LANE * runs.length}px`;
    this.scrub.addEventListener("pointermove", (event) => this.point(event));
    this.scrub.addEventListener("pointerleave", () => (this.tip.hidden = true));
    new ResizeObserver(() => this.drawMarks()).observe(this.canvas);
  }

  /** Legend of the kinds of marks that occur. */
  key() {
    const kinds = new Set(this.all.map((mark) => mark.kind));
    return h(
      "ul",
      { class: "key", "aria-label": "Marks" },
      ...Object.entries(KINDS)
        .filter(([kind]) => kinds.has(kind))
        .map(([kind, text]) => {
          const swatch = h("i", { class: `mark ${kind.replace(" ", "-")}` });
          return h("li", {}, swatch, h("span", { text }));
        }),
    );
  }

  list() {
    if (!this.events.length) return null;
    const items = this.events.slice(0, MOST_EVENTS).map((mark) =>
      h(
        "li",
        {},
        h("button", {
          type: "button",
          text: `${this.format(mark.time)} ${this.describe(mark)}`,
          onclick: () => this.clock.seek(mark.time),
        }),
      ),
    );
    if (this.events.length > MOST_EVENTS) items.push(h("li", { text: `and ${this.events.length - MOST_EVENTS} more` }));
    return h("details", { class: "events" }, h("summary", { text: `Events (${this.events.length})` }), h("ol", {}, ...items));
  }

  describe(mark) {
    const run = this.runs.length > 1 ? ` [${short(this.runs[mark.run].label, 30)}]` : "";
    return short(mark.text || mark.kind, 160) + run;
  }

  format(t) {
    return `${t.toFixed(this.digits)} s`;
  }

  sliderKey(event) {
    const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 };
    if (event.key in steps && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      event.stopPropagation();
      this.clock.step(steps[event.key] * (event.shiftKey ? 100 : 1));
    }
  }

  jump(direction) {
    const { time } = this.clock;
    const marks = this.events.length ? this.events : this.all;
    const next = direction > 0 ? marks.find((m) => m.time > time + 1e-9) : marks.findLast((m) => m.time < time - 1e-9);
    if (next) this.clock.seek(next.time);
  }

  changeSpeed(direction) {
    const next = SPEEDS[SPEEDS.indexOf(this.clock.speed) + direction];
    if (next) this.speed.value = String((this.clock.speed = next));
  }

  moveTo(t, playing) {
    this.slider.value = String(t);
    this.readout.textContent = `${t.toFixed(this.digits)} / ${this.format(this.clock.stop)}`;
    this.slider.setAttribute("aria-valuetext", this.format(t));
    if (this.shownPlaying !== playing) {
      this.shownPlaying = playing;
      setIcon(this.playButton, playing ? "pause" : "play");
      this.playButton.setAttribute("aria-label", playing ? "Pause" : "Play");
    }
  }

  position(t, width) {
    const { start, stop } = this.clock;
    return 8 + ((t - start) / (stop - start || 1)) * (width - 16); // the slider's thumb is 16 px wide
  }

  drawMarks() {
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth;
    const height = LANE * this.runs.length;
    if (!width) return;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    const c = this.canvas.getContext("2d");
    c.scale(ratio, ratio);
    this.runs.forEach((run, k) => {
      const top = k * LANE;
      c.fillStyle = css("--line");
      c.fillRect(this.position(run.start, width), top + 4, this.position(run.stop, width) - this.position(run.start, width), LANE - 5);
      for (const kind of ["base sample", "passivity control", "fault", "stop"]) {
        let last = -9;
        for (const mark of run.marks) {
          if (mark.kind !== kind) continue;
          const x = this.position(mark.time, width);
          if (kind === "base sample") {
            if (x - last < 3) continue; // denser ticks would be a bar
            last = x;
            c.fillStyle = css("--muted");
            c.fillRect(x - 0.5, top + LANE - 6, 1, 5);
          } else if (kind === "passivity control") {
            c.fillStyle = MEANING.passivity;
            c.fillRect(x, top + 4, Math.max(1, this.position(mark.until ?? mark.time, width) - x), 6);
          } else if (kind === "fault") {
            c.fillStyle = MEANING.fault;
            c.beginPath();
            c.moveTo(x - 5, top);
            c.lineTo(x + 5, top);
            c.lineTo(x, top + 9);
            c.fill();
          } else {
            c.fillStyle = MEANING.fault;
            c.fillRect(x - 1.5, top, 3, LANE);
            c.fillRect(x - 4, top, 8, 6);
          }
        }
      }
    });
  }

  /** Show the text of the nearest mark below the pointer. */
  point(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = event.clientX - box.left;
    const lane = Math.min(this.runs.length - 1, Math.max(0, Math.floor((event.clientY - box.top) / LANE)));
    let best = null;
    let distance = 7;
    for (const mark of this.all) {
      if (mark.run !== lane) continue;
      const from = this.position(mark.time, box.width);
      const to = mark.until === null ? from : this.position(mark.until, box.width);
      const away = x < from ? from - x : x > to ? x - to : 0;
      const weight = mark.kind === "base sample" ? 1 : 0;
      if (away + weight < distance) {
        distance = away + weight;
        best = mark;
      }
    }
    this.tip.hidden = !best;
    if (!best) return;
    this.tip.textContent = `${this.format(best.time)}  ${this.describe(best)}`;
    this.tip.style.left = `${Math.min(Math.max(0, x - 40), Math.max(0, box.width - 260))}px`;
  }
}
