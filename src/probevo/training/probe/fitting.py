"""Samples → model, with K and γ given or chosen (PROBE IV-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise.probe.nearest_neighbors import NearestNeighbors, check_neighbors
from probevo.noise.registry import untrained_model
from probevo.training.probe.samples import Samples, folds_of_steps
from probevo.training.probe.selection import Search, choose_exponent, choose_neighbors, out_of_fold
from probevo.training.probe.subsets import SubsetSampler
from probevo.training.trainer import TrainingContext


def fit_model(
    samples: Samples, samplers: Sequence[SubsetSampler], context: TrainingContext
) -> NearestNeighbors:
    """Fit the model to all samples, with K and γ given or chosen.

    Args:
        samples: the samples of all drives.
        samplers: one for each drive.
        context: the metric of the prediction space, the settings, and facts of the recordings.

    Raises:
        InputError: K is larger than the data, or K or γ is to be chosen and the drives are too
            short for that.
    """
    settings = context.settings
    searches: dict[str, Search] = {}
    neighbors = settings.neighbors
    exponent = settings.exponent

    # Neighbours are averaged in α, or in its logarithm.
    coordinates = np.concatenate([sampler.coordinates for sampler in samplers])[samples.features]
    is_logarithmic = settings.average == "geometric"
    values = np.log(samples.alphas) if is_logarithmic else samples.alphas
    if neighbors is not None:
        check_neighbors(neighbors, len(values))
    if (neighbors is None or exponent is None) and len(np.unique(samples.fold_by_time)) < 2:
        raise InputError(
            "training data",
            "the drives are too short to choose K and γ by blocks of time.",
            "Give longer ones, or both --neighbors and --exponent.",
        )

    # K by cross-validation.
    if neighbors is None:
        searches["neighbors"] = choose_neighbors(coordinates, values, samples.fold_by_error)
        neighbors = int(searches["neighbors"].chosen)

    # γ by the error of the training drives, each feature weighed by samples of other folds.
    if exponent is None:
        log_relative_alphas = _log_relative_alphas(
            samples,
            samplers,
            coordinates,
            values=values,
            neighbors=neighbors,
            is_logarithmic=is_logarithmic,
        )
        searches["exponent"] = choose_exponent(samplers, log_relative_alphas)
        exponent = searches["exponent"].chosen

    # The model keeps all samples, at their points in the prediction space.
    model = NearestNeighbors(
        neighbors,
        exponent,
        settings.average,
        base=untrained_model(settings.base),
        camera=samplers[0].camera,
        training={
            "settings": settings.model_dump(mode="json"),
            "recordings": [dict(recording) for recording in context.recordings],
            "searches": {name: search.as_dict() for name, search in searches.items()},
        },
    )
    phi = np.concatenate([sampler.drive.phi for sampler in samplers])[samples.features]
    return model.fit(phi, samples.alphas, metric=context.metric)


def _log_relative_alphas(
    samples: Samples,
    samplers: Sequence[SubsetSampler],
    coordinates: FloatArray,
    *,
    values: FloatArray,
    neighbors: int,
    is_logarithmic: bool,
) -> list[FloatArray]:
    """Predict ln(α/ᾱ) of every feature of each drive from the samples of other folds, [n] each.

    Args:
        samples: the N samples.
        samplers: one for each drive.
        coordinates: points of the samples, [N, M].
        values: α of the samples, or its logarithm, [N].
        neighbors: K.
        is_logarithmic: whether the values are logarithms.
    """
    # Where values are logarithms, the difference of means is the logarithm of a ratio.
    mean_of_all = float(values.mean())
    predicted = []
    for number, sampler in enumerate(samplers):
        fold_of_feature = folds_of_steps(sampler, number)[sampler.drive.step_of_feature]
        means = out_of_fold(
            coordinates,
            values,
            samples.fold_by_time,
            neighbors=neighbors,
            queries=sampler.coordinates,
            fold_of_query=fold_of_feature,
        )
        predicted.append(means - mean_of_all if is_logarithmic else np.log(means / mean_of_all))
    return predicted
