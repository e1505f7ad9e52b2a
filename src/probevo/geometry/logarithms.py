"""Compiled logarithms of rotations and poses: SciPy takes 0.1 ms to be called for one, of which a frame needs five."""

from __future__ import annotations

import math

from probevo.arrays import FloatArray
from probevo.compiled import compiled

SMALL_SQ = 0.25
"""θ², rad², up to which the series is as good as a double; beyond, the closed form cancels no more than two digits."""


@compiled
def log_rotations(C: FloatArray, phi: FloatArray) -> None:
    """phi[n] = Log(C[n]), [n, 3, 3] to [n, 3], by way of the quaternion, its largest component first."""
    for n in range(len(C)):
        xx, yy, zz = C[n, 0, 0], C[n, 1, 1], C[n, 2, 2]
        a, b, c = C[n, 2, 1] - C[n, 1, 2], C[n, 0, 2] - C[n, 2, 0], C[n, 1, 0] - C[n, 0, 1]
        d, e, f = C[n, 1, 0] + C[n, 0, 1], C[n, 2, 0] + C[n, 0, 2], C[n, 2, 1] + C[n, 1, 2]
        trace = xx + yy + zz
        if not trace < max(xx, yy, zz):
            w, x, y, z = 1.0 + trace, a, b, c
        elif xx >= yy and xx >= zz:
            w, x, y, z = a, 1.0 + xx - yy - zz, d, e
        elif yy >= zz:
            w, x, y, z = b, d, 1.0 - xx + yy - zz, f
        else:
            w, x, y, z = c, e, f, 1.0 - xx - yy + zz
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        length = math.sqrt(x * x + y * y + z * z)
        ratio = 2.0 * math.atan2(length, w) / length if length > 1e-9 * w else 2.0 / w
        phi[n, 0], phi[n, 1], phi[n, 2] = ratio * x, ratio * y, ratio * z


@compiled
def log_translations(phi: FloatArray, t: FloatArray, rho: FloatArray) -> None:
    """rho[n] = J(φ)⁻¹ t, [n, 3] each: t − φ × t / 2 + k φ × (φ × t), with k = (1 − θ/2 cot θ/2) / θ²."""
    for n in range(len(phi)):
        x, y, z = phi[n, 0], phi[n, 1], phi[n, 2]
        s = x * x + y * y + z * z
        if s < SMALL_SQ:
            k = 1 / 12 + s * (1 / 720 + s * (1 / 30240 + s * (1 / 1209600 + s * (1 / 47900160 + s * 5.284e-10))))
        else:
            half = 0.5 * math.sqrt(s)
            k = (1.0 - half * math.cos(half) / math.sin(half)) / s
        u, v, w = y * t[n, 2] - z * t[n, 1], z * t[n, 0] - x * t[n, 2], x * t[n, 1] - y * t[n, 0]
        rho[n, 0] = t[n, 0] - 0.5 * u + k * (y * w - z * v)
        rho[n, 1] = t[n, 1] - 0.5 * v + k * (z * u - x * w)
        rho[n, 2] = t[n, 2] - 0.5 * w + k * (x * v - y * u)
