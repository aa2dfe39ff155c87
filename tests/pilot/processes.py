"""Free ports, and waiting for what has to come."""

import socket
import time


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(true, limit=30.0):
    """Wait until ``true()``; the limit only ends a test that would fail."""
    deadline = time.monotonic() + limit
    while not (found := true()):
        assert time.monotonic() < deadline, "what was waited for did not come"
        time.sleep(0.01)
    return found
