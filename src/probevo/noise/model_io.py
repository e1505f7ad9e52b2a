"""Reading and writing learned noise models of every registered kind."""

from __future__ import annotations

from pathlib import Path

from probevo.errors import InputError
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.model_file import read_model_file, write_model_file
from probevo.noise.registry import noise_kinds


def save_model(model: LearnedNoiseModel, path: Path | str) -> None:
    """Write a fitted model; the same model gives the same bytes.

    Raises:
        InputError: the model was not learned, or the file cannot be written.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    if not hasattr(model, "to_file"):
        what = f"is a {type(model).__name__}, which has nothing to be kept."
        raise InputError("model", what, "Give a model as train_model or fit returns it.")
    write_model_file(Path(path), model.to_file())


def load_model(path: Path | str) -> LearnedNoiseModel:
    """Read a model. A file holds data only; nothing in it is ever executed.

    Raises:
        InputError: the file is missing or damaged, or holds no noise model of a known kind.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    path = Path(path)
    file = read_model_file(path)
    readers = {
        name: kind.from_file for name, kind in noise_kinds().items() if kind.from_file is not None
    }
    if file.kind not in readers:
        raise InputError(
            path,
            f"a noise model of kind {file.kind!r}.",
            f"Known are {', '.join(sorted(readers))}.",
        )
    # Each kind checks its own content; here the file and the remedy are added to what it reports.
    try:
        return readers[file.kind](file)
    except (KeyError, ValueError, OverflowError, RecursionError, InputError) as error:
        raise InputError(
            path, f"it is not a complete {file.kind} model ({error}).", "Train it again."
        ) from error
