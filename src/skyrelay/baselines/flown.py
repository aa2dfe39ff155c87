"""The rules of the games fly a run: from what one UAV sees, a game of its own, of which it plays the first row.

A UAV knows where its team is and where its own vehicles are, as a policy does; whom its mates serve it does not know,
nor how vehicles drive: in the rule's game they stand. Each selection begins a new game.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from skyrelay.airspace.sight import Sight
from skyrelay.baselines.catalogue import baseline
from skyrelay.baselines.centroid import Centroid
from skyrelay.baselines.player import Memory, Player
from skyrelay.baselines.recharge import Recharge
from skyrelay.coordination import game
from skyrelay.coordination.dynamics import Traffic
from skyrelay.coordination.energy import Charging
from skyrelay.coordination.settings import Parameters, Shape
from skyrelay.core.entities import FloatArray
from skyrelay.core.errors import ModelError

MOST_UAVS, MOST_VEHICLES = 16, 255
"""Rows of a game; of more, the nearest count."""
LINKED = Centroid(linked=True)
STEPS = 100_000
"""A run has no time limit that a rule should know."""


class FlownPlayer:
    """A player of the games as the rule of every UAV; it remembers for each what it planned.

    Args:
        player: decides for a whole team; a UAV takes what it says of the first row, its own.
        seed: of what it draws.
    """

    def __init__(self, player: Player, seed: int) -> None:
        self._player = player
        self._games: dict[str, tuple[Shape, Memory]] = {}
        self._begun: Counter[str] = Counter()
        self._key = jax.random.key(seed)

    def __call__(self, sight: Sight) -> int:
        """The UAV's action.

        Raises:
            ModelError: the rule is about charging, and there is nowhere to charge.
        """
        player = self._player
        if isinstance(player, Recharge) and sight.law.charger(sight.zone) is None:
            if not sight.law.places:
                raise ModelError(
                    "coordination.policy",
                    "recharge",
                    "charging points: energy.charge_per_minute above 0, energy.places or [[charging]]",
                )
            player = LINKED  # who goes to a place on the ground, and when, is the UAV's own matter (`RECHARGE`)
        known = _known(sight, self._key)
        kept = self._games.get(sight.uav)
        if sight.decisions == 0 or kept is None or kept[0] != known.shape:
            self._begun[sight.uav] += 1
            memory = _begin(player, self._own_key(sight.uav), known)
        else:
            memory = kept[1]
            if player.period and sight.decisions % player.period == 0:
                memory = _plan(player, known, memory)
        action, memory = _act(player, known, memory)
        self._games[sight.uav] = known.shape, memory
        return int(action)

    def _own_key(self, uav: str) -> PRNGKeyArray:
        """Of what one UAV draws in the game that it begins."""
        return jax.random.fold_in(jax.random.fold_in(self._key, zlib.crc32(uav.encode())), self._begun[uav])


def flown(player: Player | type[Player], seed: int) -> FlownPlayer:
    """A player, or the class of one, as a rule."""
    return FlownPlayer(player() if isinstance(player, type) else player, seed)


def _by_name(name: str) -> Callable[[int], FlownPlayer]:
    def with_seed(seed: int) -> FlownPlayer:
        return FlownPlayer(baseline(name), seed)

    return with_seed


random, centroid, centroid_linked, cover, pso, pso_10, planner, recharge = map(
    _by_name, ("random", "centroid", "centroid-linked", "cover", "pso", "pso-10", "planner", "recharge")
)


class Known(NamedTuple):
    """The game that a UAV knows itself in, before it is compiled: NumPy's arrays, by the names of the state's fields.

    A compiled function takes them faster than JAX makes twenty, one by one.
    """

    shape: Shape
    fields: dict[str, Any]

    def state(self) -> game.State:
        """Inside a compiled function, where the arrays are JAX's."""
        return game.State(shape=self.shape, **self.fields)


@eqx.filter_jit
def _begin(player: Player, key: PRNGKeyArray, known: Known) -> Memory:
    return player.begin(key, known.state())[1]


@eqx.filter_jit
def _plan(player: Player, known: Known, memory: Memory) -> Memory:
    return player.plan(known.state(), memory)


@eqx.filter_jit
def _act(player: Player, known: Known, memory: Memory) -> tuple[jax.Array, Memory]:
    actions, memory = player.act(known.state(), memory)
    return actions[0], memory


def _known(sight: Sight, key: PRNGKeyArray) -> Known:
    """The game that a UAV is in as far as it knows: row 0 is itself; the sizes are powers of two, to compile few."""
    law = sight.law
    corner, side = np.array(law.grid.corner(sight.zone)), law.grid.side

    def within(places: Sequence[tuple[float, float]], most: int) -> FloatArray:
        """[rows, 2] in zone sides, the nearest to the UAV where there are too many."""
        points = np.array(places, dtype=np.float64).reshape(-1, 2)
        nearest = np.sort(np.argsort(np.hypot(*(points - sight.own).T), kind="stable")[:most])
        placed: FloatArray = (points[nearest] - corner) / side
        return placed

    team = np.concatenate([within((sight.own,), 1), within(sight.team, MOST_UAVS - 1)])
    vehicles = within(sight.vehicles, MOST_VEHICLES)
    rows, columns = _rows(len(team), MOST_UAVS), _rows(len(vehicles), MOST_VEHICLES)
    # Links are held shorter than the range by what is not known of the mate that was heard least lately.
    reach = max(law.reach - max(sight.margins, default=0.0), 0.0) / side
    charger = law.charger(sight.zone)
    charging = charge = None
    if charger is not None:
        hover, move, gain = (_as(rate / 100.0) for rate in law.cost)
        point, radius = (np.array(charger[:2]) - corner) / side, charger[2] / side
        charging = Charging(hover, move, gain, _as(point), _as(radius), _as(0.0))
        charge = _as(np.ones(rows))
        charge[0] = max(sight.battery - law.energy.reserve, 0.0) / 100.0
    zero, places, count = _as(0.0), _as(_filled(vehicles, columns)), len(vehicles)
    fields = {
        "parameters": Parameters(
            uavs=_as(len(team), np.int32),
            vehicles=_as(count, np.int32),
            reach=_as(reach),
            uav_step=_as(law.stride / side),
            slowest=zero,
            fastest=zero,
            turn=zero,
            halt=zero,
            go=_as(1.0),
            swap=zero,
            astray=zero,
            waypoint=_as(False, np.bool_),
            drop_out=zero,
            charging=charging,
        ),
        "uavs": _as(_filled(team, rows)),
        "active": _as(np.arange(rows) < len(team), np.bool_),
        "traffic": Traffic(
            position=places,
            heading=_as(np.zeros(columns), np.int32),
            target=places,
            stride=_as(np.zeros(columns)),
            halted=_as(np.zeros(columns), np.bool_),
        ),
        "owner": _as(np.zeros(columns), np.int32),
        "present": _as(np.arange(columns) < count, np.bool_),
        "time": _as(sight.decisions, np.int32),
        "key": key,
        "charge": charge,
    }
    return Known(Shape(rows, columns, steps=STEPS, energy=charging is not None), fields)


def _as(value: Any, kind: Any = np.float32) -> Any:
    """A NumPy array where one of JAX's is expected: compiled functions take both."""
    return np.asarray(value, kind)


def _rows(count: int, most: int) -> int:
    """The power of two that holds so many."""
    return min(1 << max(count - 1, 0).bit_length(), most)


def _filled(points: FloatArray, rows: int) -> FloatArray:
    """[rows, 2], what is left over in the middle of the zone."""
    filled = np.full((rows, 2), 0.5)
    filled[: len(points)] = points
    return filled
