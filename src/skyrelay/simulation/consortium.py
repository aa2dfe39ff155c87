"""The parties that are neither vehicle nor UAV: who deploys, coordinates, publishes models and sets reputations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from skyrelay.airspace.maps import map_names
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.claims import SUPPLY, ClaimClient
from skyrelay.chain.client import IovClient, Role, Settings
from skyrelay.chain.embedded.chain import EmbeddedChain, signing_members
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.core.errors import ModelError
from skyrelay.core.scenario import Chain as ChainConfig
from skyrelay.core.scenario import Scenario
from skyrelay.policy import Policy, builtin_policies
from skyrelay.policy.signature import public_key, verify
from skyrelay.protocol.claims import ClaimBook
from skyrelay.protocol.model_card import chain_card
from skyrelay.protocol.relay import Relay
from skyrelay.protocol.rule import MARK, Decider, Rule
from skyrelay.runfolder.folder import CHAIN, STORE
from skyrelay.simulation.payment import Cashier
from skyrelay.simulation.world import World
from skyrelay.store.cid import Cid
from skyrelay.store.kubo import KuboStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import ModelStore

PARTIES = ("administrator", "coordinator", "publisher", "reputation authority")


class Hangar:
    """Loads policies; UAVs that were given the same file share one, as all of them are in this process.

    Args:
        scenario: whose rule, if it names one, the UAVs here have on board: no rule's code comes from a store; and whose
            ``store.trusted_keys``, if it has any, must have signed a policy.
        now: the time by which signatures expire.
    Raises:
        ModelError: a key's file is none.
    """

    def __init__(self, scenario: Scenario, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._policies: dict[bytes, Policy] = {}
        self._now = now
        self._keys = [public_key(Path(path)) for path in scenario.store.trusted_keys or ()]
        self._rules = [decider for decider in deciders(scenario) if isinstance(decider, Rule)]

    def load(self, data: bytes) -> Decider:
        """A checked policy from a file's bytes; or the rule that they are the card of.

        Raises:
            ModelError: the card or the network does not fit a UAV, or the rule here is another; or no trusted key has
                signed it, or its time is over.
        """
        for rule in self._rules:
            if rule.content == data:
                return rule
        if data.startswith(MARK):
            own = ", ".join(rule.content.decode() for rule in self._rules) or "none"
            raise ModelError("policy", data[:200].decode(errors="replace"), f"the rule of this host: {own}")
        if self._keys:  # each time, since a policy on board may expire
            verify(data, self._keys, self._now(), "policy")
        digest = hashlib.sha256(data).digest()
        if digest not in self._policies:
            self._policies[digest] = Policy.load(data)
        return self._policies[digest]


class Consortium:
    """The chain with the deployed contract, the model store, and the accounts with a role.

    Args:
        scenario: resolved.
        folder: of the run.
        elsewhere: addresses of the parties whose keys are not here, by name.
        coordinators: how many, each with an authority of its own; the further ones are numbered from 2.
    """

    def __init__(
        self, scenario: Scenario, folder: Path, elsewhere: Mapping[str, str] | None = None, *, coordinators: int = 1
    ) -> None:
        self._deciders = deciders(scenario)
        self._names: dict[str, str] = {}
        url = scenario.store.url
        self.store: ModelStore = KuboStore(url) if url else LocalStore(folder / STORE)
        self.hangar = Hangar(scenario)
        self.chain, self._keyring = _open_chain(scenario.chain, folder, signs=members_sign(scenario))
        self._signs = scenario.chain.signs
        self._elsewhere = dict(elsewhere or {})
        self.administrator, self.coordinator, self.publisher, self.authority = map(self.account, PARTIES)
        self._standbys = [
            (role, f"{party} {number}")
            for number in range(2, coordinators + 1)
            for role, party in ((Role.COORDINATOR, "coordinator"), (Role.REPUTATION, "reputation authority"))
        ]
        claimed = scenario.chain.allocation != "strict"
        settings = Settings.of(
            scenario.selection,
            channels=len(self._deciders[0].card.maps),
            settling=3 * scenario.chain.challenge_window if claimed else 0,
        )
        self.client = IovClient.deploy(self.chain, settings, self.administrator)
        self._claims = ClaimClient.deploy(self.client, self.administrator) if claimed else None
        proven = scenario.chain.allocation == "proven"
        self.book = None if self._claims is None else ClaimBook(self._claims, proven=proven)

    def account(self, name: str) -> str:
        """The address of a party or member."""
        if name in self._elsewhere:
            return self._elsewhere[name]
        return self.chain.account(name) if self._keyring is None else self._keyring.account(name)

    def cashier(self, world: World) -> Cashier | None:
        """What settles the run's payments, with its contract deployed; None where nobody pays."""
        if not world.scenario.payment.enabled or self._keyring is None:
            return None
        return Cashier.found(world, self.client, self.administrator, self._keyring)

    @property
    def relay(self) -> Relay | None:
        """The coordinator, where vehicles sign with keys that are here."""
        if self._keyring is None or not self._signs:
            return None
        return Relay(self._keyring, self.coordinator, once_a_round=self.book is not None)

    def parties(self) -> dict[str, str]:
        """Name and address of those with a role."""
        return {name: self.account(name) for name in (*PARTIES, *(name for _, name in self._standbys))}

    @property
    def signer(self) -> Callable[[bytes], tuple[str, bytes]] | None:
        """Signs for the coordinator, or where its keys are elsewhere for the publisher; None on the embedded chain."""
        if isinstance(self.chain, EmbeddedChain):
            return None
        chain, party = self.chain, self.publisher if self._elsewhere else self.coordinator
        return lambda message: (party, chain.vouch(party, message))

    def found(self) -> None:
        """Grant the roles, store every policy and register it by its CID."""
        client = self.client
        roles = [
            (Role.COORDINATOR, self.coordinator),
            (Role.PUBLISHER, self.publisher),
            (Role.REPUTATION, self.authority),
            *((role, self.account(name)) for role, name in self._standbys),
        ]
        client.execute([client.grant_role(self.administrator, role, account) for role, account in roles])
        if self._claims is not None:
            client.execute([self._claims.transfer(self.administrator, self.coordinator, SUPPLY)])
        calls = []
        for decider in self._deciders:
            cid = self.store.put(decider.content)
            self._names[str(cid)] = ("rule " if isinstance(decider, Rule) else "policy ") + decider.card.name
            calls.append(client.register_model(self.publisher, bytes(cid), chain_card(decider.card)))
        client.execute(calls)

    def deciders(self) -> dict[str, str]:
        """The names of the policies and rules that are registered, by CID."""
        return dict(self._names)

    def cid_of_model(self, model_id: str) -> Cid:
        """The CID that the contract holds for a model."""
        return Cid.from_bytes(self.client.model(model_id).cid, f"model {model_id}")

    def __enter__(self) -> Consortium:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(self.chain, EmbeddedChain):
            self.chain.close()


def chain_facts(chain: EmbeddedChain | NodeChain, contract: str) -> dict[str, Any]:
    """What a run's summary says of its chain; the id is None on the embedded one."""
    number = chain.block_number
    chain_id = None if isinstance(chain, EmbeddedChain) else chain.chain_id
    head = chain.head if isinstance(chain, EmbeddedChain) else str(chain.blocks([number])[0]["hash"])
    return {"blocks": number, "chain_head": head, "contract": contract, "chain_id": chain_id}


def _open_chain(config: ChainConfig, folder: Path, *, signs: bool) -> tuple[EmbeddedChain | NodeChain, Keyring | None]:
    """The chain, and the keys of this host's members; an embedded chain's have some where they sign."""
    if config.url is None:
        return EmbeddedChain(folder / CHAIN), signing_members() if signs else None
    keyring = Keyring.open(Path(config.keystore)) if config.keystore else Keyring.ephemeral()
    urls = [url.strip() for url in config.url.split(",")]
    root = TrustRoot.of(config.validators or ())
    chain = NodeChain(urls, keyring, chain_id=config.chain_id, root=root, confirmations=config.confirmations)
    return chain, keyring


def members_sign(scenario: Scenario) -> bool:
    """Whether members sign anything but transactions, so that those of an embedded chain need keys, too."""
    return scenario.chain.signs or scenario.payment.enabled


def deciders(scenario: Scenario) -> list[Policy] | list[Rule]:
    """The one of that name or path; or the shipped ones that look at all that this run can show, or nearest to it.

    Policies that look at maps which the run does not have are left out: they were trained for other games.

    Raises:
        UsageError, ModelError: there is no policy and no rule of that name, or it cannot be loaded.
    """
    name = scenario.coordination.policy
    if name != "auto":
        if Policy.is_named(name):
            return [Policy.named(name)]
        return [Rule.named(name, scenario.seed, ["auto", *builtin_policies()])]
    buildings, charging = bool(scenario.obstacles.buildings), scenario.energy.charge_per_minute > 0
    has = map_names(obstacles=buildings, energy=charging, tells_range=True, outlook=True)
    shipped = [Policy.builtin(name) for name in builtin_policies()]
    fitting = [policy for policy in shipped if set(policy.card.maps) <= set(has)]
    most = max(fitting, key=lambda policy: len(policy.card.maps)).card.maps
    return [policy for policy in fitting if policy.card.maps == most]
