"""Settings of a training that do not go together are refused here, before the long work."""

from __future__ import annotations

from operator import attrgetter

from probevo.config.networks import METHOD_SETTINGS
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.sensor_kinds import SENSOR_KINDS
from probevo.training.trainer import trainer_of

SENSOR_SETTINGS = ("kind", "nets", "max_frames")
"""Fields of ``TrainSettings`` that the training of a sensor uses."""
MIN_IN_ENSEMBLE = 2
"""Networks whose estimates have a spread."""


def check_settings(settings: TrainSettings) -> None:
    """Refuse what the kind of model cannot do, and what it would silently ignore.

    Raises:
        InputError: names the flag.
    """
    kind = settings.kind
    trainer = trainer_of(kind)

    # What the supervision gives must suffice for the kind of model, and use all that is set.
    if settings.every_s and settings.supervision not in ("sparse", "position"):
        raise InputError(
            "--every-s",
            f"--supervision {settings.supervision} does not take it.",
            "Leave it out, or take --supervision sparse or position.",
        )
    if settings.supervision == "position" and not trainer.learns_from_positions:
        raise InputError(
            "--supervision",
            f"position is for --kind knn alone: {kind} takes the truth as a motion, and positions"
            " give no rotation.",
            "Take sparse if attitudes are known too, or else loop or none.",
        )

    # A model without predictors has no prediction space to choose.
    if settings.predictors is not None and not trainer.default_predictors:
        raise InputError(
            "--predictors",
            f"{kind} takes none: it gives all features the same noise.",
            "Leave it out.",
        )

    # A setting of another kind counts as given if it differs from its default.
    default = TrainSettings()
    if settings.nets != default.nets:
        raise InputError("--nets", f"--kind {kind} is not a network.", "Leave its options out.")
    for name, cure in trainer.unused_settings.items():
        value_of = attrgetter(name)
        if value_of(settings) != value_of(default):
            flag = "--" + name.replace("_", "-")
            raise InputError(flag, f"--kind {kind} does not take it.", cure)

    # What remains concerns this kind only.
    trainer.check(settings)


def check_sensor_settings(settings: TrainSettings) -> None:
    """Refuse settings that the training of a sensor would silently ignore.

    Raises:
        InputError: names the first of them.
    """
    default = TrainSettings()
    kind = SENSOR_KINDS[settings.kind]
    for name in TrainSettings.model_fields:
        if name not in (*SENSOR_SETTINGS, *kind.settings) and getattr(settings, name) != getattr(
            default, name
        ):
            flag = "--" + name.replace("_", "-")
            what = f"--kind {settings.kind} does not take it: it is not a noise model."
            raise InputError(flag, what, "Leave it out.")
    for name in sorted({name for other in SENSOR_KINDS.values() for name in other.nets}):
        if name not in kind.nets and getattr(settings.nets, name) != getattr(default.nets, name):
            flag = "--nets." + name.replace("_", "-")
            raise InputError(flag, f"--kind {kind.name} does not take it.", "Leave it out.")
    method = settings.nets.method
    if method == "ensemble" and settings.nets.networks < MIN_IN_ENSEMBLE:
        what = "one network has no spread."
        raise InputError("--nets.networks", what, f"Give {MIN_IN_ENSEMBLE} or more.")
    for other, names in METHOD_SETTINGS.items():
        for name in names:
            is_given = getattr(settings.nets, name) != getattr(default.nets, name)
            if is_given and name not in METHOD_SETTINGS[method]:
                what = f"the method {method} does not take it."
                cure = f"Leave it out, or take --nets.method {other}."
                raise InputError(f"--nets.{name}", what, cure)
