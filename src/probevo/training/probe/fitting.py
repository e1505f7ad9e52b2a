"""Samples → model, with K and γ given or chosen (PROBE IV-B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from probevo.errors import InputError
from probevo.noise.metric import Metric
from probevo.noise.probe.nearest_neighbors import NearestNeighbors, check_neighbors
from probevo.noise.registry import untrained_model
from probevo.training.probe.samples import Samples, folds_of_steps
from probevo.training.probe.selection import Search, choose_exponent, choose_neighbors, out_of_fold
from probevo.training.probe.subsets import Learner
from probevo.training.settings import TrainSettings


def fit_model(
    samples: Samples,
    learners: Sequence[Learner],
    metric: Metric,
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
) -> NearestNeighbors:
    """The model of all samples, with K and γ given or chosen.

    Args:
        samples: of all drives.
        learners: the drives.
        metric: of the prediction space.
        settings: all settings.
        recordings: what the model should remember of each recording.

    Raises:
        InputError: K is larger than the data, or K or γ is to be chosen and the drives are too
            short for that.
    """
    searches: dict[str, Search] = {}
    neighbors = settings.neighbors
    exponent = settings.exponent
    coordinates = np.concatenate([learner.coordinates for learner in learners])[samples.features]
    logarithmic = settings.average == "geometric"
    values = np.log(samples.alphas) if logarithmic else samples.alphas
    if neighbors is not None:
        check_neighbors(neighbors, len(values))
    if (neighbors is None or exponent is None) and len(np.unique(samples.fold)) < 2:
        what = "the drives are too short to choose K and γ by blocks of time."
        raise InputError(
            "training data", what, "Give longer ones, or both --neighbors and --exponent."
        )
    if neighbors is None:
        searches["neighbors"] = choose_neighbors(coordinates, values, samples.left_out)
        neighbors = int(searches["neighbors"].chosen)
    if exponent is None:
        relative = []
        overall = float(values.mean())
        for number, learner in enumerate(learners):
            own = folds_of_steps(learner, number)[learner.drive.step_of_feature]
            means = out_of_fold(
                coordinates,
                values,
                samples.fold,
                neighbors=neighbors,
                asked=learner.coordinates,
                fold_asked=own,
            )
            relative.append(means - overall if logarithmic else np.log(means / overall))
        searches["exponent"] = choose_exponent(learners, relative)
        exponent = searches["exponent"].chosen
    training = {
        "settings": settings.model_dump(mode="json"),
        "recordings": [dict(recording) for recording in recordings],
        "searches": {name: search.as_dict() for name, search in searches.items()},
    }
    model = NearestNeighbors(
        neighbors,
        exponent,
        settings.average,
        base=untrained_model(settings.base),
        camera=learners[0].camera,
        training=training,
    )
    predictors = np.concatenate([learner.drive.phi for learner in learners])[samples.features]
    return model.fit(predictors, samples.alphas, metric=metric)
