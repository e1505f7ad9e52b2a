"""The settings of a run as a file: round trip, and messages that name file, key, value and cure."""

from pathlib import Path

import pytest

from probevo.config import OdometryConfig, TrackingConfig
from probevo.errors import InputError
from probevo.run_config import OWN_KEYS, RunConfig, config_text, read_config, run_config
from probevo.sequences import format_names
from probevo.sequences.read_settings import FORMAT_HELP


def test_names_are_those_that_exist() -> None:
    assert all(f" {name}" in FORMAT_HELP for name in format_names())
    assert all(RunConfig(format=name).format == name for name in format_names())
    assert set(RunConfig.model_fields) - set(OdometryConfig.model_fields) == set(OWN_KEYS)


@pytest.mark.parametrize(
    "config",
    [
        RunConfig(),
        RunConfig(
            sequence=Path("a/ü b"),
            noise="fixed",
            max_frames=9,
            tracking=TrackingConfig(fast_threshold=30),
        ),
    ],
)
def test_round_trip(config: RunConfig, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(config_text(config), encoding="utf-8")
    assert read_config(tmp_path / "config.yaml") == config


def test_a_run_takes_over_what_it_shares() -> None:
    shared = RunConfig(max_frames=9, format="tracks", tracking=TrackingConfig(fast_threshold=30))
    config = run_config(shared, Path("a.npz"), "fixed")
    assert config == shared.model_copy(update={"sequence": Path("a.npz"), "noise": "fixed"})
    assert run_config(OdometryConfig(seed=3), Path("a"), "b") == RunConfig(
        seed=3, sequence=Path("a"), noise="b"
    )


@pytest.mark.parametrize("text", ["", "# nothing\n", "{}\n"])
def test_an_empty_file_means_the_defaults(text: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(text)
    assert read_config(tmp_path / "config.yaml") == RunConfig()


@pytest.mark.parametrize(
    ("text", "what", "cure"),
    [
        (
            "tracking: {num_feature: 9}",
            "the key tracking.num_feature is not known.",
            "mean tracking.num_features?",
        ),
        (
            "num_features: 9",
            "the key num_features is not known.",
            "Did you mean tracking.num_features?",
        ),
        (
            "tracking: {num-features: 9}",
            "the key tracking.num-features",
            "Did you mean tracking.num_features?",
        ),
        (
            "tracking.num_features: 9",
            "the key tracking.num_features is not known.",
            "Nest it: tracking: {num_features: …}.",
        ),
        ("tracking.num_feature: 9", "not known.", "Did you mean tracking: {num_features: …}?"),
        ("qwertz: 9", "the key qwertz is not known.", "Known are seed,"),
        (
            "tracking: {window_px: 3}",
            "tracking.window_px is 3; it should be greater than or equal to 5.",
            "Side of the",
        ),
        (
            "format: kitty",
            "format is 'kitty'; it should be the name of a format.",
            "euroc, 4seasons",
        ),
        ("noise: 3", "noise is 3; it should be a valid string.", "Noise of the features"),
        (
            "ransac: {threshold_px: .nan}",
            "ransac.threshold_px is nan; it should be a finite number.",
            "Reprojection",
        ),
        (
            "seed: many",
            "seed is 'many'; it should be a valid integer",
            "Seed of all random choices",
        ),
        ("solver: 3", "solver is 3; it should be a valid dictionary", ""),
        ("[seed, 3]", "holds a list; expected `key: value` lines.", "pattern"),
        ("seed: [", "this is not YAML", "pattern"),
        ("seed: 2001-99-99", "this is not YAML: month must be in 1..12.", "pattern"),
        ("seed: 1\nseed: 2", "the key seed is given twice", "pattern"),
    ],
)
def test_faults_are_named(text: str, what: str, cure: str, tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_config(path)
    assert caught.value.where == str(path)
    assert what in caught.value.what
    assert cure in caught.value.cure


@pytest.mark.parametrize("name", ["missing.yaml", "."])
def test_a_file_that_cannot_be_read(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing|cannot be read"):
        read_config(tmp_path / name)
