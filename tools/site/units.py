"""Shapes and units in docstrings, ``[N, 2] [m]``, are no Markdown links."""

from __future__ import annotations

import re
from typing import Any

import griffe


class Units(griffe.Extension):
    """Escapes the bracket that follows a bracket."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for every module, class, function and attribute."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"(\])(\s*)(?=\[)", r"\1\2\\", obj.docstring.value)
