import { Chain, identity, poseMatrix, setPose } from "./kinematics.js";
import { decodeAll, decode, decodeTimes, indexAt } from "./series.js";

const TABLE = 40000; // most points of the trail
const BLOCKS = 200; // parts of the time for the automatic magnification

/** Value between two samples; the value of the first where the second is missing. */
function between(values, i, f) {
  const a = values[i];
  if (!f) return a;
  const b = values[i + 1];
  return b === b ? a + f * (b - a) : a;
}

/** Quaternions between two samples are interpolated on the shorter arc, and normalised by setPose. */
function poseBetween(pose, i, f, out) {
  const [px, py, pz] = pose.position;
  const [qx, qy, qz, qw] = pose.orientation;
  let sign = 1;
  if (f && qx[i] * qx[i + 1] + qy[i] * qy[i + 1] + qz[i] * qz[i + 1] + qw[i] * qw[i + 1] < 0) sign = -1;
  const mix = (q) => {
    const b = q[i + 1];
    return f && b === b ? (1 - f) * q[i] + f * sign * b : q[i];
  };
  return setPose(out, between(px, i, f), between(py, i, f), between(pz, i, f), mix(qx), mix(qy), mix(qz), mix(qw));
}

async function decodePose(raw) {
  if (!raw) return null;
  return { position: await decodeAll(raw.position), orientation: await decodeAll(raw.orientation) };
}

/** One run: its series, decoded, and what follows from them at a time. */
export class Run {
  /** @param {any} raw a RUN of the page's data */
  static async load(raw) {
    const run = new Run();
    run.raw = raw;
    run.label = String(raw.label ?? "");
    run.end = raw.end ?? { kind: "completed", time: null, cause: null };
    run.marks = (raw.marks ?? []).filter((mark) => Number.isFinite(mark.time));
    run.scene = raw.scene ?? null;
    run.chain = new Chain(run.scene);
    run.time = await decodeTimes(raw.time);
    run.base = await decodePose(raw.base);
    run.joints = raw.joints ? await decodeAll(raw.joints) : null;
    run.desired = await decodePose(raw.desired);
    run.setPoint = raw.set_point ? poseMatrix(raw.set_point) : null;
    run.wrenches = await Promise.all(
      (raw.wrenches ?? []).map(async (w) => ({
        name: String(w.name),
        at: w.at,
        passivity: Boolean(w.passivity),
        force: await decodeAll(w.force),
        torque: await decodeAll(w.torque),
      })),
    );
    run.centerOfMass = raw.center_of_mass ? await decodeAll(raw.center_of_mass) : null;
    run.momentum = raw.momentum
      ? { linear: await decodeAll(raw.momentum.linear), angular: await decodeAll(raw.momentum.angular) }
      : null;
    run.jointMargin = raw.joint_margin ? await decode(raw.joint_margin) : null;
    run.poses = Array.from({ length: run.chain.frames }, identity);
    run.q = new Array(run.chain.joints.length).fill(0);
    run.wanted = identity();
    run.index = 0;
    run.fraction = 0;
    run.tabulate();
    return run;
  }

  get start() {
    return this.time.length ? this.time[0] : 0;
  }

  /** Time of the end: that of the last pose or, where it is later, the end that the record states. */
  get stop() {
    const last = this.time.length ? this.time[this.time.length - 1] : 0;
    return Number.isFinite(this.end.time) ? Math.max(last, this.end.time) : last;
  }

  get frames() {
    return this.chain.frames;
  }

  /** Compute all frames and the desired end-effector at time `t`. */
  moveTo(t) {
    const times = this.time;
    const i = (this.index = Math.max(0, indexAt(times, t)));
    const next = times[i + 1];
    const f = next > times[i] && t > times[i] ? Math.min(1, (t - times[i]) / (next - times[i])) : 0;
    this.fraction = f;
    this.at(i, f);
  }

  at(i, f) {
    if (this.base) poseBetween(this.base, i, f, this.poses[0]);
    if (this.joints) for (let k = 0; k < this.q.length; k++) this.q[k] = this.joints[k] ? between(this.joints[k], i, f) : 0;
    this.chain.forward(this.poses, this.q);
    if (this.desired) poseBetween(this.desired, i, f, this.wanted);
  }

  /** The frame of the end-effector, or null. */
  get endEffector() {
    return this.chain.end ? this.poses[this.chain.frames - 1] : null;
  }

  /** Vector of three series at the current sample. These signals are held: they are not interpolated. */
  vector(series, out) {
    for (let a = 0; a < 3; a++) out[a] = series[a] ? (series[a][this.index] ?? NaN) : NaN;
    return out;
  }

  /** Positions of the trail, and the largest deviations in parts of the time. */
  tabulate() {
    const n = this.time.length;
    const stride = Math.max(1, Math.ceil(n / TABLE));
    const m = n ? Math.floor((n - 1) / stride) + 1 : 0;
    this.table = {
      time: new Float64Array(m),
      actual: new Float32Array(3 * m),
      wanted: new Float32Array(3 * m),
      deviation: new Float64Array(BLOCKS),
    };
    const duration = this.stop - this.start || 1;
    for (let j = 0; j < m; j++) {
      const i = j * stride;
      this.at(i, 0);
      const block = Math.min(BLOCKS - 1, Math.floor(((this.time[i] - this.start) / duration) * BLOCKS));
      this.table.time[j] = this.time[i];
      const end = this.endEffector ?? this.poses[0];
      for (let a = 0; a < 3; a++) {
        this.table.actual[3 * j + a] = end[12 + a];
        this.table.wanted[3 * j + a] = this.desired ? this.wanted[12 + a] : NaN;
      }
      for (const d of [this.deviationOfEnd(), this.deviationOfBase()])
        if (d && d.distance > this.table.deviation[block]) this.table.deviation[block] = d.distance;
    }
  }

  deviationOfEnd() {
    return this.desired && this.endEffector ? deviation(this.endEffector, this.wanted) : null;
  }

  deviationOfBase() {
    return this.setPoint && this.base ? deviation(this.poses[0], this.setPoint) : null;
  }

  /** Largest deviation near `t` [m]. */
  deviationNear(t) {
    const middle = Math.floor(((Math.min(t, this.stop) - this.start) / (this.stop - this.start || 1)) * BLOCKS);
    let largest = 0;
    for (let k = Math.max(0, middle - 3); k <= Math.min(BLOCKS - 1, middle + 3); k++)
      largest = Math.max(largest, this.table.deviation[k]);
    return largest;
  }
}

/** Distance [m] and angle [rad] between two frames. */
export function deviation(a, b) {
  const distance = Math.hypot(b[12] - a[12], b[13] - a[13], b[14] - a[14]);
  // The angle from the difference of the matrices, which is exact for small angles: |A - B|_F = 2 sqrt(2) sin(angle/2).
  let square = 0;
  for (const k of [0, 1, 2, 4, 5, 6, 8, 9, 10]) square += (a[k] - b[k]) ** 2;
  return { distance, angle: 2 * Math.asin(Math.min(1, Math.sqrt(square / 8))) };
}
