"""The metrics of a run in plain language."""

from __future__ import annotations

from probevo.evaluation.metrics import Metrics
from probevo.output.table import Table, readable, text_table

_ROWS: dict[str, tuple[str, str, str]] = {
    "num_frames": ("Frames compared", "", "Frames whose true pose is known."),
    "path_length_m": ("Path length", "m", "Length of the true path."),
    "short_t_percent": (
        "Drift, short",
        "%",
        "Position error per distance over segments of 10 to 50 m, wherever they start.",
    ),
    "short_r_deg_per_m": (
        "Rotation drift, short",
        "°/m",
        "Heading and tilt error per metre over the same segments.",
    ),
    "kitti_t_percent": (
        "Drift, KITTI",
        "%",
        "The same over segments of 100 to 800 m, as the KITTI benchmark ranks.",
    ),
    "kitti_r_deg_per_m": (
        "Rotation drift, KITTI",
        "°/m",
        "Rotation error per metre over the same segments.",
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
            "Average normalised squared error (NEES) of single steps: 6 where their covariance is"
            " consistent, more is overconfident, less is conservative. Truth from GPS and INS is"
            " noisier than a step of good odometry and drives it far above 6, farther for a better"
            " odometry; `probevo covariance-check` needs no truth."
        ),
    ),
}


def metrics_rows(metrics: Metrics) -> list[tuple[str, str, str]]:
    """Show name, value with unit, and explanation of each metric that is defined."""
    rows = []
    for key, (name, unit, text) in _ROWS.items():
        value = getattr(metrics, key)
        if value is not None:
            rows.append((name, f"{readable(value)} {unit}".strip(), text))
    if metrics.nees_coverage:
        shares = " / ".join(f"{100 * share:.0f}" for share in metrics.nees_coverage.values())
        nominal = " / ".join(metrics.nees_coverage)
        text = f"Share of single steps inside the ellipsoids that should hold {nominal} % of them."
        rows.append(("Coverage", f"{shares} %", text))
    return rows


def metrics_table(metrics: Metrics) -> Table:
    """Make the table of these rows, without a head."""
    return text_table(("", "", ""), metrics_rows(metrics), left=(0, 1, 2))
