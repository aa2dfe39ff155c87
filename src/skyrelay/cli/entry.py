"""The process ``skyrelay``: Ctrl-C ends it with one line and status 130, whatever it is doing.

Python raises KeyboardInterrupt wherever the main thread happens to be. Inside an import that leaves half a module, and
inside JAX it passes through compiled code that does not expect it; the interpreter then takes down what threads of the
compiler still use, and the process dies of a segmentation fault. So the exception is raised in our own code only, where
`with` and `finally` put things in order. From anywhere else the process leaves at once, as if it were killed: every
folder that we write survives that.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import MutableMapping
from types import FrameType
from typing import NoReturn

STATUS = 130
CACHE_BYTES = 512 * 2**20
"""Of compiled programs that are kept; the least lately used go first."""
PATIENCE = 0.3
"""Seconds that the main thread has to notice; then it is inside compiled code, which may take minutes (a compiler)."""
_UNSAFE = ("jax", "jaxlib", "equinox", "optax", "importlib", "_frozen_importlib", "_frozen_importlib_external")
_noticed = threading.Event()


def main() -> None:
    """Entry point of the console script; `skyrelay.cli.main.main` within a process of its own."""
    guard()
    keep_programs()
    try:
        from skyrelay.cli.main import main as command

        command()
    except KeyboardInterrupt:
        leave()
    except SystemExit as end:
        # What was asked for is done or refused: Ctrl-C has nothing left to stop.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if end.code == STATUS:
            _gone()
        raise


def keep_programs(environment: MutableMapping[str, str] = os.environ) -> None:
    """Have JAX keep what it compiles in the user's cache folder, for the commands to come, unless told otherwise.

    ``SKYRELAY_COMPILED=off`` keeps nothing, another value is the folder; what is set for JAX itself stays.
    """
    place = environment.get("SKYRELAY_COMPILED", "")
    if place == "off" or "JAX_COMPILATION_CACHE_DIR" in environment:
        return
    if not place:
        from platformdirs import user_cache_path

        place = str(user_cache_path("skyrelay") / "compiled")
    environment["JAX_COMPILATION_CACHE_DIR"] = place
    environment.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(CACHE_BYTES))
    environment.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")


def guard() -> None:
    """Take Ctrl-C over for the rest of the process."""
    heard, hear = os.pipe()
    os.set_blocking(hear, False)
    signal.set_wakeup_fd(hear, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _interrupt)
    threading.Thread(target=_watch, args=(heard,), name="interrupt", daemon=True).start()


def leave() -> NoReturn:
    """One line, and out."""
    shown = b"\x1b[?25h" if os.isatty(2) else b""  # a progress bar hides the cursor
    os.write(2, shown + b"skyrelay: interrupted\n")
    _gone()


def _gone() -> NoReturn:
    """Without the interpreter's own end, which the compiler's threads do not survive."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            continue  # whoever read it has gone
    os._exit(STATUS)


def _interrupt(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 (the signal module's form)
    """In the main thread, between two instructions."""
    _noticed.set()
    while frame is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] in _UNSAFE:
            leave()
        frame = frame.f_back
    raise KeyboardInterrupt


def _watch(heard: int) -> None:
    """In a thread of its own, which the signal wakes even while the main thread is inside compiled code."""
    while True:
        if signal.SIGINT not in os.read(heard, 1):
            continue
        ours = signal.getsignal(signal.SIGINT) is _interrupt  # a command may have its own way to stop
        if ours and not _noticed.wait(PATIENCE):
            leave()
        _noticed.clear()
