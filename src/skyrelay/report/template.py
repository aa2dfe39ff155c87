"""Pages of one file: a template with its style and script inside, by a policy that lets nothing else run or load."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files


def filled(template: str, styles: Sequence[str], script: str, values: Mapping[str, str]) -> str:
    """The text of a page.

    Args:
        template, styles, script: names of assets; the template has places for ``{{style}}``, ``{{script}}`` and their
            hashes, ``{{style_hash}}`` and ``{{script_hash}}``.
        values: of its other places, as HTML.
    """
    style, code = "".join(map(_asset, styles)), _asset(script)
    whole = {**values, "style": style, "script": code, "style_hash": _hash(style), "script_hash": _hash(code)}
    # One pass, so that nothing that a value contains is taken for a place to fill in.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: whole[match[1]], _asset(template))


def _asset(name: str) -> str:
    return (files("skyrelay.report") / "assets" / name).read_text("utf-8")


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
