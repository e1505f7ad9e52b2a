"""``probevo paper hydranet``: both experiments from the first datum to the last file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np

from probevo import __version__
from probevo.cli.progress import progress_bar
from probevo.cli.text import table
from probevo.nets.extra import require_nets
from probevo.output.comparison.comparison_files import write_csv
from probevo.output.json_file import write_json
from probevo.storage.files import write_atomically
from probevo_paper.hydranet_config import HydranetConfig

NUMBERS_HEAD = ("1-D regression", "median NLL", "published", "10 % … 90 %", "RMS error")
ORBIT_HEAD = (
    *("orbiting camera", "error in, °", "out, °", "NLL in", "out", "90 % holds in", "out"),
    *("factor", "calibrated: in", "out"),
)
NOTES = (
    "1-D regression: negative log-likelihood of true values on [−2, 2]; trained on [0, 0.6] and"
    " [0.8, 1].",
    "Orbiting camera: in is within ±60° of polar angle, as trained; out is from there to ±81°.",
    "Factor: what views left out ask the covariances to be multiplied by; 1 is consistent.",
)


def repeat_experiments(settings: HydranetConfig, out: Path) -> list[str]:
    """Repeat the experiments; return the lines to print.

    Networks that an earlier call has trained with the same settings are not trained again, and an
    unfinished training is resumed.

    Raises:
        InputError: JAX is missing, or a file cannot be read or written.
    """
    require_nets("paper hydranet")
    records: list[dict[str, object]] = []
    texts = []
    if "numbers" in settings.experiments:
        rows = _repeat_numbers(settings, out, records)
        texts += [table(NUMBERS_HEAD, rows), ""]
    if "orbit" in settings.experiments:
        rows = _repeat_orbit(settings, out, records)
        texts += [table(ORBIT_HEAD, rows), ""]
    text = "\n".join([*texts, *NOTES, ""])
    write_atomically(out / "hydranet.txt", text)
    names = dict.fromkeys(name for record in records for name in record)
    write_csv(
        out / "hydranet.csv", ({name: record.get(name) for name in names} for record in records)
    )
    document = {
        "probevo": __version__,
        "settings": settings.model_dump(mode="json"),
        "notes": NOTES,
        "results": records,
    }
    write_json(out / "hydranet.json", document)
    return [text, str(out / "hydranet.txt")]


def _repeat_numbers(
    settings: HydranetConfig, out: Path, records: list[dict[str, object]]
) -> list[tuple[str, ...]]:
    """Repeat the 1-D regression; add to the records, and return the rows of its table."""
    from probevo_paper.hydranet_numbers import METHODS, PUBLISHED_NLL, regress

    chosen = {"repetitions": settings.repetitions, "epochs": settings.epochs, "seed": settings.seed}
    rows: list[tuple[str, ...]] = []
    for method in METHODS:
        file = _network_file(out, f"numbers-{method.name}", chosen)
        with progress_bar(f"1-D, {method.name}", "compiling", "epochs") as show:
            result = regress(method, settings, file, show)
        published = PUBLISHED_NLL[method.name]
        low, median, high = np.quantile(result.nll, [0.1, 0.5, 0.9])
        rms = float(np.sqrt(np.median(result.squared_error)))
        rows.append(
            (method.name, f"{median:.2f}", f"{published}", f"{low:.2f} … {high:.2f}", f"{rms:.2f}")
        )
        for repetition, (nll, squared) in enumerate(
            zip(result.nll.tolist(), result.squared_error.tolist(), strict=True)
        ):
            records.append(
                {
                    "experiment": "numbers",
                    "method": method.name,
                    "repetition": repetition,
                    "nll": nll,
                    "squared_error": squared,
                    "published_median_nll": published,
                }
            )
    return rows


def _repeat_orbit(
    settings: HydranetConfig, out: Path, records: list[dict[str, object]]
) -> list[tuple[str, ...]]:
    """Repeat the orbiting camera; add to the records, and return the rows of its table."""
    from probevo_paper.hydranet_orbit import orbit, orbit_methods

    chosen = settings.model_dump(mode="json", exclude={"experiments", "repetitions", "epochs"})
    rows: list[tuple[str, ...]] = []
    for method in orbit_methods(settings):
        file = _network_file(out, f"orbit-{method.name}", chosen)
        with progress_bar(f"orbit, {method.name}", "compiling", "epochs") as show:
            result = orbit(method, settings, file, show)
        inside = result.inside
        outside = result.outside
        row = (
            *(method.name, f"{inside.error_deg:.2f}", f"{outside.error_deg:.2f}"),
            *(f"{inside.nll:.2f}", f"{outside.nll:.2f}"),
            *(f"{inside.coverage:.0%}", f"{outside.coverage:.0%}", f"{result.scale:.2f}"),
            *(f"{inside.calibrated_coverage:.0%}", f"{outside.calibrated_coverage:.0%}"),
        )
        rows.append(row)
        record: dict[str, object] = {"experiment": "orbit", "method": method.name}
        for name, domain in (("inside", inside), ("outside", outside)):
            record |= {f"{name}_{key}": value for key, value in asdict(domain).items()}
        records.append(record | {"covariance_scale": result.scale})
    return rows


def _network_file(out: Path, name: str, chosen: Mapping[str, object]) -> Path:
    """Return the file of a method's networks: other settings have another file."""
    text = repr(sorted(chosen.items())) + __version__
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    return out / "models" / f"{name}-{digest}.safetensors"
