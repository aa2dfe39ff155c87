"""A contract's life from the command line, on the embedded chain behind JSON-RPC."""

import json

import pytest

from skyrelay.chain.accounts import PASSWORD, PASSWORD_FILE, Keyring
from skyrelay.chain.client import IovClient, ModelCard
from skyrelay.chain.node.chain import NodeChain
from skyrelay.pilot.chain_server import ChainServer
from skyrelay.pilot.signed_chain import SignedChain
from skyrelay.store.cid import cid_of


@pytest.fixture
def served(tmp_path):
    chain = SignedChain(tmp_path / "state")
    with ChainServer(chain, "127.0.0.1:0") as server:
        yield server.url
    chain.close()


@pytest.fixture
def keys(tmp_path, monkeypatch):
    monkeypatch.setenv(PASSWORD, "open")
    monkeypatch.delenv(PASSWORD_FILE, raising=False)
    return tmp_path / "keys.json"


@pytest.fixture
def told(skyrelay):
    """JSON of a command that has to succeed."""

    def run(*arguments):
        ended = skyrelay(*arguments, "--json")
        assert ended.status == 0, ended.err
        return json.loads(ended.out)

    return run


def test_a_contract_is_deployed_roles_are_given_and_taken_and_its_status_says_so(served, keys, told, skyrelay):
    names = told("accounts", keys, "--create", "administrator", "publisher", "coordinator")
    assert told("accounts", keys, "publisher") == {"publisher": names["publisher"]}, "the same each time"
    signing = ("--node", served, "--chain-id", 31337, "--keystore", keys)
    made = told("deploy", *signing, "--set", "selection.max_distance=500", "--rating-step", 2.5, "--admission")
    assert made["administrator"] == names["administrator"]
    at = ("--contract", made["contract"])
    told("grant", "publisher", names["publisher"], *at, *signing)
    told("grant", "coordinator", "coordinator", *at, *signing)  # by its name in the keystore
    asked = ("status", "--node", served, *at)
    now = told(*asked, "--chain-id", 31337)
    assert now["roles"] == {
        "admin": [names["administrator"]],
        "coordinator": [names["coordinator"]],
        "publisher": [names["publisher"]],
        "reputation": [],
        "registrar": [],
        "settler": [],
    }
    assert (now["settings"]["max_distance"], now["settings"]["rating_step"]) == (500.0, 2.5)
    assert now["settings"]["admission"] is True
    assert (now["uavs"], now["zones"], now["models"]) == (0, [], [])

    told("revoke", "publisher", names["publisher"], *at, *signing)
    told("grant", "publisher", names["coordinator"], *at, *signing)
    assert told(*asked)["roles"]["publisher"] == [names["coordinator"]]
    shown = skyrelay(*asked)
    assert f"publisher      {names['coordinator']}" in shown.out
    assert "registrar      nobody" in shown.out


def test_a_zone_has_a_coordinator_of_its_own_and_loses_it(served, keys, told, skyrelay):
    names = told("accounts", keys, "--create", "administrator", "north", "south")
    signing = ("--node", served, "--chain-id", 31337, "--keystore", keys)
    at = ("--contract", told("deploy", *signing)["contract"], *signing)
    told("grant", "coordinator", "north", "--zone", 3, *at)
    assert told("status", "--node", served, "--contract", at[1])["coordinators"] == {"3": names["north"]}
    shown = skyrelay("status", "--node", served, "--contract", at[1]).out
    assert f"zone 3         coordinator {names['north']}" in shown
    wrong = skyrelay("revoke", "coordinator", "south", "--zone", 3, *at)
    assert wrong.status == 2
    assert wrong.err == f"skyrelay: zone 3: is '{names['north']}'; expected {names['south']}\n"
    told("revoke", "coordinator", "north", "--zone", 3, *at)
    assert told("status", "--node", served, "--contract", at[1])["coordinators"] == {}


def test_a_model_is_retired_by_who_registered_it_or_the_administrator(served, keys, told, skyrelay):
    names = told("accounts", keys, "--create", "administrator", "publisher", "rival")
    signing = ("--node", served, "--chain-id", 31337, "--keystore", keys)
    at = ("--contract", told("deploy", *signing, "--channels", 10)["contract"], *signing)
    for name in ("publisher", "rival"):
        told("grant", "publisher", name, *at)
    client = IovClient.connect(NodeChain(served, Keyring.open(keys)), at[1])
    card, cids = ModelCard(1, 4, 1, 20, 9, 10, 9, -1.0), [cid_of(bytes([number])) for number in range(3)]
    for owner, cid in (("publisher", cids[0]), ("publisher", cids[1]), ("rival", cids[1]), ("rival", cids[2])):
        client.execute([client.register_model(client.chain.account(owner), bytes(cid), card)])

    stranger = skyrelay("models", "retire", cids[0], *at, "--by", "rival")
    assert stranger.status == 2
    assert f"expected who has registered it ({names['publisher']})" in stranger.err
    gone = told("models", "retire", cids[0], *at)
    assert (gone["owner"], gone["retired"]) == (names["publisher"], True)
    again = skyrelay("models", "retire", cids[0], *at)
    assert again.status == 2
    assert "that the contract has and that is not retired" in again.err
    told("models", "retire", cids[2], *at, "--by", "administrator")
    both = skyrelay("models", "retire", cids[1], *at, "--by", "administrator")
    assert both.status == 2
    assert all(model.model_id in both.err for model in client.models())
    told("models", "retire", client.models()[1].model_id, *at, "--by", "administrator")
    assert [model.owner for model in client.models()] == [names["publisher"]], "one's own of the two"


def test_what_does_not_fit_is_one_line_and_changes_nothing(served, keys, told, skyrelay, monkeypatch):
    told("accounts", keys, "--create")
    signing = ("--node", served, "--chain-id", 31337, "--keystore", keys)
    contract = told("deploy", *signing)["contract"]
    at = ("--contract", contract, *signing)
    before = told("status", "--node", served, "--contract", contract)

    other_chain = ("--node", served, "--chain-id", 1, "--keystore", keys)
    for arguments, expected in (
        (("deploy", *other_chain), "chain id: is 31337; expected 1: this is another network"),
        (("grant", "publisher", "x", "--contract", contract, *other_chain), "this is another network"),
        (("grant", "publisher", "0x12", *at), "contract: is '0x12'; expected 0x and 40 hexadecimal digits"),
        (("grant", "publisher", "x", "--by", "someone", *at), "expected the contract's administrator"),
        (("grant", "publisher", "x", "--zone", 1, *at), "--zone: is 1; expected the role coordinator"),
        (("revoke", "publisher", "x", *at), "expected an account that has it"),
        (("grant", "owner", "x", *at), "'owner' is not one of 'coordinator'"),
        (("grant", "publisher", "x", "--contract", "0x" + "11" * 20, *signing), "expected a contract's address"),
        (("accounts", keys, "--create"), "expected a place for a new keystore"),
        (("deploy", "--node", "http://127.0.0.1:9", *signing[2:]), "expected a node that answers JSON-RPC"),
        (("deploy", *signing[2:]), "Missing option '--node'"),
    ):
        ended = skyrelay(*arguments)
        assert ended.status == 2, arguments
        assert expected in ended.err, ended.err
        assert ended.err.count("\n") == 1
    monkeypatch.setenv(PASSWORD, "secret-guess")
    ended = skyrelay("deploy", *signing)
    assert ended.err == f"skyrelay: {keys}: expected a Web3 keystore and its password\n"
    assert told("status", "--node", served, "--contract", contract) == before
