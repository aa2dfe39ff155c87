import pytest

from skyrelay.core.errors import ProtocolError
from skyrelay.protocol.sequence import (
    UAV,
    VEHICLE,
    ZONE,
    Machine,
    UavState,
    VehicleMessage,
    VehicleState,
    ZoneState,
    to_mermaid,
)

TABLES = [(VEHICLE, VehicleState.NEW), (UAV, UavState.NEW), (ZONE, ZoneState.COLLECTING)]


@pytest.mark.parametrize(("table", "start"), TABLES)
def test_every_state_can_be_reached_and_every_message_is_used(table, start):
    reached = {start}
    while grown := {step for (state, _), step in table.items() if state in reached} - reached:
        reached |= grown
    assert reached == set(type(start).__members__.values())
    messages = {message for _, message in table}
    assert messages == set(type(next(iter(messages))).__members__.values())


def test_a_message_out_of_sequence_raises_and_changes_nothing():
    machine = Machine("v1", VEHICLE, VehicleState.NEW)
    with pytest.raises(ProtocolError, match=r"registerVehicle\(\)"):
        machine.advance(VehicleMessage.PROPOSE)
    assert machine.state is VehicleState.NEW


@pytest.mark.parametrize(("table", "start"), TABLES)
def test_the_diagram_shows_each_transition_once(table, start):
    assert to_mermaid(table, start).count("-->") == len(table) + 1
