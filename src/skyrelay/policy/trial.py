"""A policy is tried in a process of its own, with limits, before this one loads it: a hostile file ends that one alone.

Run as a program it has what a trial needs imported, and forks for each file that comes on standard input: a length of
eight bytes and the file. To standard output goes a line of JSON for each: how the fork has ended, and what it found.
"""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import resource
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Any, BinaryIO

from skyrelay.core.errors import ModelError
from skyrelay.core.untrusted import parse_json

MEMORY = 3 << 30
"""Address space of a trial's process [bytes]; onnxruntime maps half a gigabyte by itself."""
SECONDS = 10
"""Of its processor time."""
DECISION = 0.5
"""Of processor time for one decision [s]: a UAV has to decide in every step."""
PATIENCE = 120
"""Of waiting [s]: a busy machine gives a process a part of its time."""
IDLE = 30
"""Without a file for so long the process that forks ends [s]; the next trial starts another one."""
_LONGEST_ANSWER = 1 << 16

_tried: dict[bytes, ModelError | None] = {}
"""What each file's trial found, by the file's SHA-256; the error without its place."""


def require_harmless(content: bytes, place: str) -> None:
    """Try a policy; one that this process has tried before is not tried again.

    Raises:
        ModelError: it is refused, or ends the process that tries it.
    """
    digest = hashlib.sha256(content).digest()
    if digest not in _tried:
        told = _trials.ask(content, place)
        _tried[digest] = _verdict(told)
    refused = _tried[digest]
    if refused is not None:
        raise ModelError(place + refused.place, refused.value, refused.expected)


def trust(content: bytes) -> None:
    """A policy of the package itself needs no trial."""
    _tried[hashlib.sha256(content).digest()] = None


def end() -> None:
    """Let go of the process that forks for trials."""
    _trials.end()


def _verdict(answer: Any) -> ModelError | None:
    status, told = answer["status"], answer["told"]
    if status != 0 or not isinstance(told, dict):
        found = f"ended by signal {-status}" if status < 0 else f"ended with status {status}"
        limits = f"{MEMORY >> 30} GiB and {SECONDS} s"
        return ModelError("", f"a process that tried it {found}", f"a policy that loads and decides within {limits}")
    return ModelError(str(told["place"]), told["value"], str(told["expected"])) if told else None


class _Trials:
    """The process that forks for trials; started when first asked, one trial at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._lock = threading.Lock()

    def ask(self, content: bytes, place: str) -> Any:
        """What became of a file's trial: ``status`` and ``told``.

        Raises:
            ModelError: it took too long.
        """
        with self._lock:
            line = self._exchange(content, place) or self._exchange(content, place)  # the first may just have ended
            try:
                return parse_json(line, size=_LONGEST_ANSWER)
            except ValueError:
                status = self.end()
                return {"status": status or 1, "told": None}

    def end(self) -> int:
        """Let go of the process; its status."""
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return 0
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        return process.wait()

    def _exchange(self, content: bytes, place: str) -> bytes:
        """The line that answers; empty where the process has ended."""
        process = self._running()
        assert process.stdin is not None and process.stdout is not None  # noqa: S101, PT018
        with suppress(BrokenPipeError):
            process.stdin.write(struct.pack(">Q", len(content)) + content)
            process.stdin.flush()
        begin = time.monotonic()
        line = b""
        while not line.endswith(b"\n") and len(line) <= _LONGEST_ANSWER:
            left = PATIENCE - (time.monotonic() - begin)
            if left <= 0 or not select.select([process.stdout], [], [], left)[0]:
                self.end()
                raise ModelError(place, f"not loaded after {PATIENCE} s", "a policy that loads and decides at once")
            read = os.read(process.stdout.fileno(), 4096)
            if not read:
                break
            line += read
        return line

    def _running(self) -> subprocess.Popen[bytes]:
        process = self._process
        if process is not None and self._owner == os.getpid() and process.poll() is None:
            return process
        self.end()
        environment = {name: os.environ[name] for name in ("PATH", "LD_LIBRARY_PATH") if name in os.environ}
        environment |= {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"}
        self._owner = os.getpid()
        self._process = subprocess.Popen(
            # -P: nothing is imported from the folder that one happens to stand in.
            [sys.executable, "-P", "-m", "skyrelay.policy.trial"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,
        )
        return self._process


_trials = _Trials()
atexit.register(end)


def main() -> None:
    """Fork for each file that comes on standard input, until there are no more."""
    import skyrelay.policy.graph
    import skyrelay.policy.runtime  # noqa: F401  (what every fork needs)

    source = sys.stdin.buffer
    while select.select([source], [], [], IDLE)[0]:
        header = source.read(8)
        if len(header) < 8:
            return
        content = source.read(struct.unpack(">Q", header)[0])
        sys.stdout.write(json.dumps(_forked(content)) + "\n")
        sys.stdout.flush()


def _forked(content: bytes) -> dict[str, Any]:
    """Try a file in a fork of this process; ``status`` as `subprocess` has it, and what the fork told."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            os.close(reader)
            with open(os.devnull, "r+b") as nothing, os.fdopen(writer, "wb") as out:  # noqa: PTH123
                os.dup2(nothing.fileno(), 0)
                os.dup2(nothing.fileno(), 1)
                _limit()
                _try(content, out)
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        data = answer.read(_LONGEST_ANSWER)
    _, ended = os.waitpid(child, 0)
    try:
        told = parse_json(data, size=_LONGEST_ANSWER)
    except ValueError:
        told = None
    return {"status": os.waitstatus_to_exitcode(ended), "told": told}


def _limit() -> None:
    """What this process may take from now on."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


def _try(content: bytes, out: BinaryIO) -> None:
    """Look at the graph, load it, decide on a few observations, and write what is wrong with it."""
    from skyrelay.policy.graph import check_graph
    from skyrelay.policy.runtime import Policy

    told: dict[str, object] = {}
    try:
        check_graph(content, "")
        require_prompt(Policy(content, ""))
    except ModelError as error:
        value = error.value if isinstance(error.value, str | int | None) else str(error.value)
        told = {"place": error.place, "value": value, "expected": error.expected}
    out.write(json.dumps(told).encode())


def require_prompt(policy: Any) -> None:
    """A decision must come in time, and on more than an empty map.

    Raises:
        ModelError: it does not.
    """
    import numpy as np

    shape = (1, len(policy.card.maps), policy.n, policy.n)
    noise = np.random.default_rng(0).random(shape, dtype=np.float32)
    for maps in (np.ones(shape, np.float32), noise, 4.0 * noise - 2.0):
        begin = time.process_time()
        policy.decide(maps)
        spent = time.process_time() - begin
        if spent > DECISION:
            raise ModelError(": a decision", f"{spent:.1f} s of processor time", f"one within {DECISION:g} s")


if __name__ == "__main__":
    main()
