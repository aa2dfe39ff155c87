"""How a command that runs until it is stopped is stopped."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from skyrelay.core.errors import HostError, SkyRelayError


@contextmanager
def until_terminated() -> Iterator[None]:
    """SIGTERM ends what runs in here as Ctrl-C does: whoever has something to tidy up does."""
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def one_line_for_the_unforeseen(name: str, logger: logging.Logger) -> Iterator[None]:
    """An exception that is none of ours ends the host with one line; where it came up is in the log for who debugs.

    Raises:
        HostError: in place of any such exception.
    """
    try:
        yield
    except SkyRelayError:
        raise
    except Exception as error:
        logger.debug("where it came up", exc_info=True)
        told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise HostError(f"{name}", told, "nothing of the kind; --debug says where it came up") from None


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
