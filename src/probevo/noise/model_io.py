"""Reading and writing learned noise models of every registered kind."""

from __future__ import annotations

from pathlib import Path

from probevo.errors import InputError
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.model_file import ModelFile, read_model_file, write_model_file
from probevo.noise.registry import noise_kinds


def save_model(model: LearnedNoiseModel, path: Path | str) -> None:
    """Write a fitted model; the same model gives the same bytes.

    Raises:
        InputError: the model was not learned, or could not be read back, or the file cannot be
            written.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    if not hasattr(model, "to_file"):
        what = f"is a {type(model).__name__}, which has nothing to be kept."
        raise InputError("model", what, "Give a model as train_model or fit returns it.")
    try:
        file = model.to_file()
    except AttributeError as error:  # such as ``metric_``, which ``fit`` sets
        what = f"is a {type(model).__name__} that is not fitted: it has no {error.name}."
        raise InputError("model", what, "Call fit first.") from error
    _model_of(file, "model", "Nothing was written.")
    write_model_file(Path(path), file)


def load_model(path: Path | str) -> LearnedNoiseModel:
    """Read a model. A file holds data only; nothing in it is ever executed.

    Raises:
        InputError: the file is missing or damaged, or holds no noise model of a known kind.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    path = Path(path)
    return _model_of(read_model_file(path), path, "Train it again.")


def _model_of(file: ModelFile, where: Path | str, cure: str) -> LearnedNoiseModel:
    """Return the model that a file describes.

    Raises:
        InputError: its kind is unknown, or it does not hold such a model.
    """
    readers = {
        name: kind.from_file for name, kind in noise_kinds().items() if kind.from_file is not None
    }
    if file.kind not in readers:
        raise InputError(
            where,
            f"a noise model of kind {file.kind!r}.",
            f"Known are {', '.join(sorted(readers))}.",
        )
    # Each kind checks its own content; here the file and the remedy are added to what it reports.
    try:
        return readers[file.kind](file)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError, InputError) as error:
        raise InputError(
            where, f"it is not a complete {file.kind} model ({error}).", cure
        ) from error
