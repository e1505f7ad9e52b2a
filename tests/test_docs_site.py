"""The documentation builds as a site without a warning, and has all pages."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MISSING = [name for name in ("sphinx", "myst_parser", "furo") if not importlib.util.find_spec(name)]

pytestmark = pytest.mark.skipif(bool(MISSING), reason="the extra docs is not installed")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from sphinx.cmd.build import main

    out = tmp_path_factory.mktemp("site")
    words = ["-q", "-W", "--keep-going", "-c", str(ROOT / "docs"), str(ROOT), str(out)]
    assert main(words) == 0
    return out


@pytest.mark.slow
def test_every_page_is_there_and_reached_from_the_first(site: Path) -> None:
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert {path.stem for path in (site / "docs").glob("*.html")} == pages
    assert 'href="docs/index.html"' in (site / "index.html").read_text("utf-8")
    first = (site / "docs" / "index.html").read_text("utf-8")
    assert {name for name in pages if f'href="{name}.html"' in first} >= pages - {"index"}
    assert {"../README.html", "../CONTRIBUTING.html"} <= set(re.findall(r'href="([^"#]+)"', first))


@pytest.mark.slow
def test_the_reference_has_signatures_and_docstrings(site: Path) -> None:
    page = (site / "docs" / "reference.html").read_text("utf-8")
    text = " ".join(re.sub(r"<[^>]+>", "", page).split())
    assert "If anything raises, the odometry is as it was before the call" in text
    for name in ("StereoOdometry", "LiveOdometry", "estimate_motion", "open_sequence"):
        assert name in text


@pytest.mark.slow
def test_no_link_leads_to_what_the_site_does_not_have(site: Path) -> None:
    broken = []
    for page in site.rglob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text("utf-8")):
            if not re.match("[a-z]+:", link) and not (page.parent / link).exists():
                broken.append(f"{page.relative_to(site)}: {link}")
    assert broken == []
