"""The contract, typed: builds its calls, executes them, reads its views and its events.

In and out go the units of the rest of the package (m, kbit/s, cents per Mbit/s, 0-100); the contract's integers stay in
here. Methods that change the contract are named after its functions and return a `Call`, so that many can be executed
together (`IovClient.execute`); methods that read answer at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from typing import Any

from skyrelay.chain.abi import ContractError, Event, Function, contract, extension
from skyrelay.chain.chain import DEFAULT_GAS, Answer, Call, Chain, Receipt
from skyrelay.chain.genuine import require_genuine
from skyrelay.chain.typed_data import SignedProposal, Voucher
from skyrelay.core.errors import ChainError
from skyrelay.core.scenario import Selection
from skyrelay.selection.fixed_point import fixed_weights

DECIMETRES = 10
"""Positions and distances of the contract, in one metre."""
HUNDREDTHS = 100
"""Battery and reputation of the contract, in one per cent."""
QOV_UNIT = 1e-15
SCORE_UNIT = 1e-17
DEPLOYMENT_GAS = 8_000_000
SIGNED_GAS = 120_000
"""Gas limit of a signed proposal in a batch: twice what the dearest takes."""
PAGE = 1000
"""UAVs that one question asks a zone's list for."""


class Role(Enum):
    """Who may do more than a member."""

    ADMIN = "DEFAULT_ADMIN_ROLE"
    COORDINATOR = "COORDINATOR_ROLE"
    PUBLISHER = "PUBLISHER_ROLE"
    REPUTATION = "REPUTATION_ROLE"
    REGISTRAR = "REGISTRAR_ROLE"
    SETTLER = "SETTLER_ROLE"


class ProposalStatus(IntEnum):
    """Where a vehicle's latest proposal stands."""

    NONE = 0
    PENDING = 1
    SELECTED = 2
    REJECTED = 3


@dataclass(frozen=True, slots=True)
class Settings:
    """What the contract is deployed with.

    Attributes:
        qou_weights: of bandwidth, battery, reputation, closeness (Eq. 1); to 1e-6, and they sum to 1.
        qov_weights: of demand, payment, reputation, closeness (Eq. 2); likewise.
        max_bandwidth, max_demand: [kbit/s], whole.
        max_payment: [cents per Mbit/s], whole.
        max_distance: [m], to 0.1.
        range_gate: candidates are the zone's UAVs within ``max_distance``; if not, all of the zone.
        initial_reputation: of a new member [0-100], to 0.01.
        rating_step: how far one rating moves a reputation [0-100], to 0.01; 0 switches ratings off.
        observation_side: n that a model must have; 0: any.
        channels, actions: that a model must have.
        admission: members need a registrar's voucher to register (`sign_voucher`).
        stale_after: how long a UAV takes proposals after its last report [s]; 0: for ever.
        allocation_deadline: how long after a round's first proposal anyone may have the zone allocated [s].
        minimum_period: how long a period lasts at the least [s]; 0: as the coordinator likes, and it alone ends one.
        admin_delay: how long a change of the administrator takes at the least [s].
        settling: blocks in which a member's reputation changes once at the most, three times the window in which a
            claim can be questioned; 0: no such rule, and no claims.
    """

    qou_weights: tuple[float, float, float, float] = (0.25, 0.25, 0.25, 0.25)
    qov_weights: tuple[float, float, float, float] = (0.25, 0.25, 0.25, 0.25)
    max_bandwidth: int = 20_000
    max_demand: int = 4_000
    max_payment: int = 700
    max_distance: float = 3000.0
    range_gate: bool = True
    initial_reputation: float = 50.0
    rating_step: float = 0.0
    observation_side: int = 0
    channels: int = 6
    actions: int = 9
    admission: bool = False
    stale_after: int = 3_600
    allocation_deadline: int = 60
    minimum_period: int = 0
    admin_delay: int = 86_400
    settling: int = 0

    @classmethod
    def of(cls, selection: Selection, **others: Any) -> Settings:
        """From a scenario's ``[selection]``; ``others`` are the fields that it does not have."""
        return cls(
            qou_weights=selection.qou_weights,
            qov_weights=selection.qov_weights,
            max_bandwidth=round(selection.max_uav_bandwidth * 1000),
            max_demand=round(selection.max_demand * 1000),
            max_payment=round(selection.max_payment),
            max_distance=selection.max_distance,
            range_gate=selection.candidates == "range",
            **others,
        )


@dataclass(frozen=True, slots=True)
class UavRecord:
    """What a UAV says of itself: position and altitude [m], battery [0-100], bandwidth [kbit/s], zone (0: none)."""

    x: float
    y: float
    altitude: float
    battery: float
    bandwidth: float
    zone: int = 0


@dataclass(frozen=True, slots=True)
class VehicleRecord:
    """What a vehicle says of itself: position [m], payment [cents per Mbit/s], zone."""

    x: float
    y: float
    payment: float
    zone: int


@dataclass(frozen=True, slots=True)
class UavInfo:
    """A UAV as the contract has it: `UavRecord`, reputation [0-100], bandwidth left [kbit/s], time of write [s]."""

    address: str
    x: float
    y: float
    altitude: float
    battery: float
    reputation: float
    bandwidth: int
    available: int
    zone: int
    timestamp: int
    index: int


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """A vehicle as the contract has it: as `VehicleRecord`, and reputation [0-100], time of the last write [s]."""

    address: str
    x: float
    y: float
    payment: int
    reputation: float
    zone: int
    timestamp: int


@dataclass(frozen=True, slots=True)
class ZoneInfo:
    """A zone as the contract has it.

    Attributes:
        waiting: a proposal of the round is not decided.
        suspended: the zone takes no proposals.
        since: time of the round's first proposal, before it of the last allocation or reset [s].
        begun: when the period began [s].
        coordinator: who alone acts on the zone; None: the holders of the role.
        model_id: None where none is assigned.
    """

    zone: int
    period: int
    round: int
    allocating: bool
    waiting: bool
    suspended: bool
    since: int
    begun: int
    coordinator: str | None
    uavs: int
    selected_uavs: int
    selected_vehicles: int
    model_id: str | None


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposal to a UAV: demand [kbit/s], QoV / sqrt(demand)."""

    vehicle: str
    demand: int
    score: float
    status: ProposalStatus


@dataclass(frozen=True, slots=True)
class ModelCard:
    """What a policy was trained for; `score` is its mean greedy return per episode, to 0.001."""

    min_uavs: int
    max_uavs: int
    min_vehicles: int
    max_vehicles: int
    observation_side: int
    channels: int
    actions: int
    score: float


@dataclass(frozen=True, slots=True)
class Model:
    """A registered model; `cid` is the binary CIDv1."""

    model_id: str
    cid: bytes
    card: ModelCard
    owner: str
    retired: bool


class IovClient:
    """The deployed contract.

    Args:
        chain: where it is.
        address: of the contract.
        settings: that it was deployed with.
    """

    def __init__(self, chain: Chain, address: str, settings: Settings) -> None:
        self.chain = chain
        self.address = address
        self.settings = settings
        self._contract = contract()
        self._reader = chain.account("reader")

    @classmethod
    def deploy(cls, chain: Chain, settings: Settings, sender: str, timestamp: int | None = None) -> IovClient:
        """Deploy the contract; ``sender`` becomes its administrator.

        Raises:
            ContractError: the contract refuses the settings.
            ChainError: the chain is out of reach.
        """
        gas = min(DEPLOYMENT_GAS, chain.block_gas_limit)
        parameters = _parameters(settings)
        first = chain.send([Call(sender, None, extension().creation(parameters), gas, "constructor")], timestamp)[0]
        if not first.status or first.created is None:
            raise extension().error("constructor", first.output, first.halt)
        compiled = contract()
        data = compiled.creation(parameters, first.created)
        receipt = chain.send([Call(sender, None, data, gas, "constructor")], timestamp)[0]
        if not receipt.status or receipt.created is None:
            raise compiled.error("constructor", receipt.output, receipt.halt)
        return cls(chain, receipt.created, settings)

    @classmethod
    def connect(cls, chain: Chain, address: str, chain_id: int | None = None) -> IovClient:
        """Use a contract that is deployed.

        Args:
            chain_id: what the chain's id must be; None where any will do.
        Raises:
            ChainError: the chain has another id, or at the address there is no contract or not this one.
        """
        if chain_id is not None and chain.chain_id != chain_id:
            raise ChainError("chain id", chain.chain_id, f"{chain_id}: this is another network")
        address = checked_address(address)
        code = chain.code(address)
        if not code:
            raise ChainError("contract", address, f"a contract's address on chain {chain.chain_id}")
        compiled = contract()
        deployed = [
            e for e in chain.logs(address, 0, chain.block_number) if e.topics[:1] == (compiled.topic("Deployed"),)
        ]
        if len(deployed) != 1:
            told = "the code of this version's SkyRelay contract: another one is there (it has no Deployed event)"
            raise ChainError("contract", address, told)
        arguments = compiled.event(deployed[0]).args
        helper = str(arguments["extension"])
        creation = chain.transaction(deployed[0].block, deployed[0].transaction)
        require_genuine(address, code, helper, chain.code(helper), creation, chain.chain_id)
        return cls(chain, address, _settings(arguments["parameters"]))

    @property
    def parameters(self) -> tuple[Any, ...]:
        """The settings as constructors take them."""
        return _parameters(self.settings)

    # Execution

    def execute(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Receipt]:
        """Have calls mined, all of which must succeed.

        Args:
            timestamp: of the blocks on the embedded chain [s].
        Returns: one receipt a call.
        Raises:
            ContractError: the first call that the contract refused (the others have their effect all the same).
            ChainError: the chain is out of reach.
        """
        receipts = self.chain.send(calls, timestamp)
        for call, receipt in zip(calls, receipts, strict=True):
            if not receipt.status:
                raise self.refusal(call, receipt)
        return receipts

    def refusal(self, call: Call, receipt: Receipt) -> ContractError:
        """Why a call failed, for those who use `Chain.send` and expect some to."""
        return self._contract.error(call.name, receipt.output, receipt.halt)

    # Registration and updates

    def register_uav(self, sender: str, record: UavRecord) -> Call:
        """`registerUAV`: the sender becomes a UAV."""
        return self._call(sender, "registerUAV", *_uav(record), record.zone)

    def register_vehicle(self, sender: str, record: VehicleRecord) -> Call:
        """`registerVehicle`: the sender becomes a vehicle."""
        return self._call(sender, "registerVehicle", *_vehicle(record))

    def update_vehicle_info(self, sender: str, record: VehicleRecord) -> Call:
        """`updateVehicleInfo`: a change of zone withdraws the vehicle's proposal or selection."""
        return self._call(sender, "updateVehicleInfo", *_vehicle(record))

    def update_uav_info(self, sender: str, record: UavRecord) -> Call:
        """`updateUAVInfo`: all but the zone."""
        return self._call(sender, "updateUAVInfo", *_uav(record))

    def update_uav_zone(self, sender: str, zone: int) -> Call:
        """`updateUAVZone` of the sender; zone 0 leaves."""
        return self._call(sender, "updateUAVZone", sender, zone)

    # Selection

    def submit_signed(self, sender: str, proposals: Sequence[SignedProposal]) -> Call:
        """`submitSigned`: hand in what vehicles have signed, for the present round of each UAV's zone; anyone may.

        What the contract would refuse of a vehicle it passes over: events VehSelectionSubmitted tell what was taken.
        """
        batches: dict[str, list[tuple[int, bytes, bytes]]] = {}
        for signed in proposals:
            batches.setdefault(signed.proposal.uav, []).append(signed.packed)
        gas = DEFAULT_GAS + SIGNED_GAS * len(proposals)
        return self._call(sender, "submitSigned", list(batches.items()), gas=gas)

    def submit_veh_selection(self, sender: str, uav: str, demand: float, round_: int) -> Call:
        """`submitVehSelection`: the sender asks ``uav`` for ``demand`` [kbit/s] in this round of its zone."""
        return self._call(sender, "submitVehSelection", uav, round(demand), round_)

    def allocate_zone(self, sender: str, zone: int, max_proposals: int) -> Call:
        """A piece of Algorithm 2 of about so many proposals; the event ZoneAllocated tells that it was the last."""
        return self._call(sender, "allocateZone", zone, max_proposals, gas=self.chain.block_gas_limit // 2)

    def reset_lists_for_zone(self, sender: str, zone: int) -> Call:
        """`resetListsForZone`: the next period of the zone starts."""
        return self._call(sender, "resetListsForZone", zone)

    def reset_uav_submission(self, sender: str, uav: str) -> Call:
        """`resetUAVSubmission`: proposals to and selections by a UAV are void, and it takes none until the next period.

        By the UAV itself, by anyone where it is stale or suspended.
        """
        return self._call(sender, "resetUAVSubmission", uav)

    # Claims

    def reputations_at(self, members: Sequence[str], block: int) -> list[int]:
        """`recordsAt`: reputations [0.01] after a block of no more than `Settings.settling` blocks ago."""
        (records,) = self._read("recordsAt", [(list(members), block)])[0] if members else ([],)
        return [record >> 168 & 0xFFFF for record in records]

    # Models

    def register_model(self, sender: str, cid: bytes, card: ModelCard) -> Call:
        """`registerModel`; the id is in the event ModelRegistered."""
        fields = (
            card.min_uavs,
            card.max_uavs,
            card.min_vehicles,
            card.max_vehicles,
            card.observation_side,
            card.channels,
            card.actions,
            round(card.score * 1000),
        )
        return self._call(sender, "registerModel", cid, fields)

    def retire_model(self, sender: str, model_id: str) -> Call:
        """`retireModel`."""
        return self._call(sender, "retireModel", bytes.fromhex(model_id.removeprefix("0x")))

    def determine_mdrl_model(self, sender: str, zone: int) -> Call:
        """`determineMDRLModel`; the choice is in the event ModelAssigned."""
        return self._call(sender, "determineMDRLModel", zone, gas=3 * DEFAULT_GAS)

    # Admission, roles and reputation

    def admit(self, sender: str, voucher: Voucher) -> Call:
        """`admit`: hand a registrar's voucher in; anyone may."""
        return self._call(sender, "admit", voucher.member, voucher.kind, voucher.expires, voucher.signature)

    def suspend_member(self, sender: str, member: str, suspended: bool = True) -> Call:
        """`suspendMember`: its proposals and selections are void."""
        return self._call(sender, "suspendMember", member, suspended)

    def suspend_zone(self, sender: str, zone: int, suspended: bool = True) -> Call:
        """`suspendZone`: the zone takes no proposals."""
        return self._call(sender, "suspendZone", zone, suspended)

    def set_zone_coordinator(self, sender: str, zone: int, coordinator: str | None) -> Call:
        """`setZoneCoordinator`: who alone acts on the zone; None: the holders of the role again."""
        return self._call(sender, "setZoneCoordinator", zone, coordinator or "0x" + "00" * 20)

    def grant_role(self, sender: str, role: Role, account: str) -> Call:
        """`grantRole`."""
        return self._call(sender, "grantRole", self._role(role), account)

    def revoke_role(self, sender: str, role: Role, account: str) -> Call:
        """`revokeRole`."""
        return self._call(sender, "revokeRole", self._role(role), account)

    def begin_admin_transfer(self, sender: str, successor: str) -> Call:
        """`beginDefaultAdminTransfer`: the successor may accept when the delay is over."""
        return self._call(sender, "beginDefaultAdminTransfer", successor)

    def cancel_admin_transfer(self, sender: str) -> Call:
        """`cancelDefaultAdminTransfer`, while the administrator is still the old one."""
        return self._call(sender, "cancelDefaultAdminTransfer")

    def accept_admin_transfer(self, sender: str) -> Call:
        """`acceptDefaultAdminTransfer`: the sender, announced the delay before, is administrator from now on."""
        return self._call(sender, "acceptDefaultAdminTransfer")

    def set_reputations(self, sender: str, reputations: Mapping[str, float], evidence: bytes = b"") -> Call:
        """`setReputations` of members [0-100].

        Args:
            evidence: the hash of what speaks for it; stands in the transaction behind the arguments.
        """
        values = [round(value * HUNDREDTHS) for value in reputations.values()]
        gas = DEFAULT_GAS + 60_000 * len(values)
        call = self._call(sender, "setReputations", list(reputations), values, gas=gas)
        return replace(call, data=call.data + evidence)

    def rate_uav(self, sender: str, uav: str, good: bool) -> Call:
        """`rateUAV`: the sender rates the UAV that served it in its last finished session."""
        return self._call(sender, "rateUAV", uav, good)

    def rate_vehicle(self, sender: str, vehicle: str, index: int, good: bool) -> Call:
        """`rateVehicle`: the sender rates a vehicle that it served, by the index of its proposal."""
        return self._call(sender, "rateVehicle", vehicle, index, good)

    # Views

    def zone_uavs(self, zone: int) -> list[str]:
        """`getZoneUAV`, page by page: UAVs of a zone, in list order; none of a zone that no UAV ever entered."""
        return self._pages("getZoneUAV", zone)

    def selected_uavs(self, zone: int) -> list[str]:
        """`getSelectedUAVs`: those that serve at least one vehicle in the current period."""
        return self._pages("getSelectedUAVs", zone)

    def zone_info(self, zone: int) -> ZoneInfo | None:
        """`getZoneInfo`; None of a zone that no UAV ever entered."""
        info = self._one_or_none("getZoneInfo", zone)
        if info is None:
            return None
        return ZoneInfo(
            zone,
            info["period"],
            info["round"],
            info["allocating"],
            info["waiting"],
            info["suspended"],
            info["since"],
            info["begun"],
            None if int(info["coordinator"], 16) == 0 else info["coordinator"],
            info["uavs"],
            info["selectedUAVs"],
            info["selectedVehicles"],
            None if int(info["modelId"], 16) == 0 else info["modelId"],
        )

    def uav_infos(self, uavs: Sequence[str]) -> list[UavInfo]:
        """`getUAVInfo` of many at once.

        Raises:
            ContractError: one is no UAV.
        """
        return [
            UavInfo(
                uav,
                info["x"] / DECIMETRES,
                info["y"] / DECIMETRES,
                float(info["altitude"]),
                info["battery"] / HUNDREDTHS,
                info["reputation"] / HUNDREDTHS,
                info["bandwidth"],
                info["available"],
                info["zone"],
                info["timestamp"],
                info["index"],
            )
            for uav, (info,) in zip(uavs, self._read("getUAVInfo", [(uav,) for uav in uavs]), strict=True)
        ]

    def vehicle_info(self, vehicle: str) -> VehicleInfo:
        """`getVehicleInfo`."""
        return self.vehicle_infos([vehicle])[0]

    def vehicle_infos(self, vehicles: Sequence[str]) -> list[VehicleInfo]:
        """`getVehicleInfo` of many at once.

        Raises:
            ContractError: one is no vehicle.
        """
        return [
            VehicleInfo(
                vehicle,
                info["x"] / DECIMETRES,
                info["y"] / DECIMETRES,
                info["payment"],
                info["reputation"] / HUNDREDTHS,
                info["zone"],
                info["timestamp"],
            )
            for vehicle, (info,) in zip(vehicles, self._read("getVehicleInfo", [(v,) for v in vehicles]), strict=True)
        ]

    def proposals(self, uav: str) -> list[Proposal]:
        """`getProposals`: the current period's, by index; a withdrawn one has the status NONE."""
        (found,) = self._read("getProposals", [(uav,)])[0]
        return [_proposal(entry) for entry in found]

    def selections(self, uavs: Sequence[str]) -> dict[str, list[str]]:
        """The vehicles that each UAV serves in the current period, by their proposals' order."""
        answers = self._read("getProposals", [(uav,) for uav in uavs])
        return {
            uav: [entry["vehicle"] for entry in found if entry["status"] == ProposalStatus.SELECTED]
            for uav, (found,) in zip(uavs, answers, strict=True)
        }

    def vehicle_selections(self, vehicles: Sequence[str]) -> list[tuple[ProposalStatus, str, int]]:
        """`getVehicleSelection` of many: where the latest proposal stands, to which UAV, at which index."""
        answers = self._read("getVehicleSelection", [(vehicle,) for vehicle in vehicles])
        return [(ProposalStatus(status), uav, index) for status, uav, index in answers]

    def quality(self, vehicle: str, uav: str, demand: float) -> tuple[float, float]:
        """QoV [0-100] and QoV / sqrt(demand) that a proposal would get now."""
        qov, score = self._read("quality", [(vehicle, uav, round(demand))])[0]
        return qov * QOV_UNIT, score * SCORE_UNIT

    def models(self) -> list[Model]:
        """All registered models, the first registered first."""
        (count,) = self._read("modelCount", [()])[0]
        return [self.model(model_id) for (model_id,) in self._read("modelAt", [(i,) for i in range(count)])]

    def model(self, model_id: str) -> Model:
        """`getModel`.

        Raises:
            ContractError: no model has this id.
        """
        cid, card, owner, retired = self._read("getModel", [(bytes.fromhex(model_id.removeprefix("0x")),)])[0]
        return Model(model_id, bytes.fromhex(cid[2:]), model_card(card), owner, retired)

    def model_of_zone(self, zone: int) -> Model | None:
        """The model assigned to a zone in the current period."""
        info = self.zone_info(zone)
        return None if info is None or info.model_id is None else self.model(info.model_id)

    def has_role(self, role: Role, account: str) -> bool:
        """`hasRole`."""
        (answer,) = self._read("hasRole", [(self._role(role), account)])[0]
        return bool(answer)

    def role_id(self, role: Role) -> str:
        """What events call a role: 0x and 64 digits."""
        return "0x" + self._role(role).hex()

    # Events

    def events(self, from_block: int = 0, to_block: int | None = None) -> list[Event]:
        """All events of the contract in these blocks, both included, in order."""
        last = self.chain.block_number if to_block is None else to_block
        return [self._contract.event(entry) for entry in self.chain.logs(self.address, from_block, last)]

    def events_of(self, receipts: Iterable[Receipt]) -> list[Event]:
        """The contract's events in these receipts, in order."""
        return [
            self._contract.event(entry)
            for receipt in receipts
            for entry in receipt.logs
            if entry.address == self.address
        ]

    # Within

    def _function(self, name: str) -> Function:
        return self._contract.functions[name]

    def _role(self, role: Role) -> bytes:
        (identifier,) = self._read(role.value, [()])[0]
        return bytes.fromhex(identifier[2:])

    def _call(self, sender: str, name: str, *arguments: Any, gas: int = DEFAULT_GAS) -> Call:
        data = self._function(name).encode(*arguments)
        return Call(sender, self.address, data, min(gas, self.chain.block_gas_limit), name)

    def _ask(self, name: str, arguments: Sequence[Sequence[Any]]) -> list[Answer]:
        function = self._function(name)
        return self.chain.query([Call(self._reader, self.address, function.encode(*a), name=name) for a in arguments])

    def _read(self, name: str, arguments: Sequence[Sequence[Any]]) -> list[list[Any]]:
        values = []
        for answer in self._ask(name, arguments):
            if not answer.status:
                raise self._contract.error(name, answer.output, None)
            values.append(self._function(name).decode_output(answer.output))
        return values

    def _pages(self, name: str, zone: int) -> list[str]:
        """What a view says of a zone's list of UAVs, a page at a time."""
        info = self.zone_info(zone)
        found: list[str] = []
        for first in range(0, info.uavs if info is not None else 0, PAGE):
            found += self._read(name, [(zone, first, PAGE)])[0][0]
        return found

    def _one_or_none(self, name: str, zone: int) -> Any:
        """The single value of a zone's view; None where the contract does not know the zone."""
        answer = self._ask(name, [(zone,)])[0]
        if answer.status:
            return self._function(name).decode_output(answer.output)[0]
        error = self._contract.error(name, answer.output, None)
        if error.error == "UnknownZone":
            return None
        raise error


def model_card(card: Mapping[str, Any]) -> ModelCard:
    """A card as the contract's views and events give it."""
    return ModelCard(
        card["minUAVs"],
        card["maxUAVs"],
        card["minVehicles"],
        card["maxVehicles"],
        card["observationSide"],
        card["channels"],
        card["actions"],
        card["score"] / 1000,
    )


def _proposal(entry: Mapping[str, Any]) -> Proposal:
    return Proposal(entry["vehicle"], entry["demand"], entry["score"] * SCORE_UNIT, ProposalStatus(entry["status"]))


def _uav(record: UavRecord) -> tuple[int, ...]:
    return (
        round(record.x * DECIMETRES),
        round(record.y * DECIMETRES),
        round(record.altitude),
        round(record.battery * HUNDREDTHS),
        round(record.bandwidth),
    )


def _vehicle(record: VehicleRecord) -> tuple[int, ...]:
    return round(record.x * DECIMETRES), round(record.y * DECIMETRES), round(record.payment), record.zone


def _parameters(settings: Settings) -> tuple[Any, ...]:
    return (
        fixed_weights(settings.qou_weights),
        fixed_weights(settings.qov_weights),
        settings.max_bandwidth,
        settings.max_demand,
        settings.max_payment,
        round(settings.max_distance * DECIMETRES),
        settings.range_gate,
        round(settings.initial_reputation * HUNDREDTHS),
        round(settings.rating_step * HUNDREDTHS),
        settings.observation_side,
        settings.channels,
        settings.actions,
        settings.admission,
        settings.stale_after,
        settings.allocation_deadline,
        settings.minimum_period,
        settings.admin_delay,
        settings.settling,
    )


def _settings(parameters: Mapping[str, Any]) -> Settings:
    def weights(name: str) -> tuple[float, float, float, float]:
        a, b, c, d = (weight / 1e6 for weight in parameters[name])
        return a, b, c, d

    return Settings(
        qou_weights=weights("qouWeights"),
        qov_weights=weights("qovWeights"),
        max_bandwidth=parameters["maxBandwidth"],
        max_demand=parameters["maxDemand"],
        max_payment=parameters["maxPayment"],
        max_distance=parameters["maxDistance"] / DECIMETRES,
        range_gate=parameters["rangeGate"],
        initial_reputation=parameters["initialReputation"] / HUNDREDTHS,
        rating_step=parameters["ratingStep"] / HUNDREDTHS,
        observation_side=parameters["observationSide"],
        channels=parameters["channels"],
        actions=parameters["actions"],
        admission=parameters["admission"],
        stale_after=parameters["staleAfter"],
        allocation_deadline=parameters["allocationDeadline"],
        minimum_period=parameters["minimumPeriod"],
        admin_delay=parameters["adminDelay"],
        settling=parameters["settling"],
    )


def checked_address(address: str) -> str:
    """An address in lower case.

    Raises:
        ChainError: it is none.
    """
    text = address.lower()
    if len(text) != 42 or not text.startswith("0x") or any(c not in "0123456789abcdef" for c in text[2:]):
        raise ChainError("contract", address, "0x and 40 hexadecimal digits")
    return text
