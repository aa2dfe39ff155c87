"""A relayer that leaves a vehicle out, and what the vehicle does about it."""

import pytest

from skyrelay.chain.client import ProposalStatus
from skyrelay.chain.embedded.chain import signing_members
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Phase
from skyrelay.protocol.relay import Relay
from skyrelay.protocol.sequence import VehicleState
from skyrelay.protocol.vehicle import VehicleAgent


class Withholding(Relay):
    """Hands in all but the first that it is given."""

    def calls(self, client, proposals):
        return super().calls(client, proposals[1:])


@pytest.fixture(params=[Relay, Withholding])
def signing_town(request, town, tmp_path):
    """The town with vehicles that sign, after a period."""
    signing, keyring = type(town)(tmp_path / "signing"), signing_members()
    signing.agents = [
        VehicleAgent(a.name, keyring.account(a.name), a._demand, a._payment, a._grid, a._settings, signs=True)
        if isinstance(a, VehicleAgent)
        else a
        for a in signing.agents
    ]
    relay = request.param(keyring, signing.chain.account("boss"))
    signing.host = Host(signing.agents, signing.client, signing.store, signing.events.append, relay=relay)
    signing.cheated = request.param is Withholding
    signing.tell_positions()
    signing.tick(Phase.JOIN)
    signing.select()
    return signing


def uavs_that_serve(town):
    """By vehicle; None of those that nobody serves."""
    found = {}
    for vehicle in (agent for agent in town.agents if isinstance(agent, VehicleAgent)):
        ((status, uav, _),) = town.client.vehicle_selections([vehicle.address])
        assert (status is ProposalStatus.SELECTED) == (vehicle.state is VehicleState.SERVED)
        serves = status is ProposalStatus.SELECTED
        found[vehicle.name] = next(agent.name for agent in town.agents if agent.address == uav) if serves else None
    return found


def test_left_out_or_not_the_same_are_served(signing_town, town):
    town.select()
    for one in (signing_town, town):
        one.tell_positions()
        one.select()
    assert any(uavs_that_serve(town).values())
    assert uavs_that_serve(signing_town) == uavs_that_serve(town)


def test_who_is_left_out_sends_record_and_proposal_itself(signing_town):
    signing_town.events.clear()
    signing_town.tell_positions()
    signing_town.select()
    told = {event.args["vehicle"] for event in signing_town.events if event.name == "VehicleUpdated"}
    proposed = [event.args["vehicle"] for event in signing_town.events if event.name == "VehSelectionSubmitted"]
    assert len(proposed) == len(set(proposed)) > 1
    assert told & set(proposed) == ({signing_town["v1"].address} if signing_town.cheated else set())
