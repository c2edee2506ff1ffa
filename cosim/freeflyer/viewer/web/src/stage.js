// The picture: one canvas with a panel for each run, one camera.

import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  Color,
  DirectionalLight,
  GridHelper,
  Group,
  HemisphereLight,
  Line,
  LineBasicMaterial,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  PerspectiveCamera,
  Points,
  PointsMaterial,
  Quaternion,
  Scene,
  Sphere,
  SphereGeometry,
  Spherical,
  TorusGeometry,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { MEANING } from "./colors.js";
import { css } from "./dom.js";
import { indexAt } from "./series.js";
import { Arrow, Label, drawVisual, ghostOfBox, triad } from "./shapes.js";

const FIELD = 38; // field of view [degrees]
const CAPTION = 90; // height that the captions take from a panel [px]
const LARGEST_TURN = (2 * Math.PI) / 3; // magnified rotations are not drawn larger [rad]
export const DECADES = 4; // from the shortest to the longest arrow

const UP = new Vector3(0, 1, 0);
const a = new Matrix4();
const position = new Vector3();
const rotation = new Quaternion();
const wantedRotation = new Quaternion();
const unit = new Vector3(1, 1, 1);
const axis = new Vector3();
const vector = new Vector3();
const numbers = [0, 0, 0];

/** The ghost's pose for display: its deviation from `actual`, times `factor`. */
function magnify(actual, wanted, factor, out) {
  out.fromArray(wanted);
  if (factor === 1) return out;
  rotation.setFromRotationMatrix(a.fromArray(actual));
  wantedRotation.setFromRotationMatrix(out);
  const turn = rotation.clone().invert().multiply(wantedRotation);
  if (turn.w < 0) turn.set(-turn.x, -turn.y, -turn.z, -turn.w);
  axis.set(turn.x, turn.y, turn.z);
  const sine = axis.length();
  const angle = Math.min(LARGEST_TURN, 2 * Math.atan2(sine, turn.w) * factor);
  if (sine > 0) rotation.multiply(turn.setFromAxisAngle(axis.multiplyScalar(1 / sine), angle));
  for (let k = 0; k < 3; k++) numbers[k] = actual[12 + k] + factor * (wanted[12 + k] - actual[12 + k]);
  return out.compose(position.fromArray(numbers), rotation, unit);
}

/** Power of ten that is not less than the largest length of the vectors; 0 without any. */
function decadeAbove(lists) {
  let largest = 0;
  for (const [x, y, z] of lists) {
    if (!x || !y || !z) continue;
    for (let i = 0; i < x.length; i++) {
      const size = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
      if (size > largest) largest = size;
    }
  }
  return largest > 0 && Number.isFinite(largest) ? 10 ** Math.ceil(Math.log10(largest) / 2 - 1e-9) : 0;
}

/** Objects of one run. */
class Actor {
  constructor(run, stage) {
    this.run = run;
    this.scene = new Scene();
    this.root = new Group();
    this.scene.add(this.root);
    this.scene.add(new HemisphereLight(0xffffff, 0x8d99a8, 2.2));
    const sun = new DirectionalLight(0xffffff, 1.9);
    sun.position.set(2, -3, 5);
    this.scene.add(sun);
    this.robot = new Group();
    this.root.add(this.robot);
    this.groups = run.poses.map(() => {
      const group = new Group();
      group.matrixAutoUpdate = false;
      this.robot.add(group);
      return group;
    });
    this.undrawn = 0;
    for (const visual of run.scene?.visuals ?? []) {
      try {
        const drawn = drawVisual(visual);
        if (!drawn || !this.groups[visual.frame]) throw new Error();
        this.groups[visual.frame].add(drawn);
      } catch {
        this.undrawn += 1;
      }
    }
    this.labels = [];
    this.place(0);
    // The ghost of the base is the box of its largest shape.
    this.baseBox = null;
    let largest = 0;
    const toBase = new Matrix4().copy(this.groups[0].matrix).invert();
    for (const shape of this.groups[0].children) {
      const box = new Box3().setFromObject(shape).applyMatrix4(toBase);
      const { x, y, z } = box.getSize(vector);
      if (x * y * z <= largest) continue;
      largest = x * y * z;
      this.baseBox = box;
    }
  }

  /** Copy the run's poses into the groups. */
  place() {
    this.run.poses.forEach((pose, k) => this.groups[k].matrix.fromArray(pose));
    this.robot.updateMatrixWorld(true);
  }

  label(parent, x, y) {
    const label = new Label(x, y);
    this.labels.push(label);
    parent.add(label);
    return label;
  }

  /** Add frames, ghosts, arrows and trail, in proportion to the robot's size. */
  furnish(size, scales) {
    const { run, root } = this;
    const radius = 0.0055 * size;
    const last = run.poses.length - 1;
    this.size = size;
    this.frameI = triad(0.34 * size, 0.5 * radius, 0.8);
    this.labelI = this.label(this.frameI, 1, 0);
    this.labelI.position.x = 0.34 * size;
    this.frameB = triad(0.16 * size, 0.7 * radius);
    this.groups[0].add(this.frameB);
    root.add(this.frameI);
    this.labelB = this.label(this.groups[0], -1, -1.1);
    const ring = (color, r) =>
      new Mesh(new TorusGeometry(r, 0.12 * r, 10, 40), new MeshBasicMaterial({ color, depthTest: false, transparent: true, opacity: 0.95 }));
    this.ports = [ring(MEANING.base, 0.055 * size)];
    this.groups[0].add(this.ports[0]);
    if (run.chain.end) {
      this.groups[last].add(triad(0.11 * size, 0.7 * radius));
      this.labelE = this.label(this.groups[last], 1, 1.1);
      this.ports.push(ring(MEANING.end_effector, 0.04 * size));
      this.groups[last].add(this.ports[1]);
    }
    for (const port of this.ports) port.renderOrder = 9;

    this.ghosts = new Group();
    root.add(this.ghosts);
    if (run.desired && run.chain.end) {
      this.wanted = this.ghost(size, new SphereGeometry(0.04 * size, 24, 16), 1, 0.09);
      this.wanted.label = this.label(this.wanted, 1, -1.1);
    }
    if (run.setPoint) {
      this.wantedBase = this.ghost(size, null, -1, 0.13);
      if (this.baseBox) this.wantedBase.add(ghostOfBox(this.baseBox, MEANING.wanted));
      this.wantedBase.label = this.label(this.wantedBase, -1, 1.1);
    }
    this.arrows = new Group();
    root.add(this.arrows);
    this.wrenches = run.wrenches.map((wrench) => {
      const color = wrench.passivity ? MEANING.passivity : MEANING[wrench.at] ?? MEANING.base;
      const thick = wrench.passivity ? 0.7 : 1.25;
      const pair = {
        wrench,
        force: new Arrow(color, thick * radius),
        torque: new Arrow(color, 0.55 * thick * radius, 2),
      };
      this.arrows.add(pair.force, pair.torque);
      if (wrench.passivity) pair.force.traverse((object) => (object.renderOrder = 11));
      return pair;
    });
    this.scales = scales;

    this.extras = new Group();
    root.add(this.extras);
    if (run.centerOfMass) {
      this.center = new Group();
      this.center.add(new Mesh(new SphereGeometry(0.025 * size, 20, 14), new MeshBasicMaterial({ color: 0x888888, depthTest: false, transparent: true })));
      this.center.label = this.label(this.center, 1, 1);
      this.extras.add(this.center);
      if (run.momentum) {
        this.linear = new Arrow("#F0E442", radius);
        this.angular = new Arrow("#F0E442", 0.6 * radius, 2);
        this.extras.add(this.linear, this.angular);
      }
    }

    this.trail = this.line(run.table.actual, MEANING.end_effector, 3);
    this.trailWanted = this.line(Float32Array.from(run.table.wanted), MEANING.wanted, 2);
    this.trailFactor = 1;
    this.grid = new GridHelper(6 * size, 24);
    this.grid.rotation.x = Math.PI / 2;
    this.grid.material.transparent = true;
    this.grid.material.depthWrite = false;
    root.add(this.grid);
    this.theme();
  }

  ghost(size, solid, side, length) {
    const ghost = new Group();
    ghost.matrixAutoUpdate = false;
    ghost.add(triad(length * size, 0.003 * size, 0.6));
    if (solid) {
      const skin = new MeshBasicMaterial({ color: MEANING.wanted, transparent: true, opacity: 0.35, depthTest: false });
      ghost.add(new Mesh(solid, skin));
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
    ghost.tie = new Line(geometry, new LineBasicMaterial({ color: MEANING.wanted, depthTest: false, transparent: true }));
    ghost.tie.frustumCulled = false;
    this.ghosts.add(ghost, ghost.tie);
    return ghost;
  }

  line(positions, color, width) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(positions, 3));
    geometry.setDrawRange(0, 0);
    geometry.boundingSphere = new Sphere(); // not computed: the positions may have gaps
    const group = new Group();
    group.add(new Line(geometry, new LineBasicMaterial({ color })));
    group.add(new Points(geometry, new PointsMaterial({ color, size: width, sizeAttenuation: false })));
    for (const object of group.children) object.frustumCulled = false;
    group.geometry = geometry;
    this.root.add(group);
    return group;
  }

  theme() {
    const theme = { background: css("--panel"), text: css("--text") };
    this.colors = theme;
    this.scene.background = new Color(css("--sky"));
    if (!this.grid) return;
    const colors = this.grid.geometry.getAttribute("color");
    const line = new Color(css("--grid"));
    for (let i = 0; i < colors.count; i++) colors.setXYZ(i, line.r, line.g, line.b);
    colors.needsUpdate = true;
    this.labelI.write("I inertial", css("--muted"), theme);
    const ports = (at) => this.run.wrenches.filter((w) => w.at === at && !w.passivity).map((w) => w.name);
    this.labelB.write(["B base", ...ports("base")].join(" · "), MEANING.base, theme);
    this.labelE?.write(["E end-effector", ...ports("end_effector")].join(" · "), MEANING.end_effector, theme);
    this.center?.label.write("centre of mass", "#888888", theme);
  }

  /** Draw the state of the run, which has been moved to the time `t`. */
  update(t, options, factor, anchor) {
    const { run } = this;
    const end = run.endEffector;
    this.place();
    const known = Number.isFinite(run.poses[run.poses.length - 1][12]) && Number.isFinite(run.poses[0][12]);
    this.robot.visible = known;
    const followed = options.follow === "base" ? run.poses[0] : options.follow === "end-effector" ? (end ?? run.poses[0]) : null;
    if (followed && known) this.root.position.set(anchor[12] - followed[12], anchor[13] - followed[13], anchor[14] - followed[14]);
    else if (!followed) this.root.position.set(0, 0, 0);

    const times = factor === 1 ? "" : ` ×${factor}`;
    this.ghosts.visible = options.ghosts && known;
    if (this.wanted) this.moveGhost(this.wanted, end, run.wanted, factor, `E desired${times}`);
    if (this.wantedBase) this.moveGhost(this.wantedBase, run.poses[0], run.setPoint, factor, `B set point${times}`);
    for (const label of this.labels) label.visible = options.labels;

    this.arrows.visible = options.wrenches && known;
    if (this.arrows.visible)
      for (const { wrench, force, torque } of this.wrenches) {
        const frame = wrench.at === "end_effector" && end ? end : run.poses[0];
        this.point(force, frame, run.vector(wrench.force, numbers), this.scales.force);
        this.point(torque, frame, run.vector(wrench.torque, numbers), this.scales.torque);
      }
    this.extras.visible = options.momentum && known;
    if (this.center && this.extras.visible) {
      run.vector(run.centerOfMass, numbers);
      this.center.position.fromArray(numbers);
      const frame = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, ...numbers];
      if (this.linear) {
        this.point(this.linear, frame, run.vector(run.momentum.linear, numbers), this.scales.linear);
        this.point(this.angular, frame, run.vector(run.momentum.angular, numbers), this.scales.angular);
      }
    }
    this.drawTrail(t, options, factor);
  }

  moveGhost(ghost, actual, wanted, factor, text) {
    ghost.visible = ghost.tie.visible = Number.isFinite(wanted[12]) && Number.isFinite(actual[12]);
    if (!ghost.visible) return;
    magnify(actual, wanted, factor, ghost.matrix);
    ghost.matrixWorldNeedsUpdate = true;
    const ends = ghost.tie.geometry.getAttribute("position");
    ends.setXYZ(0, actual[12], actual[13], actual[14]);
    ends.setXYZ(1, ghost.matrix.elements[12], ghost.matrix.elements[13], ghost.matrix.elements[14]);
    ends.needsUpdate = true;
    ghost.label.write(text, MEANING.wanted, this.colors);
  }

  /** Place an arrow at a frame, with a length that is logarithmic in the vector's. */
  point(arrow, frame, value, largest) {
    const size = Math.hypot(value[0], value[1], value[2]);
    const share = largest > 0 && size > 0 ? 1 + Math.log10(size / largest) / DECADES : 0;
    arrow.visible = share > 0;
    if (!arrow.visible) return;
    arrow.position.set(frame[12], frame[13], frame[14]);
    arrow.quaternion.setFromUnitVectors(UP, vector.set(...value).multiplyScalar(1 / size));
    arrow.setLength(0.55 * this.size * share);
  }

  drawTrail(t, options, factor) {
    const { table } = this.run;
    const shown = options.trail !== 0 && table.time.length > 0;
    this.trail.visible = shown;
    this.trailWanted.visible = shown && options.ghosts && Boolean(this.wanted);
    if (!shown) return;
    const to = t < table.time[0] ? 0 : indexAt(table.time, t) + 1;
    const from = options.trail > 0 ? Math.max(0, indexAt(table.time, t - options.trail)) : 0;
    this.trail.geometry.setDrawRange(from, to - from);
    this.trailWanted.geometry.setDrawRange(from, to - from);
    if (this.trailFactor !== factor && this.trailWanted.visible) {
      this.trailFactor = factor;
      const points = this.trailWanted.geometry.getAttribute("position");
      const { actual, wanted } = table;
      for (let i = 0; i < wanted.length; i++) points.array[i] = actual[i] + factor * (wanted[i] - actual[i]);
      points.needsUpdate = true;
    }
  }
}

export class Stage {
  /**
   * @param {HTMLElement} element of the panels; the canvas is put below them
   * @param {HTMLElement[]} panels one for each run
   * @param {any[]} runs
   * @param {() => void} changed is called when a new picture is needed
   */
  constructor(element, panels, runs, changed) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    const context = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
    if (!context) throw new Error("This browser has no WebGL 2, or it is switched off.");
    element.prepend(canvas);
    this.element = element;
    this.panels = panels;
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, context, antialias: true });
    this.renderer.setScissorTest(true);
    this.renderer.info.autoReset = false;
    this.camera = new PerspectiveCamera(FIELD, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.lost = false;
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.lost = true;
      changed();
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.lost = false;
      changed();
    });

    for (const run of runs) run.moveTo(run.start);
    this.actors = runs.map((run) => new Actor(run, this));
    const box = new Box3();
    for (const actor of this.actors) {
      box.expandByObject(actor.robot);
      for (const pose of actor.run.poses) box.expandByPoint(position.fromArray(pose, 12));
    }
    const sound = Number.isFinite(box.min.x) && Number.isFinite(box.max.x);
    if (!sound) box.set(new Vector3(-1, -1, -1), new Vector3(1, 1, 1));
    this.center = box.getCenter(new Vector3());
    this.radius = Math.max(1e-3, 0.5 * box.getSize(new Vector3()).length());
    this.size = Math.max(1e-3, this.reach(runs[0]) || 0.8 * this.radius);
    const wrenches = runs.flatMap((run) => run.wrenches);
    const momenta = runs.flatMap((run) => (run.momentum ? [run.momentum] : []));
    this.scales = {
      force: decadeAbove(wrenches.map((w) => w.force)),
      torque: decadeAbove(wrenches.map((w) => w.torque)),
      linear: decadeAbove(momenta.map((m) => m.linear)),
      angular: decadeAbove(momenta.map((m) => m.angular)),
    };
    for (const actor of this.actors) {
      actor.furnish(this.size, this.scales);
      actor.grid.position.z = box.min.z - 0.15 * this.radius;
    }
    this.anchor = Float64Array.from(runs[0].poses[0]);
    this.anchorEnd = Float64Array.from(runs[0].endEffector ?? runs[0].poses[0]);
    this.camera.near = 0.01 * this.radius;
    this.camera.far = 200 * this.radius;
    this.controls = new OrbitControls(this.camera, element);
    this.controls.maxDistance = 40 * this.radius;
    this.controls.minDistance = 0.05 * this.radius;
    this.preset("overview");
    this.controls.addEventListener("change", changed);
    element.addEventListener("keydown", (event) => this.key(event, changed));
    new ResizeObserver(changed).observe(element);
  }

  /** Length of the arm: the sum of the distances between its frames. */
  reach(run) {
    let sum = 0;
    for (let k = 1; k < run.poses.length; k++)
      sum += Math.hypot(...[12, 13, 14].map((i) => run.poses[k][i] - run.poses[k - 1][i]));
    return Number.isFinite(sum) ? sum : 0;
  }

  /** Look from a side. @param {string} name */
  preset(name) {
    const views = {
      overview: [1, -1.15, 0.55],
      front: [1, 0, 0],
      side: [0, -1, 0],
      top: [0, -1e-4, 1],
      base: [1, -1, 0.5],
      "end-effector": [1, -1, 0.5],
    };
    const first = this.actors[0];
    const target = this.center.clone();
    let distance = 2.2 * this.radius;
    if (name === "base" || name === "end-effector") {
      const pose = name === "base" ? first.run.poses[0] : (first.run.endEffector ?? first.run.poses[0]);
      if (Number.isFinite(pose[12])) target.fromArray(pose, 12).add(first.root.position);
      distance = 1.1 * this.size;
    }
    // A narrow panel sees less to the sides.
    const rectangle = this.panels[0].getBoundingClientRect();
    if (rectangle.width > 0 && rectangle.height > 0) {
      const free = rectangle.height - Math.min(CAPTION, 0.3 * rectangle.height);
      distance *= (rectangle.height / free) * Math.max(1, (0.95 * free) / rectangle.width);
    }
    const direction = new Vector3(...(views[name] ?? views.overview)).normalize();
    this.camera.position.copy(target).addScaledVector(direction, distance);
    this.controls.target.copy(target);
    this.controls.update();
  }

  /** Rotate, approach or shift with the keys, as with the mouse. */
  key(event, changed) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const offset = this.camera.position.clone().sub(this.controls.target);
    if (event.key in steps) {
      const [x, y] = steps[event.key];
      if (event.shiftKey) {
        const right = new Vector3().setFromMatrixColumn(this.camera.matrix, 0);
        const up = new Vector3().setFromMatrixColumn(this.camera.matrix, 1);
        const shift = right.multiplyScalar(x).addScaledVector(up, -y).multiplyScalar(0.05 * offset.length());
        this.controls.target.add(shift);
        this.camera.position.add(shift);
      } else {
        // Spherical has y up; the camera has z up.
        const turned = new Spherical().setFromCartesianCoords(offset.x, offset.z, -offset.y);
        turned.theta += 0.08 * x;
        turned.phi = Math.min(Math.PI - 0.01, Math.max(0.01, turned.phi + 0.08 * y));
        offset.setFromSpherical(turned);
        this.camera.position.copy(this.controls.target).add(new Vector3(offset.x, -offset.z, offset.y));
      }
    } else if (event.key === "+" || event.key === "=" || event.key === "-") {
      offset.multiplyScalar(event.key === "-" ? 1.12 : 1 / 1.12);
      this.camera.position.copy(this.controls.target).add(offset);
    } else return;
    event.preventDefault();
    event.stopPropagation();
    this.controls.update();
    changed();
  }

  /** Position of the camera and its target, for a link. */
  get view() {
    return [...this.camera.position.toArray(), ...this.controls.target.toArray()];
  }

  set view(values) {
    this.camera.position.fromArray(values, 0);
    this.controls.target.fromArray(values, 3);
    this.controls.update();
  }

  theme() {
    for (const actor of this.actors) actor.theme();
  }

  /** Draw all panels at the time to which the runs have been moved. */
  draw(t, options, factor) {
    if (this.lost) return;
    const outer = this.element.getBoundingClientRect();
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    const width = Math.max(1, Math.round(outer.width));
    const height = Math.max(1, Math.round(outer.height));
    if (this.width !== width || this.height !== height || this.ratio !== ratio) {
      Object.assign(this, { width, height, ratio });
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(width, height, false);
    }
    // The panels' edges may lie between pixels.
    this.renderer.setScissor(0, 0, width, height);
    this.renderer.setClearColor(this.actors[0].scene.background);
    this.renderer.clear();
    const tangent = Math.tan((FIELD * Math.PI) / 360);
    this.actors.forEach((actor, k) => {
      const inner = this.panels[k].getBoundingClientRect();
      if (inner.width < 2 || inner.height < 2) return;
      const x = inner.left - outer.left;
      const y = outer.bottom - inner.bottom;
      this.renderer.setViewport(x, y, inner.width, inner.height);
      this.renderer.setScissor(x, y, inner.width, inner.height);
      this.camera.aspect = inner.width / inner.height;
      // The picture's centre is that of the part below the captions.
      const { width: across, height: high } = inner;
      this.camera.setViewOffset(across, high, 0, -0.5 * Math.min(CAPTION, 0.3 * high), across, high);
      actor.update(t, options, factor, options.follow === "end-effector" ? this.anchorEnd : this.anchor);
      actor.scene.updateMatrixWorld();
      this.camera.updateMatrixWorld();
      if (options.labels) for (const label of actor.labels) label.fit(this.camera, across, high, tangent);
      this.renderer.render(actor.scene, this.camera);
    });
  }

  /** Largest power of ten that keeps the deviations near `t` within the picture. */
  automaticFactor(t) {
    const largest = Math.max(0, ...this.actors.map((actor) => actor.run.deviationNear(t)));
    if (!(largest > 0)) return 1;
    return Math.min(1000, Math.max(1, 10 ** Math.floor(Math.log10((0.45 * this.size) / largest))));
  }
}
