"""Training of a network of rotations: recordings → pairs of images → network → calibration."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Collection
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.files import check_folder, remove_stale
from probevo.geometry import so3
from probevo.lock import locked
from probevo.nets import methods, quaternions
from probevo.nets.covariance_scale import (
    covariance_scale,
    coverage,
    negative_log_likelihoods,
)
from probevo.nets.domain import Domain
from probevo.nets.extra import require_nets
from probevo.nets.field_network import LinearFit, linear_fit, pooled_flow, standardisation
from probevo.nets.image_pairs import (
    ImagePairs,
    check_recording,
    facts_of,
    read_pairs,
    read_pairs_file,
    write_pairs,
)
from probevo.nets.learning import LearningPlan, TrainingData, learn
from probevo.nets.rotation_network import (
    SPACE,
    RotationNetwork,
    build,
    first_facts,
    method_of,
    trunk_features,
)
from probevo.network_settings import NetworkSettings
from probevo.sensor_kinds import SensorErrors
from probevo.sequences.base import Sequence

BLOCK = 10
"""Successive pairs whose errors are added up to see how far they are correlated in time."""
OnProgress = Callable[[int, int], None]
"""Takes the number of frames that are done, all epochs counted, and their total."""


def train_rotation(
    recordings: Collection[Sequence],
    settings: NetworkSettings,
    out: Path,
    *,
    max_frames: int | None = None,
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Learn rotations from recordings with truth, and write the network.

    What was done so far is kept in a folder beside ``out`` until the end, so that a training that
    was stopped resumes after the last recording, and after one of the last epochs. On one CPU, the
    same recordings and settings give the same bytes however often it was stopped.

    Args:
        recordings: those to learn from; the last ``left_out`` stop the training and calibrate it.
        settings: all settings.
        out: the file.
        max_frames: frames of each recording that are used; None for all.
        on_progress: called after each frame and each epoch.

    Returns:
        What was learned, in lines for the terminal.

    Raises:
        InputError: JAX is missing; a recording is faulty, lacks images or truth, is named twice, or
            sees too little; nothing would remain to learn from; or ``out`` cannot be written to.
    """
    require_nets("train --kind rotation")
    _check(recordings, settings)
    check_folder(out.parent, "--out")
    if out.is_dir():
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")
    counts = [min(len(sequence), max_frames or len(sequence)) for sequence in recordings]
    for sequence, count in zip(recordings, counts, strict=True):
        if count < BLOCK + 1:
            what = f"{count} frames are too few."
            raise InputError(sequence.path, what, f"Give at least {BLOCK + 1}.")
        check_recording(sequence)
    folder = out.with_name(out.name + ".work")
    with locked(folder):
        network = _train(
            recordings, counts, settings, folder=folder, on_progress=on_progress or _show_nothing
        )
        network.save(out)
        for file in [*folder.glob("pairs-*.npz"), *folder.glob("network-*.safetensors")]:
            remove_stale(file)
    with suppress(OSError):  # it holds files of others
        folder.rmdir()
    return summary(network.facts)


def summary(facts: Mapping[str, Any]) -> list[str]:
    """Return what the file of a network says of its training, in lines for the terminal."""
    rms_deg = ", ".join(f"{value:.3f}" for value in facts["error_rms_deg"])
    return [
        f"learned from: {', '.join(facts['learned_from'])}",
        f"left out:     {', '.join(facts['left_out'])} ({facts['num_left_out']} pairs)",
        f"error:        median {facts['error_deg']:.3f}°, rms {rms_deg}° about x, y, z; that of the"
        f" linear regression {facts['linear_error_deg']:.3f}°",
        f"covariance:   × {facts['scale']:.2f}, by errors of {BLOCK} successive pairs"
        f" ({facts['scale_single']:.2f} by single ones); then {facts['coverage_90']:.0%} of single"
        " errors lie in their 90 % region",
    ]


def _show_frames(on_progress: OnProgress, done: int, total: int, frames: int) -> None:
    """Show how many frames are read: those of earlier recordings, and these."""
    on_progress(done + frames, total)


def _show_nothing(done: int, total: int) -> None:
    """Show no progress."""


def _check(recordings: Collection[Sequence], settings: NetworkSettings) -> None:
    """Refuse recordings that are named twice, or too few.

    Raises:
        InputError: says which.
    """
    paths = [sequence.path.resolve() for sequence in recordings]
    for path in paths:
        if paths.count(path) > 1:
            cure = "Name each once: it would count double."
            raise InputError(path, "this recording is named twice.", cure)
    if len(recordings) <= settings.left_out:
        what = f"{len(recordings)} named, of which the last {settings.left_out} would be left out."
        cure = "Name more, since the covariance is calibrated on recordings that are left out."
        raise InputError("SEQUENCE", what, cure)


def _train(
    recordings: Collection[Sequence],
    counts: list[int],
    settings: NetworkSettings,
    *,
    folder: Path,
    on_progress: OnProgress,
) -> RotationNetwork:
    """Learn the network, while no other process does."""
    total = sum(counts) * (1 + settings.epochs)
    facts = [facts_of(sequence, count) for sequence, count in zip(recordings, counts, strict=True)]
    pairs = []
    for number, (sequence, count) in enumerate(zip(recordings, counts, strict=True)):
        done = sum(counts[:number])
        file = folder / f"pairs-{_digest(facts[number])}.npz"
        found = read_pairs_file(file)
        if found is None:
            found = read_pairs(sequence, count, partial(_show_frames, on_progress, done, total))
            write_pairs(file, found)
        pairs.append(found)
    split = len(pairs) - settings.left_out
    learned = ImagePairs.joined(pairs[:split]).multiplied(
        settings.copies, np.random.default_rng(settings.seed)
    )
    left_out = pairs[split:]

    # The network: a linear regression in closed form, then what the heads add to it.
    method = method_of(settings.heads)
    linear = linear_fit(learned.fields, learned.rotations / SPACE.unit_rad)
    file = folder / f"network-{_digest([facts, settings.model_dump(mode='json')])}.safetensors"
    of_experiments = learn(
        method,
        SPACE,
        partial(_built, fields=learned.fields, linear=linear),
        data=_data(learned, ImagePairs.joined(left_out), settings),
        plan=LearningPlan(
            epochs=settings.epochs,
            batch=settings.batch,
            learning_rate=settings.learning_rate,
            patience=settings.patience,
            keep_every=1,
            seed=settings.seed,
        ),
        file=file,
        show=lambda epochs, _: on_progress(sum(counts) * (1 + epochs), total),
    )
    networks = jax.tree.map(lambda array: array[0], of_experiments)
    domain = Domain.of(
        trunk_features(networks, learned.fields),
        trunk_features(networks, ImagePairs.joined(left_out).fields),
    )
    of_linear = linear_errors(linear, learned, ImagePairs.joined(left_out))
    first = {
        **first_facts(method),
        "scale": 1.0,
        "linear_error_deg": float(np.degrees(np.median(np.linalg.norm(of_linear, axis=1)))),
    }
    trained = RotationNetwork(networks, domain, first)
    return calibrated(trained, left_out, recordings=facts, settings=settings)


def _built(method: methods.Method, key: jax.Array, *, fields: FloatArray, linear: Any) -> Any:
    return build(method, fields, linear, key)


def _data(learned: ImagePairs, left_out: ImagePairs, settings: NetworkSettings) -> TrainingData:
    """Return the data of one network, with leading dimensions of 1."""
    method = method_of(settings.heads)
    rng = np.random.default_rng(settings.seed)
    targets = methods.head_targets(method, SPACE, _quaternions(learned.rotations), rng)
    samples = methods.samples(method, len(learned), rng)
    return TrainingData(
        inputs=jnp.asarray(learned.fields[None], jnp.float32),
        targets=jnp.asarray(targets[None], jnp.float32),
        samples=jnp.asarray(samples[None]),
        held_out_inputs=jnp.asarray(left_out.fields[None], jnp.float32),
        held_out_targets=jnp.asarray(_quaternions(left_out.rotations)[None], jnp.float32),
    )


def linear_errors(linear: LinearFit, learned: ImagePairs, left_out: ImagePairs) -> FloatArray:
    """Return the errors of the linear regression alone, [N, 3], rad, on pairs left out."""
    mean, scale = standardisation(learned.fields)
    flow = np.asarray(pooled_flow((left_out.fields - mean) * scale), np.float64)
    estimated = SPACE.unit_rad * (flow @ linear.weights.T + linear.offset)
    errors: FloatArray = so3.log(so3.exp(estimated) @ so3.exp(-left_out.rotations))
    return errors


def errors_of(network: RotationNetwork, pairs: ImagePairs) -> tuple[FloatArray, FloatArray]:
    """Return φ = Log(C_estimated C_trueᵀ), [N, 3], rad, and the claimed covariances, [N, 3, 3]."""
    found = network.estimate(pairs.fields)
    q_true = jnp.asarray(_quaternions(pairs.rotations))
    errors = SPACE.difference(jnp.asarray(found.q_curr_prev), q_true)
    return np.asarray(errors, np.float64), found.covariance


def errors_on(path: Path, sequence: Sequence) -> SensorErrors:
    """Return the errors of a network on a recording with truth.

    Raises:
        InputError: the file cannot be read, or the recording lacks images or truth.
    """
    network = RotationNetwork.load(path)
    pairs = read_pairs(sequence, len(sequence))
    errors, covariances = errors_of(network, pairs)
    widening = network.estimate(pairs.fields).widening
    return SensorErrors(errors, covariances, int(np.sum(widening > 1.0)))


def calibrated(
    network: RotationNetwork,
    left_out: Collection[ImagePairs],
    *,
    recordings: list[dict[str, Any]],
    settings: NetworkSettings,
) -> RotationNetwork:
    """Return the network with the factor on its covariances that recordings left out ask for.

    Errors of successive pairs are correlated: the same street is seen again. A path adds them up,
    and each measurement enters with a covariance of its own, so that the sum of ten errors has to
    fit the sum of their covariances, too. The larger of the two factors counts.

    Args:
        network: with a factor of 1.
        left_out: recordings that were not learned from.
        recordings: facts of all recordings, for the file.
        settings: of the training, for the file.
    """
    errors = []
    covariances = []
    block_errors = []
    block_covariances = []
    for pairs in left_out:
        error, covariance = errors_of(network, pairs)
        errors.append(error)
        covariances.append(covariance)
        blocks = len(error) // BLOCK
        used = slice(0, blocks * BLOCK)
        block_errors.append(error[used].reshape(blocks, BLOCK, 3).sum(axis=1))
        block_covariances.append(covariance[used].reshape(blocks, BLOCK, 3, 3).sum(axis=1))
    all_errors = np.concatenate(errors)
    all_covariances = np.concatenate(covariances)
    single = covariance_scale(all_errors, all_covariances)
    in_blocks = covariance_scale(np.concatenate(block_errors), np.concatenate(block_covariances))
    scale = max(single, in_blocks)
    split = len(recordings) - len(left_out)
    names = [each["name"] for each in recordings]
    nll = negative_log_likelihoods(all_errors, scale * all_covariances)
    facts = {
        **network.facts,
        "scale": scale,
        "scale_single": single,
        "scale_blocks": in_blocks,
        "error_deg": float(np.degrees(np.median(np.linalg.norm(all_errors, axis=1)))),
        "error_rms_deg": np.degrees(np.sqrt(np.mean(all_errors**2, axis=0))).tolist(),
        "nll": float(np.mean(nll)),
        "coverage_90": coverage(all_errors, scale * all_covariances, 0.9),
        "learned_from": names[:split],
        "left_out": names[split:],
        "num_left_out": len(all_errors),
        "settings": settings.model_dump(mode="json"),
    }
    return RotationNetwork(network.networks, network.domain, facts)


def _quaternions(rotation_vectors: FloatArray) -> FloatArray:
    """Return unit quaternions, [N, 4], scalar first, of rotation vectors, [N, 3], rad."""
    return np.asarray(quaternions.exp(jnp.asarray(rotation_vectors, jnp.float32)))


def _digest(facts: Any) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:12]
