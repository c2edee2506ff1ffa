import { LINES, MEANING, themed } from "./colors.js";
import { h, short } from "./dom.js";
import { fromHash, picture, saveCsv, savePicture, toHash } from "./exports.js";
import { identity } from "./kinematics.js";
import { Plots } from "./plots.js";
import { Run } from "./run.js";
import { indexAt } from "./series.js";
import { DECADES, Stage } from "./stage.js";
import { Timeline } from "./timeline.js";
import { quantity } from "./units.js";

const FACTORS = ["1", "10", "100", "1000", "auto"];
const FOLLOW = { none: "nothing", base: "base", "end-effector": "end-effector" };
const TRAILS = { 0: "off", 5: "5 s", 20: "20 s", "-1": "whole" };
const VIEWS = { overview: "Overview", front: "Front", side: "Side", top: "Top", base: "B", "end-effector": "E" };
const PORTS = { "port B": "base controller ↔ base", "port M": "manipulator controller ↔ end-effector" };
const ENDS = { completed: "ended", diverged: "diverged", failed: "failed", interrupted: "was interrupted" };
const TEXT_PERIOD = 100; // texts are renewed at this period while playing [ms]
const KEYS = [
  ["Space or K", "play, pause"],
  ["← →", "one sample back, forward; with Shift 100 samples"],
  ["Home, End", "first, last sample"],
  [", and .", "previous, next mark"],
  ["< and >", "slower, faster"],
  ["1 to 6", "view: overview, front, side, top, base, end-effector"],
  ["F", "follow nothing, the base, the end-effector"],
  ["D", "factor of the deviations"],
  ["G, W, T, L, M, J", "desired frames, wrenches, trail, labels, momentum, joint limits"],
  ["[ and ], 0", "shorter, longer time window of the plots, whole run"],
  ["P, C, U", "save picture, CSV file, copy link"],
  ["?", "this list"],
  ["In the picture (Tab)", "arrows rotate, with Shift they move; + and − zoom"],
];

class Viewer {
  constructor(data) {
    this.data = data;
    this.options = { deviation: "auto", follow: "none", trail: 20, ghosts: true, wrenches: true, labels: true, momentum: false, joints: false };
    this.playing = false;
    this.speed = 1;
    this.time = 0;
    this.factor = 1;
    this.scriptTimes = [];
    this.toggles = {};
    this.textDue = 0;
  }

  async load() {
    const raw = (this.data.runs ?? []).slice(0, 2);
    this.runs = await Promise.all(raw.map((run) => Run.load(run)));
    this.start = Math.min(...this.runs.map((run) => run.start));
    this.stop = Math.max(...this.runs.map((run) => run.stop));
    if (!this.runs.length) this.start = this.stop = 0;
    this.time = this.start;
    const title = String(this.data.title ?? "Run");
    document.title = short(title);
    document.documentElement.lang ||= "en";
    document.body.append(this.header(title), this.main(), this.timeline.element, this.help(), (this.said = h("div", { class: "said", role: "status" })));
    this.makeStage();
    document.addEventListener("keydown", (event) => this.key(event));
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.theme());
    window.addEventListener("hashchange", () => this.follow(location.hash));
    window.addEventListener("resize", () => this.invalidate());
    this.seek(this.start);
    this.follow(location.hash);
    this.frame(performance.now());
  }

  // Elements.

  header(title) {
    const notes = [...(this.data.notes ?? []), ...this.runs.flatMap((run) => [...(run.raw.notes ?? []), ...(run.scene?.notes ?? [])])];
    const button = (text, key, onclick) => h("button", { type: "button", text, title: `${text} (${key})`, onclick });
    return h(
      "header",
      { class: "top" },
      h("h1", { text: short(title, 200), title }),
      notes.length > 0 &&
        h("details", { class: "notes" }, h("summary", { text: `Notes (${notes.length})` }), h("ul", {}, ...notes.slice(0, 100).map((note) => h("li", { text: short(note, 400) })))),
      h(
        "div",
        { class: "buttons" },
        button("Picture", "P", () => this.savePicture()),
        button("CSV", "C", () => this.saveCsv()),
        button("Link", "U", () => this.link()),
        button("Keys", "?", () => this.dialog.showModal()),
      ),
    );
  }

  main() {
    this.timeline = new Timeline(this.runs, this);
    this.plots = new Plots(this.runs, [this.start, this.stop > this.start ? this.stop : this.start + 1], (t) => this.seek(t));
    this.panels = this.runs.map((run, k) => {
      const name = h("div", { class: "name", text: short(run.label || run.raw.title || `run ${k + 1}`, 80), title: run.raw.title ?? "" });
      name.style.borderColor = this.runs.length > 1 ? themed(LINES[k][0]) : MEANING.end_effector;
      const panel = {
        name: name.textContent,
        state: h("div", { class: "state" }),
        chip: h("div", { class: "chip", hidden: true }),
        end: h("div", { class: "end", role: "status", hidden: true }),
        joints: this.jointBars(run),
      };
      panel.element = h("div", { class: "panel" }, h("div", { class: "veil" }), h("div", { class: "caption" }, name, panel.state, panel.chip, panel.end, panel.joints?.element));
      return panel;
    });
    this.view = h(
      "div",
      {
        class: "stage",
        tabindex: 0,
        role: "application",
        "aria-label": "Picture of the robot. Arrow keys rotate, with Shift they move, plus and minus zoom.",
      },
      ...this.panels.map((panel) => panel.element),
    );
    this.legend = this.makeLegend();
    this.tools = this.toolbar();
    const frame = h("div", { class: this.runs.length > 1 ? "frame two" : "frame" }, this.view);
    const picture = h("section", { class: "picture", "aria-label": "Picture" }, this.tools, frame, this.legend);
    const zoom = (text, label, keys, factor) => h("button", { type: "button", text, "aria-label": text === "All" ? null : label, title: `${label} (${keys})`, onclick: () => this.zoom(factor) });
    this.windowText = h("output", { class: "window", "aria-label": "Time window" });
    const plots = h(
      "section",
      { class: "side", "aria-label": "Plots" },
      h(
        "div",
        { class: "tools" },
        h("h2", { text: "Plots" }),
        this.runs.length > 1 && this.lineKey(),
        h("div", { class: "group", role: "group", "aria-label": "Time window" }, zoom("+", "Shorter time window", "[", 0.5), zoom("−", "Longer time window", "]", 2), zoom("All", "Whole run", "0", Infinity)),
        this.windowText,
      ),
      h("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Plots, drag to zoom in time, click to go to a time" }, this.plots.element),
    );
    this.plots.onwindow = () => this.showWindow();
    this.showWindow();
    // A robot without a run has only a picture.
    const alone = this.runs.length > 0 && this.stop === this.start && !this.plots.joined.length;
    plots.hidden = this.timeline.element.hidden = alone;
    return h("main", { class: alone && "alone" }, picture, plots);
  }

  lineKey() {
    return h(
      "ul",
      { class: "key" },
      ...this.runs.map((run, k) => {
        const swatch = h("i", { class: "swatch" });
        swatch.style.background = themed(LINES[k][0]);
        return h("li", {}, swatch, h("span", { text: short(run.label, 30) }));
      }),
    );
  }

  toolbar() {
    const choice = (label, key, values, set) =>
      h(
        "label",
        { title: `${label} (${key})` },
        h("span", { text: label }),
        (this.toggles[label] = h("select", { onchange: (event) => set(event.target.value) }, ...Object.entries(values).map(([value, text]) => h("option", { value, text })))),
      );
    const toggle = (name, text, key, available) => {
      const button = h("button", { type: "button", text, title: available ? `${text} (${key})` : `${text}: not recorded`, disabled: !available, "aria-pressed": String(available && this.options[name]), onclick: () => this.toggleOption(name) });
      this.toggles[name] = button;
      return button;
    };
    const group = (label, ...children) => h("div", { class: "group", role: "group", "aria-label": label }, ...children);
    const any = (test) => this.runs.some(test);
    const deviation = group(
      "Deviation drawn times",
      h("span", { text: "Deviation" }),
      ...FACTORS.map((value) => {
        const button = h("button", { type: "button", text: value === "auto" ? "auto" : `×${value}`, title: "The deviations from the desired frames are drawn larger, for display only (D)", "aria-pressed": String(value === this.options.deviation), onclick: () => this.setDeviation(value) });
        this.toggles[`deviation ${value}`] = button;
        return button;
      }),
    );
    const element = h(
      "div",
      { class: "tools", role: "toolbar", "aria-label": "Picture" },
      group("View", h("span", { text: "View" }), ...Object.entries(VIEWS).map(([name, text], k) => h("button", { type: "button", text, title: `View: ${name} (${k + 1})`, onclick: () => this.preset(name) }))),
      any((run) => run.desired || run.setPoint) && deviation,
      group(
        "Show",
        toggle("ghosts", "Desired", "G", any((run) => run.desired || run.setPoint)),
        toggle("wrenches", "Wrenches", "W", any((run) => run.wrenches.length)),
        toggle("labels", "Labels", "L", true),
        toggle("momentum", "Momentum", "M", any((run) => run.centerOfMass)),
        toggle("joints", "Joint limits", "J", any((run) => run.jointMargin || (run.joints && run.scene))),
      ),
      choice("Trail", "T", TRAILS, (value) => this.set("trail", Number(value))),
      choice("Follow", "F", FOLLOW, (value) => this.set("follow", value)),
    );
    this.toggles.Trail.value = String(this.options.trail);
    return element;
  }

  makeLegend() {
    const item = (color, text, kind = "dot") => {
      const mark = h("i", { class: kind });
      mark.style.setProperty("--mark", color);
      return h("li", {}, mark, h("span", { text }));
    };
    const any = (test) => this.runs.some(test);
    const wrenches = new Map(this.runs.flatMap((run) => run.wrenches).map((w) => [w.name, w]));
    const ports = [...wrenches.values()].filter((w) => !w.passivity);
    const added = [...wrenches.values()].filter((w) => w.passivity);
    const place = (at) => (at === "base" ? "at the base" : "at the end-effector");
    this.scales = h("div", { class: "scales" });
    const items = [
      any((run) => run.desired || run.setPoint) && item(MEANING.wanted, "desired: E (sphere), B (outline)"),
      any((run) => run.scene) && item(MEANING.end_effector, "actual E and its trail"),
      ...ports.slice(0, 6).map((w) => item(MEANING[w.at] ?? MEANING.base, `${short(w.name, 60)}: ${PORTS[w.name] ?? `wrench ${place(w.at)}`}`, "arrow")),
      added.length > 0 && item(MEANING.passivity, "added by the passivity controllers", "arrow"),
    ];
    const axes = h("li", { class: "axes" });
    axes.title = "axes of the frames";
    ["x", "y", "z"].forEach((name, k) => {
      const mark = h("i", { class: "arrow" });
      mark.style.setProperty("--mark", MEANING.axes[k]);
      axes.append(mark, h("span", { text: name }));
    });
    items.push(axes);
    const wide = window.matchMedia("(min-width: 821px)").matches;
    return h("details", { class: "legend", open: wide }, h("summary", { text: "Legend" }), h("ul", {}, ...items), this.scales);
  }

  /** Rulers of the logarithmic arrows. */
  showScales() {
    const ruler = (text, largest, unit) => {
      if (!(largest > 0)) return null;
      const ticks = h("div", { class: "ticks" });
      for (let k = 0; k <= DECADES; k++) {
        const value = Number((largest * 10 ** (k - DECADES)).toPrecision(3));
        ticks.append(h("span", { text: k === 0 ? "0" : k === DECADES ? `${value} ${unit}` : String(value) }));
      }
      return h("div", { class: "ruler" }, h("span", { text }), ticks);
    };
    const { force, torque, linear, angular } = this.stage.scales;
    this.scales.replaceChildren(
      ...[
        this.options.wrenches && ruler("force (one head)", force, "N"),
        this.options.wrenches && ruler("torque (two heads)", torque, "N m"),
        this.options.momentum && ruler("momentum (yellow)", linear, "N s"),
        this.options.momentum && ruler("angular momentum (two heads)", angular, "N m s"),
      ].filter(Boolean),
    );
  }

  jointBars(run) {
    if (!run.scene || !run.joints) return null;
    const rows = run.scene.joints.slice(0, 40).map((joint) => {
      const limited = Number.isFinite(joint.lower) && Number.isFinite(joint.upper) && joint.upper > joint.lower;
      const dot = h("i");
      const value = h("output");
      const bar = h("div", { class: limited ? "bar" : "bar free" }, dot);
      return { joint, limited, dot, value, bar, element: h("div", { class: "joint" }, h("span", { text: short(joint.name, 18) }), bar, value) };
    });
    const margin = h("div", { class: "margin" });
    return { rows, margin, element: h("div", { class: "joints", hidden: true }, margin, ...rows.map((row) => row.element)) };
  }

  help() {
    this.dialog = h(
      "dialog",
      { class: "keys", "aria-label": "Keys" },
      h("h2", { text: "Keys" }),
      h("dl", {}, ...KEYS.flatMap(([key, text]) => [h("dt", { text: key }), h("dd", { text })])),
      h("p", { class: "note", text: short(this.data.created_by ?? "") }),
      h("button", { type: "button", text: "Close", onclick: () => this.dialog.close() }),
    );
    return this.dialog;
  }

  makeStage() {
    const refuse = (reason) => {
      this.view.classList.add("blind");
      this.view.append(h("p", { class: "reason", role: "status", text: reason }));
      this.legend.hidden = this.tools.hidden = true;
      this.view.setAttribute("aria-label", "No picture");
    };
    if (!this.runs.length) return refuse("This page has no run.");
    for (const [k, run] of this.runs.entries()) {
      const note = !run.scene && !run.base ? "No poses are recorded." : !run.scene ? "The run has no geometry: only frames are drawn." : !run.base && !run.joints ? "No poses are recorded: the robot is drawn with all joints at zero." : "";
      const shapes = run.scene?.drawn === "inertia" ? "The shapes are made from inertia and joints; the robot looks different." : "";
      for (const text of [note, shapes].filter(Boolean)) this.panels[k].element.querySelector(".caption").append(h("p", { class: "note", text }));
    }
    try {
      this.stage = new Stage(this.view, this.panels.map((panel) => panel.element), this.runs, () => this.invalidate());
    } catch (error) {
      return refuse(`There is no picture: ${error.message} The plots work without it.`);
    }
    this.stage.actors.forEach((actor, k) => {
      if (actor.undrawn) this.panels[k].element.querySelector(".caption").append(h("p", { class: "note", text: `${actor.undrawn} shapes of the robot cannot be drawn.` }));
    });
    this.showScales();
    this.stage.canvas.addEventListener("webglcontextlost", () => this.say("The graphics card stopped drawing. The plots go on; the picture returns when the browser restores it."));
  }

  // Time.

  seek(t) {
    this.time = Math.min(this.stop, Math.max(this.start, Number.isFinite(t) ? t : this.start));
    for (const run of this.runs) run.moveTo(this.time);
    this.invalidate();
  }

  /** Go `count` samples of the first run forward. */
  step(count) {
    const times = this.runs[0]?.time ?? [];
    let i = indexAt(times, this.time);
    const sign = Math.sign(count);
    for (let k = 0; k < Math.abs(count); k++) {
      do i += sign;
      while (i > 0 && i < times.length && times[i] === times[i - sign]);
    }
    if (i < 0) this.seek(this.start);
    else this.seek(i < times.length ? times[i] : this.stop);
  }

  toggle() {
    if (!this.playing && this.time >= this.stop) this.seek(this.start);
    this.playing = !this.playing;
    if (this.playing) this.scriptTimes = [];
    this.before = null;
    this.invalidate();
  }

  invalidate() {
    if (this.requested) return;
    this.requested = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    const begin = performance.now();
    this.requested = false;
    const played = this.playing;
    if (this.playing) {
      const passed = this.before === null ? 0 : Math.min(0.25, (now - this.before) / 1000);
      this.before = now;
      this.time = Math.min(this.stop, this.time + passed * this.speed);
      for (const run of this.runs) run.moveTo(this.time);
      if (this.time >= this.stop) this.playing = false;
    }
    const texts = !this.playing || now >= this.textDue;
    if (texts) this.textDue = now + TEXT_PERIOD;
    this.show(texts);
    if (played) {
      this.scriptTimes.push(performance.now() - begin);
      if (this.scriptTimes.length > 240) this.scriptTimes.shift();
    }
    if (this.playing) this.invalidate();
  }

  /** Show the state at this time. @param {boolean} texts renew the texts, too: this takes longer than the picture */
  show(texts) {
    this.factor = this.options.deviation === "auto" ? (this.stage?.automaticFactor(this.time) ?? 1) : Number(this.options.deviation);
    this.panels.forEach((panel, k) => this.showState(panel, this.runs[k], texts));
    this.stage?.draw(this.time, this.options, this.factor);
    this.plots.moveTo(this.time, texts);
    if (texts) this.timeline.moveTo(this.time, this.playing);
    else this.timeline.slider.value = String(this.time);
  }

  showState(panel, run, texts) {
    const over = this.time >= run.stop && run.time.length > 0;
    const elsewhere = over && this.time > run.stop;
    panel.element.classList.toggle("ended", elsewhere);
    if (!texts) return;
    const shown = over && (elsewhere || run.end.kind !== "completed");
    panel.end.hidden = !shown;
    if (shown) {
      const cause = run.end.cause ? `: ${run.end.cause}` : "";
      const at = Number.isFinite(run.end.time) ? run.end.time : run.stop;
      panel.end.textContent = short(`${ENDS[run.end.kind] ?? run.end.kind} at ${this.timeline.format(at)}${cause}`, 300);
    }
    const parts = [];
    const add = (name, d) => d && Number.isFinite(d.distance) && parts.push(`${name}: ${quantity(d.distance, "m")}, ${quantity(d.angle, "rad")}`);
    add("E", run.deviationOfEnd());
    add("B", run.deviationOfBase());
    panel.state.textContent = parts.length ? `deviation  ${parts.join("   ")}` : "";
    const magnified = this.stage && this.factor !== 1 && parts.length > 0 && this.options.ghosts;
    panel.chip.hidden = !magnified;
    if (magnified) panel.chip.textContent = `deviation drawn ×${this.factor}, display only`;
    if (panel.joints && this.options.joints) this.showJoints(panel.joints, run);
  }

  showJoints({ rows, margin }, run) {
    const least = run.jointMargin?.[run.index];
    margin.textContent = least === undefined ? "joint positions" : `least margin ${quantity(least, "rad")}`;
    rows.forEach(({ joint, limited, dot, value, bar }, k) => {
      const q = run.q[k];
      value.textContent = quantity(q, joint.kind === "prismatic" ? "m" : "rad");
      if (!limited) return;
      const share = (q - joint.lower) / (joint.upper - joint.lower);
      dot.style.left = `${100 * Math.min(1, Math.max(0, share || 0))}%`;
      bar.classList.toggle("near", share < 0.05 || share > 0.95);
    });
  }

  // Options.

  set(name, value) {
    this.options[name] = value;
    this.invalidate();
  }

  toggleOption(name) {
    if (this.toggles[name].disabled) return;
    this.set(name, !this.options[name]);
    this.toggles[name].setAttribute("aria-pressed", String(this.options[name]));
    if (name === "joints") for (const { joints } of this.panels) if (joints) joints.element.hidden = !this.options.joints;
    if (this.stage) this.showScales();
  }

  setDeviation(value) {
    for (const factor of FACTORS) this.toggles[`deviation ${factor}`]?.setAttribute("aria-pressed", String(factor === value));
    this.set("deviation", value);
  }

  preset(name) {
    this.stage?.preset(name);
    this.invalidate();
  }

  next(label, values) {
    const select = this.toggles[label];
    const keys = [...select.options].map((option) => option.value);
    select.value = keys[(keys.indexOf(select.value) + 1) % keys.length];
    select.dispatchEvent(new Event("change"));
  }

  zoom(factor) {
    const [first, last] = this.plots.extent;
    const [from, to] = this.plots.window;
    const span = Math.min(last - first, Math.max((last - first) * 1e-6, (to - from) * factor));
    if (!Number.isFinite(factor) || span >= last - first) return this.plots.setWindow(first, last);
    const begin = Math.min(last - span, Math.max(first, this.time - span / 2));
    this.plots.setWindow(begin, begin + span);
  }

  showWindow() {
    const [from, to] = this.plots.window;
    const digits = Math.min(6, Math.max(0, Math.ceil(2 - Math.log10(to - from))));
    this.windowText.textContent = `${from.toFixed(digits)} to ${to.toFixed(digits)} s`;
  }

  theme() {
    this.stage?.theme();
    this.plots.redraw();
    this.timeline.drawMarks();
    this.invalidate();
  }

  // Files and links.

  say(text) {
    this.said.textContent = text;
    clearTimeout(this.saying);
    this.saying = setTimeout(() => (this.said.textContent = ""), 6000);
  }

  pictureCanvas() {
    const { stage } = this;
    this.show(true); // the drawing buffer is kept until the end of this task
    const captions = this.panels.map((panel) => ({
      lines: [panel.name, panel.state.textContent, panel.chip.hidden ? "" : panel.chip.textContent, panel.end.hidden ? "" : panel.end.textContent].filter(Boolean),
    }));
    const charts = this.plots.plots.filter((plot) => plot.chart && this.plots.visible.has(plot)).slice(0, 6);
    const footer = `t = ${this.timeline.format(this.time)}    ${this.data.title ?? ""}    ${this.data.created_by ?? ""}`;
    return picture(stage, this.panels.map((panel) => panel.element), captions, footer, charts, this.time);
  }

  savePicture() {
    savePicture(this.data.title, this.pictureCanvas());
    this.say("The picture is saved as a PNG file.");
  }

  async saveCsv() {
    await saveCsv(this.data.title, this.runs, this.plots.joined, this.plots.window);
    this.say("The values of the visible time window are saved as a CSV file.");
  }

  async link() {
    const hash = toHash(this.time, this.stage?.view, this.options);
    try {
      history.replaceState(null, "", hash);
      await navigator.clipboard.writeText(location.href);
      this.say("A link with time and camera is in the clipboard and in the address.");
    } catch {
      this.say(`The address has time and camera: ${hash}`);
    }
  }

  /** Apply the state that a link states. */
  follow(hash) {
    const state = fromHash(hash);
    if (FACTORS.includes(state.deviation)) this.setDeviation(state.deviation);
    if (Object.hasOwn(FOLLOW, state.follow)) {
      this.toggles.Follow.value = state.follow;
      this.set("follow", state.follow);
    }
    if (state.view && this.stage) this.stage.view = state.view;
    if (state.time !== undefined) this.seek(state.time);
  }

  // Keys.

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || this.dialog.open) return;
    const { target } = event;
    if (target instanceof HTMLSelectElement) return;
    const onButton = target instanceof HTMLButtonElement || target instanceof HTMLElement && target.tagName === "SUMMARY";
    if (event.key === " " && onButton) return;
    const actions = {
      " ": () => this.toggle(),
      k: () => this.toggle(),
      ArrowLeft: () => this.step(event.shiftKey ? -100 : -1),
      ArrowRight: () => this.step(event.shiftKey ? 100 : 1),
      Home: () => this.seek(this.start),
      End: () => this.seek(this.stop),
      ",": () => this.timeline.jump(-1),
      ".": () => this.timeline.jump(1),
      "<": () => this.timeline.changeSpeed(-1),
      ">": () => this.timeline.changeSpeed(1),
      f: () => this.next("Follow"),
      t: () => this.next("Trail"),
      d: () => this.setDeviation(FACTORS[(FACTORS.indexOf(this.options.deviation) + 1) % FACTORS.length]),
      g: () => this.toggleOption("ghosts"),
      w: () => this.toggleOption("wrenches"),
      l: () => this.toggleOption("labels"),
      m: () => this.toggleOption("momentum"),
      j: () => this.toggleOption("joints"),
      p: () => this.savePicture(),
      c: () => this.saveCsv(),
      u: () => this.link(),
      "[": () => this.zoom(0.5),
      "]": () => this.zoom(2),
      0: () => this.zoom(Infinity),
      "?": () => this.dialog.showModal(),
    };
    Object.keys(VIEWS).forEach((name, k) => (actions[k + 1] = () => this.preset(name)));
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }
}

async function start() {
  if (document.readyState === "loading") await new Promise((done) => document.addEventListener("DOMContentLoaded", done, { once: true }));
  const element = document.getElementById("data");
  const viewer = new Viewer(JSON.parse(element.textContent));
  element.remove(); // its text is not needed any more
  await viewer.load();
  return viewer;
}

let viewer = null;
const ready = start().then(
  (made) => {
    viewer = made;
  },
  (error) => {
    document.body.prepend(h("p", { class: "reason", role: "alert", text: `The data of this page cannot be shown: ${error.message}` }));
    console.error(error);
  },
);

/** For tests: what the page shows. */
window.freeflyerView = {
  ready,
  time: () => viewer.time,
  setTime: (t) => viewer.seek(t),
  /** T_frame in I at the shown time: 16 numbers, column-major, float64, not magnified. */
  pose: (run, frame) => Array.from(viewer.runs[run].poses[frame] ?? identity().fill(NaN)),
  frames: (run) => viewer.runs[run].frames,
  playing: () => viewer.playing,
  play: () => viewer.playing || viewer.toggle(),
  pause: () => viewer.playing && viewer.toggle(),
  factor: () => viewer.factor,
  picture: () => viewer.pictureCanvas().toDataURL("image/png"),
  /** Mean time of script for a frame while playing [ms]; null before the first. */
  scriptTimePerFrame: () => {
    const times = viewer.scriptTimes;
    return times.length ? times.reduce((sum, t) => sum + t, 0) / times.length : null;
  },
};
