"""``skyrelay deploy``, ``grant``, ``revoke``, ``status``, ``accounts``, ``models retire``: a contract's life on a
consortium's chain.
"""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skyrelay.cli.options import Json, Override, print_result
from skyrelay.core.errors import ChainError, UsageError

if TYPE_CHECKING:
    from skyrelay.chain.accounts import Keyring
    from skyrelay.chain.client import IovClient
    from skyrelay.chain.node.chain import NodeChain


class Grantable(StrEnum):
    """A role that the administrator gives."""

    COORDINATOR = "coordinator"
    PUBLISHER = "publisher"
    REPUTATION = "reputation"
    REGISTRAR = "registrar"


Nodes = Annotated[
    list[str],
    typer.Option("--node", metavar="URL", help="A node's JSON-RPC endpoint; repeated: the next one in reserve."),
]
Keystore = Annotated[
    Path, typer.Option("--keystore", metavar="FILE", help="Encrypted keys of this host's accounts (see `accounts`).")
]
Pinned = Annotated[int, typer.Option("--chain-id", min=1, metavar="N", help="What the chain's id must be.")]
Sealers = Annotated[
    str | None,
    typer.Option("--validators", metavar="ADDRESS,...", help="Who must have sealed the node's blocks."),
]
Confirmations = Annotated[
    int, typer.Option("--confirmations", min=0, help="Blocks above a receipt's before it counts (Clique).")
]
Deployed = Annotated[str, typer.Option("--contract", metavar="ADDRESS", help="The contract.")]
By = Annotated[str, typer.Option("--by", metavar="NAME", help="The administrator's account: its name in the keystore.")]
Zone = Annotated[
    int | None,
    typer.Option("--zone", min=1, metavar="N", help="Of a coordinator: this zone alone, which then has no other."),
]


def deploy(
    node: Nodes,
    keystore: Keystore,
    chain_id: Pinned,
    scenario: Annotated[str, typer.Option(help="Whose [selection] the contract gets.")] = "bologna",
    override: Override = None,
    by: By = "administrator",
    channels: Annotated[int, typer.Option(min=1, max=255, help="Maps that models must have.")] = 6,
    admission: Annotated[bool, typer.Option("--admission", help="Members need a registrar's voucher.")] = False,
    rating_step: Annotated[float, typer.Option(min=0, max=100, help="How far one rating moves; 0: no ratings.")] = 0.0,
    stale_after: Annotated[int, typer.Option(min=0, help="A UAV not heard of for so long takes none [s].")] = 3600,
    allocation_deadline: Annotated[int, typer.Option(min=1, help="Then anyone allocates a zone [s].")] = 60,
    minimum_period: Annotated[int, typer.Option(min=0, help="Shortest period [s]; 0: the coordinator's.")] = 0,
    admin_delay: Annotated[int, typer.Option(min=0, help="Of a change of administrator [s].")] = 86_400,
    validators: Sealers = None,
    confirmations: Confirmations = 0,
    as_json: Json = False,
) -> None:
    """Deploy the contract; the account that does becomes its administrator.

    For example:

      skyrelay deploy --node http://127.0.0.1:8545 --chain-id 1337 --keystore devnet/accounts/operator.json
    """
    from skyrelay.chain.client import IovClient, Settings
    from skyrelay.core.scenario import load_scenario

    chain = _chain(node, keystore, chain_id, validators, confirmations)
    settings = Settings.of(
        load_scenario(scenario, override or ()).selection,
        channels=channels,
        admission=admission,
        rating_step=rating_step,
        stale_after=stale_after,
        allocation_deadline=allocation_deadline,
        minimum_period=minimum_period,
        admin_delay=admin_delay,
    )
    administrator = chain.account(by)
    client = IovClient.deploy(chain, settings, administrator)
    told = {"contract": client.address, "chain_id": chain.chain_id, "administrator": administrator}
    print_result(told, as_json)


def grant(
    role: Annotated[Grantable, typer.Argument(help="What it may then do.")],
    account: Annotated[str, typer.Argument(help="An address, or the name of an account in the keystore.")],
    node: Nodes,
    keystore: Keystore,
    chain_id: Pinned,
    contract: Deployed,
    by: By = "administrator",
    zone: Zone = None,
    validators: Sealers = None,
    confirmations: Confirmations = 0,
    as_json: Json = False,
) -> None:
    """Give an account a role, or a zone a coordinator of its own.

    For example:

      skyrelay grant publisher 0x... --contract 0x... --node http://127.0.0.1:8545 --chain-id 1337 --keystore keys.json

      skyrelay grant coordinator 0x... --zone 3 --contract 0x... --node URL --chain-id 1337 --keystore keys.json
    """
    chain = _chain(node, keystore, chain_id, validators, confirmations)
    _change(True, role, account, _connect(chain, contract, chain_id), chain.account(by), zone, as_json)


def revoke(
    role: Annotated[Grantable, typer.Argument(help="What it may no longer do.")],
    account: Annotated[str, typer.Argument(help="An address, or the name of an account in the keystore.")],
    node: Nodes,
    keystore: Keystore,
    chain_id: Pinned,
    contract: Deployed,
    by: By = "administrator",
    zone: Zone = None,
    validators: Sealers = None,
    confirmations: Confirmations = 0,
    as_json: Json = False,
) -> None:
    """Take a role from an account, or a zone's coordinator from it (then holders of the role act on the zone again).

    For example:

      skyrelay revoke publisher 0x... --contract 0x... --node http://127.0.0.1:8545 --chain-id 1337 --keystore keys.json
    """
    chain = _chain(node, keystore, chain_id, validators, confirmations)
    _change(False, role, account, _connect(chain, contract, chain_id), chain.account(by), zone, as_json)


def retire(
    model: Annotated[str, typer.Argument(metavar="CID|ID", help="The model: its address, or its id on the chain.")],
    node: Nodes,
    keystore: Keystore,
    chain_id: Pinned,
    contract: Deployed,
    by: Annotated[
        str, typer.Option("--by", metavar="NAME", help="The publisher's or the administrator's account.")
    ] = "publisher",
    validators: Sealers = None,
    confirmations: Confirmations = 0,
    as_json: Json = False,
) -> None:
    """Take a model back: it is assigned to no zone any more, and a UAV that reads it refuses it.

    Who has registered a model retires it, or the administrator. It cannot be undone. For example:

      skyrelay models retire bafkrei... --contract 0x... --node URL --chain-id 1337 --keystore keys.json
    """
    from skyrelay.chain.client import Role
    from skyrelay.store.cid import Cid

    wanted = None if model.lower().startswith("0x") else bytes(Cid.parse(model, "models retire: CID"))
    chain = _chain(node, keystore, chain_id, validators, confirmations)
    client = _connect(chain, contract, chain_id)
    sender = chain.account(by)
    found = [one for one in client.models() if one.cid == wanted or one.model_id == model.lower()]
    own = [one for one in found if one.owner == sender]
    if not found:
        raise ChainError("models retire", model, "a model that the contract has and that is not retired")
    if not own and not client.has_role(Role.ADMIN, sender):
        raise ChainError("--by", sender, f"who has registered it ({found[0].owner}), or the contract's administrator")
    chosen = own or found
    if len(chosen) > 1:
        raise ChainError("models retire", model, f"one id: {', '.join(one.model_id for one in chosen)}")
    receipt = client.execute([client.retire_model(sender, chosen[0].model_id)])[0]
    told: dict[str, Any] = {"id": chosen[0].model_id, "owner": chosen[0].owner, "retired": True}
    print_result(told | {"block": receipt.block, "transaction": receipt.hash}, as_json)


def status(
    node: Nodes,
    contract: Deployed,
    chain_id: Annotated[
        int | None, typer.Option("--chain-id", min=1, metavar="N", help="What the chain's id must be.")
    ] = None,
    validators: Sealers = None,
    as_json: Json = False,
) -> None:
    """Say how a contract stands: roles, zones, members, models; nothing is signed and no key is needed.

    For example: skyrelay status --node http://127.0.0.1:8545 --contract 0x...
    """
    from skyrelay.chain.accounts import Keyring
    from skyrelay.chain.status import contract_status
    from skyrelay.store.cid import Cid

    chain = _node(node, Keyring.ephemeral(), chain_id, validators)
    client = _connect(chain, contract, chain_id)
    now = contract_status(client)
    models = [
        {"id": model.model_id, "cid": str(Cid.from_bytes(model.cid, model.model_id)), "retired": model.retired}
        for model in now.models
    ]
    told: dict[str, Any] = {
        "contract": client.address,
        "chain_id": chain.chain_id,
        "block": now.block,
        "roles": {role.name.lower(): list(holders) for role, holders in now.roles.items()},
        "settings": asdict(client.settings),
        "uavs": now.uavs,
        "vehicles": now.vehicles,
        "suspended": list(now.suspended),
        "zones": [asdict(zone) for zone in now.zones],
        "coordinators": now.coordinators,
        "models": models,
    }
    if as_json:
        print_result(told, as_json)
        return
    typer.echo(f"{'contract':<14} {client.address} on chain {chain.chain_id}, at block {now.block}")
    for role, holders in told["roles"].items():
        typer.echo(f"{role:<14} {', '.join(holders) or 'nobody'}")
    typer.echo(f"{'members':<14} {now.uavs} UAVs, {now.vehicles} vehicles, {len(now.suspended)} suspended")
    for zone in now.zones:
        state = "suspended" if zone.suspended else "allocating" if zone.allocating else "open"
        name = f"zone {zone.zone}"
        typer.echo(f"{name:<14} period {zone.period}, {state}, {zone.selected_uavs} of {zone.uavs} UAVs serve")
    for number, coordinator in now.coordinators.items():
        name = f"zone {number}"
        typer.echo(f"{name:<14} coordinator {coordinator}")
    for model in models:
        typer.echo(f"{'model':<14} {model['cid']}{' (retired)' if model['retired'] else ''}")


def accounts(
    keystore: Annotated[Path, typer.Argument(metavar="KEYSTORE", help="The file.")],
    names: Annotated[list[str] | None, typer.Argument(metavar="NAME...", help="Accounts, by any names.")] = None,
    create: Annotated[bool, typer.Option("--create", help="Make the file, with a new secret.")] = False,
    as_json: Json = False,
) -> None:
    """Print the addresses of a keystore's accounts: each name has a key of its own, derived from one secret.

    The password comes from SKYRELAY_KEYSTORE_PASSWORD, or from the file that SKYRELAY_KEYSTORE_PASSWORD_FILE names.

    For example: skyrelay accounts keys.json --create administrator coordinator
    """
    from skyrelay.chain.accounts import Keyring, keystore_password

    ring = Keyring.create(keystore, keystore_password()) if create else Keyring.open(keystore)
    print_result({name: ring.account(name) for name in names or ["administrator"]}, as_json)


def _change(
    granted: bool, role: Grantable, account: str, client: IovClient, sender: str, zone: int | None, as_json: bool
) -> None:
    from skyrelay.chain.client import Role, checked_address
    from skyrelay.chain.status import contract_status

    holder = checked_address(account) if account.lower().startswith("0x") else client.chain.account(account)
    kind = Role[role.name]
    if not client.has_role(Role.ADMIN, sender):
        raise ChainError("--by", sender, "the contract's administrator, which alone gives and takes roles")
    if zone is not None:
        if role is not Grantable.COORDINATOR:
            raise UsageError("--zone", zone, "the role coordinator: no other is given for one zone")
        present = contract_status(client).coordinators.get(zone)
        if not granted and present != holder:
            raise ChainError(f"zone {zone}", present or "without a coordinator of its own", f"{holder}")
        call = client.set_zone_coordinator(sender, zone, holder if granted else None)
    else:
        if not granted and not client.has_role(kind, holder):
            raise ChainError(f"role {role.value}", holder, "an account that has it")
        change = client.grant_role if granted else client.revoke_role
        call = change(sender, kind, holder)
    receipt = client.execute([call])[0]
    told: dict[str, Any] = {"role": role.value, "account": holder}
    told |= {} if zone is None else {"zone": zone}
    print_result(told | {"granted": granted, "block": receipt.block, "transaction": receipt.hash}, as_json)


def _chain(urls: list[str], keystore: Path, chain_id: int, validators: str | None, confirmations: int) -> NodeChain:
    """A chain to sign for; the keystore is opened first, so that a wrong password is told before anyone is asked."""
    from skyrelay.chain.accounts import Keyring

    return _node(urls, Keyring.open(keystore), chain_id, validators, confirmations)


def _node(
    urls: list[str], ring: Keyring, chain_id: int | None, validators: str | None, confirmations: int = 0
) -> NodeChain:
    from skyrelay.chain.node.chain import NodeChain
    from skyrelay.chain.proof.root import TrustRoot

    named = [] if validators is None else [address.strip() for address in validators.split(",")]
    return NodeChain(urls, ring, chain_id=chain_id, root=TrustRoot.of(named), confirmations=confirmations)


def _connect(chain: NodeChain, contract: str, chain_id: int | None) -> IovClient:
    from skyrelay.chain.client import IovClient

    return IovClient.connect(chain, contract, chain_id)
