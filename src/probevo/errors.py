"""The one exception family: what is wrong, where, and how to mend it.

The library raises these errors. The command line catches them once, prints one message and exits
with code 2.
"""

from __future__ import annotations

from pathlib import Path


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
