"""Real validators that stand still, and what the doctor says of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrelay.chain.node.devnet import Devnet
from skyrelay.chain.node.doctor import diagnose

pytestmark = pytest.mark.nodes


def test_two_of_four_validators_are_no_quorum(tmp_path: Path) -> None:
    with Devnet.create(tmp_path / "net") as network:
        network.wait_for_blocks(4)
        well = diagnose(network.endpoints, 30.0)
        assert (well.moves, well.findings) == (True, [])
        for index in (0, 1):
            network.kill(index)
        ill = diagnose(network.endpoints, 6.0)
    assert not ill.moves
    text = "\n".join(ill.findings)
    assert text.count("does not answer") == 2
    assert "no new block in 6 s" in text
    assert "no quorum: 3 of 4 validators must sign, no node sees more than 2" in text
