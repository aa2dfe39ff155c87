"""Node programs beside the agents: what dies is started again, and what does not start is tried again."""

import os
import signal

import pytest

from skyrelay.core.errors import ChainError, StoreError
from skyrelay.pilot.nodes import _Kubo, _revive, kubo_program


class Network:
    """Three validators that have ended at once: with the first alone there is no quorum, so that it sees no block."""

    def __init__(self):
        self.dead, self.started = [0, 1, 2], []

    def ended(self):
        dead, self.dead = self.dead, []
        return dead

    def restart(self, index):
        self.started.append(index)
        if len(self.started) == 1:
            raise ChainError("validator 0", None, "a new block")

    def pid(self, index):
        return index

    def log(self, index):
        return f"{index}.log"


def test_a_validator_that_sees_no_block_yet_does_not_keep_the_others_from_being_started_again():
    network, dead, said = Network(), [], []
    with pytest.raises(ChainError):
        _revive(network, dead, said.append)
    _revive(network, dead, said.append)
    assert network.started == [0, 1, 2]
    assert not dead


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
