"""The one exception family: what is wrong, where, and how to mend it.

The library raises these errors. The command line catches them once, prints one message and exits
with code 2.
"""

from __future__ import annotations

from pathlib import Path
from reprlib import Repr

LONGEST_VALUE = 80
"""Characters of a value that a message quotes."""
_SHORT = Repr()
_SHORT.maxlevel = 2
_SHORT.maxstring = LONGEST_VALUE
_SHORT.maxother = LONGEST_VALUE
_SHORT.maxlong = LONGEST_VALUE


class ProbevoError(Exception):
    """Base of every error that probevo raises on purpose."""


class InputError(ProbevoError):
    """A file, a field of a file, or an option given by the user is wrong.

    Args:
        where: the file or option at fault, as the user would name it.
        what: what is wrong, naming the field and the value found.
        cure: how to mend it, in one sentence.
    """

    def __init__(self, where: str | Path, what: str, cure: str = "") -> None:
        self.where = str(where)
        self.what = what
        self.cure = cure
        super().__init__(f"{self.where}: {what}" + (f"\n         {cure}" if cure else ""))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str]]:
        """Pickle the parts: an error raised in a worker process arrives as the same error."""
        return type(self), (self.where, self.what, self.cure)


def brief(value: object) -> str:
    """Return the repr of a value for a message, shortened in its middle where it is long.

    A value of many nested lists is not written out first, which could take all memory.
    """
    text = _SHORT.repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 1]}…"
