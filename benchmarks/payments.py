"""Gas of each step of a payment, by vehicle, on the embedded chain: a UAV and what it serves, period after period.

python benchmarks/payments.py --vehicles 10
"""

from __future__ import annotations

import argparse
import json

from skyrelay.chain.accounts import Keyring
from skyrelay.chain.chain import Call
from skyrelay.chain.client import IovClient, Role, Settings, UavRecord, VehicleRecord
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.payments import PaymentsClient, price_of
from skyrelay.chain.typed_data import Receipt

PERIODS = 4
"""The storage of the first ones is new; what it costs from then on is the last one's."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, default=10, help="that one UAV serves")
    count = parser.parse_args().vehicles
    keyring = Keyring(bytes(32))
    admin, uav = keyring.account("admin"), keyring.account("uav")
    vehicles = [keyring.account(f"vehicle {number}") for number in range(count)]
    chain = EmbeddedChain()
    relay = IovClient.deploy(chain, Settings(), admin)
    relay.execute([relay.grant_role(admin, Role.COORDINATOR, admin)])
    relay.execute([relay.register_uav(uav, UavRecord(0, 0, 100, 90, 20_000, 1))])
    relay.execute([relay.register_vehicle(vehicle, VehicleRecord(1, 0, 500, 1)) for vehicle in vehicles])
    payments = PaymentsClient.deploy(chain, relay.address, admin, service_seconds=40, window_seconds=60)
    demand = 20_000 // count
    price = price_of(500, demand)

    def gas(calls: list[Call], timestamp: int) -> float:
        receipts = chain.send(calls, timestamp)
        if not all(receipt.status for receipt in receipts):
            raise SystemExit("a call was refused")
        used: int = sum(receipt.gas_used for receipt in receipts)
        return float(round(used / count))

    rows: dict[str, list[float]] = {}

    def note(step: str, used: float) -> None:
        rows.setdefault(step, []).append(used)

    payments.execute([payments.mint(admin, vehicle, 100 * price) for vehicle in vehicles], 1)
    payments.execute([payments.approve(vehicle, 100 * price) for vehicle in vehicles], 1)
    for number in range(PERIODS):
        now = 1 + 40 * number
        note("deposit", gas([payments.deposit(vehicle, vehicle, 3 * price) for vehicle in vehicles], now))
        relay.execute([relay.submit_veh_selection(v, uav, demand, number + 1 + number) for v in vehicles], now)
        relay.execute([relay.allocate_zone(admin, 1, 1000)], now)
        zone = relay.zone_info(1)
        assert zone is not None
        period = zone.period
        note("open", gas([payments.open(uav, count)], now))
        receipts = [Receipt(vehicle, uav, 1, period, price // 2) for vehicle in vehicles]
        if number % 2:  # as a vehicle does that wants its rest sooner
            note("claim", gas([payments.claim(v, uav, 1, period, price // 2) for v in vehicles], now + 30))
        signed = [
            (receipt, keyring.sign_message(receipt.vehicle, receipt.message(payments.address, chain.chain_id)))
            for receipt in receipts
        ]
        note("settle", gas(payments.settle(uav, signed), now + 39))
        note("request a withdrawal", gas([payments.request_withdrawal(v, price) for v in vehicles], now + 39))
        relay.execute([relay.reset_lists_for_zone(admin, 1)], now + 39)
    note("withdraw", gas([payments.withdraw(vehicle) for vehicle in vehicles], 1000))
    print(f"Gas a vehicle, {count} vehicles of one UAV")
    for step, used in rows.items():
        print(f"  {step:<22}{used[0]:>9,.0f} the first time{used[-1]:>9,.0f} from then on")
    print(json.dumps({"vehicles": count, "gas": rows}))


if __name__ == "__main__":
    main()
