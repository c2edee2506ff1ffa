"""Seeded noise inside equations: a linear congruential generator in exact double arithmetic, the same on every platform."""

from __future__ import annotations

import casadi as ca

SX = ca.SX
MULTIPLIER, MODULUS = 16807.0, 2147483647.0
"""Lewis, Goodman and Miller's minimal standard generator: products stay below 2^46, so doubles hold them exactly."""


def first_state(seed: SX) -> SX:
    """A generator state in 1 ... MODULUS - 1 from a seed of any size."""
    scrambled = ca.fabs(seed) * 7919.0 + 12345.0
    return scrambled - ca.floor(scrambled / (MODULUS - 1.0)) * (MODULUS - 1.0) + 1.0


def normal(state: SX, size: int) -> tuple[SX, SX]:
    """The next generator state, and `size` numbers of mean 0 and standard deviation 1: sums of four uniform ones each."""
    numbers = []
    for _ in range(size):
        total = SX(0)
        for _ in range(4):
            product = MULTIPLIER * state
            state = product - ca.floor(product / MODULUS) * MODULUS
            total += state / MODULUS
        numbers.append((total - 2.0) * 3.0**0.5)
    return state, ca.vertcat(*numbers)
