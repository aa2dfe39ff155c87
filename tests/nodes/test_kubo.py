"""Two real Kubo nodes on loopback, in a swarm of their own."""

import array
import json
import secrets
from pathlib import Path

import numpy as np
import pytest

from skyrelay.airspace.law import Law
from skyrelay.chain.client import IovClient, Role, Settings, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.core.errors import StoreError
from skyrelay.core.scenario import Energy
from skyrelay.core.zones import ZoneGrid
from skyrelay.policy import Policy
from skyrelay.protocol.host import Host
from skyrelay.protocol.messages import Fix, Phase, Tick
from skyrelay.protocol.model_card import chain_card
from skyrelay.protocol.sequence import UavState
from skyrelay.protocol.uav import UavAgent
from skyrelay.store.cid import CHUNK_BYTES, LINKS_PER_NODE, PROFILE, Cid, cid_of
from skyrelay.store.fallback import FallbackStore
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import StoredModel

pytestmark = [pytest.mark.nodes, pytest.mark.xdist_group("kubo")]

KNOWN = json.loads((Path(__file__).parents[1] / "store" / "known_cids.json").read_text())["cids"]


def counters(path: Path, size: int) -> Path:
    """The content that known_cids.json names."""
    with path.open("wb") as file:
        for start in range(0, size, 1_000_000):
            file.write(array.array("I", range(start // 4, start // 4 + 250_000)).tobytes()[: size - start])
    return path


@pytest.mark.parametrize("size", [int(size) for size in KNOWN])
def test_kubo_and_the_local_store_give_the_known_address_and_the_same_bytes(swarm, tmp_path, size):
    source = counters(tmp_path / "model", size)
    kubo, local = KuboStore(swarm[0].url), LocalStore(tmp_path / "store")
    cid = kubo.put(source)
    assert str(cid) == KNOWN[str(size)]
    assert local.put(source) == cid
    for store in (kubo, local):
        assert store.fetch(cid, tmp_path / "copy") == size
        assert cid_of(tmp_path / "copy") == cid
        assert store.has(cid)
        assert StoredModel(cid, size) in store.models()


def test_kubo_itself_gives_the_same_addresses_under_the_profile_that_ours_name(tmp_path, idle_node):
    node = idle_node
    node.run("config", "profile", "apply", PROFILE)
    for size in (*map(int, KNOWN), LINKS_PER_NODE * CHUNK_BYTES + 1):  # the last: one leaf more than a node links to
        path = tmp_path / "model"
        if str(size) in KNOWN:
            counters(path, size)
        else:
            with path.open("wb") as file:
                file.truncate(size)
        assert node.run("add", "-Q", "--only-hash", str(path)).strip() == str(cid_of(path))


@pytest.mark.parametrize("size", [5, 300_000, 3_000_000])
def test_a_model_published_through_one_node_is_fetched_through_the_other_by_its_address_alone(swarm, tmp_path, size):
    model = secrets.token_bytes(size)
    published, remote = KuboStore(swarm[0].url), KuboStore(swarm[1].url)
    address = str(published.put(model))
    cid = Cid.parse(address)
    assert not remote.has(cid)
    assert StoredModel(cid, size) not in remote.models()
    remote.pin(cid)
    assert remote.has(cid)
    assert StoredModel(cid, size) in remote.models()
    assert remote.fetch(cid, tmp_path / "model.onnx") == size
    assert (tmp_path / "model.onnx").read_bytes() == model


def test_a_model_that_nobody_holds_is_told_in_time_and_the_next_store_is_asked(swarm, tmp_path):
    model = secrets.token_bytes(300_000)
    local = LocalStore(tmp_path / "store")
    cid = local.put(model)
    kubo = KuboStore(swarm[0].url, timeout=2)
    assert not kubo.has(cid)
    for ask in (kubo.get, kubo.verify, kubo.pin):
        with pytest.raises(StoreError, match=r"deadline exceeded|silent for 2 s"):
            ask(cid)
    notices: list[StoreError] = []
    assert FallbackStore([kubo, local], notices.append).get(cid) == model
    assert len(notices) == 1


def test_a_node_that_went_down_is_told_and_the_other_answers(swarm, tmp_path):
    model = secrets.token_bytes(CHUNK_BYTES + 1)
    one, other = KuboStore(swarm[0].url), KuboStore(swarm[1].url)
    cid = one.put(model)
    other.pin(cid)
    swarm[0].stop()
    notices: list[StoreError] = []
    try:
        assert FallbackStore([one, other], notices.append).get(cid) == model
        assert "expected a Kubo RPC endpoint that answers" in str(notices[0])
    finally:
        swarm[0].start()
        swarm[1].connect(swarm[0])
    assert KuboStore(swarm[0].url).verify(cid) == len(model), "the pin survived the stop"


def test_a_block_that_rots_on_the_nodes_disk_is_refused(swarm, tmp_path):
    model = secrets.token_bytes(2 * CHUNK_BYTES)
    kubo = KuboStore(swarm[0].url, timeout=3)
    cid = kubo.put(model)
    rotten = [path for path in (swarm[0].home / "blocks").rglob("*.data") if path.read_bytes() == model[:CHUNK_BYTES]]
    assert len(rotten) == 1
    rotten[0].chmod(0o600)
    rotten[0].write_bytes(b"\0" + model[1:CHUNK_BYTES])
    with pytest.raises(StoreError, match=str(cid)):
        kubo.fetch(cid, tmp_path / "out")
    assert not list(tmp_path.iterdir()), "nothing half-written"


def test_an_address_of_another_layout_is_refused(swarm, tmp_path):
    (tmp_path / "model").write_bytes(secrets.token_bytes(700_000))
    other = swarm[0].run("add", "-Q", "--cid-version=1", "--chunker=size-100000", str(tmp_path / "model")).strip()
    with pytest.raises(StoreError, match="700000 bytes that hash to bafk"):
        KuboStore(swarm[0].url).verify(Cid.parse(other))


def test_a_uav_that_knows_only_the_cid_from_the_chain_flies_the_published_policy(swarm, tmp_path):
    policy = Policy.builtin("generalist")
    with EmbeddedChain(tmp_path / "chain") as chain:
        administrator, vehicle = chain.account("administrator"), chain.account("vehicle")
        client = IovClient.deploy(chain, Settings(channels=len(policy.card.maps)), administrator)
        for role in (Role.COORDINATOR, Role.PUBLISHER):
            client.execute([client.grant_role(administrator, role, administrator)])
        published = KuboStore(swarm[0].url).put(policy.content)
        client.execute([client.register_model(administrator, bytes(published), chain_card(policy.card))])

        law = Law(ZoneGrid(0.0, 0.0, 1000.0, 1, 1), 500.0, 30.0, 2.0, Energy(), None, 10.0)
        agent = UavAgent("u1", chain.account("u1"), 1, 100.0, 9_000, law, Policy.load)
        host = Host([agent], client, KuboStore(swarm[1].url), lambda event: None, alone=False)
        agent.receive(Fix((0.0, 0.0), 90.0))
        host.tick(Tick(Phase.JOIN))
        client.execute([client.register_vehicle(vehicle, VehicleRecord(10.0, 10.0, 500.0, 1))])
        client.execute([client.submit_veh_selection(vehicle, agent.address, 1_000.0, 1)])
        client.execute([client.allocate_zone(administrator, 1, 10)])
        client.execute([client.determine_mdrl_model(administrator, 1)])
        host.tick(Tick(Phase.BEACON))
    assert agent.state is UavState.FLYING
    flown = agent.policy
    assert isinstance(flown, Policy)
    assert flown.content == policy.content
    maps = np.zeros((1, len(flown.card.maps), flown.n, flown.n), np.float32)
    assert flown.decide(maps).shape == (1,)
