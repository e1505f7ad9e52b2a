"""Training of networks from recordings: checked, kept as it goes, resumed, progress shown.

Every kind of network goes through the same steps: recordings → samples → network → calibration on
recordings left out → file. What differs is a ``Task``.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import abc
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from probevo import __version__
from probevo.arrays import FloatArray
from probevo.config.networks import NetworkSettings
from probevo.errors import InputError
from probevo.nets import methods
from probevo.nets.calibration import BLOCK
from probevo.nets.extra import require_nets
from probevo.nets.image_pairs import facts_of
from probevo.nets.learning import Augment, Learned, LearningPlan, TrainingData, learn
from probevo.nets.methods import Build, Method
from probevo.nets.target_space import TargetSpace
from probevo.nets.trained_network import TrainedNetwork
from probevo.sequences.base import Sequence
from probevo.sequences.formats.folder import SUN_FILE
from probevo.storage.files import check_folder, remove_stale
from probevo.storage.lock import locked
from probevo.storage.npz import NO_NPZ, read_npz, write_npz

OnProgress = Callable[[int, int], None]
"""Takes the number of frames that are done, all epochs counted, and their total."""
OnFrame = Callable[[int], None]
"""Takes the number of frames of a recording that are done."""
Samples = TypeVar("Samples")
"""A dataclass whose fields are arrays, one row a datum."""


@dataclass(frozen=True)
class TrainingRun:
    """The inputs of a training beside its samples."""

    kind: str
    """Kind of network."""
    settings: NetworkSettings
    recordings: list[dict[str, Any]]
    """Facts of all recordings, in order; the last ``left_out`` are left out."""
    origins: list[str]
    """What else the samples of each recording depend on (``_origin``)."""
    num_frames: int
    """Number of frames of all recordings."""
    folder: Path
    """Where the work so far is kept."""
    extra: Any
    """JSON values on which the network also depends."""
    on_progress: OnProgress

    @property
    def split(self) -> int:
        """Number of recordings that are learned from."""
        return len(self.recordings) - self.settings.left_out

    @property
    def num_copies(self) -> int:
        """Random copies of each datum in an epoch, as many of them mirrored as not."""
        return 2 * self.settings.copies

    @property
    def total(self) -> int:
        """Frames to go through, all epochs counted."""
        return self.num_frames * (1 + self.settings.epochs)

    def learn(
        self,
        method: Method,
        space: TargetSpace,
        build: Build,
        *,
        learned: tuple[FloatArray, FloatArray],
        left_out: tuple[FloatArray, FloatArray],
        augment: Augment | None = None,
    ) -> Learned:
        """Train one network, resuming where an earlier call was stopped.

        The result has no dimension of experiments: arrays are [M, ...], of M networks.

        Args:
            method: what is learned, and by how many heads.
            space: of the targets.
            build: makes a network to begin with.
            learned: inputs [N, …] and targets [N, …] to learn from.
            left_out: the same of what only says when to stop.
            augment: makes random copies of what is learned from, as many as the settings say.
        """
        settings = self.settings
        copies = 1 if augment is None else self.num_copies
        # The file's name depends on all that the training depends on.
        facts = [self.recordings, self.origins, settings.model_dump(mode="json"), self.extra]
        trained = learn(
            method,
            space,
            build,
            data=_one_network(
                method,
                space,
                settings.seed,
                learned=learned,
                left_out=left_out,
                augment=augment,
            ),
            plan=LearningPlan(
                epochs=settings.epochs,
                batch=min(settings.batch, copies * len(learned[0])),
                learning_rate=settings.learning_rate,
                copies=copies,
                patience=settings.patience,
                calibrated_after=True,
                keep_every=1,
                seed=settings.seed,
            ),
            file=self.folder / f"network-{_digest([self.kind, *facts])}.safetensors",
            show=self._show_epochs,
        )
        networks = jax.tree.map(lambda array: array[0], trained.networks)
        return trained._replace(networks=networks)

    def facts(self, trained: Learned) -> dict[str, Any]:
        """Return what the file of a network says of its training."""
        names = [each["name"] for each in self.recordings]
        facts: dict[str, Any] = {
            "learned_from": names[: self.split],
            "left_out": names[self.split :],
            "views": [each["view"] for each in self.recordings],
            "settings": self.settings.model_dump(mode="json"),
        }
        if trained.kept_epoch is not None:
            facts |= {"epochs": trained.epochs, "kept_epoch": trained.kept_epoch}
        return facts

    def _show_epochs(self, done: int, total: int) -> None:
        self.on_progress(self.num_frames * (1 + done), self.total)


def _one_network(
    method: Method,
    space: TargetSpace,
    seed: int,
    *,
    learned: tuple[FloatArray, FloatArray],
    left_out: tuple[FloatArray, FloatArray],
    augment: Augment | None,
) -> TrainingData:
    """Return the data of one experiment of one network: with leading dimensions of 1."""
    # Noise of the targets and bootstrap samples are drawn once, by the seed.
    rng = np.random.default_rng(seed)
    inputs, truth = learned
    targets = methods.head_targets(method, space, truth, rng)
    samples = methods.samples(method, len(inputs), rng)
    return TrainingData(
        inputs=jnp.asarray(inputs[None], jnp.float32),
        targets=jnp.asarray(targets[None], jnp.float32),
        samples=jnp.asarray(samples[None]),
        held_out_inputs=jnp.asarray(left_out[0][None], jnp.float32),
        held_out_targets=jnp.asarray(left_out[1][None], jnp.float32),
        augment=augment,
    )


@dataclass(frozen=True)
class Task(Generic[Samples]):
    """The part of a training that is specific to one kind of network."""

    kind: str
    check: Callable[[Sequence], None]
    """Refuses a recording that it cannot learn from."""
    samples: type[Samples]
    read: Callable[[Sequence, int, OnFrame], Samples]
    """Reads the samples of a number of frames of a recording."""
    train: Callable[[list[Samples], TrainingRun], TrainedNetwork]
    """Learns the network from the samples of each recording, and calibrates it."""
    extra: Any = None
    """JSON values on which the samples depend beside the recording."""


def train_task(
    task: Task[Samples],
    recordings: abc.Sequence[Sequence],
    settings: NetworkSettings,
    *,
    out: Path,
    max_frames: int | None = None,
    on_progress: OnProgress | None = None,
) -> TrainedNetwork:
    """Learn a network from recordings with truth, and write it.

    What was done so far is kept in a folder beside ``out`` until the end, so that a training that
    was stopped resumes after the last recording, and after one of the last epochs. On one CPU, the
    same recordings and settings give the same bytes however often it was stopped.

    Args:
        task: the kind of network.
        recordings: those to learn from; the last ``left_out`` stop the training and calibrate it.
        settings: all settings.
        out: the file.
        max_frames: frames of each recording that are used; None for all.
        on_progress: called after each frame and each epoch.

    Raises:
        InputError: JAX is missing; a recording is faulty, lacks images or truth, is named twice, or
            sees too little; nothing would remain to learn from, or to calibrate by; or ``out``
            cannot be written to.
    """
    # Refuse early what cannot succeed.
    require_nets(f"train --kind {task.kind}")
    _check(recordings, settings)
    check_folder(out.parent, "--out")
    if out.is_dir():
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")
    counts = [min(len(sequence), max_frames or len(sequence)) for sequence in recordings]
    for sequence, count in zip(recordings, counts, strict=True):
        if count < BLOCK + 1:
            what = f"{count} frames are too few."
            raise InputError(sequence.path, what, f"Give at least {BLOCK + 1}.")
        task.check(sequence)
    folder = out.with_name(out.name + ".work")
    with locked(folder):
        run = TrainingRun(
            task.kind,
            settings,
            [facts_of(sequence, count) for sequence, count in zip(recordings, counts, strict=True)],
            origins=[_origin(sequence) for sequence in recordings],
            num_frames=sum(counts),
            folder=folder,
            extra=task.extra,
            on_progress=on_progress or _show_nothing,
        )
        # The work so far is removed only when the network is written.
        samples = _read_all(task, recordings, counts, run)
        _check_samples(samples, recordings, counts, split=run.split)
        network = task.train(samples, run)
        network.save(out)
        for file in [*folder.glob("samples-*.npz"), *folder.glob("network-*.safetensors")]:
            remove_stale(file)
    with suppress(OSError):  # it holds files of others
        folder.rmdir()
    return network


def _origin(sequence: Sequence) -> str:
    """Return a digest of where a recording is and what it shows, for the names of files of work.

    Two drives that are rendered alike but for their light have the same facts. The network's file
    does not depend on it: recordings may be moved.
    """
    origin = hashlib.sha256(os.fsencode(sequence.path.resolve()))
    origin.update(__version__.encode())
    origin.update(repr(sequence.imu).encode())
    first = next(iter(sequence))
    if first.left is not None:
        origin.update(first.left.tobytes())
    sun = sequence.path / SUN_FILE
    if sun.is_file():
        origin.update(sun.read_bytes())
    return origin.hexdigest()


def _read_all(
    task: Task[Samples],
    recordings: abc.Sequence[Sequence],
    counts: list[int],
    run: TrainingRun,
) -> list[Samples]:
    """Return the samples of each recording, also of those that an earlier call read."""
    samples = []
    for number, (sequence, count) in enumerate(zip(recordings, counts, strict=True)):
        done = sum(counts[:number])
        # The name depends on all that the samples depend on.
        key = [task.kind, run.recordings[number], run.origins[number], task.extra]
        file = run.folder / f"samples-{_digest(key)}.npz"
        own_samples = read_samples(file, task.samples)
        if own_samples is None:
            show = partial(_show_frames, run.on_progress, done, run.total)
            own_samples = task.read(sequence, count, show)
            write_samples(file, own_samples)
        samples.append(own_samples)
    return samples


def _check_samples(
    samples: list[Any], recordings: abc.Sequence[Sequence], counts: list[int], *, split: int
) -> None:
    """Refuse recordings whose truth is known too seldom to learn from them, or to calibrate.

    Args:
        samples: dataclasses of arrays, one row a datum, of each recording.
        recordings: the recordings.
        counts: number of frames of each that are used.
        split: number of recordings that are learned from.

    Raises:
        InputError: those to learn from give fewer data than a block of the calibration has, or one
            of those left out does.
    """
    sizes = [len(next(iter(vars(each).values()))) for each in samples]
    if sum(sizes[:split]) < BLOCK:
        what = f"{sum(sizes[:split])} of {sum(counts[:split])} frames can be learned from."
        cure = f"Name recordings whose truth is known for {BLOCK + 1} successive frames or more."
        raise InputError("SEQUENCE", what, cure)
    left_out = zip(recordings[split:], sizes[split:], counts[split:], strict=True)
    for sequence, size, count in left_out:
        if size < BLOCK:
            what = f"it is left out, and {size} of its {count} frames show errors of estimates."
            cure = (
                f"The covariance is calibrated by {BLOCK} successive ones: name last a recording"
                " whose truth is known for longer, or use more frames of it."
            )
            raise InputError(sequence.path, what, cure)


def write_samples(path: Path, samples: Any) -> None:
    """Write a dataclass of arrays to a file, completely or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    write_npz(path, vars(samples))


def read_samples(path: Path, samples: type[Samples]) -> Samples | None:
    """Return the samples of a file; None where it is missing or damaged."""
    try:
        return samples(**read_npz(path))
    except (*NO_NPZ, TypeError):
        return None


def _show_frames(on_progress: OnProgress, done: int, total: int, frames: int) -> None:
    """Show how many frames are read, of earlier recordings and of this one."""
    on_progress(done + frames, total)


def _show_nothing(done: int, total: int) -> None:
    """Show no progress."""


def _check(recordings: abc.Sequence[Sequence], settings: NetworkSettings) -> None:
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


def _digest(facts: Any) -> str:
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:12]
