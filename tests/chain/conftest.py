"""What the chain's tests share: a populated contract, and anvil as the other machine."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(Path(__file__).parent))  # for `chain_rounds` and `json_rpc_node`, which several tests share


class Anvil:
    """A running anvil, by plain JSON-RPC."""

    def __init__(self, url: str) -> None:
        self.url = url

    def __call__(self, method: str, *params: Any) -> Any:
        (answer,) = self.batch([(method, list(params))])
        if "error" in answer:
            raise AssertionError(f"{method}: {answer['error']}")
        return answer["result"]

    def batch(self, requests: list[tuple[str, list[Any]]]) -> list[dict[str, Any]]:
        body = [{"jsonrpc": "2.0", "id": i, "method": m, "params": p} for i, (m, p) in enumerate(requests)]
        request = urllib.request.Request(  # noqa: S310
            self.url, json.dumps(body).encode(), headers={"content-type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=60) as response:  # noqa: S310
            return sorted(json.load(response), key=lambda answer: answer["id"])


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start_anvil(port: int, *options: str) -> subprocess.Popen[bytes]:
    places = os.pathsep.join([str(ROOT / "contracts" / "node_modules" / ".bin"), os.environ["PATH"]])
    binary = shutil.which("anvil", path=places)
    assert binary, "no anvil in contracts/node_modules or on PATH: run `npm ci` in contracts/"
    command = [binary, "--silent", "--hardfork", "london", "--port", str(port), "--order", "fifo"]
    command += ["--gas-price", "0", "--block-base-fee-per-gas", "0", "--gas-limit", "30000000", *options]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, env={**os.environ, "RUST_LOG": "off"})


def wait_for(anvil: Anvil) -> None:
    deadline = time.monotonic() + 20
    while True:
        try:
            anvil("eth_chainId")
        except OSError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.05)
        else:
            return


@pytest.fixture
def anvil() -> Iterator[Anvil]:
    """London rules, blocks on demand, any sender."""
    port = free_port()
    process = start_anvil(port, "--no-mining", "--timestamp", "1")
    try:
        machine = Anvil(f"http://127.0.0.1:{port}")
        wait_for(machine)
        machine("anvil_autoImpersonateAccount", True)
        yield machine
    finally:
        process.terminate()
        process.wait()
