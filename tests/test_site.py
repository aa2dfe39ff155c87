"""The documentation site: it builds strictly, every page is in it, and nothing on it comes from elsewhere."""

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mkdocs.config import load_config

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    line = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)]
    quiet = {"NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(line, cwd=ROOT, env=os.environ | quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, f"make docs fails:\n{built.stdout}{built.stderr}"
    return folder


def entries(nav):
    if isinstance(nav, str):
        yield nav
    else:
        for child in nav.values() if isinstance(nav, dict) else nav:
            yield from entries(child)


def test_every_page_is_in_the_navigation():
    listed = set(entries(load_config(str(ROOT / "mkdocs.yml")).nav))
    for path in [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]:
        page = str(path.relative_to(DOCS).with_suffix(".md"))
        folder = str(path.relative_to(DOCS).parent) + "/*"
        assert {page, folder} & listed, f"docs/{page}: add it to a section of `nav` in mkdocs.yml, or '{folder}'"


def test_it_builds_with_every_page(site):
    for path in [*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")]:
        assert (site / path.relative_to(DOCS)).with_suffix(".html").exists(), path


def test_nothing_is_fetched_from_elsewhere(site):
    loaded = re.compile(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"?(https?:)?//|<link[^>]*href=\"?(https?:)?//")
    for page in site.rglob("*.html"):
        text = re.sub(r'<link rel="?(canonical|next|prev)[^>]*>', "", page.read_text())
        found = loaded.search(text)
        assert found is None, f"{page.name}: {text[found.start() : found.start() + 120]}"
        assert 'class="mermaid"' not in text, f"{page.name}: a Mermaid block fetches its program from elsewhere"


def test_the_sequence_page_shows_its_pictures(site):
    text = (site / "reference" / "sequence.html").read_text()
    for name in ("vehicle", "uav", "zone"):
        assert f"sequence-{name}.svg" in text


def documented():
    for page in sorted((DOCS / "reference" / "api").glob("*.md")):
        yield from re.findall(r"^::: (\S+)", page.read_text(), re.MULTILINE)


@pytest.mark.parametrize("name", list(documented()))
def test_every_public_name_is_documented(name):
    module = importlib.import_module(name)
    for public in getattr(module, "__all__", [public for public in vars(module) if not public.startswith("_")]):
        value = getattr(module, public)
        if callable(value) and value.__module__.startswith("skyrelay"):
            assert (value.__doc__ or "").strip(), f"{name}.{public} has no docstring"
            assert not value.__doc__.startswith(f"{public}("), f"{name}.{public} has the docstring of a dataclass only"
