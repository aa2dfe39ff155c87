"""A UAV flies what the contract says of a model, and nothing that is retired."""

from dataclasses import replace

import pytest

from skyrelay.core.errors import ModelError
from skyrelay.protocol.model_card import UNTESTED, chain_card
from skyrelay.protocol.sequence import UavState


def publish(town, card):
    boss = town.chain.account("boss")
    (old,) = town.client.models()
    town.client.execute(
        [
            town.client.retire_model(boss, old.model_id),
            town.client.register_model(boss, bytes(town.store.put(town.policy.content)), card),
        ]
    )


@pytest.mark.parametrize(("field", "value"), [("score", -0.001), ("max_uavs", 60_000), ("max_vehicles", 60_000)])
def test_a_card_that_promises_more_than_the_file_is_refused(town, field, value):
    publish(town, replace(chain_card(town.policy.card), **{field: value}))
    with pytest.raises(ModelError, match=f"{field} of the file's card"):
        town.select()
    assert all(agent.state is not UavState.FLYING for agent in town.agents if agent.name.startswith("u"))


def test_the_same_card_flies(town):
    town.select()
    assert any(agent.state is UavState.FLYING for agent in town.agents if agent.name.startswith("u"))


def test_a_model_that_was_retired_after_it_was_assigned_is_refused(town):
    heard = town.host._heard

    def retire_at_once(event):
        heard(event)
        if event.name == "ModelAssigned" and not town.client.model(event.args["modelId"]).retired:
            town.client.execute([town.client.retire_model(town.chain.account("boss"), event.args["modelId"])])

    town.host._heard = retire_at_once
    with pytest.raises(ModelError, match="retired"):
        town.select()


def test_a_host_that_takes_refusals_outlives_a_policy_that_does_not_fit(town, monkeypatch):
    """A publisher's file, or a store that is silent, ends nobody else's flight: the UAV hovers and asks again."""
    told = []
    town.host._refused = lambda agent, error: told.append((agent.name, type(error)))
    publish(town, replace(chain_card(town.policy.card), score=-0.001))
    town.select()
    assert {kind for _, kind in told} == {ModelError}
    assert town.fly(0) == {}


def test_a_host_that_takes_refusals_outlives_a_policy_that_fails_in_flight(town, monkeypatch):
    told = []
    town.host._refused = lambda agent, error: told.append((agent.name, type(error)))
    town.select()
    assert town.fly(0)

    def fails(maps):
        raise ModelError("policy", None, "a network that decides")

    monkeypatch.setattr(town.policy, "decide", fails)
    assert town.fly(1) == {}
    assert {kind for _, kind in told} == {ModelError}


def test_a_policy_without_an_evaluation_comes_last(town):
    untested = town.policy.card.model_copy(update={"evaluation": []})
    assert chain_card(untested).score == UNTESTED < chain_card(town.policy.card).score
