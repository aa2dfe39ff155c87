"""What the contract costs: every function of the paper's Table "Implementation Cost" beside ours, and the curves.

Measured on the embedded chain, whose gas is a node's to the unit. Every figure is a transaction's whole gas, with the
21,000 that any transaction pays, and repeats exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyrelay.chain.abi import contract
from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call, Receipt, SentTransaction
from skyrelay.chain.claims import ClaimClient, Part, Share, read_claim
from skyrelay.chain.client import IovClient, ModelCard, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.typed_data import Proposal, sign_proposal
from skyrelay.core.errors import ChainError

PAPER_GAS = {
    "deployment": 2_932_986,
    "registerUAV": 265_964,
    "registerVehicle": 161_646,
    "updateVehicleInfo": 54_002,
    "updateUAVInfo": 67_287,
    "updateUAVZone": 104_492,
    "submitVehSelection": 159_442,
    "resetListsForZone": 116_565,
}
"""Table "Implementation Cost"."""

CURVE = (1, 10, 50, 100, 200, 500, 1000)
"""Proposals in a zone, for the curves of allocateZone."""

BATCHES = (20, 200)
"""Vehicles that sign in one period."""

CLAIMED = (200, 1000)
"""Vehicles in a claimed round."""
_REPLAYED = 60
"""Proposals to one UAV that are replayed to prove it wrong."""

_TIME = 1_700_000_000
_ZONE_UAVS = 20


@dataclass(frozen=True)
class GasRow:
    """One function's cost.

    Attributes:
        function: of the contract.
        case: what was measured.
        gas: of the whole transaction.
        paper: the paper's figure; None where it has none.
    """

    function: str
    case: str
    gas: int
    paper: int | None = None

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's."""
        return None if self.paper is None else self.gas / self.paper


@dataclass(frozen=True)
class CurvePoint:
    """allocateZone over the proposals of a zone.

    Attributes:
        proposals: in the zone.
        spread: gas where they are spread over 20 UAVs, in one piece.
        single: gas where all go to one UAV.
        pieces: gas in all where they are spread and allocated in pieces of at most 60.
        calls: that it takes.
    """

    proposals: int
    spread: int
    single: int
    pieces: int
    calls: int


@dataclass(frozen=True)
class BatchPoint:
    """A period of a zone whose vehicles sign and whose UAVs have served before.

    Attributes:
        vehicles: in one batch, spread over 20 UAVs.
        signed: gas a vehicle for handing their proposals in, positions included.
        allocated: gas a vehicle for allocating the zone.
    """

    vehicles: int
    signed: int
    allocated: int


@dataclass(frozen=True)
class ClaimPoint:
    """A round of a zone that its coordinator claims (OptimisticSelection), from the ninth period on.

    Attributes:
        vehicles: spread over 20 UAVs.
        claimed: gas a vehicle, proposals, positions and allocation included.
        calldata: of that, for the bytes of the transaction alone.
        proved: gas a vehicle where the contract checks everything at once instead.
    """

    vehicles: int
    claimed: int
    calldata: int
    proved: int


@dataclass(frozen=True)
class GasReport:
    """Rows with a figure of the paper first, in its order."""

    rows: tuple[GasRow, ...]
    curve: tuple[CurvePoint, ...]
    batches: tuple[BatchPoint, ...]
    claims: tuple[ClaimPoint, ...]

    def as_json(self) -> dict[str, object]:
        """What ``skyrelay chain gas --json`` prints and ``contracts/gas-snapshot.json`` holds."""
        return {
            "rows": [
                {
                    "function": row.function,
                    "case": row.case,
                    "paper": row.paper,
                    "gas": row.gas,
                    "ratio": None if row.ratio is None else round(row.ratio, 4),
                }
                for row in self.rows
            ],
            "allocate_zone": [
                {
                    "proposals": point.proposals,
                    "gas_20_uavs": point.spread,
                    "gas_1_uav": point.single,
                    "gas_pieces_of_60": point.pieces,
                    "calls": point.calls,
                }
                for point in self.curve
            ],
            "signed": [
                {"vehicles": point.vehicles, "signed_each": point.signed, "allocated_each": point.allocated}
                for point in self.batches
            ],
            "claimed": [
                {
                    "vehicles": point.vehicles,
                    "claimed_each": point.claimed,
                    "calldata_each": point.calldata,
                    "proved_each": point.proved,
                }
                for point in self.claims
            ],
        }


def differences(found: dict[str, object], expected: dict[str, object]) -> list[str]:
    """What two reports (`GasReport.as_json`) do not have in common, a line each."""
    lines: list[str] = []
    for part, names in (
        ("rows", ("function", "case")),
        ("allocate_zone", ("proposals",)),
        ("signed", ("vehicles",)),
        ("claimed", ("vehicles",)),
    ):
        old, new = (
            {tuple(entry[name] for name in names): entry for entry in report[part]}  # type: ignore[attr-defined]
            for report in (expected, found)
        )
        for key in [*old, *(key for key in new if key not in old)]:
            name = f"{part} {' / '.join(map(str, key))}"
            if key not in new:
                lines.append(f"{name}: is no longer measured")
            elif old.get(key) != new[key]:
                lines.append(f"{name}: {old.get(key)} became {new[key]}")
    return lines


def measure(curve: Sequence[int] = CURVE) -> GasReport:
    """Deploy on a fresh embedded chain and use every function.

    Args:
        curve: numbers of proposals, at most 1,000, to measure allocateZone with.
    Raises:
        ContractError: the contract refuses a call that it should take.
    """
    with EmbeddedChain(timestamp=_TIME) as chain:
        session = _Session(chain)
        session.paper_functions()
        session.other_functions()
        points = tuple(session.curve(curve))
        batches = tuple(session.batches(BATCHES))
    rows, claims = _claims(CLAIMED)
    return GasReport((*session.rows, *rows), points, batches, claims)


class _Session:
    """A deployed contract and the rows measured so far."""

    def __init__(self, chain: EmbeddedChain) -> None:
        self.chain = chain
        self.time = _TIME
        self.admin = chain.account("admin")
        self.rows: list[GasRow] = []
        before = chain.block_number
        settings = Settings(rating_step=1.0)
        self.client = IovClient.deploy(chain, settings, self.admin, self._now())
        extension, core = (block.gas_used for block in chain.blocks if block.number > before)
        self._row("deployment", "SkyRelay: what members call", core)
        self.extension_gas = extension
        self.grant = self._run(
            [self.client.grant_role(self.admin, role, self.admin) for role in Role if role is not Role.ADMIN]
        )

    def paper_functions(self) -> None:
        """The functions of the paper's table, in the state that a running system finds them in."""
        client = self.client
        first, *others = [self._uav(f"uav {i}", 1) for i in range(3)]
        self._row("registerUAV", "into a zone with UAVs", others[-1].gas_used)
        vehicles = [self._vehicle(f"vehicle {i}", 1) for i in range(12)]
        self._row("registerVehicle", "", vehicles[-1].gas_used)
        name = self.chain.account
        self._measure(
            "updateVehicleInfo",
            "without a proposal before",
            client.update_vehicle_info(name("vehicle 0"), VehicleRecord(1500.5, 99.5, 350, 1)),
        )
        for case, bandwidth in (("bandwidth as before", 20_000), ("less bandwidth than before", 18_000)):
            record = UavRecord(1501.5, 98.5, 120, bandwidth / 250, bandwidth)
            self._measure("updateUAVInfo", case, client.update_uav_info(name("uav 0"), record))
        self._uav("uav of zone 2", 2)
        for case, uav in (("from within its zone's list", "uav 1"), ("from the end of its zone's list", "uav 2")):
            self._measure("updateUAVZone", case, client.update_uav_zone(name(uav), 2))
        self._submit("vehicle 0", "uav 0", 1)
        receipt = self._submit("vehicle 1", "uav 0", 1)
        self._row("submitVehSelection", "first use of a place in the UAV's list", receipt.gas_used)
        self._run([client.allocate_zone(self.admin, 1, 60)])
        self._measure("resetListsForZone", "", client.reset_lists_for_zone(self.admin, 1))
        self._row("registerUAV", "first of a new zone", first.gas_used)
        self._measure("updateUAVZone", "to a new zone", client.update_uav_zone(name("uav 2"), 3))
        # A UAV's two lists alternate: from the third period on, places are used again.
        for period in (2, 3):
            for vehicle in ("vehicle 0", "vehicle 1"):
                receipt = self._submit(vehicle, "uav 0", 1)
            self._run([client.allocate_zone(self.admin, 1, 60)])
            if period == 2:
                self._run([client.reset_lists_for_zone(self.admin, 1)])
        self._row("submitVehSelection", "from the third period on", receipt.gas_used)
        self._run([client.reset_lists_for_zone(self.admin, 1)])
        moved = VehicleRecord(1501.5, 98.5, 350, 1)
        self._measure(
            "updateVehicleInfo", "after a period with a proposal", client.update_vehicle_info(name("vehicle 0"), moved)
        )
        for vehicle in ("vehicle 0", "vehicle 1"):
            self._submit(vehicle, "uav 0", 1)
        self._run([client.allocate_zone(self.admin, 1, 60)])
        self.rows.sort(key=lambda row: list(PAPER_GAS).index(row.function))

    def other_functions(self) -> None:
        """What the paper leaves out."""
        client, name = self.client, self.chain.account
        self._row("deployment of the extension", "what the consortium calls, and views", self.extension_gas)
        self._row("grantRole", "", self.grant[-1].gas_used)
        for i in range(2, 12):
            self._submit(f"vehicle {i}", "uav 0", 1)
        self._measure("allocateZone", "10 new and 2 held proposals, 1 UAV", client.allocate_zone(self.admin, 1, 60))
        models = []
        for i in range(10):
            cid = bytes.fromhex("01551220") + bytes([i + 1]) * 32
            card = ModelCard(2, 5, 1, 20, 11, 6, 9, -3.0 - i / 10)
            models.append(self._run([client.register_model(self.admin, cid, card)])[0])
        self._row("registerModel", "", models[-1].gas_used)
        self._measure("determineMDRLModel", "of 10 models", client.determine_mdrl_model(self.admin, 1))
        registered = [contract().event(log).args["modelId"] for receipt in models for log in receipt.logs]
        self._measure("retireModel", "the first of 10", client.retire_model(self.admin, registered[0]))
        self._measure("resetUAVSubmission", "", client.reset_uav_submission(name("uav 0"), name("uav 0")))
        selected = next(
            event.args["selected"]
            for event in reversed(client.events(0, self.chain.block_number))
            if event.name == "UAVAllocated"
        )
        rater = next(v for v in (name(f"vehicle {i}") for i in range(12)) if v in {s.lower() for s in selected})
        self._measure("rateUAV", "", client.rate_uav(rater, name("uav 0"), True))
        proposal = next(
            event.args["index"]
            for event in reversed(client.events(0, self.chain.block_number))
            if event.name == "VehSelectionSubmitted" and event.args["vehicle"].lower() == rater
        )
        self._measure("rateVehicle", "", client.rate_vehicle(name("uav 0"), rater, proposal, True))
        ratings = {name(f"vehicle {i}"): 40.0 + i for i in range(10)}
        self._measure("setReputations", "10 members", client.set_reputations(self.admin, ratings))

    def curve(self, numbers: Sequence[int]) -> list[CurvePoint]:
        """What allocateZone costs in a zone of 20 UAVs that all have served before."""
        zone = 9
        uavs = [f"curve uav {i}" for i in range(_ZONE_UAVS)]
        for uav in uavs:
            self._uav(uav, zone)
        largest = max(numbers, default=0)
        vehicles = [f"curve vehicle {i}" for i in range(largest)]
        self._run([self._vehicle_call(vehicle, zone) for vehicle in vehicles])
        points: list[CurvePoint] = []
        for count in (1, 1, *numbers):  # the first two periods fill both of each UAV's lists
            spread = self._allocation(zone, vehicles[: count if points else _ZONE_UAVS], uavs, 10**6)
            pieces = self._allocation(zone, vehicles[: count if points else _ZONE_UAVS], uavs, 60)
            single = self._allocation(zone, vehicles[:count], uavs[:1], 10**6)
            points.append(CurvePoint(count, sum(spread), sum(single), sum(pieces), len(pieces)))
        return points[2:]

    def batches(self, numbers: Sequence[int]) -> list[BatchPoint]:
        """What a vehicle and period cost where proposals are signed, from the third period on."""
        zone, keyring = 11, Keyring(b"gas of signed proposals".ljust(32, b"."))
        uavs = [self.chain.account(f"batch uav {i}") for i in range(_ZONE_UAVS)]
        for i in range(_ZONE_UAVS):
            self._uav(f"batch uav {i}", zone)
        vehicles = [keyring.account(f"vehicle {i}") for i in range(max(numbers))]
        self._run([self.client.register_vehicle(v, VehicleRecord(1400.0, 90.5, 1, 0)) for v in vehicles])
        points = []
        for count in (max(numbers), max(numbers), *numbers):
            proposals = [
                sign_proposal(
                    keyring,
                    vehicle,
                    Proposal(
                        uavs[i % _ZONE_UAVS], zone, self._round(zone), 14_000 + i, 905, 350, 2_500, told.timestamp
                    ),
                    self.client.address,
                    self.chain.chain_id,
                )
                for i, (vehicle, told) in enumerate(
                    zip(vehicles[:count], self.client.vehicle_infos(vehicles[:count]), strict=True)
                )
            ]
            signed = self._run([self.client.submit_signed(self.admin, proposals)])[0]
            allocated = self._run([self.client.allocate_zone(self.admin, zone, 10**6)])[0]
            self._run([self.client.reset_lists_for_zone(self.admin, zone)])
            points.append(BatchPoint(count, signed.gas_used // count, allocated.gas_used // count))
        return points[2:]

    def _allocation(self, zone: int, vehicles: Sequence[str], uavs: Sequence[str], piece: int) -> list[int]:
        """Gas of each call of one whole allocation; a period of its own."""
        round_ = self._round(zone)
        self._run([self._submission(v, uavs[i % len(uavs)], round_, 1000 + i % 2999) for i, v in enumerate(vehicles)])
        gas = []
        while self._round(zone) == round_:
            gas.append(self._run([self.client.allocate_zone(self.admin, zone, piece)])[0].gas_used)
        self._run([self.client.reset_lists_for_zone(self.admin, zone)])
        return gas

    def _round(self, zone: int) -> int:
        info = self.client.zone_info(zone)
        if info is None:
            raise ChainError(f"zone {zone}", None, "a zone that a UAV has entered")
        return info.round

    def _uav(self, name: str, zone: int) -> Receipt:
        record = UavRecord(1500.0 + zone, 100.5, 100, 90.5, 20_000, zone)
        return self._run([self.client.register_uav(self.chain.account(name), record)])[0]

    def _vehicle(self, name: str, zone: int) -> Receipt:
        return self._run([self._vehicle_call(name, zone)])[0]

    def _vehicle_call(self, name: str, zone: int) -> Call:
        number = int(name.rsplit(maxsplit=1)[-1])
        record = VehicleRecord(1400.0 + number / 10, 90.5 - number / 10, 1 + number * 7 % 700, zone)
        return self.client.register_vehicle(self.chain.account(name), record)

    def _submission(self, vehicle: str, uav: str, round_: int, demand: float) -> Call:
        account = self.chain.account
        return self.client.submit_veh_selection(account(vehicle), account(uav), demand, round_)

    def _submit(self, vehicle: str, uav: str, zone: int) -> Receipt:
        round_ = self._round(zone)
        return self._run([self._submission(vehicle, uav, round_, 2500)])[0]

    def _measure(self, function: str, case: str, call: Call) -> None:
        self._row(function, case, self._run([call])[0].gas_used)

    def _row(self, function: str, case: str, gas: int) -> None:
        self.rows.append(GasRow(function, case, gas, PAPER_GAS.get(function)))

    def _run(self, calls: Sequence[Call]) -> list[Receipt]:
        return self.client.execute(calls, self._now())

    def _now(self) -> int:
        self.time += 1
        return self.time


def _claims(numbers: Sequence[int]) -> tuple[list[GasRow], tuple[ClaimPoint, ...]]:
    """What rounds cost that are claimed, and a proof that one is wrong, on a chain of their own."""
    zone, keyring = 1, Keyring(b"gas of claimed proposals".ljust(32, b"."))
    with EmbeddedChain(timestamp=_TIME) as chain:
        admin = chain.account("admin")
        client = IovClient.deploy(chain, Settings(settling=3), admin)
        claims = ClaimClient.deploy(client, admin)
        created = chain.blocks[-2].gas_used
        client.execute([client.grant_role(admin, Role.COORDINATOR, admin)])
        uavs = sorted(chain.account(f"uav {i}") for i in range(_ZONE_UAVS))
        client.execute([client.register_uav(u, UavRecord(1501.0, 100.5, 100, 90.5, 20_000, zone)) for u in uavs])
        vehicles = [keyring.account(f"vehicle {i}") for i in range(max(numbers))]
        client.execute([client.register_vehicle(v, VehicleRecord(1400.0, 90.5, 1, 0)) for v in vehicles])

        def share(uav: str, round_: int, count: int) -> Share:
            """A UAV's, of its next vehicles: the nearest eight are served; of those replayed, one too many."""
            here = [vehicles.pop() for _ in range(count)]
            proposals = [Proposal(uav, zone, round_, 14_000 - i, 905, 350, 2_500, 0) for i in range(count)]
            signed = [
                sign_proposal(keyring, vehicle, one, client.address, chain.chain_id)
                for vehicle, one in zip(here, proposals, strict=True)
            ]
            vehicles[:0] = here
            served = [*range(min(count, 8)), *([count - 1] if count == _REPLAYED else [])]
            return Share(uav, sum(1 << place for place in served), 0, tuple(signed))

        def claim(counts: Sequence[int], *, proven: bool = False) -> tuple[Call, int]:
            info = client.zone_info(zone)
            assert info is not None  # noqa: S101  (UAVs are in it)
            shares = [share(uav, info.round, count) for uav, count in zip(uavs, counts, strict=False)]
            if proven:
                call = claims.prove(admin, zone, info.round, shares)
            else:
                call = claims.claim(admin, zone, info.round, chain.block_number, shares)
            return call, client.execute([call])[0].gas_used

        points = []
        for count in (*[1] * 8, *numbers):  # the first eight fill the places that later periods use again
            counts = [1] if count == 1 else [count // _ZONE_UAVS] * _ZONE_UAVS
            call, gas = claim(counts)
            calldata = sum(16 if byte else 4 for byte in call.data)
            client.execute([client.reset_lists_for_zone(admin, zone)])
            proved = claim(counts, proven=True)[1] if count > 1 else 0
            if proved:
                client.execute([client.reset_lists_for_zone(admin, zone)])
            points.append(ClaimPoint(count, gas // count, calldata // count, proved // count))
        wrong, _ = claim([_REPLAYED])
        events = client.events()
        shown = read_claim(SentTransaction(admin, 0, wrong.to, wrong.data))
        assert shown is not None  # noqa: S101  (it was built above)
        part = Part(uavs[0], (claims.shown(shown, uavs[0], events),))
        info = client.zone_info(zone)
        assert info is not None  # noqa: S101
        proof = client.execute([claims.challenge(admin, zone, info.period, part)])[0].gas_used
    rows = [
        GasRow("deployment of OptimisticSelection", "where claims are wanted", created),
        GasRow("challenge", f"one UAV of {_REPLAYED} proposals", proof),
    ]
    return rows, tuple(points[8:])
