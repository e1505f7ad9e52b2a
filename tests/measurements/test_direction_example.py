"""A sensor of one's own: a direction of the world, such as gravity's or the sun's, that it sees.

``Direction`` is all that it takes; the solver is not touched. The drift of the attitude is then
bounded, and as small as its Fisher information allows.
"""

import numpy as np

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements import Values, Variable, VectorMeasurement, pose_of
from probevo.sequences.frame import Frame, StereoFeatures
from worlds import CAMERA, FORWARD, FRAME_NS, START_NS, moved, random_pixels

NUM_FRAMES = 61
NUM_POINTS = 25
NUM_RUNS = 12
SIGMA_PX = 0.5
SIGMA_DIRECTION = np.deg2rad(0.3)
DOWN = np.array([0.0, 1.0, 0.0])


class Direction(VectorMeasurement):
    """A unit vector of the world, measured in the camera's frame with a covariance, [3, 3]."""

    def __init__(
        self, pose: Variable, in_world: FloatArray, in_camera: FloatArray, covariance: FloatArray
    ) -> None:
        super().__init__(covariance)
        self.pose = pose
        self.in_world = in_world
        self.in_camera = in_camera

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose of the camera."""
        return (self.pose,)

    def residual(self, values: Values) -> FloatArray:
        """Return measured minus predicted, [3]."""
        C_cam_world = values[self.pose][:3, :3]
        return self.in_camera - C_cam_world @ self.in_world


def frames_of(rng: np.random.Generator) -> list[Frame]:
    """Return frames of which each pair sees points of its own: errors of steps are independent."""
    pairs = []
    for _ in range(NUM_FRAMES):
        prev_px = random_pixels(rng, NUM_POINTS)
        pairs.append((prev_px, moved(prev_px, FORWARD)))
    frames = []
    for index in range(NUM_FRAMES):
        seen_px = np.vstack([pairs[index - 1][1], pairs[index][0]])
        prev_ids = NUM_POINTS * ((index - 1) % NUM_FRAMES) + np.arange(NUM_POINTS)
        ids = np.concatenate([prev_ids, NUM_POINTS * index + np.arange(NUM_POINTS)])
        pixels = seen_px + SIGMA_PX * rng.normal(size=seen_px.shape)
        stamp_ns = START_NS + index * FRAME_NS
        frames.append(Frame(index, stamp_ns, features=StereoFeatures(ids, pixels)))
    return frames


def true_pose(index: int) -> FloatArray:
    """Return T_cam_world of a frame."""
    return np.asarray(np.linalg.matrix_power(FORWARD, index))


def run(seed: int, *, with_sensor: bool) -> list[pv.MotionEstimate]:
    """Return the estimates of a drive, with directions measured in every frame or without."""
    rng = np.random.default_rng(seed)
    frames = frames_of(rng)
    covariance = SIGMA_DIRECTION**2 * np.eye(3)

    def sense(prev: Frame, frame: Frame) -> list[Direction]:
        true = true_pose(frame.index)[:3, :3] @ DOWN
        measured = true + SIGMA_DIRECTION * rng.normal(size=3)
        return [Direction(pose_of(frame.index), DOWN, measured, covariance)]

    odometry = pv.StereoOdometry(
        CAMERA,
        pv.noise.Fixed(SIGMA_PX**2 * np.eye(4)),
        config=pv.OdometryConfig(estimator="two-frame", self_calibration=False),
        sensors=[sense] if with_sensor else [],
    )
    return [odometry.step(frame) for frame in frames]


def attitude_error(estimate: pv.MotionEstimate, index: int) -> FloatArray:
    """Return φ of the estimated attitude against the true one, [3], rad."""
    C_estimated = estimate.T_cam_world[:3, :3]
    return so3.log(true_pose(index)[:3, :3] @ C_estimated.T)


def fisher_bound(estimates: list[pv.MotionEstimate]) -> FloatArray:
    """Return the Cramér–Rao bound of the last pose, [6, 6], from the steps' own covariances."""
    cov = 1e-12 * np.eye(6)
    for index, estimate in enumerate(estimates[1:], start=1):
        adjoint = se3.adjoint(FORWARD)
        cov = adjoint @ cov @ adjoint.T + estimate.cov
        H = np.hstack([np.zeros((3, 3)), so3.wedge(true_pose(index)[:3, :3] @ DOWN)])
        cov = np.linalg.inv(np.linalg.inv(cov) + H.T @ H / SIGMA_DIRECTION**2)
    return np.asarray(cov)


def test_a_direction_bounds_the_drift_of_the_attitude() -> None:
    """To the Fisher bound across the direction; about it nothing is gained."""
    sensed = [run(seed, with_sensor=True) for seed in range(NUM_RUNS)]
    blind = [run(seed, with_sensor=False) for seed in range(NUM_RUNS)]
    last = NUM_FRAMES - 1
    down = true_pose(last)[:3, :3] @ DOWN
    across = np.eye(3) - np.outer(down, down)
    bounds = np.array([fisher_bound(estimates)[3:, 3:] for estimates in blind])
    # The claimed covariance of the pose is the bound.
    claimed = np.array([estimates[-1].cov_cam_world[3:, 3:] for estimates in sensed])
    assert np.allclose(claimed, bounds, rtol=0.05, atol=0.02 * bounds.max())
    # The errors agree with it: their normalized squares are those of χ² with 3 degrees of freedom.
    errors = np.array([attitude_error(estimates[-1], last) for estimates in sensed])
    nees = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(claimed), errors)
    low, high = chi2_interval(dof=3, count=NUM_RUNS, confidence=0.999)
    assert low < nees.mean() < high
    # Across the direction, the drift without it is several times as large.
    drifted = np.array([attitude_error(estimates[-1], last) for estimates in blind])
    rms = np.sqrt(np.mean(np.sum((errors @ across) ** 2, axis=1)))
    rms_blind = np.sqrt(np.mean(np.sum((drifted @ across) ** 2, axis=1)))
    bound = np.sqrt(np.mean(np.trace(across @ bounds @ across, axis1=1, axis2=2)))
    assert rms < 0.6 * rms_blind
    assert 0.8 < rms / bound < 1.2
    # About it, they are the same to a tenth.
    about = errors @ down
    about_blind = drifted @ down
    assert np.isclose(np.sqrt(np.mean(about**2)), np.sqrt(np.mean(about_blind**2)), rtol=0.1)
