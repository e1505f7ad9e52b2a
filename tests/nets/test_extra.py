"""The extra ``nets``: what is said without it, and that nothing else imports JAX."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from probevo.cli.main import main
from probevo.nets import extra


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (["paper", "hydranet"], "paper hydranet"),
        (["train", ".", "--kind", "rotation"], "--kind rotation"),
    ],
    ids=["experiment", "training"],
)
def test_a_missing_package_is_named_with_its_cure(
    words: list[str],
    where: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda name: None if name == "jax" else object())
    assert main([*words, "--out", str(tmp_path / "out.safetensors")]) == 2
    shown = capsys.readouterr().err
    assert f"{where}: networks need the package jax." in shown
    assert "pip install 'probevo[nets]'" in shown
    assert not (tmp_path / "out.safetensors").exists()


@pytest.mark.parametrize(
    "code",
    [
        "import probevo, probevo.runs.runner, probevo.nets, probevo_paper.command",
        "import probevo.cli.train, probevo.cli.compare, probevo.cli.inspect, probevo.sensor_kinds",
        "from probevo.cli.main import main\ntry: main(['paper', 'hydranet', '--help'])\n"
        "except SystemExit: pass",
    ],
)
def test_nothing_else_imports_jax(code: str) -> None:
    ask = "import sys\nassert not {'jax', 'equinox', 'optax'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", f"{code}\n{ask}"], check=True, capture_output=True)
