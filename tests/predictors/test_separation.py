"""Predictors tell affected features from clean ones, and clean ones not from others; the page about
them is complete.

The measures are those of benchmarks/separation_measures.py, on a small scene.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from coarse_rendering import coarse_rendering
from probevo.predictors import PREDICTORS
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig

ROOT = Path(__file__).parents[2]
CITY = SceneConfig(distance_m=20.0, rig=RigConfig(width_px=414, height_px=126, focal_px=240.0))


def load_benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "separation", ROOT / "benchmarks" / "separation_measures.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["separation"] = module  # where its dataclasses look their annotations up
    spec.loader.exec_module(module)
    return module


separation = load_benchmark()
columns = separation.SPACE.columns


def drive(number: int = 0, **effects: float) -> Any:
    config = CITY.model_copy(update={"drive": number, "effects": Effects(**effects)})
    with coarse_rendering():
        return separation.drive(config, warm_up=2, counted=5)


@pytest.fixture(scope="module")
def clean() -> Any:
    return drive()


def first_row(name: str, effect: Any, clean: Any) -> dict[str, float]:
    return dict(zip(columns, next(separation.rows(name, effect, clean)).aucs, strict=True))


@pytest.mark.slow
def test_blurred_features(clean: Any) -> None:
    aucs = first_row("blur", drive(blur=1.0), clean)
    assert aucs["blur"] >= 0.8
    assert aucs["high_frequency"] <= 0.2


@pytest.mark.slow
def test_features_on_what_moves(clean: Any) -> None:
    aucs = first_row("traffic", drive(traffic=1.0), clean)
    assert aucs["residual_flow"] >= 0.8
    assert aucs["disparity_change"] >= 0.8


@pytest.mark.slow
def test_places_without_texture(clean: Any) -> None:
    row = separation.fixed_places("textureless", drive(textureless=1.0), clean)
    aucs = dict(zip(columns, row.aucs, strict=True))
    assert max(aucs[column] for column in ("high_frequency", "entropy", "structure_min")) <= 0.2


@pytest.mark.slow
def test_clean_features_are_not_separated_from_clean_ones(clean: Any) -> None:
    """Of another drive through the same place, a little aside and with other jolts."""
    other = drive(number=1)
    for column in (
        "blur",
        "residual_flow",
        "disparity_change",
        "high_frequency",
        "entropy",
        "structure_min",
    ):
        k = columns.index(column)
        assert 0.4 < separation.auc(other.phi[:, k], clean.phi[:, k]) < 0.6, column


def test_auc_against_all_pairs() -> None:
    rng = np.random.default_rng(0)
    affected = rng.integers(0, 9, 40).astype(float)
    clean = rng.integers(2, 12, 70).astype(float)
    pairs = affected[:, None] - clean
    expected = pytest.approx(np.mean((pairs > 0) + 0.5 * (pairs == 0)), abs=1e-12)
    assert separation.auc(affected, clean) == expected
    assert separation.auc(np.append(affected, np.nan), np.append(np.nan, clean)) == expected
    assert 1.0 - separation.auc(clean, affected) == expected
    assert np.isnan(separation.auc(np.full(3, np.nan), clean))


def test_auc_of_known_distributions() -> None:
    """Of two normals whose means are σ apart: Φ(1/√2)."""
    rng = np.random.default_rng(1)
    affected = rng.normal(1.0, 1.0, 20_000)
    clean = rng.normal(0.0, 1.0, 30_000)
    assert separation.auc(affected, clean) == pytest.approx(0.7602, abs=0.008)
    assert separation.auc(clean[::2], clean[1::2]) == pytest.approx(0.5, abs=0.012)


@pytest.mark.parametrize("name", PREDICTORS)
def test_the_page_names_every_predictor_as_it_is(name: str) -> None:
    """docs/predictors.md keeps in step with the table: columns, units, source and where a predictor
    is undefined."""
    predictor = PREDICTORS[name]
    lines = (ROOT / "docs" / "predictors.md").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith(f"| `{name}` | ")]
    for text in (
        *predictor.columns,
        *predictor.columns.values(),
        predictor.source,
        predictor.undefined,
    ):
        assert text in line, text
