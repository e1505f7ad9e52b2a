"""Training of a network of the sun: recordings → images → network → calibration."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from probevo.arrays import FloatArray, concatenated
from probevo.config.networks import NetworkSettings
from probevo.nets.calibration import BLOCK, Claimed, calibration
from probevo.nets.covariance_scale import coverage, negative_log_likelihoods
from probevo.nets.domain import Domain
from probevo.nets.field_network import field_network, fit_fields
from probevo.nets.methods import Method
from probevo.nets.random_copies import RandomCopies, turned_views
from probevo.nets.recorded_training import OnProgress, Task, TrainingRun, train_task
from probevo.nets.sun_network import KIND, SPACE, SunNetwork, method_of, method_text
from probevo.nets.sun_views import (
    SunViews,
    check_sun_recording,
    image_statistics,
    read_views,
)
from probevo.nets.trained_network import (
    first_facts,
    kept_lines,
    saliency,
    sensor_errors,
)
from probevo.sensor_kinds import SensorErrors
from probevo.sequences.base import Sequence

RIDGE = 1.0
"""Ridge penalty of the linear regression: images of one street are alike, and count for few."""


def train_sun(
    recordings: Collection[Sequence],
    settings: NetworkSettings,
    out: Path,
    *,
    max_frames: int | None = None,
    on_progress: OnProgress | None = None,
) -> list[str]:
    """Learn the direction of the sun from recordings, and write the network (``train_task``).

    Returns:
        What was learned, in lines for the terminal.

    Raises:
        InputError: a recording has no ``sun.txt``, or as ``train_task`` raises.
    """
    task = Task(KIND, check=check_sun_recording, samples=SunViews, read=read_views, train=_train)
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
    baselines = facts["baseline_deg"]
    return [
        f"method:       {method_text(Method(**facts['method']))}",
        f"learned from: {len(facts['learned_from'])} recordings",
        f"left out:     {len(facts['left_out'])} recordings ({facts['num_left_out']} images)",
        *kept_lines(facts),
        f"error:        median {facts['error_deg']:.1f}°; of the linear regression"
        f" {baselines['linear regression']:.1f}°, of the mean direction"
        f" {baselines['mean direction']:.1f}°",
        f"covariance:   × {facts['scale']:.2f}; {facts['coverage_90']:.0%} of errors lie in their"
        f" 90 % region; × {facts['correlation']:.2f} where {BLOCK} successive images are fused",
    ]


def _train(views: list[SunViews], run: TrainingRun) -> SunNetwork:
    """Learn the network: a linear regression in closed form, and what the heads add to it."""
    # The last recordings are left out; of the others, copies are learned from.
    settings = run.settings
    learned = concatenated(views[: run.split])
    left_out = views[run.split :]
    joined = concatenated(left_out)
    method = method_of(settings)
    copies = RandomCopies(
        turned_views,
        learned.fields,
        learned.directions,
        count=run.num_copies,
        seed=settings.seed,
    )
    fit = fit_fields(copies, RIDGE)
    # The regression stays as it is; what is trained is added to it.
    trained = run.learn(
        method,
        SPACE,
        partial(field_network, space=SPACE, fit=fit),
        learned=(learned.fields, learned.directions),
        left_out=(joined.fields, joined.directions),
        augment=turned_views,
    )
    # Domain, facts, and calibration on what was left out.
    networks = trained.networks
    statistics_of_copies = [(image_statistics(fields), directions) for fields, directions in copies]
    statistics, directions = (
        np.concatenate(parts) for parts in zip(*statistics_of_copies, strict=True)
    )
    domain = Domain.of(statistics, image_statistics(joined.fields))
    first = {
        **first_facts(KIND, method),
        "scale": 1.0,
        "correlation": 1.0,
        "baseline_deg": {
            "linear regression": _median_deg(fit.estimates(joined.fields), joined.directions),
            "mean direction": _median_deg(
                np.tile(directions.mean(axis=0), (len(joined), 1)), joined.directions
            ),
        },
        **run.facts(trained),
    }
    return calibrated(SunNetwork(networks, domain, first), left_out)


def _median_deg(vectors: FloatArray, directions: FloatArray) -> float:
    """Return the median angle between vectors and true directions, degrees."""
    lengths = np.linalg.norm(vectors, axis=1)
    cosine = np.sum(vectors * directions, axis=1) / np.maximum(lengths, 1e-12)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def errors_of(network: SunNetwork, views: SunViews) -> Claimed:
    """Return the errors along azimuth and zenith angle, [N, 2], rad, and what was claimed."""
    estimates = network.estimate(views.fields)
    errors = SPACE.difference(jnp.asarray(estimates.directions), jnp.asarray(views.directions))
    return Claimed(np.asarray(errors, np.float64), estimates.covariance, estimates.widening)


def errors_on(path: Path, sequence: Sequence) -> SensorErrors:
    """Return the errors of a network on a recording with truth, where a run measures.

    Raises:
        InputError: the file cannot be read, the network measures nothing there, or the recording
            lacks images, truth or ``sun.txt``.
    """
    network = SunNetwork.load(path)
    views = read_views(sequence, len(sequence), is_thinned=True)
    claimed = errors_of(network, views)
    return sensor_errors(
        claimed._replace(covariances=network.correlation * claimed.covariances),
        network.facts,
        path=sequence.path,
        saliency=saliency(network, SPACE, views.fields, views.directions),
    )


def calibrated(network: SunNetwork, left_out: Collection[SunViews]) -> SunNetwork:
    """Return the network with the factors on its covariances that recordings left out ask for.

    One makes single errors consistent. The other is by how much more ten successive errors added up
    ask for: an estimate is wrong for as long as the street is the same, and a path that is
    corrected again and again has to claim no more than it knows.

    Args:
        network: with factors of 1.
        left_out: recordings that were not learned from.
    """
    claimed = [errors_of(network, views) for views in left_out]
    factors = calibration(claimed)
    errors = np.concatenate([each.errors for each in claimed])
    covariances = factors.scale_single * np.concatenate([each.covariances for each in claimed])
    angles = np.linalg.norm(errors, axis=1)
    facts = {
        **network.facts,
        **factors.facts(),
        "nll": float(np.mean(negative_log_likelihoods(errors, covariances))),
        "scale": factors.scale_single,
        # How much more blocks ask for once single errors are consistent
        "correlation": max(factors.scale_blocks / factors.scale_single, 1.0),
        "coverage_90": coverage(errors, covariances, 0.9),
        "error_deg": float(np.degrees(np.median(angles))),
    }
    return SunNetwork(network.networks, network.domain, facts)
