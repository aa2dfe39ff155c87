"""The processes of `skyrelay up`: each with a log of its own, started again when it dies, ended with their parent."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType

from skyrelay.core.errors import SkyRelayError

LAUNCH = """\
import os, signal, threading


def end_with_parent():
    os.read(0, 1)  # nothing is ever written: the pipe ends when the parent is gone, however it went
    os.kill(os.getpid(), signal.SIGTERM)


threading.Thread(target=end_with_parent, daemon=True).start()
from skyrelay.cli.main import main
main()
"""
"""What a child runs: the command line of this same installation, as long as its parent is there."""
SLOWEST = 10.0
"""Between two starts of a child that dies again and again [s]."""
PATIENCE = 10.0
"""A child that has not ended so long after SIGTERM is killed [s]."""


class Children:
    """Processes of this one; use it as a context, which ends them all.

    Args:
        folder: of their logs.
        environment: beyond this process's own.
        say: is called with every line about a process.
        lost: is called with the name of one that has ended and is not started again.
    """

    def __init__(
        self, folder: Path, environment: Mapping[str, str], say: Callable[[str], None], lost: Callable[[str], None]
    ) -> None:
        self._folder, self._environment, self._say, self._lost = folder, dict(environment), say, lost
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._watchers: list[threading.Thread] = []
        self._ending = threading.Event()

    def start(self, name: str, arguments: Sequence[str], again: bool = False) -> None:
        """Run a command of ours; ``again`` and again, unless it says itself that it cannot (exit status 2)."""
        self._launch(name, arguments, None)
        watcher = threading.Thread(target=self._watch, args=(name, list(arguments), again), daemon=True)
        watcher.start()
        self._watchers.append(watcher)

    def follow(self, name: str, arguments: Sequence[str]) -> Iterator[str]:
        """Run a command of ours, and give what it writes to standard output, line by line, until it ends.

        Raises:
            SkyRelayError: it has ended with another status than 0; with the last line of its log.
        """
        process = self._launch(name, arguments, subprocess.PIPE)
        if process.stdout is not None:
            with process.stdout as lines:
                yield from (line.decode("utf-8", "replace") for line in lines)
        if process.wait():
            self.check(name)

    def end(self, name: str) -> None:
        """End one that runs."""
        process = self._running.get(name)
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGTERM)

    def check(self, name: str) -> None:
        """Raise if a child has ended; what was never started here has not.

        Raises:
            SkyRelayError: with the last line of its log.
        """
        process = self._running.get(name)
        if process is not None and process.poll() is not None:
            ended = f"ended with status {process.returncode}"
            raise SkyRelayError(name, ended, f"a process that runs ({self._last(name)})")

    def pid(self, name: str) -> int:
        """Of the process that is running now under a name."""
        return self._running[name].pid

    def _launch(self, name: str, arguments: Sequence[str], output: int | None) -> subprocess.Popen[bytes]:
        with (self._folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(  # noqa: S603  (our own interpreter and code)
                [sys.executable, "-P", "-c", LAUNCH, *arguments],  # -P: no code from the folder that one stands in
                stdin=subprocess.PIPE,
                stdout=log if output is None else output,
                stderr=log,
                env=os.environ | self._environment,
                start_new_session=True,  # Ctrl-C comes to the parent, which ends them in order
            )
        self._running[name] = process
        self._say(f"{name:<12} process {process.pid}, log {self._folder / name}.log")
        return process

    def _watch(self, name: str, arguments: Sequence[str], again: bool) -> None:
        for attempt in itertools.count():
            status = self._running[name].wait()
            if self._ending.is_set():
                return
            if again and status == 0:
                return
            if not again or status == 2:
                self._say(f"{name:<12} ended with status {status}: {self._last(name)}")
                self._lost(name)
                return
            self._say(f"{name:<12} ended with status {status}; started again")
            if self._ending.wait(min(0.1 * 2**attempt, SLOWEST) if attempt else 0.0):
                return
            self._launch(name, arguments, None)

    def _last(self, name: str) -> str:
        """The last line of a child's log."""
        with (self._folder / f"{name}.log").open("rb") as log:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 1000))
            lines = log.read().decode("utf-8", "replace").splitlines()
        return lines[-1] if lines else "it said nothing"

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        for process in reversed(self._running.values()):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in self._running.values():
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for watcher in self._watchers:
            watcher.join()
