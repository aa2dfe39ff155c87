"""Node programs beside the agents: what dies is started again, and what does not start is tried again."""

import contextlib
import os
import signal
import socket
from typing import Any

import pytest

from skyrelay.chain.node.devnet import Devnet
from skyrelay.core.errors import ChainError, StoreError
from skyrelay.pilot.nodes import _Kubo, _revive, kubo_program


class Network:
    """Three validators that have ended at once.

    Args:
        runs: whether one that did not start as it should runs nevertheless.
    """

    def __init__(self, *, runs):
        self.dead, self.started, self.fails, self._runs = [0, 1, 2], [], 1, runs

    def ended(self):
        dead, self.dead = self.dead, []
        return dead

    def restart(self, index):
        self.started.append(index)
        if len(self.started) <= self.fails:
            raise ChainError(f"validator {index}", None, "a new block, or a port that is free")

    def runs(self, index):
        return self._runs

    def pid(self, index):
        return index

    def log(self, index):
        return f"{index}.log"


def test_a_validator_that_sees_no_block_yet_does_not_keep_the_others_from_being_started_again():
    """With the first alone there is no quorum."""
    network: Any = Network(runs=True)
    dead: list[int] = []
    said: list[str] = []
    with pytest.raises(ChainError):
        _revive(network, dead, said.append)
    _revive(network, dead, said.append)
    assert network.started == [0, 1, 2]
    assert not dead


def test_a_validator_whose_port_is_still_taken_is_tried_until_it_is_free():
    network: Any = Network(runs=False)
    dead: list[int] = []
    said: list[str] = []
    network.fails = 7
    for _ in range(7):
        with pytest.raises(ChainError):
            _revive(network, dead, said.append)
    _revive(network, dead, said.append)
    assert network.started == [0, 1, 2, 0, 1, 2, 0, 1, 2, 0]
    assert not dead
    assert sum("started again" in line for line in said) == 3


@pytest.mark.nodes
def test_a_validator_comes_back_to_a_port_that_another_had_meanwhile(tmp_path):
    with Devnet.create(tmp_path / "devnet", validators=1) as network:
        dead, said = [], []
        os.kill(network.pid(0), signal.SIGKILL)
        port, taker = network.validators[0].rpc_port, socket.socket()
        taker.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        while True:
            try:
                taker.bind(("127.0.0.1", port))
                break
            except OSError:  # it has not gone yet
                continue
        with taker:
            taker.listen()
            while not dead:
                with contextlib.suppress(ChainError):
                    _revive(network, dead, said.append)
        _revive(network, dead, said.append)
        assert network.runs(0)


@pytest.mark.nodes
def test_a_kubo_node_that_did_not_start_again_counts_as_ended_and_starts_later(tmp_path):
    node = _Kubo(tmp_path / "repository", kubo_program())
    url = node.start()
    try:
        os.killpg(node.pid, signal.SIGKILL)
        node._process.wait()
        key = tmp_path / "repository" / "swarm.key"  # without which it may not run
        away = key.rename(tmp_path / "swarm.key")
        with pytest.raises(StoreError):
            node.start()
        assert node.ended()
        away.rename(key)
        assert node.start() == url
        assert not node.ended()
    finally:
        node.stop()
