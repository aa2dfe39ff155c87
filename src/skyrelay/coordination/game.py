"""The Markov game of Section "MDRL Approach for UAV Coordination": reset, step.

N UAVs keep their own vehicles in range and the team linked, in a square zone of side 1. Both functions are pure and
play one game; `jax.vmap` plays many. Sizes are compiled in (`Shape`); everything else about a game is an array in its
state (`Parameters`), so that one compiled program plays mixed games.

    shape, domain = Shape(uavs=3, vehicles=20), physical((3, 3), (20, 20))
    state = reset(key, shape, domain.draw(key))
    state, transition = step(state, actions)
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray, UInt

from skyrelay.airspace.charge import at_charger, spend
from skyrelay.airspace.flight import STAY, connectivity, links
from skyrelay.airspace.maps import footprint
from skyrelay.airspace.observation import Observer, Scene
from skyrelay.coordination import dynamics, reward
from skyrelay.coordination.dynamics import Traffic
from skyrelay.coordination.observation import six_maps
from skyrelay.coordination.reward import Score, score
from skyrelay.coordination.settings import Parameters, Shape
from skyrelay.core.errors import UsageError

Tree = TypeVar("Tree")

_DRAWS = 9
"""Uniform numbers that a new vehicle takes. They come from one call: each call of the generator costs compile time."""


class Trace(NamedTuple):
    """Vehicle positions from outside ("replay").

    Attributes:
        position: at each step [zone sides]; what stands there while a vehicle is absent does not matter.
        present: whether each vehicle is there.
    """

    position: Float[Array, "states vehicles 2"]
    present: Bool[Array, "states vehicles"]


class State(eqx.Module):
    """One game between two steps, or many with their axes in front.

    Attributes:
        shape: compiled sizes.
        parameters: the game's numbers.
        uavs: [N, 2] positions [zone sides].
        active: [N] false for a row that holds no UAV, or one that has left.
        traffic: the vehicles.
        owner: [V] row of the UAV that serves each vehicle, also while it is absent.
        present: [V] whether the vehicle is there.
        time: steps played.
        key: of this game's randomness.
        built: [h, h] whether each cell's centre is inside a building; None on open ground.
        charge: [N] of each UAV, from 0 to 1; None in games without energy.
    """

    shape: Shape = eqx.field(static=True)
    parameters: Parameters
    uavs: Float[Array, "*games uavs 2"]
    active: Bool[Array, "*games uavs"]
    traffic: Traffic
    owner: Int[Array, "*games vehicles"]
    present: Bool[Array, "*games vehicles"]
    time: Int[Array, "*games"]
    key: Key[Array, "*games"]
    built: Bool[Array, "*games h h"] | None = None
    charge: Float[Array, "*games uavs"] | None = None

    @property
    def served_by(self) -> Int[Array, "*games vehicles"]:
        """Row of each vehicle's UAV; -1 for a vehicle that is not there."""
        return jnp.where(self.present, self.owner, -1)

    @property
    def flying(self) -> Bool[Array, "*games uavs"]:
        """Whether there is a UAV in the air: one without charge is on the ground, serves nobody and has no link."""
        return self.active if self.charge is None else self.active & (self.charge > 0.0)


class Transition(NamedTuple):
    """What a step returns.

    Attributes:
        observation: levels of the new state; six maps, and those of the options.
        score: reward and measures of the new state.
        truncated: the time limit is reached. The game never ends otherwise: bootstrap through it.
    """

    observation: UInt[Array, "uavs maps n n"]
    score: Score
    truncated: Bool[Array, ""]


def reset(key: PRNGKeyArray, shape: Shape, parameters: Parameters, trace: Trace | None = None) -> State:
    """Begin a game: UAVs anywhere, each vehicle uniformly within the range of its own UAV.

    So every UAV covers its vehicles at the start, and the team need not be connected. With probability ``astray`` a
    vehicle starts anywhere in the zone instead. In a replay the trace says where vehicles are; each is given to a UAV
    in whose range it first appears, or else to the nearest.

    Raises:
        UsageError: the parameters were drawn for other options than the shape's.
    """
    _check_options(shape, parameters)
    k_uavs, k_vehicles, key = jax.random.split(key, 3)
    active = jnp.arange(shape.uavs) < parameters.uavs
    uavs = jax.random.uniform(k_uavs, (shape.uavs, 2))
    draws = jax.random.uniform(k_vehicles, (shape.vehicles, _DRAWS))
    owner, traffic = _appear(draws, uavs, parameters)
    present = jnp.arange(shape.vehicles) < parameters.vehicles
    if trace is not None:
        traffic, present = traffic._replace(position=trace.position[0]), trace.present[0]
        owner = _owners(draws, uavs, active, _first_positions(trace), parameters.reach)
    built = charge = None
    if parameters.walls is not None:
        built = footprint(parameters.walls, shape.n * shape.zoom)
    if parameters.charging is not None:
        least = parameters.charging.least
        charge = least + (1.0 - least) * jax.random.uniform(jax.random.fold_in(k_uavs, 1), (shape.uavs,))
    return State(shape, parameters, uavs, active, traffic, owner, present, jnp.int32(0), key, built, charge)


def step(state: State, actions: Int[Array, " uavs"], trace: Trace | None = None) -> tuple[State, Transition]:
    """All UAVs move, then all vehicles; the reward is of the state that results.

    Args:
        actions: 0 stays, k in 1..8 flies ``uav_step`` towards 2 pi k / 8; a move ends at the zone's border. Compiled
            code cannot refuse others: what they do is undefined (`skyrelay.coordination.pettingzoo` refuses them).
        trace: the vehicles of a replay (the same at every step); None for the synthetic models.

    In games with drop-outs some UAVs leave at the end of the step, and others get their vehicles at once.
    """
    moved = dynamics.move(state.uavs, actions, state.parameters.uav_step)
    uavs = jnp.where(state.flying[:, None], moved, state.uavs)
    time = state.time + 1
    if trace is not None:
        traffic, owner = state.traffic._replace(position=trace.position[time]), state.owner
        present = trace.present[time]
    else:
        traffic, owner = _drive(state)
        present = state.present
    charging = state.parameters.charging
    if state.charge is not None and charging is not None:
        at_point = at_charger(uavs, charging.charger)
        charge = spend(state.charge, actions != STAY, state.charge > 0.0, at_point, charging.cost, full=1.0)
        state = replace(state, charge=charge)
    state = replace(state, uavs=uavs, traffic=traffic, owner=owner, present=present, time=time)
    if state.shape.drop_outs:
        state = _drop_out(state)
    return state, Transition(observe(state), measure(state), time >= state.shape.steps)


def observe(state: State) -> UInt[Array, "uavs maps n n"]:
    """The maps of every UAV, as levels: the six, then those of the options."""
    shape, parameters, charging = state.shape, state.parameters, state.parameters.charging
    scene = Scene(
        uavs=state.uavs,
        vehicles=state.traffic.position,
        owner=state.served_by,
        reach=parameters.reach,
        step=parameters.uav_step,
        airborne=state.flying,
        walls=parameters.walls,
        built=state.built,
    )
    if state.charge is not None and charging is not None:
        flight = state.charge / jnp.maximum(charging.move, 1e-6) * parameters.uav_step
        scene = replace(scene, charger=charging.charger, flight=flight)
    six = six_maps(scene, state.active, shape.n, shape.zoom)
    further = Observer(shape.maps, shape.n, shape.zoom).further(scene)
    if not further:
        return six
    shown = jnp.where(state.active[:, None, None, None], jnp.stack(further, axis=1), 0)
    return jnp.concatenate([six, shown.astype(six.dtype)], axis=1)


def measure(state: State) -> Score:
    """Reward, coverage and connectivity of a state."""
    position, parameters = state.traffic.position, state.parameters
    flying = None if state.charge is None else state.flying
    return score(state.uavs, state.active, position, state.served_by, parameters.reach, parameters.walls, flying)


def linked(state: State, margin: float) -> Float[Array, " uavs"]:
    """1 where links that are ``margin`` steps of a UAV shorter than the range connect all in the air, else 0.

    A UAV on the ground is not connected: 0 for it alone.
    """
    reach = jnp.maximum(state.parameters.reach - margin * state.parameters.uav_step, 0.0)
    whole = connectivity(links(state.uavs, reach, state.flying), state.flying)
    grounded = state.active & ~state.flying
    each: Array = (whole & ~grounded).astype(state.uavs.dtype)
    return each


def potential(state: State) -> Float[Array, " uavs"]:
    """Of each UAV, `skyrelay.coordination.reward.potential` of a state."""
    position, parameters = state.traffic.position, state.parameters
    value = reward.potential(
        state.uavs,
        state.flying,
        position,
        state.served_by,
        parameters.reach,
        parameters.uav_step,
        parameters.walls,
    )
    if state.charge is not None and parameters.charging is not None:
        value += reward.energy_potential(state.uavs, state.charge, parameters.uav_step, parameters.charging)
    return value


def row_where(mask: Bool[Array, " rows"], yes: Tree, no: Tree) -> Tree:
    """Row by row, one tree of arrays or the other; the mask is over their first axis."""

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(mask.reshape(mask.shape + (1,) * (a.ndim - 1)), a, b)

    chosen: Tree = jax.tree.map(choose, yes, no)
    return chosen


def _check_options(shape: Shape, parameters: Parameters) -> None:
    """The sizes of what is compiled and of what was drawn."""
    walls = 0 if parameters.walls is None else parameters.walls.shape[-2]
    if shape.walls != walls:
        raise UsageError("shape.walls", shape.walls, f"{walls}, as in the game's parameters")
    if shape.energy != (parameters.charging is not None):
        raise UsageError("shape.energy", shape.energy, f"{not shape.energy}, as in the game's parameters")


def _drive(state: State) -> tuple[Traffic, Int[Array, " vehicles"]]:
    """Move the vehicles of the synthetic models; in mixed games some leave, and others appear in their rows."""
    shape, parameters, traffic = state.shape, state.parameters, state.traffic
    key = jax.random.fold_in(state.key, state.time)
    if shape.mobility == "manhattan":
        turn_draw, halt_draw = dynamics.fractions(jax.random.bits(key, (shape.vehicles,)))
        halted = dynamics.halting(halt_draw, traffic.halted, parameters.halt, parameters.go)
        return dynamics.manhattan(turn_draw, traffic, parameters.turn, halted), state.owner

    draws = jax.random.uniform(key, (shape.vehicles, 5 + _DRAWS))
    halted = dynamics.halting(draws[:, 0], traffic.halted, parameters.halt, parameters.go)
    waypoint = dynamics.random_waypoint(draws[:, 1:3], traffic, halted)
    if shape.mobility == "random-waypoint":
        return waypoint, state.owner
    grid = dynamics.manhattan(draws[:, 3], traffic, parameters.turn, halted)
    traffic = jax.tree.map(partial(jnp.where, parameters.waypoint), waypoint, grid)
    leaves = draws[:, 4] < parameters.swap
    owner, fresh = _appear(draws[:, 5:], state.uavs, parameters)
    mixed = row_where(leaves, fresh, traffic)
    return mixed, jnp.where(leaves, owner, state.owner)


def _drop_out(state: State) -> State:
    """Some UAVs leave for good, though never the last ones; their vehicles select again (`_owners`)."""
    # Negative: the vehicles' randomness is folded in by the steps themselves.
    k_leave, k_select = jax.random.split(jax.random.fold_in(state.key, -state.time))
    parameters = state.parameters
    kept = state.active & (jax.random.uniform(k_leave, (state.shape.uavs,)) >= parameters.drop_out)
    active = jnp.where(jnp.any(kept), kept, state.active)
    draws = jax.random.uniform(k_select, (state.shape.vehicles, 1))
    again = _owners(draws, state.uavs, active, state.traffic.position, parameters.reach)
    return replace(state, active=active, owner=jnp.where(active[state.owner], state.owner, again))


def _appear(
    draws: Float[Array, "vehicles draws"], uavs: Float[Array, "uavs 2"], parameters: Parameters
) -> tuple[Int[Array, " vehicles"], Traffic]:
    """New vehicles, each with an owner, in its range (uniform in the disc, mirrored at the border) or astray."""
    owner = jnp.minimum((draws[:, 0] * parameters.uavs).astype(jnp.int32), parameters.uavs - 1)
    radius, angle = parameters.reach * jnp.sqrt(draws[:, 1]), 2.0 * jnp.pi * draws[:, 2]
    near = uavs[owner] + radius[:, None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    near = dynamics.mirrored(near)
    # In the long run this share of vehicles stands.
    standing = parameters.halt / jnp.maximum(parameters.halt + parameters.go, 1e-6)
    return owner, Traffic(
        position=jnp.where((draws[:, 3] < parameters.astray)[:, None], draws[:, 1:3], near),
        heading=(draws[:, 4] * 4).astype(jnp.int32),
        target=draws[:, 5:7],
        stride=parameters.slowest + (parameters.fastest - parameters.slowest) * draws[:, 7],
        halted=draws[:, 8] < standing,
    )


def _first_positions(trace: Trace) -> Float[Array, "vehicles 2"]:
    """Where each vehicle of a trace appears first."""
    first = jnp.argmax(trace.present, axis=0)
    return jnp.take_along_axis(trace.position, first[None, :, None], axis=0)[0]


def _owners(draws: Array, uavs: Array, active: Array, position: Array, reach: Array) -> Int[Array, " vehicles"]:
    """For each vehicle one of the UAVs in range at random, or else the nearest."""
    distance = jnp.sqrt(jnp.sum((position[:, None] - uavs[None]) ** 2, -1))
    order = (jnp.arange(uavs.shape[0]) + (draws[:, :1] * uavs.shape[0]).astype(jnp.int32)) % uavs.shape[0]
    lottery = jnp.where(distance <= reach, order / uavs.shape[0], 1.0 + distance)
    return jnp.argmin(jnp.where(active[None], lottery, jnp.inf), axis=1)
