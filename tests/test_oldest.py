"""The oldest dependencies: one line each, and none without a lower bound."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from oldest import PROJECT, oldest


def test_each_dependency_of_the_core_has_a_line() -> None:
    lines = oldest()
    dependencies = tomllib.loads(PROJECT.read_text("utf-8"))["project"]["dependencies"]
    assert len(lines) == len(dependencies)
    assert all(re.fullmatch(r"[\w-]+==[\d.]+\.\*", line) for line in lines)
    assert "numpy==2.0.*" in lines


def test_a_dependency_without_a_lower_bound_is_named(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text('[project]\ndependencies = ["numpy>=2.0", "scipy"]\n')
    with pytest.raises(ValueError, match="scipy has no lower bound"):
        oldest(tmp_path / "p.toml")
