"""When it is time for what, by the wall's clock: for agents that nobody asks, each goes by the same table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from skyrelay.core.scenario import Scenario
from skyrelay.protocol.messages import RESELECTION, Phase, Tick

SHARES = {Phase.BEACON: 0.4, Phase.DECIDE: 0.4, Phase.LAND: 0.2}
"""Of a step's time, in order."""


@dataclass(frozen=True, slots=True)
class Due:
    """A tick and when it is due.

    Attributes:
        begin, end: the time that it has [s since 1970].
    """

    tick: Tick
    begin: float
    end: float


@dataclass(frozen=True)
class Timetable:
    """A run's ticks: a selection's phases take a slot each, then the period's steps follow.

    Attributes:
        begin: of the run [s since 1970].
        slot: what a phase of the selection has, transactions included [s].
        step: what a step of flight has [s].
        seconds: a step in the world's time [s].
        steps, period_steps, rounds: as the scenario has them.
        dispatch: whether UAVs change zones between two periods.
    """

    begin: float
    slot: float
    step: float
    seconds: float
    steps: int
    period_steps: int
    rounds: int
    dispatch: bool
    reselections: frozenset[int] = frozenset()

    @classmethod
    def of(cls, scenario: Scenario, begin: float, slot: float, step: float) -> Timetable:
        """A scenario's."""
        config = scenario.coordination
        rounds = scenario.selection.rounds
        moves = config.dispatch or bool(scenario.charging or scenario.energy.places)
        return cls(
            begin,
            slot,
            step,
            config.step_seconds,
            config.steps,
            config.period_steps,
            rounds,
            moves,
            scenario.reselections,
        )

    def __iter__(self) -> Iterator[Due]:
        """All ticks, in order, as `skyrelay.simulation.run.Run` has them."""
        begin = self.begin
        for tick, length in self._lengths():
            yield Due(tick, begin, begin + length)
            begin += length

    def _lengths(self) -> Iterator[tuple[Tick, float]]:
        for phase in (Phase.JOIN, Phase.RATE):
            yield Tick(phase), self.slot
        for period, start in enumerate(range(0, self.steps, self.period_steps)):
            for phase, round_ in self._selection():
                yield Tick(phase, period, round_, start, start * self.seconds), self.slot
            for step in range(start, min(start + self.period_steps, self.steps)):
                for phase in RESELECTION if step in self.reselections else ():
                    yield Tick(phase, period, 1, step, step * self.seconds), self.slot
                for phase, share in SHARES.items():
                    at = step + 1 if phase is Phase.LAND else step
                    yield Tick(phase, period, 1, at, at * self.seconds), share * self.step

    def _selection(self) -> Iterator[tuple[Phase, int]]:
        yield from ((phase, 1) for phase in (Phase.CLOSE, Phase.LAND, Phase.REPORT))
        if self.dispatch:
            yield Phase.DISPATCH, 1
        yield Phase.RATE, 1
        for round_ in range(1, self.rounds + 1):
            yield from ((Phase.PROPOSE, round_), (Phase.ALLOCATE, round_))
        yield Phase.DETERMINE, 1
