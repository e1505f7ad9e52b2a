"""HydraNet's orbiting camera: rotations from the pixels of 36 points, and beyond them (thesis 7).

A camera looks from a distance of 25 m at a plane grid of points around the origin. Networks learn
its rotation from the noisy pixels, at polar angles of ±60°. They are tested along a sweep of ±81°,
whose ends are out of the domain that they have seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import BoolArray, FloatArray
from probevo.geometry import so3
from probevo.nets import methods
from probevo.nets.covariance_scale import covariance_scale, coverage, negative_log_likelihoods
from probevo.nets.learning import LearningPlan, TrainingData, learn
from probevo.nets.methods import Method
from probevo.nets.networks import Network, PReluHead, ResidualLayers
from probevo.nets.target_space import RotationTargets
from probevo_paper.hydranet_config import HydranetConfig

POINTS_A_SIDE = 6
HALF_WIDTH_M = 7.5
DISTANCE_M = 25.0
FOCAL_PX = 500.0
SIZE_PX = 500.0
NOISE_PX = 1.0
UNSEEN = -1.0
"""Both inputs of a point outside the image."""
DOMAIN_DEG = (60.0, 45.0, 45.0)
"""Largest angles about x (the polar angle), y and z of the training."""
SWEEP_DEG = (81.0, 20.0, 20.0)
"""The same of the test; the polar angle goes evenly from one end to the other."""
NUM_TESTS = 500
NUM_INPUTS = 2 * POINTS_A_SIDE**2
NUM_BLOCKS = 5
HEAD_UNITS = 512
TARGET_SIGMA_RAD = 0.05
"""Noise on the targets of heads."""
DROPOUT = 0.1
"""Rate of the dropout baseline; not published."""
PATIENCE = 10
PROBABILITY = 0.9
"""Probability of the regions whose coverage is measured."""


class Views(NamedTuple):
    """What the camera sees of the points, and its rotations."""

    inputs: FloatArray
    """Pixels of each point divided by 250 px, ``UNSEEN`` outside the image, [N, 72]."""
    quaternions: FloatArray
    """Rotation from the world to the camera, [N, 4]."""


@dataclass(frozen=True)
class DomainResult:
    """How good predictions are over a part of the sweep, as predicted and calibrated."""

    error_deg: float
    """Mean angle between estimate and truth."""
    nll: float
    """Mean of ½ φᵀ Σ⁻¹ φ + ½ log|Σ|, nats."""
    coverage: float
    """Share of errors within the 90 % region."""
    calibrated_nll: float
    calibrated_coverage: float
    """The same with all covariances multiplied by the factor of the data left out."""


@dataclass(frozen=True)
class OrbitResult:
    """A method's predictions along the sweep."""

    method: str
    inside: DomainResult
    """Polar angles that it was trained on."""
    outside: DomainResult
    """Polar angles beyond."""
    scale: float
    """Factor on the covariances that the data left out ask for; 1 is consistent."""


def orbit(
    method: Method, settings: HydranetConfig, file: Path, show: Callable[[int, int], None]
) -> OrbitResult:
    """Train a method, calibrate it on views left out, and test it along the sweep.

    Args:
        method: one of ``orbit_methods``.
        settings: of the experiment.
        file: where the networks are kept.
        show: called after each epoch.

    Raises:
        InputError: the file is damaged or cannot be written.
    """
    space = RotationTargets()
    rng = np.random.default_rng([settings.seed, 1])
    training = random_views(settings.poses, rng)
    held_out = random_views(settings.poses // 10, rng)
    polar_rad, tests = sweep(rng)
    rng_of_method = np.random.default_rng([settings.seed, 2])
    targets = methods.head_targets(method, space, training.quaternions, rng_of_method)
    samples = methods.samples(method, settings.poses, rng_of_method)
    data = TrainingData(
        inputs=jnp.asarray(training.inputs[None], jnp.float32),
        targets=jnp.asarray(targets[None], jnp.float32),
        samples=jnp.asarray(samples[None]),
        held_out_inputs=jnp.asarray(held_out.inputs[None], jnp.float32),
        held_out_targets=jnp.asarray(held_out.quaternions[None], jnp.float32),
    )
    plan = plan_of(settings)
    trained = learn(method, space, build, data=data, plan=plan, file=file, show=show)
    networks = jax.tree.map(lambda array: array[0], trained.networks)

    def predict(views: Views) -> tuple[FloatArray, FloatArray]:
        """Return errors, [N, 3], and their covariances, [N, 3, 3]."""
        inputs = jnp.asarray(views.inputs, jnp.float32)
        key = jax.random.key(settings.seed)
        estimated, raw = methods.estimates(method, space, networks, inputs, key)
        predicted = methods.prediction(space, estimated, raw)
        C_estimated = Rotation.from_quat(predicted.mean, scalar_first=True)
        C_true = Rotation.from_quat(views.quaternions, scalar_first=True)
        return (C_estimated * C_true.inv()).as_rotvec(), predicted.covariance

    scale = covariance_scale(*predict(held_out))
    errors, covariances = predict(tests)
    is_inside = np.abs(polar_rad) <= np.radians(DOMAIN_DEG[0])
    return OrbitResult(
        method.name,
        inside=domain_result(errors, covariances, is_inside, scale=scale),
        outside=domain_result(errors, covariances, ~is_inside, scale=scale),
        scale=scale,
    )


def orbit_methods(settings: HydranetConfig) -> tuple[Method, ...]:
    """Return the methods, each with the number of heads or networks of the settings."""
    heads = settings.heads
    return (
        Method("dropout", passes=heads, dropout=DROPOUT),
        Method("ensemble", networks=settings.networks, bootstrap=True),
        Method("sigma", learns_covariance=True),
        Method("hydra", heads=heads, target_sigma=TARGET_SIGMA_RAD),
        Method("hydra-sigma", heads=heads, learns_covariance=True, target_sigma=TARGET_SIGMA_RAD),
    )


def build(method: Method, key: jax.Array) -> Network:
    """Return one network: five residual blocks, and heads 72 → 512 → PReLU → 4."""
    key_of_trunk, key_of_heads, key_of_covariance = jax.random.split(key, 3)

    def head(head_key: jax.Array) -> PReluHead:
        """Return one head with initial weights."""
        sizes = (NUM_INPUTS, HEAD_UNITS, RotationTargets.num_outputs)
        return PReluHead(sizes, method.dropout, key=head_key)

    covariance_head = None
    if method.learns_covariance:
        sizes = (NUM_INPUTS, HEAD_UNITS, RotationTargets.num_covariance)
        covariance_head = PReluHead(sizes, method.dropout, key=key_of_covariance)
    return Network(
        trunk=ResidualLayers(NUM_INPUTS, NUM_BLOCKS, method.dropout, key=key_of_trunk),
        heads=eqx.filter_vmap(head)(jax.random.split(key_of_heads, method.heads)),
        covariance_head=covariance_head,
    )


def plan_of(settings: HydranetConfig) -> LearningPlan:
    """Return how all methods are trained; as published, but stopped by data left out."""
    return LearningPlan(
        epochs=settings.orbit_epochs,
        batch=32,
        learning_rate=1e-4,
        patience=PATIENCE,
        keep_every=5,
        seed=settings.seed,
    )


def random_views(count: int, rng: np.random.Generator) -> Views:
    """Return views at random angles within the domain of the training."""
    largest_rad = np.radians(DOMAIN_DEG)
    return views_at(rng.uniform(-largest_rad, largest_rad, (count, 3)), rng)


def sweep(rng: np.random.Generator) -> tuple[FloatArray, Views]:
    """Return the polar angles of the test, [500], rad, and the views there."""
    largest_rad = np.radians(SWEEP_DEG)
    angles_rad = rng.uniform(-largest_rad, largest_rad, (NUM_TESTS, 3))
    angles_rad[:, 0] = np.linspace(-largest_rad[0], largest_rad[0], NUM_TESTS)
    return angles_rad[:, 0], views_at(angles_rad, rng)


def views_at(angles_rad: FloatArray, rng: np.random.Generator) -> Views:
    """Return what the camera sees at angles about x, y and z, [N, 3], rad, with noise."""
    line_m = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, POINTS_A_SIDE)
    grid_x, grid_y = np.meshgrid(line_m, line_m)
    points_m = np.stack([grid_x.ravel(), grid_y.ravel(), np.zeros(grid_x.size)], axis=-1)
    about_x, about_y, about_z = (so3.exp(angles_rad[:, k, None] * np.eye(3)[k]) for k in range(3))
    # The camera lies on +z of the turned points, and looks down on them.
    C_turned_world = about_z @ about_y @ about_x
    C_cam_turned = np.diag([1.0, -1.0, -1.0])
    C_cam_world = C_cam_turned @ C_turned_world
    points_camera_m = points_m @ C_cam_world.mT + np.array([0.0, 0.0, DISTANCE_M])
    exact_px = FOCAL_PX * points_camera_m[..., :2] / points_camera_m[..., 2:] + SIZE_PX / 2.0
    pixels_px = exact_px + rng.normal(0.0, NOISE_PX, exact_px.shape)
    is_seen = np.all((pixels_px >= 0.0) & (pixels_px < SIZE_PX), axis=-1)
    inputs = np.where(is_seen[..., None], pixels_px / (SIZE_PX / 2.0), UNSEEN)
    quaternions = Rotation.from_matrix(C_cam_world).as_quat(scalar_first=True)
    return Views(inputs.reshape(len(angles_rad), -1), quaternions)


def domain_result(
    errors: FloatArray, covariances: FloatArray, rows: BoolArray, *, scale: float
) -> DomainResult:
    """Return the figures of some errors, [N, 3], rad, and covariances, [N, 3, 3]."""
    chosen = errors[rows]
    predicted = covariances[rows]
    calibrated = scale * predicted
    return DomainResult(
        error_deg=float(np.degrees(np.linalg.norm(chosen, axis=-1)).mean()),
        nll=float(negative_log_likelihoods(chosen, predicted).mean()),
        coverage=coverage(chosen, predicted, PROBABILITY),
        calibrated_nll=float(negative_log_likelihoods(chosen, calibrated).mean()),
        calibrated_coverage=coverage(chosen, calibrated, PROBABILITY),
    )
