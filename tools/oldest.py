"""Print the oldest versions of the dependencies that pyproject.toml allows, as pip's constraints.

python tools/oldest.py > oldest.txt && pip install '.[test]' --constraint oldest.txt
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def oldest(project: Path = PROJECT) -> list[str]:
    """Return a line ``name==version.*`` for each dependency of the core.

    Raises:
        ValueError: a dependency has no lower bound.
    """
    lines = []
    for requirement in tomllib.loads(project.read_text("utf-8"))["project"]["dependencies"]:
        found = re.fullmatch(r"([\w.-]+)>=([\w.]+)", requirement)
        if found is None:
            raise ValueError(f"{requirement} has no lower bound")
        lines.append(f"{found[1]}=={found[2]}.*")
    return lines


if __name__ == "__main__":
    print("\n".join(oldest()))
