"""The contract for payments, typed: deposits, agreements of a period, receipts and their settlement.

Amounts are whole numbers of the token's unit: for `Credit`, and for the price of a period, 1e-5 of a currency's unit,
a thousandth of a cent. What each function does stands in `contracts/src/payment/ISkyRelayPayments.sol`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from skyrelay.chain import abi
from skyrelay.chain.abi import Contract, Event
from skyrelay.chain.chain import DEFAULT_GAS, Call, Chain
from skyrelay.chain.client import checked_address
from skyrelay.chain.typed_data import Receipt, compact
from skyrelay.core.errors import ChainError

DEPLOYMENT_GAS = 4_000_000
RECEIPTS_GAS = 60_000
"""Gas limit of one receipt in a settlement, and of one agreement that is opened or closed."""
MAX_RECEIPTS = 200
"""In one transaction."""


def price_of(payment: int, demand: int) -> int:
    """What a full period costs: payment [cents per Mbit/s] times demand [kbit/s], in the token's unit."""
    return payment * demand


@dataclass(frozen=True, slots=True)
class Account:
    """A member's money in the contract.

    Attributes:
        free: can be locked or withdrawn.
        leaving: waits to be withdrawn, from ``leaves_at`` [s] on; can be locked until it is.
    """

    free: int
    leaving: int
    leaves_at: int


@dataclass(frozen=True, slots=True)
class Agreement:
    """Between a vehicle and a UAV for a period of a zone.

    Attributes:
        locked: of the vehicle's deposit; 0 once it is settled.
        claimed: what the vehicle says is due; None where it has said nothing.
        deadline: until when receipts are taken [s].
    """

    vehicle: str
    uav: str
    zone: int
    period: int
    locked: int
    claimed: int | None
    deadline: int


class PaymentsClient:
    """The deployed contract for payments.

    Args:
        chain: where it is.
        address, token: of the contract; of its token.
    """

    def __init__(self, chain: Chain, address: str, token: str) -> None:
        self.chain = chain
        self.address, self.token = address, token
        self._reader = chain.account("reader")

    @classmethod
    def deploy(
        cls,
        chain: Chain,
        relay: str,
        sender: str,
        *,
        service_seconds: int,
        window_seconds: int,
        token: str | None = None,
        timestamp: int | None = None,
    ) -> PaymentsClient:
        """Deploy it beside a SkyRelay contract.

        Args:
            relay: the address of that contract.
            service_seconds: how long a period can last.
            window_seconds: how long a UAV has for its receipts after it, and how long a withdrawal waits.
            token: an ERC-20's address; None: a `Credit` of the sender's.
        Raises:
            ContractError: the contract refuses the terms.
            ChainError: the chain is out of reach.
        """
        money = _created(chain, sender, abi.credit(), (), timestamp) if token is None else checked_address(token)
        terms = (relay, money, service_seconds, window_seconds)
        return cls(chain, _created(chain, sender, abi.payments(), terms, timestamp), money)

    @classmethod
    def connect(cls, chain: Chain, address: str, relay: str) -> PaymentsClient:
        """Use one that is deployed.

        Raises:
            ChainError: there is none at the address, or it settles for another SkyRelay contract.
        """
        address = checked_address(address)
        if not chain.code(address):
            raise ChainError("payments", address, f"a contract's address on chain {chain.chain_id}")
        found = cls(chain, address, "")
        if found._read("RELAY")[0] != relay:
            raise ChainError("payments", address, f"one that settles for the contract {relay}")
        return cls(chain, address, str(found._read("TOKEN")[0]))

    # Calls

    def mint(self, sender: str, account: str, amount: int) -> Call:
        """`Credit.mint`, by its owner."""
        return self._call(abi.credit(), self.token, sender, "mint", account, amount)

    def approve(self, sender: str, amount: int) -> Call:
        """`approve` of the token: what the contract may take from the sender."""
        return self._call(abi.credit(), self.token, sender, "approve", self.address, amount)

    def deposit(self, sender: str, account: str, amount: int) -> Call:
        """`deposit`, of the sender's money, which it has approved."""
        return self._mine(sender, "deposit", account, amount)

    def request_withdrawal(self, sender: str, amount: int) -> Call:
        """`requestWithdrawal`."""
        return self._mine(sender, "requestWithdrawal", amount)

    def withdraw(self, sender: str) -> Call:
        """`withdraw`."""
        return self._mine(sender, "withdraw")

    def open(self, uav: str, vehicles: int) -> Call:
        """`open`, for so many that the UAV has selected."""
        return self._mine(uav, "open", gas=DEFAULT_GAS + vehicles * 2 * RECEIPTS_GAS)

    def settle(self, uav: str, receipts: Sequence[tuple[Receipt, bytes]]) -> list[Call]:
        """`settle`, of a UAV's receipts, each with its vehicle's signature; `MAX_RECEIPTS` to a transaction."""
        words = [(r.vehicle, r.zone, r.period, r.amount, *compact(signature)) for r, signature in receipts]
        pieces = [words[start : start + MAX_RECEIPTS] for start in range(0, len(words), MAX_RECEIPTS)]
        return [self._mine(uav, "settle", piece, gas=DEFAULT_GAS + len(piece) * RECEIPTS_GAS) for piece in pieces]

    def claim(self, vehicle: str, uav: str, zone: int, period: int, amount: int) -> Call:
        """`claim`."""
        return self._mine(vehicle, "claim", uav, zone, period, amount)

    def close(self, sender: str, vehicles: Sequence[str]) -> Call:
        """`close`, by anyone."""
        return self._mine(sender, "close", list(vehicles), gas=DEFAULT_GAS + len(vehicles) * 2 * RECEIPTS_GAS)

    def execute(self, calls: Sequence[Call], timestamp: int | None = None) -> list[Event]:
        """Have calls mined, all of which must succeed.

        Returns: the contract's events of them, in order.
        Raises:
            ContractError: the first call that was refused (the others have their effect all the same).
            ChainError: the chain is out of reach.
        """
        receipts = self.chain.send(calls, timestamp)
        for call, receipt in zip(calls, receipts, strict=True):
            if not receipt.status:
                raise abi.payments().error(call.name, receipt.output, receipt.halt)
        logs = (log for receipt in receipts for log in receipt.logs)
        return [abi.payments().event(log) for log in logs if log.address == self.address]

    # Views and events

    def accounts(self, members: Iterable[str]) -> list[Account]:
        """Of these members, in their order."""
        told = self._ask("accountOf", [(member,) for member in members])
        return [Account(one["free"], one["leaving"], one["leavesAt"]) for (one,) in told]

    def agreements(self, vehicle: str) -> list[Agreement]:
        """The vehicle's agreements that are not settled, two at the most."""
        ((pair,),) = self._ask("agreementsOf", [(vehicle,)])
        return [
            Agreement(
                vehicle,
                one["uav"],
                one["zone"],
                one["period"],
                one["locked"],
                one["claimed"] if one["hasClaimed"] else None,
                one["deadline"],
            )
            for one in pair
            if one["locked"]
        ]

    def balance(self, account: str) -> int:
        """What an account has of the token itself."""
        balance_of = abi.credit().functions["balanceOf"]
        call = Call(self._reader, self.token, balance_of.encode(account), name="balanceOf")
        return int(balance_of.decode_output(self.chain.query([call])[0].output)[0])

    def events(self, from_block: int = 0) -> list[Event]:
        """All events of the contract from a block on, in order."""
        logs = self.chain.logs(self.address, from_block, self.chain.block_number)
        return [abi.payments().event(entry) for entry in logs]

    # Within

    def _mine(self, sender: str, name: str, *arguments: Any, gas: int = DEFAULT_GAS) -> Call:
        return self._call(abi.payments(), self.address, sender, name, *arguments, gas=gas)

    def _call(
        self, compiled: Contract, to: str, sender: str, name: str, *arguments: Any, gas: int = DEFAULT_GAS
    ) -> Call:
        data = compiled.functions[name].encode(*arguments)
        return Call(sender, to, data, min(gas, self.chain.block_gas_limit), name)

    def _read(self, name: str) -> list[Any]:
        return self._ask(name, [()])[0]

    def _ask(self, name: str, arguments: Sequence[Sequence[Any]]) -> list[list[Any]]:
        function = abi.payments().functions[name]
        calls = [Call(self._reader, self.address, function.encode(*given), name=name) for given in arguments]
        answers = self.chain.query(calls)
        for answer in answers:
            if not answer.status:
                raise abi.payments().error(name, answer.output, None)
        return [function.decode_output(answer.output) for answer in answers]


def _created(chain: Chain, sender: str, compiled: Contract, arguments: tuple[Any, ...], timestamp: int | None) -> str:
    gas = min(DEPLOYMENT_GAS, chain.block_gas_limit)
    receipt = chain.send([Call(sender, None, compiled.creation(*arguments), gas, "constructor")], timestamp)[0]
    if not receipt.status or receipt.created is None:
        raise compiled.error("constructor", receipt.output, receipt.halt)
    return receipt.created
