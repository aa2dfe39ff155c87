"""Two hosts coordinate the same zones: the second watches the chain, and acts where the first has not."""

import pytest
from town_of_processes import Up, audited, decided

TWO = ["--coordinators", 2, "--standby", 1, "--wait", 1, "--elsewhere", "coordinator"]


pytestmark = pytest.mark.survival


@pytest.fixture
def up(tmp_path):
    up = Up(tmp_path / "up", options=TWO)
    try:
        up.start("coordinator")
        up.start("coordinator-2")
        yield up
    finally:
        up.stop()


@pytest.mark.parametrize("block", [8, 14])
def test_what_the_first_leaves_undone_the_second_does_and_nothing_twice(run_folder, up, block):
    """Not a row differs from a run of which nobody was killed: none is lost, and none doubled."""
    up.wait_for_block(block)
    up.kill("coordinator")
    up.end()
    assert any("coordinator is gone" in line for line in up.lines)
    assert "takes over at step" in up.log("coordinator-2")
    one, many = decided(run_folder), decided(up.folder)
    for table in one:
        assert many[table] == one[table], table
    audited(up.folder)


def test_while_the_first_acts_the_second_does_not(run_folder, up):
    up.end()
    assert "takes over" not in up.log("coordinator-2")
    assert decided(up.folder)["selections"] == decided(run_folder)["selections"]
