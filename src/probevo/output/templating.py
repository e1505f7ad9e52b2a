"""Templates of pages: data goes in, HTML comes out. Whatever is not marked as HTML is escaped."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from markupsafe import Markup

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def _environment() -> Environment:
    """Make the environment that finds the templates beside this module, with autoescape on."""
    # Imported late: commands that write no page do not wait for it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(
        loader=PackageLoader("probevo.output"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def rendered(template: str, **data: object) -> Markup:
    """Fill in a template of the folder ``templates``.

    Args:
        template: its name without ``.html.jinja``.
        data: its variables. Text is escaped; HTML is what another template has rendered.

    Returns:
        HTML that other templates insert as it is.
    """
    return Markup(_environment().get_template(f"{template}.html.jinja").render(data))
