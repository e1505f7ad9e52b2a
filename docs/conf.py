"""The site of these pages: ``python -m sphinx -c docs . out/site``, with the extra ``docs``.

The source folder is the whole repository, so that links between README.md and docs/ hold on the
site as they do beside the code. Links to folders and to source files, which the site does not have,
become plain text.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx

from probevo import __version__

ROOT = Path(__file__).parents[1]

project = "probevo"
author = "the authors of probevo"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown"}
include_patterns = ["*.md", "docs/*.md", "benchmarks/README.md"]
root_doc = "docs/index"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"probevo {__version__}"
html_show_copyright = False  # LICENSE has it
myst_heading_anchors = 4
autodoc_typehints = "description"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
napoleon_google_docstring = True

_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s#]+)(?:#[^)\s]*)?\)")


def _without_links_to_code(app: Sphinx, docname: str, source: list[str]) -> None:
    """Replace links to what is no page of the site by their text."""
    folder = (ROOT / docname).parent

    def replaced(link: re.Match[str]) -> str:
        target = folder / link[2]
        is_elsewhere = re.match("[a-z]+:", link[2]) is not None
        return link[0] if is_elsewhere or target.suffix == ".md" else link[1]

    source[0] = _LINK.sub(replaced, source[0])


def _first_page(app: Sphinx, exception: Exception | None) -> None:
    """Lead from the top of the site, where browsers and hosts look, to the first page."""
    if exception is None and app.builder.format == "html":
        target = f"{root_doc}.html"
        text = (
            "<!doctype html><title>probevo</title>"
            f'<meta http-equiv="refresh" content="0; {target}">'
            f'<a href="{target}">probevo: documentation</a>\n'
        )
        (Path(app.outdir) / "index.html").write_text(text, "utf-8")


def setup(app: Sphinx) -> None:
    """Register the change of links, and the way to the first page."""
    app.connect("source-read", _without_links_to_code)
    app.connect("build-finished", _first_page)
