"""Training of a network of corrections: recordings → estimated steps → network → calibration."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from probevo.arrays import FloatArray, concatenated
from probevo.config import OdometryConfig
from probevo.config.networks import NetworkSettings
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.nets.calibration import BLOCK, Claimed, block_sums, calibration
from probevo.nets.correction_network import (
    KIND,
    NUM_REGRESSORS,
    CorrectionNetwork,
    Standardisation,
    build,
    inputs_of,
    linear_estimates,
    linear_fit,
    standardised,
)
from probevo.nets.correction_space import ALL_AXES, ROTATION_AXES, CorrectionTargets
from probevo.nets.domain import Domain
from probevo.nets.estimated_steps import EstimatedSteps, read_steps
from probevo.nets.field_network import LinearFit
from probevo.nets.image_pairs import check_recording
from probevo.nets.methods import Method
from probevo.nets.networks import Network
from probevo.nets.recorded_training import OnProgress, Task, TrainingRun, train_task
from probevo.nets.trained_network import (
    first_facts,
    kept_lines,
    sensor_errors,
    trunk_features,
)
from probevo.sensor_kinds import SensorErrors
from probevo.sequences.base import Sequence

MIN_STEPS = NUM_REGRESSORS + 1
"""Steps to learn from, at least: the weights of the regression along one axis."""
MIN_SIGMA = np.array([1e-6, 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])
"""Standard deviations, m and rad, below which what remains of the training data is rounding."""


def train_correction(
    recordings: Collection[Sequence],
    settings: NetworkSettings,
    out: Path,
    *,
    odometry: OdometryConfig | None = None,
    max_frames: int | None = None,
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Learn how far the motions of an odometry are off, and write the network (``train_task``).

    Args:
        recordings: those to learn from; the last ``left_out`` stop the training and calibrate it.
        settings: all settings.
        out: the file.
        odometry: settings of the odometry; two frames, with the defaults, if left out.
        max_frames: frames of each recording that are used; None for all.
        on_progress: called after each frame and each epoch.

    Returns:
        What was learned, in lines for the terminal.

    Raises:
        InputError: there are too few steps, or as ``train_task`` raises.
    """
    config = odometry or OdometryConfig(estimator="two-frame")
    task = Task(
        KIND,
        check=check_recording,
        samples=EstimatedSteps,
        read=partial(read_steps, config=config),
        train=partial(_train, config=config),
        extra=config.model_dump(mode="json"),
    )
    network = train_task(
        task,
        tuple(recordings),
        settings,
        out=out,
        max_frames=max_frames,
        on_progress=on_progress,
    )
    return summary(network.facts)


def summary(facts: Mapping[str, Any]) -> list[str]:
    """Return what the file of a network says of its training, in lines for the terminal."""
    lines = [
        f"learned from: {', '.join(facts['learned_from'])}",
        f"left out:     {', '.join(facts['left_out'])} ({facts['num_left_out']} steps)",
        *kept_lines(facts),
        f"errors of {BLOCK} successive steps added up, RMS, left out:",
    ]
    for name, (length_m, angle_rad) in facts["left_out_rms"].items():
        lines.append(f"  {name:<18} {1e3 * length_m:7.2f} mm {np.degrees(angle_rad):8.4f}°")
    return [
        *lines,
        f"gain:         × {facts['gain']:.2f} on all corrections",
        f"covariance:   × {facts['scale']:.2f}, the larger of what single errors ask for"
        f" ({facts['scale_single']:.2f}) and what sums of {BLOCK} successive steps do"
        f" ({facts['scale_blocks']:.2f}); then {facts['coverage_90']:.0%} of single"
        " errors lie in their 90 % region",
    ]


def _train(
    steps: list[EstimatedSteps], run: TrainingRun, *, config: OdometryConfig
) -> CorrectionNetwork:
    """Learn the network: a linear regression in closed form, and what the heads add to it."""
    # The last recordings are left out.
    settings = run.settings
    learned = concatenated(steps[: run.split])
    left_out = steps[run.split :]
    joined = concatenated(left_out)
    if len(learned) < MIN_STEPS:
        what = f"{len(learned)} steps to learn from are too few."
        raise InputError("SEQUENCE", what, f"Give at least {MIN_STEPS}.")
    axes = ROTATION_AXES if settings.rotation_only else ALL_AXES
    inputs = inputs_of(learned.fields, learned.motions, learned.covariances)
    inputs_left_out = inputs_of(joined.fields, joined.motions, joined.covariances)
    standard = standardised(inputs)

    # Units and weights of the loss: the covariance of what the regression leaves of the training
    # data, since that is what remains to be learned. With Σ = L Lᵀ of it, outputs are L⁻¹ ξ, and
    # the regression is converted to these units.
    wanted = learned.corrections[:, axes]
    fit_si = linear_fit(inputs, standard, wanted)
    # What the regression leaves, [N, d], m and rad
    remaining = wanted - linear_estimates(inputs, standard, fit_si)
    least = np.diag(MIN_SIGMA[list(axes)] ** 2)
    root = np.linalg.cholesky(np.cov(remaining, rowvar=False) + least)
    space = CorrectionTargets(tuple(map(tuple, root.tolist())), axes)
    to_units = np.linalg.inv(root)
    linear = LinearFit(to_units @ fit_si.weights, to_units @ fit_si.offset)

    # The regression stays as it is; what is trained is added to it.
    method = method_of(settings)
    trained = run.learn(
        method,
        space,
        partial(_built, space=space, standard=standard, linear=linear),
        learned=(inputs, learned.corrections),
        left_out=(inputs_left_out, joined.corrections),
    )
    # Domain, facts, and calibration on what was left out.
    networks = trained.networks
    domain = Domain.of(trunk_features(networks, inputs), trunk_features(networks, inputs_left_out))
    first = {
        **first_facts(KIND, method),
        "root": root.tolist(),
        "axes": list(axes),
        "scale": 1.0,
        "gain": 1.0,
        "constant": wanted.mean(axis=0).tolist(),
        "odometry": config.model_dump(mode="json"),
        **run.facts(trained),
    }
    network = calibrated(CorrectionNetwork(networks, domain, first), left_out)
    # What remains on the recordings left out, against simpler corrections
    constant = np.tile(wanted.mean(axis=0), (len(joined), 1))
    linear_corrections = linear_estimates(inputs_left_out, standard, fit_si)
    network_corrections = network.estimate(inputs_left_out).xi[:, axes]
    baselines = {
        "uncorrected": np.zeros_like(constant),
        "constant": constant,
        "linear regression": linear_corrections,
        "network": network_corrections,
    }
    lengths = [len(part) for part in left_out]
    rms = {
        name: _rms(_with_axes(estimated, axes), joined.corrections, lengths)
        for name, estimated in baselines.items()
    }
    facts = {**network.facts, "left_out_rms": rms}
    return CorrectionNetwork(network.networks, network.domain, facts)


def method_of(settings: NetworkSettings) -> Method:
    """Return the method: hydra-sigma without noise on its targets, or the thesis's constant Σ."""
    if settings.constant_covariance:
        return Method("hydra", heads=settings.heads)
    return Method("hydra-sigma", heads=settings.heads, learns_covariance=True)


def _built(
    method: Method,
    key: jax.Array,
    *,
    space: CorrectionTargets,
    standard: Standardisation,
    linear: LinearFit,
) -> Network:
    return build(method, space, standard, linear=linear, key=key)


def errors_of(network: CorrectionNetwork, steps: EstimatedSteps) -> Claimed:
    """Return g = Log(T_corr T*⁻¹) along the corrected axes, [N, d], and what was claimed."""
    estimates = network.estimate(inputs_of(steps.fields, steps.motions, steps.covariances))
    errors = _remaining(estimates.xi, steps.corrections)[:, network.space.axes]
    return Claimed(errors, estimates.covariance, estimates.widening)


def errors_on(path: Path, sequence: Sequence) -> SensorErrors:
    """Return the errors of a network on a recording with truth.

    Raises:
        InputError: the file cannot be read, the network measures nothing there, or the recording
            lacks images or truth.
    """
    network = CorrectionNetwork.load(path)
    config = OdometryConfig.model_validate(network.facts["odometry"])
    steps = read_steps(sequence, len(sequence), config=config)
    return sensor_errors(
        errors_of(network, steps),
        network.facts,
        path=sequence.path,
        num_lengths=0 if network.space.axes == ROTATION_AXES else 3,
    )


def calibrated(
    network: CorrectionNetwork, left_out: Collection[EstimatedSteps]
) -> CorrectionNetwork:
    """Return the network with the factors on corrections and covariances that others ask for.

    The factor on corrections, between 0 and 1, comes from a regression of true on estimated ones,
    ten successive steps added up: what does not hold on other recordings is taken back.

    Args:
        network: with factors of 1.
        left_out: recordings that were not learned from.
    """
    axes = network.space.axes
    information = np.linalg.inv(np.asarray(network.space.root) @ np.asarray(network.space.root).T)
    # gain = Σ êᵀ Σ⁻¹ e / Σ êᵀ Σ⁻¹ ê over blocks of steps, ê estimated and e true corrections: the
    # regression of e on ê, weighted by the covariance of the training data.
    both = 0.0
    own = 0.0
    for steps in left_out:
        estimates = network.estimate(inputs_of(steps.fields, steps.motions, steps.covariances))
        estimated = block_sums(estimates.xi[:, axes])
        true = block_sums(steps.corrections[:, axes])
        both += float(np.einsum("ni,ij,nj->", estimated, information, true))
        own += float(np.einsum("ni,ij,nj->", estimated, information, estimated))
    gain = float(np.clip(both / own, 0.0, 1.0)) if own > 0.0 else 0.0
    # The covariance is calibrated on what the shrunk corrections leave.
    shrunk = CorrectionNetwork(network.networks, network.domain, {**network.facts, "gain": gain})
    claimed_all = [errors_of(shrunk, steps) for steps in left_out]
    facts = {**shrunk.facts, **calibration(claimed_all).facts()}
    return CorrectionNetwork(network.networks, network.domain, facts)


def _remaining(xi: FloatArray, xi_true: FloatArray) -> FloatArray:
    """Return g = Log(Exp(ξ) Exp(ξ*)⁻¹), [N, 6]."""
    pairs = zip(xi, xi_true, strict=True)
    return np.array([se3.log(se3.exp(one) @ se3.exp(-true)) for one, true in pairs])


def _with_axes(estimated: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Return corrections, [N, 6], of those along some axes, [N, d]."""
    xi = np.zeros((len(estimated), 6))
    xi[:, axes] = estimated
    return xi


def _rms(xi: FloatArray, xi_true: FloatArray, lengths: list[int]) -> tuple[float, float]:
    """Return the RMS of what remains of ten successive steps added up, m and rad."""
    remaining = _remaining(xi, xi_true)
    # Each recording by itself: no block reaches from one into the next.
    sums = [block_sums(part) for part in np.split(remaining, np.cumsum(lengths)[:-1])]
    squares = np.mean(np.concatenate(sums) ** 2, axis=0)
    return float(np.sqrt(squares[:3].sum())), float(np.sqrt(squares[3:].sum()))
