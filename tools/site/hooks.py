"""What the site adds to MkDocs: navigation by folder, files from outside docs/, executed notebooks as pages."""

from __future__ import annotations

import posixpath
import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Navigation
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
OUTSIDE = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CODE_OF_CONDUCT.md",
    "results/*",
    "examples/*",
    "deploy/*",
)
"""What a page may link to outside docs/: it is put onto the site, at the same place below its root."""
LINK = re.compile(r"(\]\(|\bsrc=\"|\bhref=\")(?!https?://|mailto:|#)([^)#\"\s]+)")

FOLDER = re.compile(r"\[([^\]]+)\]\((?!https?://|mailto:|#)([^)#\"\s]+)\)")
"""A folder of data has no page: its name stays, the link goes."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Notebooks become pages; whatever a page links to outside docs/ comes along."""
    for notebook in [file for file in files if file.src_uri.endswith(".ipynb")]:
        files.remove(notebook)
        _add_notebook(files, config, notebook)
    wanted = {"CHANGELOG.md", *_named(config.nav)}
    seen: set[str] = set()
    pages = [(file.src_uri, Path(str(file.abs_src_path)).read_text()) for file in files if _is_page(file)]
    while pages:
        uri, text = pages.pop()
        for _, target in LINK.findall(text):
            path = _outside(uri, target)
            if path is not None:
                wanted.add(path)
        for path in sorted(wanted - seen):
            seen.add(path)
            if files.get_file_from_path(path) is not None or not (ROOT / path).is_file():
                continue
            files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
            if path.endswith(".md"):
                pages.append((path, (ROOT / path).read_text()))
    _fill(config, files)
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links that lead out of docs/ in the repository lead to the copies on the site."""

    def unlinked(match: re.Match[str]) -> str:
        path = _outside(page.file.src_uri, match[2])
        return match[1] if path is not None and (ROOT / path).is_dir() else match[0]

    def moved(match: re.Match[str]) -> str:
        path = _outside(page.file.src_uri, match[2])
        if path is None:
            return match[0]
        return match[1] + posixpath.relpath(path, posixpath.dirname(page.file.src_uri) or ".")

    return LINK.sub(moved, FOLDER.sub(unlinked, markdown))


def on_nav(nav: Navigation, config: MkDocsConfig, files: Files) -> Navigation:
    """Every page can be reached."""
    lost = [file.src_uri for file in files.documentation_pages() if file.inclusion.is_in_nav() and file.page is None]
    if lost:
        raise PluginError(f"in no section of mkdocs.yml's nav: {', '.join(lost)}")
    return nav


def _is_page(file: File) -> bool:
    return file.is_documentation_page() and file.abs_src_path is not None


def _outside(uri: str, target: str) -> str | None:
    """The path in the repository of what ``uri`` links to, if that lies outside docs/ and may be shown."""
    inside = any(fnmatch(uri, pattern) for pattern in OUTSIDE)  # such a page's links start at its own place
    place = uri if inside else f"docs/{uri}"
    path = posixpath.normpath(posixpath.join(posixpath.dirname(place), target))
    if inside and path.startswith("docs/"):
        return path.removeprefix("docs/")
    return path if any(fnmatch(path, pattern) for pattern in OUTSIDE) else None


def _named(nav: Any) -> set[str]:
    """Files outside docs/ that the navigation names."""
    if isinstance(nav, str):
        return {nav} if any(fnmatch(nav, pattern) for pattern in OUTSIDE) else set()
    children = nav.values() if isinstance(nav, dict) else nav or ()
    return set().union(*(_named(child) for child in children))


def _fill(config: MkDocsConfig, files: Files) -> None:
    """``folder/*`` in the navigation: every page of the folder that it does not name elsewhere."""
    pages = sorted(file.src_uri for file in files.documentation_pages())
    taken = _entries(config.nav)

    def filled(nav: Any) -> Any:
        if isinstance(nav, dict):
            return {title: filled(child) for title, child in nav.items()}
        if isinstance(nav, list):
            return [entry for child in nav for entry in _spread(child)]
        return nav

    def _spread(child: Any) -> list[Any]:
        if isinstance(child, str) and child.endswith("/*"):
            folder = child.removesuffix("*")
            return [page for page in pages if posixpath.dirname(page) + "/" == folder and page not in taken]
        return [filled(child)]

    config.nav = filled(config.nav)


def _entries(nav: Any) -> set[str]:
    if isinstance(nav, str):
        return {nav}
    children = nav.values() if isinstance(nav, dict) else nav or ()
    return set().union(*(_entries(child) for child in children))


def _add_notebook(files: Files, config: MkDocsConfig, notebook: File) -> None:
    """The notebook as it was executed: text, code, output and pictures."""
    from nbconvert import MarkdownExporter

    uri = notebook.src_uri.removesuffix(".ipynb")
    text, resources = MarkdownExporter().from_filename(str(notebook.abs_src_path))
    for name, content in resources["outputs"].items():
        files.append(File.generated(config, f"{uri}-{name}", content=content))
        text = text.replace(f"]({name})", f"]({posixpath.basename(uri)}-{name})")
    files.append(File.generated(config, f"{uri}.md", content=re.sub(r"\x1b\[[0-9;]*m", "", text)))
