"""``probevo paper dpc-net``: its table, its baselines, and what a second call takes as it is."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.cli.main import main

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.sequences import open_sequence  # noqa: E402
from probevo_paper import command_dpc_net, dpc_net  # noqa: E402
from probevo_paper.dpc_net_config import DpcNetConfig  # noqa: E402


def test_every_method_has_a_row_and_a_second_call_trains_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On walls instead of streets, with stand-ins for training and odometry."""
    trained = []

    def render_wall(config: Any, folder: Path) -> Path:
        return write_wall(folder, frames=3)

    def train(drives: Any, settings: Any, out: Path, **_: Any) -> None:
        trained.append((len(drives), settings.left_out, settings.rotation_only))
        out.parent.mkdir(exist_ok=True)
        out.touch()

    def drifts(drive: Any, networks: Any, config: Any) -> dict[str, dpc_net.Drift]:
        assert "only" in networks[dpc_net.ROTATION].name
        one = dpc_net.Drift(2.0, 0.01, 7.0)
        found = dict.fromkeys(dpc_net.METHODS, one)
        return found | {dpc_net.NETWORK: dpc_net.Drift(1.0, None, 6.0)}

    monkeypatch.setattr("probevo_sim.command.render_with_progress", render_wall)
    monkeypatch.setattr(command_dpc_net, "train_correction", train)
    monkeypatch.setattr(command_dpc_net, "drifts", drifts)
    out = tmp_path / "out"
    words = ["paper", "dpc-net", "--out", str(out), "--drives", "2"]
    assert main(words) == 0
    assert trained == [(4, 2, False), (4, 2, True)] * 2
    text = capsys.readouterr().out
    assert text.count("SO(3) only") == 4
    (row,) = {line for line in text.splitlines() if re.search("wrong +city 4 +network  ", line)}
    assert row.split()[-5:] == ["1.000", "0.50", "–", "–", "6.0"]
    with (out / "dpc_net.csv").open(encoding="utf-8") as file:
        records = list(csv.DictReader(file))
    assert [record["correction"] for record in records] == list(dpc_net.METHODS) * 4
    document = json.loads((out / "dpc_net.json").read_text("utf-8"))
    assert document["settings"]["drives"] == 2
    assert main(words) == 0
    assert len(trained) == 4


def test_a_baseline_keeps_the_covariance_of_the_odometry(tmp_path: Path) -> None:
    """The mean correction of 1 cm forwards moves each step by that."""
    sequence = open_sequence(write_wall(tmp_path, frames=3))
    network = SimpleNamespace(
        space=SimpleNamespace(axes=(0, 1, 2, 3, 4, 5)),
        facts={"constant": [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]},
    )
    baseline = dpc_net.BaselineCorrection(
        network,
        dpc_net._constant,
        sequence,
        dpc_net.CONSTANT,  # type: ignore[arg-type]
    )
    before, after = list(sequence)[:2]
    cov = 1e-4 * np.eye(6)
    corrected = baseline.correct(before, after, np.eye(4), cov=cov)
    assert corrected.T_curr_prev[2, 3] == pytest.approx(0.01)
    np.testing.assert_array_equal(corrected.covariance, cov)


def test_drives_take_turns_and_wrong_ones_are_seen_with_a_wrong_camera(tmp_path: Path) -> None:
    settings = DpcNetConfig(focal_error=0.1)
    drive = open_sequence(write_wall(tmp_path, frames=3))
    assert command_dpc_net._seen(drive, command_dpc_net.RIGHT, settings) is drive
    wrong = command_dpc_net._seen(drive, command_dpc_net.WRONG, settings)
    assert wrong.camera.fu_px == pytest.approx(1.1 * drive.camera.fu_px)


def test_a_wrong_setting_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "dpc-net", "--out", str(tmp_path / "out"), "--heads", "1"]) == 2
    assert "--heads" in capsys.readouterr().err
