"""The examples of CONTRIBUTING.md, for the tests that run them."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "CONTRIBUTING.md"


def section(title: str) -> str:
    """The text below a heading of the second level, up to the next one."""
    _, heading, text = PAGE.read_text("utf-8").partition(f"\n## {title}\n")
    assert heading, f"{PAGE.name} has no section {title!r}"
    return text.partition("\n## ")[0]


def example(title: str) -> str:
    """The only Python block of a section."""
    (code,) = re.findall(r"^```python\n(.*?)^```$", section(title), re.MULTILINE | re.DOTALL)
    assert isinstance(code, str)
    return code
