"""Noise as CasADi expressions, from a linear congruential generator with a seed.

The numbers are bit-identical on every platform.
"""

from __future__ import annotations

import casadi as ca

SX = ca.SX
MULTIPLIER, MODULUS = 16807.0, 2147483647.0
"""Constants of the minimal standard generator (Lewis, Goodman, Miller).

All products of the generator are below 2^46. Therefore they are exact in double precision.
"""


def first_state(seed: SX) -> SX:
    """Return a generator state in 1 ... MODULUS - 1 for a seed of any size."""
    scrambled = ca.fabs(seed) * 7919.0 + 12345.0
    return scrambled - ca.floor(scrambled / (MODULUS - 1.0)) * (MODULUS - 1.0) + 1.0


def normal(state: SX, size: int) -> tuple[SX, SX]:
    """Return the next generator state, and `size` numbers with mean 0 and standard deviation 1.

    Each number is the scaled sum of four uniformly distributed numbers.
    """
    numbers = []
    for _ in range(size):
        total = SX(0)
        for _ in range(4):
            product = MULTIPLIER * state
            state = product - ca.floor(product / MODULUS) * MODULUS
            total += state / MODULUS
        numbers.append((total - 2.0) * 3.0**0.5)
    return state, ca.vertcat(*numbers)
