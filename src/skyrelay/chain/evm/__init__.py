"""An Ethereum virtual machine with London's rules: exact gas, fast enough to simulate with.

Bytecode is translated to Python, trace by trace, when it is first reached (`translate`); the other files hold what the
translated code works on (`state`, `frame`) and what it calls (`words`, `gas`, `opcodes`, `calls`, `precompiles`). Why
not an existing one: docs/decisions/0020-embedded-chain.md.
"""

from skyrelay.chain.evm.calls import Outcome, contract_address, create_at, query, transact
from skyrelay.chain.evm.gas import INTRINSIC_GAS, intrinsic_gas
from skyrelay.chain.evm.state import BlockContext, Changes, Log, WorldState
from skyrelay.chain.evm.words import WORD

__all__ = [
    "INTRINSIC_GAS",
    "WORD",
    "BlockContext",
    "Changes",
    "Log",
    "Outcome",
    "WorldState",
    "contract_address",
    "create_at",
    "intrinsic_gas",
    "query",
    "transact",
]
