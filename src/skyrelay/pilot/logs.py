"""What a process says: lines for people, or one JSON object a line; secrets are left out of both."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import time
from collections.abc import Iterable
from typing import Any, TextIO

LOGGER = "skyrelay"
_SECRET = re.compile(r"PASSWORD|TOKEN|SECRET|KEY", re.IGNORECASE)
_FILE = re.compile(r"_FILE$", re.IGNORECASE)
_PATTERNS = (
    re.compile(r"(?<=://)[^/\s@]+(?=@)"),  # a user and password in a URL
    re.compile(r"(?<=\bbearer )\S+", re.IGNORECASE),
    re.compile(r"(?<=\bbasic )\S+", re.IGNORECASE),
)
_HIDDEN = "[redacted]"
_SHORTEST = 4
"""A secret of fewer characters is not looked for: it would be found everywhere."""


class Redactor:
    """Takes secrets out of text.

    Args:
        secrets: as they would stand there.
    """

    def __init__(self, secrets: Iterable[str]) -> None:
        known = sorted({secret for secret in secrets if len(secret) >= _SHORTEST}, key=len, reverse=True)
        self._known = re.compile("|".join(map(re.escape, known))) if known else None

    @classmethod
    def of_environment(cls) -> Redactor:
        """With what this program's variables of the environment hold that are named like secrets."""
        return cls(
            value
            for name, value in os.environ.items()
            if name.startswith("SKYRELAY_") and _SECRET.search(name) and not _FILE.search(name)
        )

    def __call__(self, text: str) -> str:
        """The text without them."""
        if self._known is not None:
            text = self._known.sub(_HIDDEN, text)
        for pattern in _PATTERNS:
            text = pattern.sub(_HIDDEN, text)
        return text


class _Lines(logging.Formatter):
    def __init__(self, redact: Redactor) -> None:
        super().__init__("%(message)s")
        self._redact = redact

    def format(self, record: logging.LogRecord) -> str:
        return self._redact(super().format(record))


class _Json(logging.Formatter):
    def __init__(self, redact: Redactor, member: str) -> None:
        super().__init__()
        self._redact, self._member = redact, member

    def format(self, record: logging.LogRecord) -> str:
        second = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created))
        tree: dict[str, Any] = {
            "time": f"{second}.{int(record.msecs):03d}Z",
            "level": record.levelname.lower(),
            "member": self._member,
            "message": self._redact(record.getMessage()),
        }
        fields = getattr(record, "fields", {})
        tree |= {name: self._redact(value) if isinstance(value, str) else value for name, value in fields.items()}
        if record.exc_info:
            tree["trace"] = self._redact(self.formatException(record.exc_info))
        return json.dumps(tree, default=lambda value: self._redact(str(value)))


def configure(member: str, as_json: bool, stream: TextIO | None = None, *, level: int = logging.INFO) -> logging.Logger:
    """The process's logger, from now on.

    What belongs to a message goes into ``extra={"fields": {...}}``; as JSON it gets keys of its own.

    Args:
        member: the process's name.
        stream: left out: standard error.
        level: of the least that is said.
    """
    redact = Redactor.of_environment()
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_Json(redact, member) if as_json else _Lines(redact))
    logger = logging.getLogger(LOGGER)
    logger.handlers = [handler]
    logger.setLevel(level)
    logger.propagate = False
    return logger


def say_as_json(line: str) -> bool:
    """Say why the process ends, if it speaks JSON; whether it does."""
    logger = logging.getLogger(LOGGER)
    speaks = any(isinstance(handler.formatter, _Json) for handler in logger.handlers)
    if speaks:
        logger.error(line)
    return speaks
