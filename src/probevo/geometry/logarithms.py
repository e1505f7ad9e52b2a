"""Compiled logarithms of rotations and poses.

A call of SciPy's takes 0.1 ms, and a frame needs five.
"""

from __future__ import annotations

import math

from probevo.arrays import FloatArray
from probevo.compiled import compiled

SMALL_SQ = 0.25
"""θ², rad², up to which the series is accurate to a double. Beyond, cancellation costs the closed
form at most two digits."""


@compiled
def log_rotations(C: FloatArray, phi: FloatArray) -> None:
    """Compute φ = Log(C) of N rotations, [N, 3, 3] to [N, 3], rad, by way of the quaternion."""
    for n in range(len(C)):
        # The quaternion (w, x, y, z) up to its scale, from its largest component, which keeps it
        # accurate at every angle. With v = (x, y, z), the differences (a, b, c) are 4 w v, and the
        # sums d, e and f are 4 x y, 4 x z and 4 y z.
        xx = C[n, 0, 0]
        yy = C[n, 1, 1]
        zz = C[n, 2, 2]
        a = C[n, 2, 1] - C[n, 1, 2]
        b = C[n, 0, 2] - C[n, 2, 0]
        c = C[n, 1, 0] - C[n, 0, 1]
        d = C[n, 1, 0] + C[n, 0, 1]
        e = C[n, 2, 0] + C[n, 0, 2]
        f = C[n, 2, 1] + C[n, 1, 2]
        trace = xx + yy + zz
        if not trace < max(xx, yy, zz):
            w = 1.0 + trace
            x = a
            y = b
            z = c
        elif xx >= yy and xx >= zz:
            w = a
            x = 1.0 + xx - yy - zz
            y = d
            z = e
        elif yy >= zz:
            w = b
            x = d
            y = 1.0 - xx + yy - zz
            z = f
        else:
            w = c
            x = e
            y = f
            z = 1.0 - xx - yy + zz
        # q and −q are the same rotation; the one with w ≥ 0 has the shorter rotation vector.
        if w < 0.0:
            w = -w
            x = -x
            y = -y
            z = -z
        length = math.sqrt(x * x + y * y + z * z)
        # φ = θ v/|v| with θ = 2 atan2(|v|, w), and 2 v/w where that has no direction.
        ratio = 2.0 * math.atan2(length, w) / length if length > 1e-9 * w else 2.0 / w
        phi[n, 0] = ratio * x
        phi[n, 1] = ratio * y
        phi[n, 2] = ratio * z


@compiled
def log_translations(phi: FloatArray, t: FloatArray, rho: FloatArray) -> None:
    """Compute ρ = J(φ)⁻¹ t of N poses, [N, 3] each.

    J(φ)⁻¹ t = t − φ × t / 2 + k φ × (φ × t), with k = (1 − θ/2 cot θ/2) / θ².
    """
    for n in range(len(phi)):
        x = phi[n, 0]
        y = phi[n, 1]
        z = phi[n, 2]
        s = x * x + y * y + z * z
        if s < SMALL_SQ:
            k = 1 / 12 + s * (
                1 / 720 + s * (1 / 30240 + s * (1 / 1209600 + s * (1 / 47900160 + s * 5.284e-10)))
            )
        else:
            half = 0.5 * math.sqrt(s)
            k = (1.0 - half * math.cos(half) / math.sin(half)) / s
        # (u, v, w) = φ × t, of which φ × (u, v, w) is taken below.
        u = y * t[n, 2] - z * t[n, 1]
        v = z * t[n, 0] - x * t[n, 2]
        w = x * t[n, 1] - y * t[n, 0]
        rho[n, 0] = t[n, 0] - 0.5 * u + k * (y * w - z * v)
        rho[n, 1] = t[n, 1] - 0.5 * v + k * (z * u - x * w)
        rho[n, 2] = t[n, 2] - 0.5 * w + k * (x * v - y * u)
