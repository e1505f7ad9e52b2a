"""Draw docs/images/data-flow.svg: `python docs/images/draw_data_flow.py`."""

from __future__ import annotations

from html import escape
from pathlib import Path

WIDTH = 1000
HEIGHT = 500
STYLE = """
text { font: 13px Helvetica, Arial, sans-serif; fill: #1f2933; text-anchor: middle; }
.title { font-weight: bold; font-size: 14px; }
.small { font-size: 11.5px; fill: #52606d; }
.folder { font: 12px Menlo, Consolas, monospace; fill: #0b5394; }
.left { text-anchor: start; }
.right { text-anchor: end; }
.line { stroke: #52606d; stroke-width: 1.6; fill: none; marker-end: url(#head); }
.border { stroke: #9aa5b1; stroke-width: 1.4; stroke-dasharray: 5 4; }
"""
parts: list[str] = []


def box(x: float, y: float, width: float, height: float, *, fill: str, lines: list[str]) -> None:
    """Draw a box with its title, its folder and what it holds, one line each."""
    parts.append(
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="7" fill="{fill}" '
        'stroke="#7b8794"/>'
    )
    for row, line in enumerate(lines):
        kind = ("title", "folder")[row] if row < 2 else "small"
        text(x + width / 2, y + 22 + 18 * row, line, kind)


def text(x: float, y: float, line: str, kind: str) -> None:
    """Write one line."""
    parts.append(f'<text x="{x}" y="{y}" class="{kind}">{escape(line)}</text>')


def arrow(*points: tuple[float, float]) -> None:
    """Draw a line with a head at its end."""
    path = " ".join(f"{x},{y}" for x, y in points)
    parts.append(f'<polyline points="{path}" class="line"/>')


BLUE = "#e3eefc"
GREEN = "#e5f5e0"
YELLOW = "#fff6d6"
GREY = "#f1f3f5"

# The figure of the odometry: one row, left to right.
box(
    16, 150, 128, 88, fill=BLUE, lines=["Frame", "sequences/", "images or features,", "IMU samples"]
)
box(
    180,
    150,
    128,
    88,
    fill=BLUE,
    lines=["Tracks", "tracking/", "stereo observations", "in two frames"],
)
box(344, 150, 118, 88, fill=BLUE, lines=["φ", "predictors/", "place in the", "prediction space"])
box(
    498,
    150,
    118,
    88,
    fill=GREEN,
    lines=["StereoNoise", "noise/", "scale, dof, bias", "of each feature"],
)
box(
    652,
    150,
    140,
    88,
    fill=GREEN,
    lines=["Measurements", "measurements/", "StereoObservations,", "RelativeRotation, …"],
)
box(
    828,
    150,
    156,
    88,
    fill=GREEN,
    lines=["Estimator", "estimation/", "RANSAC, Gauss–Newton,", "gate, covariance"],
)
for start, end in ((144, 180), (308, 344), (462, 498), (616, 652), (792, 828)):
    arrow((start, 194), (end - 2, 194))

# What else constrains the motion.
box(
    642,
    30,
    160,
    70,
    fill=YELLOW,
    lines=["Further sensors", "sensors=[…]", "direction, pose, network"],
)
arrow((722, 100), (722, 148))
box(16, 30, 128, 70, fill=GREY, lines=["Recording", "sequences/", "KITTI, EuRoC, …"])
arrow((80, 100), (80, 148))
box(498, 30, 118, 70, fill=GREY, lines=["Noise model", "training/", "learned or static"])
arrow((557, 100), (557, 148))

# The memory: read at the start of a step, assigned once at its end.
box(
    180,
    316,
    612,
    88,
    fill=YELLOW,
    lines=[
        "OdometryState",
        "state.py",
        "last frame, features, observation store, rig calibration, gyro bias, motion model,",
        "disparity filter, last residuals, pose with covariance",
    ],
)
arrow((244, 316), (244, 240))
text(250, 270, "prediction of the motion:", "small left")
text(250, 286, "search starts, gate, dead reckoning", "small left")
arrow((722, 316), (722, 240))
text(716, 270, "priors of the", "small right")
text(716, 286, "disparities", "small right")
arrow((880, 238), (880, 360), (794, 360))
text(872, 292, "the next state:", "small right")
text(872, 308, "assigned once,", "small right")
text(872, 324, "at the end", "small right")

# What comes out.
box(828, 424, 156, 64, fill=GREY, lines=["Report, files", "evaluation/ output/"])
arrow((956, 238), (956, 422))
text(820, 446, "MotionEstimate:", "small right")
text(820, 462, "T_curr_prev, cov, status, pose", "small right")

# Images are seen on the left of this line only.
parts.append('<line x1="480" y1="10" x2="480" y2="300" class="border"/>')
text(474, 22, "may see images", "small right")
text(486, 22, "never sees one", "small left")

size = f'viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}"'
drawing = f"""<svg xmlns="http://www.w3.org/2000/svg" {size}>
<title>How the data of one frame flow through probevo</title>
<style>{STYLE}</style>
<defs><marker id="head" markerWidth="9" markerHeight="9" refX="7" refY="4" orient="auto">
<path d="M0,0 L8,4 L0,8 z" fill="#52606d"/></marker></defs>
<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>
{chr(10).join(parts)}
</svg>
"""
Path(__file__).with_name("data-flow.svg").write_text(drawing, "utf-8")
