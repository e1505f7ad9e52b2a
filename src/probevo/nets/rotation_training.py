"""Training of a network of rotations: recordings → pairs of images → network → calibration."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray, concatenated
from probevo.config.networks import NetworkSettings
from probevo.geometry import so3
from probevo.nets import quaternions
from probevo.nets.calibration import BLOCK, Claimed, calibration
from probevo.nets.domain import Domain
from probevo.nets.field_network import FieldFit, field_network, fit_fields
from probevo.nets.image_pairs import ImagePairs, check_recording, read_pairs
from probevo.nets.random_copies import RandomCopies, turned_pairs
from probevo.nets.recorded_training import OnProgress, Task, TrainingRun, train_task
from probevo.nets.rotation_network import KIND, SPACE, RotationNetwork, method_of
from probevo.nets.trained_network import (
    first_facts,
    kept_lines,
    saliency,
    sensor_errors,
    trunk_features,
)
from probevo.sensor_kinds import SensorErrors
from probevo.sequences.base import Sequence


def train_rotation(
    recordings: Collection[Sequence],
    settings: NetworkSettings,
    out: Path,
    *,
    max_frames: int | None = None,
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Learn rotations from recordings with truth, and write the network (``train_task``).

    Returns:
        What was learned, in lines for the terminal.

    Raises:
        InputError: as ``train_task`` raises.
    """
    task = Task(KIND, check=check_recording, samples=ImagePairs, read=read_pairs, train=_train)
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
    rms_deg = ", ".join(f"{value:.3f}" for value in facts["error_rms_deg"])
    return [
        f"learned from: {', '.join(facts['learned_from'])}",
        f"left out:     {', '.join(facts['left_out'])} ({facts['num_left_out']} pairs)",
        *kept_lines(facts),
        f"error:        median {facts['error_deg']:.3f}°, rms {rms_deg}° about x, y, z; that of the"
        f" linear regression {facts['linear_error_deg']:.3f}°",
        f"covariance:   × {facts['scale']:.2f}, the larger of what single errors ask for"
        f" ({facts['scale_single']:.2f}) and what sums of {BLOCK} successive pairs do"
        f" ({facts['scale_blocks']:.2f}); then {facts['coverage_90']:.0%} of single"
        " errors lie in their 90 % region",
    ]


def _train(pairs: list[ImagePairs], run: TrainingRun) -> RotationNetwork:
    """Learn the network: a linear regression in closed form, and what the heads add to it."""
    # The last recordings are left out; of the others, copies are learned from.
    settings = run.settings
    learned = concatenated(pairs[: run.split])
    left_out = pairs[run.split :]
    joined = concatenated(left_out)
    method = method_of(settings.heads)
    copies = RandomCopies(
        turned_pairs,
        learned.fields,
        _quaternions(learned.rotations),
        count=run.num_copies,
        seed=settings.seed,
    )
    fit = fit_fields((fields, _vectors(q) / SPACE.unit_rad) for fields, q in copies)
    # The regression stays as it is; what is trained is added to it.
    trained = run.learn(
        method,
        SPACE,
        partial(field_network, space=SPACE, fit=fit),
        learned=(learned.fields, _quaternions(learned.rotations)),
        left_out=(joined.fields, _quaternions(joined.rotations)),
        augment=turned_pairs,
    )
    # Domain, facts, and calibration on what was left out.
    networks = trained.networks
    domain = Domain.of(
        np.concatenate([trunk_features(networks, fields) for fields, _ in copies]),
        trunk_features(networks, joined.fields),
    )
    regression_errors = linear_errors(fit, joined)
    first = {
        **first_facts(KIND, method),
        "scale": 1.0,
        "linear_error_deg": float(np.degrees(np.median(np.linalg.norm(regression_errors, axis=1)))),
        **run.facts(trained),
    }
    return calibrated(RotationNetwork(networks, domain, first), left_out)


def linear_errors(fit: FieldFit, pairs: ImagePairs) -> FloatArray:
    """Return the errors of the linear regression alone, [N, 3], rad, on pairs left out."""
    # Outputs are in units of 0.01 rad; errors are left perturbations, Log(C C_trueᵀ).
    estimated = SPACE.unit_rad * fit.estimates(pairs.fields)
    errors: FloatArray = so3.log(so3.exp(estimated) @ so3.exp(-pairs.rotations))
    return errors


def errors_of(network: RotationNetwork, pairs: ImagePairs) -> Claimed:
    """Return φ = Log(C_estimated C_trueᵀ), [N, 3], rad, and what was claimed."""
    estimates = network.estimate(pairs.fields)
    q_true = jnp.asarray(_quaternions(pairs.rotations))
    errors = SPACE.difference(jnp.asarray(estimates.q_curr_prev), q_true)
    return Claimed(np.asarray(errors, np.float64), estimates.covariance, estimates.widening)


def errors_on(path: Path, sequence: Sequence) -> SensorErrors:
    """Return the errors of a network on a recording with truth.

    Raises:
        InputError: the file cannot be read, the network measures nothing there, or the recording
            lacks images or truth.
    """
    network = RotationNetwork.load(path)
    pairs = read_pairs(sequence, len(sequence))
    return sensor_errors(
        errors_of(network, pairs),
        network.facts,
        path=sequence.path,
        saliency=saliency(network, SPACE, pairs.fields, _quaternions(pairs.rotations)),
    )


def calibrated(network: RotationNetwork, left_out: Collection[ImagePairs]) -> RotationNetwork:
    """Return the network with the factor on its covariances that recordings left out ask for.

    Args:
        network: with a factor of 1.
        left_out: recordings that were not learned from.
    """
    claimed = [errors_of(network, pairs) for pairs in left_out]
    errors = np.concatenate([each.errors for each in claimed])
    facts = {
        **network.facts,
        **calibration(claimed).facts(),
        "error_deg": float(np.degrees(np.median(np.linalg.norm(errors, axis=1)))),
        "error_rms_deg": np.degrees(np.sqrt(np.mean(errors**2, axis=0))).tolist(),
    }
    return RotationNetwork(network.networks, network.domain, facts)


def _quaternions(rotation_vectors: FloatArray) -> FloatArray:
    """Return unit quaternions, [N, 4], scalar first, of rotation vectors, [N, 3], rad."""
    return np.asarray(quaternions.exp(jnp.asarray(rotation_vectors, jnp.float32)))


def _vectors(q: FloatArray) -> FloatArray:
    """Return rotation vectors, [N, 3], rad, of unit quaternions, [N, 4], scalar first."""
    return np.asarray(quaternions.log(jnp.asarray(q, jnp.float32)), np.float64)
