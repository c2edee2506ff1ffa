// Homogeneous matrices: 16 numbers, column-major, float64. Quaternions are [x, y, z, w].

/** @returns {Float64Array} */
export function identity() {
  const m = new Float64Array(16);
  m[0] = m[5] = m[10] = m[15] = 1;
  return m;
}

/** Write the matrix of a pose to `out`. The quaternion is normalised. */
export function setPose(out, px, py, pz, x, y, z, w) {
  const norm = Math.hypot(x, y, z, w);
  x /= norm;
  y /= norm;
  z /= norm;
  w /= norm;
  out[0] = 1 - 2 * (y * y + z * z);
  out[1] = 2 * (x * y + z * w);
  out[2] = 2 * (x * z - y * w);
  out[3] = 0;
  out[4] = 2 * (x * y - z * w);
  out[5] = 1 - 2 * (x * x + z * z);
  out[6] = 2 * (y * z + x * w);
  out[7] = 0;
  out[8] = 2 * (x * z + y * w);
  out[9] = 2 * (y * z - x * w);
  out[10] = 1 - 2 * (x * x + y * y);
  out[11] = 0;
  out[12] = px;
  out[13] = py;
  out[14] = pz;
  out[15] = 1;
  return out;
}

/** @param {{position: number[], orientation: number[]}} pose */
export function poseMatrix(pose) {
  return setPose(new Float64Array(16), ...pose.position, ...pose.orientation);
}

/** out = a b, for homogeneous matrices; `out` is neither a nor b. */
export function multiply(a, b, out) {
  for (let c = 0; c < 16; c += 4) {
    const x = b[c];
    const y = b[c + 1];
    const z = b[c + 2];
    const w = b[c + 3];
    out[c] = a[0] * x + a[4] * y + a[8] * z + a[12] * w;
    out[c + 1] = a[1] * x + a[5] * y + a[9] * z + a[13] * w;
    out[c + 2] = a[2] * x + a[6] * y + a[10] * z + a[14] * w;
    out[c + 3] = w;
  }
  return out;
}

/** Forward kinematics of a chain. */
export class Chain {
  /** @param {any} scene scene.json, or null: the chain then has only frame B */
  constructor(scene) {
    this.joints = (scene?.joints ?? []).map((joint) => ({
      prismatic: joint.kind === "prismatic",
      pose: poseMatrix(joint),
    }));
    this.end = scene ? poseMatrix(scene.end_effector) : null;
    this.frames = this.joints.length + (this.end ? 2 : 1);
    this.moved = identity();
    this.before = identity();
  }

  /** Write T_1 to T_(n+1) to `out`, whose first matrix is T_0. @param {Float64Array[]} out @param {number[]} q */
  forward(out, q) {
    this.joints.forEach((joint, k) => {
      const moved = this.moved;
      if (joint.prismatic) {
        moved[0] = moved[5] = 1;
        moved[1] = moved[4] = 0;
        moved[14] = q[k];
      } else {
        moved[0] = moved[5] = Math.cos(q[k]);
        moved[1] = Math.sin(q[k]);
        moved[4] = -moved[1];
        moved[14] = 0;
      }
      multiply(multiply(out[k], joint.pose, this.before), moved, out[k + 1]);
    });
    if (this.end) multiply(out[this.joints.length], this.end, out[this.frames - 1]);
    return out;
  }
}
