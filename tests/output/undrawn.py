"""Pages whose figures are made, but not drawn.

To lay a figure out and to draw it takes Matplotlib a tenth of a second, a page has eight, and a
test of a command does not look at them. That all can be drawn is for the tests in ``output/``.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from markupsafe import Markup, escape
from matplotlib.figure import Figure


def _undrawn(figure: Figure, name: str, description: str) -> Markup:
    assert figure.axes
    return Markup(f'<svg role="img" aria-label="{escape(description)}" id="{name}"></svg>')


@contextmanager
def figures_undrawn() -> Iterator[None]:
    """Leave the figures of all pages empty within this context."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probevo.output.page.inline_svg", _undrawn)
        yield
