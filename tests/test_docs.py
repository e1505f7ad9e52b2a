"""The documents: nothing in them is still to be filled in."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "path", [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))], ids=lambda path: path.name
)
def test_no_placeholder_is_left(path: Path) -> None:
    assert re.findall(r"\b(?:ABLATION|RESULTS|LOSSES|COST|TODO)\b", path.read_text("utf-8")) == []
