"""The metrics in plain language."""

from __future__ import annotations

import math

from probevo.evaluation.metrics import Metrics

_ROWS: dict[str, tuple[str, str, str]] = {
    "num_frames": ("Frames compared", "", "Frames whose true pose is known."),
    "path_length_m": ("Path length", "m", "Length of the true path."),
    "short_t_percent": (
        "Drift, short",
        "%",
        "Position error per distance over pieces of 10 to 50 m, wherever they start.",
    ),
    "short_r_deg_per_m": (
        "Turn drift, short",
        "°/m",
        "Heading and tilt error per metre over the same pieces.",
    ),
    "kitti_t_percent": (
        "Drift, KITTI",
        "%",
        "The same over pieces of 100 to 800 m, as the KITTI benchmark ranks.",
    ),
    "kitti_r_deg_per_m": (
        "Turn drift, KITTI",
        "°/m",
        "Rotation error per metre over the same pieces.",
    ),
    "final_error_m": (
        "End error",
        "m",
        "How far the end of the estimate lies from the true end; starts made equal.",
    ),
    "armse_m": (
        "ARMSE",
        "m",
        (
            "Root mean square position error over the three axes, averaged over frames; starts made"
            " equal."
        ),
    ),
    "rot_armse_rad": ("Rotational ARMSE", "rad", "The same for the attitude."),
    "ate_rmse_m": (
        "ATE",
        "m",
        "Root mean square position error after the whole path was fitted to the true one.",
    ),
    "ate_unaligned_rmse_m": ("ATE, unaligned", "m", "The same with only the starts made equal."),
    "rpe_t_m": (
        "RPE, translation",
        "m",
        "Root mean square error of single steps; includes the noise of the truth.",
    ),
    "rpe_r_deg": ("RPE, rotation", "°", "The same for the rotation of single steps."),
    "anees": (
        "ANEES",
        "",
        (
            "Squared error of single steps over what their covariance promises: 6 is honest, more"
            " is overconfident, less is conservative. Truth from GPS and INS is noisier than a step"
            " of good odometry and drives it far above 6."
        ),
    ),
}


def metrics_rows(metrics: Metrics) -> list[tuple[str, str, str]]:
    """Name, value with unit, and explanation of each metric that is defined."""
    rows = []
    for key, (name, unit, text) in _ROWS.items():
        value = getattr(metrics, key)
        if value is not None:
            rows.append((name, f"{readable(value)} {unit}".strip(), text))
    if metrics.nees_coverage:
        shares = " / ".join(f"{100 * share:.0f}" for share in metrics.nees_coverage.values())
        promised = " / ".join(metrics.nees_coverage)
        text = f"Share of single steps inside the ellipsoids that should hold {promised} % of them."
        rows.append(("Coverage", f"{shares} %", text))
    return rows


def readable(value: float) -> str:
    """Three figures, never in scientific notation."""
    if not math.isfinite(value):
        return str(value)
    if abs(value) < 1e-9 or isinstance(value, int):
        return f"{value:,.0f}"
    rounded = float(f"{value:.3g}")
    decimals = max(0, 2 - math.floor(math.log10(abs(rounded))))
    return f"{value:,.{decimals}f}"
