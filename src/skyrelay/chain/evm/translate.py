"""Translation of EVM bytecode into Python functions, one trace at a time.

A trace starts where control arrives and follows the code through jumps whose target is known, until one whose target
is not. On the way stack items are Python locals, so that most instructions are one line of Python; what is left of
them goes to the frame's stack where the trace is left. The static gas of a stretch without exits is charged at its
start: should the gas run out in it, the frame would have halted further on, and a halted frame keeps nothing. Where
an instruction looks at the remaining gas (GAS, SSTORE, calls and creations) or control may leave (JUMPI), a new
stretch starts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from skyrelay.chain.evm import calls, opcodes, words
from skyrelay.chain.evm.frame import REVERTED, STOPPED, Halt
from skyrelay.chain.evm.gas import extend

if TYPE_CHECKING:
    from skyrelay.chain.evm.state import Code, Trace

MAX_OPERATIONS = 400
"""Of a trace; one that reaches it ends at the next place where it can."""

SHORT_OPERATIONS = 16

Item = int | str
"""On the translator's stack: a constant, or the name of a local."""

_S = 1 << 255

# opcode: (items taken, static gas, expression with {0} the topmost item)
_EXPRESSIONS: dict[int, tuple[int, int, str]] = {
    0x01: (2, 3, "({0} + {1}) & W"),
    0x02: (2, 5, "({0} * {1}) & W"),
    0x03: (2, 3, "({0} - {1}) & W"),
    0x04: (2, 5, "{0} // {1} if {1} else 0"),
    0x05: (2, 5, "sdiv({0}, {1})"),
    0x06: (2, 5, "{0} % {1} if {1} else 0"),
    0x07: (2, 5, "smod({0}, {1})"),
    0x08: (3, 8, "({0} + {1}) % {2} if {2} else 0"),
    0x09: (3, 8, "({0} * {1}) % {2} if {2} else 0"),
    0x0A: (2, 10, "exp(f, {0}, {1})"),
    0x0B: (2, 5, "sign_extend({0}, {1})"),
    0x10: (2, 3, "{0} < {1}"),
    0x11: (2, 3, "{0} > {1}"),
    0x12: (2, 3, "({0} ^ S) < ({1} ^ S)"),
    0x13: (2, 3, "({0} ^ S) > ({1} ^ S)"),
    0x14: (2, 3, "{0} == {1}"),
    0x15: (1, 3, "not {0}"),
    0x16: (2, 3, "{0} & {1}"),
    0x17: (2, 3, "{0} | {1}"),
    0x18: (2, 3, "{0} ^ {1}"),
    0x19: (1, 3, "W ^ {0}"),
    0x1A: (2, 3, "({1} >> 8 * (31 - {0})) & 255 if {0} < 32 else 0"),
    0x1B: (2, 3, "({1} << {0}) & W if {0} < 256 else 0"),
    0x1C: (2, 3, "{1} >> {0} if {0} < 256 else 0"),
    0x1D: (2, 3, "sar({0}, {1})"),
    0x20: (2, 30, "sha3(f, {0}, {1})"),
    0x30: (0, 2, "f.address"),
    0x31: (1, 0, "balance(f, {0})"),
    0x32: (0, 2, "f.tx.origin"),
    0x33: (0, 2, "f.caller"),
    0x34: (0, 2, "f.value"),
    0x35: (1, 3, "call_data_load(f.data, {0})"),
    0x36: (0, 2, "len(f.data)"),
    0x3A: (0, 2, "f.tx.price"),
    0x3B: (1, 0, "code_size(f, {0})"),
    0x3D: (0, 2, "len(f.returned)"),
    0x3F: (1, 0, "code_hash(f, {0})"),
    0x40: (1, 20, "block_hash(f, {0})"),
    0x41: (0, 2, "f.tx.block.coinbase"),
    0x42: (0, 2, "f.tx.block.timestamp"),
    0x43: (0, 2, "f.tx.block.number"),
    0x44: (0, 2, "f.tx.block.difficulty"),
    0x45: (0, 2, "f.tx.block.gas_limit"),
    0x46: (0, 2, "f.tx.block.chain_id"),
    0x47: (0, 5, "f.tx.state.balances.get(f.address, 0)"),
    0x48: (0, 2, "f.tx.block.base_fee"),
    0x54: (1, 0, "sload(f, {0})"),
    0x59: (0, 2, "len(mem)"),
}

# The same for what looks at the remaining gas.
_GAS_AWARE: dict[int, tuple[int, int, str]] = {
    0x5A: (0, 2, "f.gas"),
    0xF0: (3, 32_000, "create(f, {0}, {1}, {2})"),
    0xF1: (7, 0, "call(f, {0}, {1}, {2}, {3}, {4}, {5}, {6})"),
    0xF2: (7, 0, "call_code(f, {0}, {1}, {2}, {3}, {4}, {5}, {6})"),
    0xF4: (6, 0, "delegate_call(f, {0}, {1}, {2}, {3}, {4}, {5})"),
    0xF5: (4, 32_000, "create(f, {0}, {1}, {2}, {3})"),
    0xFA: (6, 0, "static_call(f, {0}, {1}, {2}, {3}, {4}, {5})"),
}

# The same for what leaves nothing on the stack.
_STATEMENTS: dict[int, tuple[int, int, str]] = {
    0x37: (3, 3, "copy(f, f.data, {0}, {1}, {2})"),
    0x39: (3, 3, "copy(f, f.code.code, {0}, {1}, {2})"),
    0x3C: (4, 0, "code_copy(f, {0}, {1}, {2}, {3})"),
    0x3E: (3, 3, "return_data_copy(f, {0}, {1}, {2})"),
    0xA0: (2, 375, "log(f, {0}, {1}, ())"),
    0xA1: (3, 750, "log(f, {0}, {1}, ({2},))"),
    0xA2: (4, 1125, "log(f, {0}, {1}, ({2}, {3}))"),
    0xA3: (5, 1500, "log(f, {0}, {1}, ({2}, {3}, {4}))"),
    0xA4: (6, 1875, "log(f, {0}, {1}, ({2}, {3}, {4}, {5}))"),
}

# What a trace's source can name.
_NAMES: dict[str, Any] = {
    **{
        function.__name__: function
        for function in (
            *(words.sdiv, words.smod, words.sign_extend, words.sar, words.call_data_load),
            *(opcodes.exp, opcodes.sha3, opcodes.sload, opcodes.sstore, opcodes.log, opcodes.balance),
            *(opcodes.copy, opcodes.code_copy, opcodes.return_data_copy),
            *(opcodes.code_size, opcodes.code_hash, opcodes.block_hash),
            *(calls.call, calls.call_code, calls.delegate_call, calls.static_call, calls.create, calls.self_destruct),
            extend,
        )
    },
    "Halt": Halt,
    "from_bytes": int.from_bytes,
    "W": words.WORD,
    "S": _S,
}


def translate(code: Code, pc: int, *, follow_jumps: bool, short: bool = False) -> Trace:
    """The trace of ``code`` from ``pc``.

    Args:
        follow_jumps: continue through jumps to known places; if not, end at the first jump or place where one may land.
        short: end at the first such place after `SHORT_OPERATIONS`.
    """
    source = _Translator(code, pc, follow_jumps, SHORT_OPERATIONS if short else MAX_OPERATIONS).source()
    names: dict[str, Any] = {
        **_NAMES,
        "destinations": code.jump_destinations,
    }
    exec(compile(source, f"<evm {code.hash:064x} {pc}>", "exec"), names)  # noqa: S102  (built from opcodes, not input)
    trace: Callable[..., int] = names["trace"]
    return trace


class _Translator:
    """Writes one trace."""

    def __init__(self, code: Code, start: int, follow_jumps: bool, longest: int) -> None:
        self.longest = longest
        self.code = code
        self.start = start
        self.follow_jumps = follow_jumps
        self.lines: list[str] = []
        self.items: list[Item] = []
        self.taken = 0  # items of the frame's stack that now are locals or gone
        self.growth = 0  # the most by which the stack is higher than at the start
        self.locals = 0
        self.gas = 0
        self.gas_line = 0

    def source(self) -> str:
        """Python source of the trace."""
        self._new_stretch()
        self._walk()
        self._end_stretch()
        overflow = "return f.code.straight_trace({})(f, stack)" if self.follow_jumps else "raise Halt('stack overflow')"
        head = ["def trace(f, stack):", "    mem = f.mem", "    pop = stack.pop"]
        if self.growth > 0:
            head += [f"    if len(stack) > {1024 - self.growth}:", "        " + overflow.format(self.start)]
        return "\n".join(head + ["    " + line for line in self.lines])

    def _walk(self) -> None:
        code, destinations = self.code.code, self.code.jump_destinations
        pc, operations = self.start, 0
        visited: set[int] = set()
        while True:
            operations += 1
            op = code[pc] if pc < len(code) else 0x00
            if op == 0x5B:
                if operations > 1 and (not self.follow_jumps or pc in visited or operations > self.longest):
                    self._leave(pc)
                    return
                visited.add(pc)
                self.gas += 1
                pc += 1
            elif 0x60 <= op <= 0x7F:
                size = op - 0x5F
                self.gas += 3
                self._push(int.from_bytes(code[pc + 1 : pc + 1 + size].ljust(size, b"\0"), "big"))
                pc += 1 + size
            elif 0x80 <= op <= 0x8F:
                self.gas += 3
                self._need(op - 0x7F)
                self._push(self.items[-(op - 0x7F)])
                pc += 1
            elif 0x90 <= op <= 0x9F:
                self.gas += 3
                depth = op - 0x8F + 1
                self._need(depth)
                self.items[-1], self.items[-depth] = self.items[-depth], self.items[-1]
                pc += 1
            elif op == 0x56:
                self.gas += 8
                target = self._pop()
                if not isinstance(target, int):
                    self._line(f"if {target} not in destinations: raise Halt('bad jump')")
                    self._leave(target)
                    return
                if target not in destinations:
                    self._line("raise Halt('bad jump')")
                    return
                if not self.follow_jumps or target in visited or operations > self.longest:
                    self._leave(target)
                    return
                pc = target
            elif op == 0x57:
                after = self._branch(pc, destinations)
                if after is None or not self.follow_jumps:
                    if after is not None:
                        self._leave(after)
                    return
                pc = after
            elif op == 0x58:
                self.gas += 2
                self._push(pc)
                pc += 1
            elif not self._plain(op):
                return
            else:
                pc += 1

    def _branch(self, pc: int, destinations: frozenset[int]) -> int | None:
        """JUMPI: leave on the rarer side; where the trace goes on, None if nowhere."""
        self.gas += 10
        target, condition = self._pop(), self._pop()
        if not isinstance(target, int):
            self._line(f"if {condition}:")
            self._line(f"    if {target} not in destinations: raise Halt('bad jump')")
            self._leave(target, "    ")
        elif target not in destinations:
            self._line(f"if {condition}: raise Halt('bad jump')")
        elif self.follow_jumps and self._fails(pc + 1):
            self._line(f"if not {condition}:")
            self._leave(pc + 1, "    ")
            self._end_stretch()
            self._new_stretch()
            return target
        else:
            self._line(f"if {condition}:")
            self._leave(target, "    ")
        self._end_stretch()
        self._new_stretch()
        return pc + 1

    def _fails(self, pc: int) -> bool:
        """The code from ``pc`` goes straight to REVERT or INVALID (a failed requirement)."""
        code = self.code.code
        for _ in range(40):
            op = code[pc] if pc < len(code) else 0x00
            if op in (0xFD, 0xFE):
                return True
            if op in (0x00, 0x56, 0x57, 0x5B, 0xF3, 0xFF):
                return False
            pc += op - 0x5E if 0x60 <= op <= 0x7F else 1
        return False

    def _plain(self, op: int) -> bool:
        """Any instruction that is no push, copy, swap or jump; False where the frame ends."""
        if op in _EXPRESSIONS:
            takes, gas, expression = _EXPRESSIONS[op]
            self.gas += gas
            self._assign(self._filled(takes, expression))
        elif op in _STATEMENTS:
            takes, gas, statement = _STATEMENTS[op]
            self.gas += gas
            self._line(self._filled(takes, statement))
        elif op in _GAS_AWARE:
            takes, gas, expression = _GAS_AWARE[op]
            self.gas += gas
            filled = self._filled(takes, expression)
            self._end_stretch()
            self._assign(filled)
            self._new_stretch()
        elif op == 0x55:
            slot, value = self._pop(), self._pop()
            self._end_stretch()
            self._line(f"sstore(f, {slot}, {value})")
            self._new_stretch()
        elif op == 0x50:
            self.gas += 2
            self._pop()
        elif op == 0x51:
            self.gas += 3
            offset, end = self._room(32)
            self._assign(f"from_bytes(mem[{offset}:{end}], 'big')")
        elif op == 0x52:
            self.gas += 3
            offset, end = self._room(32)
            value = self._pop()
            word = repr(value.to_bytes(32, "big")) if isinstance(value, int) else f"{value}.to_bytes(32, 'big')"
            self._line(f"mem[{offset}:{end}] = {word}")
        elif op == 0x53:
            self.gas += 3
            offset, _ = self._room(1)
            self._line(f"mem[{offset}] = {self._pop()} & 255")
        elif op == 0x38:
            self.gas += 2
            self._push(len(self.code.code))
        else:
            self._end(op)
            return False
        return True

    def _end(self, op: int) -> None:
        """What ends the frame."""
        if op == 0x00:
            self._line(f"return {STOPPED}")
        elif op in (0xF3, 0xFD):
            offset, size = self._pop(), self._pop()
            self._line(f"if {size}:")
            self._line(f"    if {offset} + {size} > len(mem): extend(f, {offset} + {size})")
            self._line(f"    f.output = bytes(mem[{offset}:{offset} + {size}])")
            self._line(f"return {STOPPED if op == 0xF3 else REVERTED}")
        elif op == 0xFF:
            self.gas += 5000
            self._line(f"self_destruct(f, {self._pop()})")
            self._line(f"return {STOPPED}")
        else:
            self._line(f"raise Halt('invalid opcode 0x{op:02x}')")

    # The stack

    def _need(self, count: int) -> None:
        while len(self.items) < count:
            name = self._name()
            self._line(f"{name} = pop()")
            self.items.insert(0, name)
            self.taken += 1

    def _pop(self) -> Item:
        self._need(1)
        return self.items.pop()

    def _push(self, item: Item) -> None:
        self.items.append(item)
        self.growth = max(self.growth, len(self.items) - self.taken)

    def _assign(self, expression: str) -> None:
        name = self._name()
        self._line(f"{name} = {expression}")
        self._push(name)

    def _filled(self, takes: int, template: str) -> str:
        return template.format(*[self._pop() for _ in range(takes)])

    def _name(self) -> str:
        self.locals += 1
        return f"x{self.locals}"

    # Lines

    def _line(self, line: str) -> None:
        self.lines.append(line)

    def _room(self, size: int) -> tuple[str, str]:
        """Pop a memory offset and make room behind it; the offset and its end as expressions."""
        offset = self._pop()
        end: Item = offset + size if isinstance(offset, int) else self._name()
        if not isinstance(offset, int):
            self._line(f"{end} = {offset} + {size}")
        self._line(f"if {end} > len(mem): extend(f, {end})")
        return str(offset), str(end)

    def _leave(self, target: Item, indent: str = "") -> None:
        """Hand what is on the stack back and go on elsewhere."""
        if len(self.items) == 1:
            self._line(f"{indent}stack.append({self.items[0]})")
        elif self.items:
            self._line(f"{indent}stack.extend(({', '.join(str(item) for item in self.items)}))")
        self._line(f"{indent}return {target}")

    def _new_stretch(self) -> None:
        self.gas = 0
        self.gas_line = len(self.lines)
        self._line("")

    def _end_stretch(self) -> None:
        if self.gas:
            self.lines[self.gas_line] = f"f.gas -= {self.gas}\n    if f.gas < 0: raise Halt('out of gas')"
        else:
            self.lines[self.gas_line] = "pass"
