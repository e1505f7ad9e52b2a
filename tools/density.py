"""Measure how densely the code is packed, against what the field's model code bases have.

    python tools/density.py [FOLDER …]      prints the figures and where to look

The exit code is 1 if a figure is beyond its bound. The field: jaxlie, kiss-icp, evo, theseus.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from dataclasses import dataclass, field
from pathlib import Path

MAX_LINE_LENGTH = 100
MAX_PACKED_PERCENT = 3.0
"""Largest share of assignments that give several values to several names. The field: 0 to 3."""
MAX_SIX_POSITIONALS_PERCENT = 0.5
"""Largest share of calls with six or more positional arguments. The field: 0 to 0.9."""
MAX_PARAMETERS = 7
"""Most parameters of a function; a constructor's are the settings of its class, and not counted."""


@dataclass
class Density:
    """The counts over some files, and the places behind them as ``file:line``."""

    num_assignments: int = 0
    num_calls: int = 0
    num_code_lines: int = 0
    num_comment_lines: int = 0
    packed: list[str] = field(default_factory=list)
    """Assignments such as ``a, b = x, y``."""
    six_positionals: list[str] = field(default_factory=list)
    """Calls with six or more positional arguments."""
    many_parameters: list[str] = field(default_factory=list)
    """Functions with more than seven parameters; printed, not part of the bounds."""
    long_lines: list[str] = field(default_factory=list)
    """Lines of more than 100 characters."""

    @property
    def packed_percent(self) -> float:
        """The share of assignments that are packed."""
        return 100.0 * len(self.packed) / max(self.num_assignments, 1)

    @property
    def six_positionals_percent(self) -> float:
        """The share of calls with six or more positional arguments."""
        return 100.0 * len(self.six_positionals) / max(self.num_calls, 1)

    @property
    def comments_percent(self) -> float:
        """The share of lines, blank ones aside, with a comment. The field: 4 to 11."""
        return 100.0 * self.num_comment_lines / max(self.num_code_lines, 1)

    @property
    def is_within_bounds(self) -> bool:
        """Whether the three figures that have a bound keep it."""
        return (
            self.packed_percent <= MAX_PACKED_PERCENT
            and self.six_positionals_percent <= MAX_SIX_POSITIONALS_PERCENT
            and not self.long_lines
        )


def measure(files: list[Path]) -> Density:
    """Count over these Python files."""
    density = Density()
    for path in files:
        text = path.read_text("utf-8")
        _count_statements(path, text, density)
        _count_lines(path, text, density)
    return density


def _count_statements(path: Path, text: str, density: Density) -> None:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Assign):
            density.num_assignments += 1
            if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
                density.packed.append(f"{path}:{node.lineno}")
        elif isinstance(node, ast.Call):
            density.num_calls += 1
            if len(node.args) >= 6:
                density.six_positionals.append(f"{path}:{node.lineno}")
        elif (
            isinstance(node, ast.FunctionDef)
            and node.name != "__init__"
            and _num_parameters(node) > MAX_PARAMETERS
        ):
            density.many_parameters.append(f"{path}:{node.lineno} {node.name}")


def _num_parameters(function: ast.FunctionDef) -> int:
    """Count the parameters of a function, without ``self`` or ``cls``."""
    parameters = function.args
    named = [*parameters.posonlyargs, *parameters.args, *parameters.kwonlyargs]
    return sum(parameter.arg not in ("self", "cls") for parameter in named)


def _count_lines(path: Path, text: str, density: Density) -> None:
    for number, line in enumerate(text.splitlines(), start=1):
        density.num_code_lines += bool(line.strip())
        if len(line) > MAX_LINE_LENGTH:
            density.long_lines.append(f"{path}:{number}")
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        density.num_comment_lines += token.type == tokenize.COMMENT


def report(density: Density) -> str:
    """Return the figures as text, and the places below them."""
    num_lines = len(density.long_lines)
    num_functions = len(density.many_parameters)
    figures = [
        f"packed assignments: {density.packed_percent:.2f} % (at most {MAX_PACKED_PERCENT})",
        f"calls with six positional arguments: {density.six_positionals_percent:.2f} %"
        f" (at most {MAX_SIX_POSITIONALS_PERCENT})",
        f"lines over {MAX_LINE_LENGTH} characters: {num_lines} (none)",
        f"functions with over {MAX_PARAMETERS} parameters: {num_functions}",
        f"lines with a comment: {density.comments_percent:.1f} %",
    ]
    places = [
        f"  {name}: {place}"
        for name in ("packed", "six_positionals", "long_lines", "many_parameters")
        for place in getattr(density, name)
    ]
    return "\n".join(figures + places)


def main(folders: list[str]) -> int:
    """Print the report; return 1 if a figure is beyond its bound, else 0."""
    files = [path for folder in folders or ["src"] for path in sorted(Path(folder).rglob("*.py"))]
    density = measure(files)
    print(report(density))
    return 0 if density.is_within_bounds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
