"""Matched law on random rigid bodies that rotate: python tests/benchmarks/rigid_body.py [COUNT]

The inertia of a rotating body is not constant in I. Then the premise of the matched law does not
hold, and the law can generate energy. Each body starts with a random orientation and angular
velocity. A torque in I is held for a period. V is the kinetic energy plus the potential of the
spring. The table shows for each theta how many bodies exceed V(0) at a sample, how many end above
V(0), and the largest V / V(0). The gains are the same about all axes.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SAMPLES = 100
"""Number of periods in a run."""
LARGEST_ANGLE = 0.05
"""Largest rotation [rad] in one integration step, for the start energy of the body."""


def quaternion_product(a: Array, b: Array) -> Array:
    """Return the products (n, 4) of quaternions [x, y, z, w]."""
    av, aw, bv, bw = a[:, :3], a[:, 3:], b[:, :3], b[:, 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    return np.hstack([vector, aw * bw - np.sum(av * bv, axis=1, keepdims=True)])


def exponential(vector: Array) -> Array:
    """Return the quaternions (n, 4) of rotation vectors (n, 3) [rad]."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.hstack([0.5 * np.sinc(angle / (2.0 * np.pi)) * vector, np.cos(0.5 * angle)])


def rotation_matrices(q: Array) -> Array:
    x, y, z, w = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


@dataclass
class Bodies:
    """`inertia` (n, 3) are principal moments [kg m2]. Gains `k`, `d` and period `T` are (n,).

    `q` (n, 4) are orientations, and `w` (n, 3) angular velocities [rad/s], in I.
    """

    inertia: Array
    k: Array
    d: Array
    T: Array
    q: Array
    w: Array

    def inertia_in_I(self) -> Array:
        R = rotation_matrices(self.q)
        return np.asarray(np.einsum("nij,nj,nkj->nik", R, self.inertia, R))

    def energy(self) -> Array:
        kinetic = 0.5 * np.einsum("ni,nij,nj->n", self.w, self.inertia_in_I(), self.w)
        # 1 - cos(angle / 2), without cancellation at small angles.
        vector = np.sum(self.q[:, :3] ** 2, axis=1)
        return np.asarray(kinetic + 4.0 * self.k * vector / (1.0 + np.abs(self.q[:, 3])))

    def torque(self, theta: float) -> Array:
        """Return the held torque (n, 3) of `sampled_control.mean_wrench`."""
        h = (theta * self.T)[:, None]
        error = 2.0 * np.where(self.q[:, 3:] < 0.0, -1.0, 1.0) * self.q[:, :3]
        J, k, d = self.inertia_in_I(), self.k[:, None], self.d[:, None]
        implicit = J + (h * d + h**2 * k)[:, :, None] * np.eye(3)
        right = np.einsum("nij,nj->ni", J, self.w) - h * k * error
        mean_velocity = np.linalg.solve(implicit, right[:, :, None])[:, :, 0]
        return np.asarray(-k * error - (h * k + d) * mean_velocity)

    def hold(self, torque: Array, steps: int) -> None:
        """Integrate one period with a constant torque in I.

        Symmetric: half a rotation, the change of the angular momentum, half a rotation.
        """
        h = self.T / steps
        momentum = np.einsum("nij,nj->ni", self.inertia_in_I(), self.w)
        for _ in range(steps):
            momentum = momentum + 0.5 * h[:, None] * torque
            middle = quaternion_product(
                exponential(0.5 * h[:, None] * self._velocity(momentum)), self.q
            )
            velocity = self._velocity(momentum, middle)
            self.q = quaternion_product(exponential(h[:, None] * velocity), self.q)
            momentum = momentum + 0.5 * h[:, None] * torque
        self.q /= np.linalg.norm(self.q, axis=1, keepdims=True)
        self.w = self._velocity(momentum)

    def _velocity(self, momentum: Array, q: Array | None = None) -> Array:
        R = rotation_matrices(self.q if q is None else q)
        in_body = np.einsum("nji,nj->ni", R, momentum) / self.inertia
        return np.asarray(np.einsum("nij,nj->ni", R, in_body))


def drawn(count: int, seed: int) -> Bodies:
    """Return random bodies: the ranges are those of a small satellite up to a large one."""
    random = np.random.default_rng(seed)

    def logarithmic(low: float, high: float) -> Array:
        return np.asarray(low * (high / low) ** random.random(count))

    # Principal moments of a random mass distribution satisfy the triangle inequality.
    spread = random.uniform(0.1, 1.0, (count, 3))
    inertia = logarithmic(1.0, 100.0)[:, None] * (spread.sum(axis=1, keepdims=True) - spread) / 2.0
    axis = random.normal(size=(count, 3))
    angle = random.uniform(0.0, np.pi, (count, 1))
    q = exponential(angle * axis / np.linalg.norm(axis, axis=1, keepdims=True))
    w = random.normal(size=(count, 3)) * 0.1
    return Bodies(
        inertia, logarithmic(1.0, 1e4), logarithmic(0.1, 1e3), logarithmic(1e-3, 2.0), q, w
    )


def run(bodies: Bodies, theta: float, samples: int = SAMPLES) -> Array:
    """Return V (samples + 1, n) at all samples."""
    # Bodies that rotate equally far in a period are integrated together, with the same steps.
    angle = np.sqrt(2.0 * bodies.energy() / bodies.inertia.min(axis=1)) * bodies.T
    energies = np.empty((samples + 1, angle.size))
    for group in np.array_split(np.argsort(angle), max(1, angle.size // 250)):
        part = Bodies(**{name: values[group] for name, values in vars(bodies).items()})
        steps = int(np.clip(np.ceil(angle[group].max() / LARGEST_ANGLE), 20, 400))
        energies[0, group] = part.energy()
        for k in range(samples):
            part.hold(part.torque(theta), steps)
            energies[k + 1, group] = part.energy()
    return energies


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print("theta, above V(0) at a sample, above V(0) at the end, largest V / V(0)")
    for theta in (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 1.0):
        ratio = run(drawn(count, 1), theta)
        ratio = ratio / ratio[0]
        above = (ratio.max(axis=0) > 1.0 + 1e-6).sum()
        print(f"{theta:4g} {above:6d} {(ratio[-1] > 1.0).sum():6d} {ratio.max():10.3g}", flush=True)


if __name__ == "__main__":
    main()
