"""Measure how densely the code is packed, against what the field's model code bases have.

    python tools/density.py [FOLDER …]      prints the figures, and where to look; exit code 1 beyond a bound
"""

from __future__ import annotations

import ast
import sys
import tokenize
from dataclasses import dataclass, field
from pathlib import Path

MAX_LINE_LENGTH = 100
MAX_PACKED_PERCENT = 3.0
"""Of assignments, those of several values to several names in one statement. The field: 0 to 3."""
MAX_SIX_POSITIONALS_PERCENT = 0.5
"""Of calls, those with six or more positional arguments. The field: 0 to 0.9."""


@dataclass
class Density:
    """Counts over some files, and the places behind them."""

    assignments: int = 0
    packed: list[str] = field(default_factory=list)
    calls: int = 0
    six_positionals: list[str] = field(default_factory=list)
    long_lines: list[str] = field(default_factory=list)
    code_lines: int = 0
    comment_lines: int = 0

    @property
    def packed_percent(self) -> float:
        """Share of assignments that are packed."""
        return 100.0 * len(self.packed) / max(self.assignments, 1)

    @property
    def six_positionals_percent(self) -> float:
        """Share of calls with six or more positional arguments."""
        return 100.0 * len(self.six_positionals) / max(self.calls, 1)

    @property
    def is_within_bounds(self) -> bool:
        """Whether all figures are."""
        return (
            self.packed_percent <= MAX_PACKED_PERCENT
            and self.six_positionals_percent <= MAX_SIX_POSITIONALS_PERCENT
            and not self.long_lines
        )


def measure(files: list[Path]) -> Density:
    """Count over these files."""
    density = Density()
    for path in files:
        _count_statements(path, density)
        _count_lines(path, density)
    return density


def _count_statements(path: Path, density: Density) -> None:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        where = f"{path}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Assign):
            density.assignments += 1
            if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
                density.packed.append(where)
        if isinstance(node, ast.Call):
            density.calls += 1
            if len(node.args) >= 6:
                density.six_positionals.append(where)


def _count_lines(path: Path, density: Density) -> None:
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        density.code_lines += bool(line.strip())
        if len(line) > MAX_LINE_LENGTH:
            density.long_lines.append(f"{path}:{number}")
    with path.open("rb") as stream:
        comments = {
            token.start[0]
            for token in tokenize.tokenize(stream.readline)
            if token.type == tokenize.COMMENT
        }
    density.comment_lines += len(comments)


def main(folders: list[str]) -> int:
    """Print the figures; 1 if one is beyond its bound."""
    files = [path for folder in folders or ["src"] for path in sorted(Path(folder).rglob("*.py"))]
    density = measure(files)
    comments = 100.0 * density.comment_lines / max(density.code_lines, 1)
    print(f"packed assignments           {density.packed_percent:5.1f} %  (≤ {MAX_PACKED_PERCENT})")
    print(
        f"six positional arguments     {density.six_positionals_percent:5.2f} % "
        f" (≤ {MAX_SIX_POSITIONALS_PERCENT})"
    )
    print(f"lines over {MAX_LINE_LENGTH} characters    {len(density.long_lines):5d}    (0)")
    print(f"comment lines                {comments:5.1f} %")
    for name in ("packed", "six_positionals", "long_lines"):
        for where in getattr(density, name):
            print(f"  {name}: {where}")
    return 0 if density.is_within_bounds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
