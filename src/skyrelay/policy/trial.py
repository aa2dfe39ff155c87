"""A policy is tried in a process of its own, with limits, before this one loads it: a hostile file ends that one alone.

Run as a program it reads a file from standard input and writes what is wrong with it, as JSON, to standard output.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import subprocess
import sys

from skyrelay.core.errors import ModelError
from skyrelay.core.untrusted import parse_json

MEMORY = 3 << 30
"""Address space of the process [bytes]; onnxruntime maps half a gigabyte by itself."""
SECONDS = 30
"""Of processor time."""
PATIENCE = 120
"""Of waiting [s]: a busy machine gives a process a part of its time."""

_tried: set[bytes] = set()


def require_harmless(content: bytes, place: str) -> None:
    """Try a policy; one that this process has tried before is not tried again.

    Raises:
        ModelError: it is refused, or ends the process that tries it.
    """
    digest = hashlib.sha256(content).digest()
    if digest in _tried:
        return
    environment = {name: os.environ[name] for name in ("PATH", "LD_LIBRARY_PATH") if name in os.environ}
    environment |= {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-m", "skyrelay.policy.trial"],
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=PATIENCE,
            env=environment,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ModelError(place, f"not loaded after {PATIENCE} s", "a policy that loads and decides at once") from None
    try:
        told = parse_json(done.stdout, size=1 << 16)
    except ValueError:
        told = None
    if done.returncode != 0 or not isinstance(told, dict):
        found = f"ended by signal {-done.returncode}" if done.returncode < 0 else f"ended with status {done.returncode}"
        limits = f"{MEMORY >> 30} GiB and {SECONDS} s"
        raise ModelError(place, f"a process that tried it {found}", f"a policy that loads and decides within {limits}")
    if told:
        raise ModelError(place + str(told["place"]), told["value"], str(told["expected"]))
    _tried.add(digest)


def trust(content: bytes) -> None:
    """A policy of the package itself needs no trial."""
    _tried.add(hashlib.sha256(content).digest())


def main() -> None:
    """Try what comes on standard input."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    content = sys.stdin.buffer.read()
    from skyrelay.policy.graph import check_graph
    from skyrelay.policy.runtime import Policy

    told: dict[str, object] = {}
    try:
        check_graph(content, "")
        Policy(content, "")
    except ModelError as error:
        value = error.value if isinstance(error.value, str | int | None) else str(error.value)
        told = {"place": error.place, "value": value, "expected": error.expected}
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main()
