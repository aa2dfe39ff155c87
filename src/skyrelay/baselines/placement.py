"""Placement by particle swarm, as the paper compares with: the UAVs' positions are optimised, not their motion.

The paper extends Hadiwardoyo et al. (2020) to coverage and connectivity and finds that the UAVs are "static once
positioned" and connected at all times: it puts them there before the first step. So does ``placed``; a fair
comparison has them fly there from where they start.

The swarm is our own: of the libraries, only evosax runs inside a compiled program of many games, and it brings
fifteen packages (flax, orbax, tensorstore); pyswarms was last released in 2021; pyswarm and pymoo optimise one game
at a time. `tests/baselines/test_placement.py` holds it against known optima.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from skyrelay.airspace.flight import coverage
from skyrelay.baselines.centroid import connected
from skyrelay.baselines.player import Memory, Player, towards
from skyrelay.coordination import game

INERTIA, PULL = 0.7298, 1.49618
"""Of a swarm that neither explodes nor freezes (Clerc and Kennedy 2002)."""


Swarm = tuple[Array, Array, Array, Array]
"""Places, speeds, the best place of each particle, and its value."""


class Placement(Player):
    """Fly to the placement with the most coverage + connectivity of the vehicles as they are at that moment.

    Attributes:
        period: steps between two placements; 0 places once, at the start.
        placed: put the UAVs at their first placement before the first step.
        particles, iterations: of the swarm.
    """

    placed: bool = eqx.field(default=False, static=True)
    particles: int = eqx.field(default=40, static=True)
    iterations: int = eqx.field(default=60, static=True)

    def begin(self, key: PRNGKeyArray, state: game.State) -> tuple[game.State, Memory]:
        """Find the first placement."""
        memory = self.plan(state, (key, state.uavs))
        return (dataclasses.replace(state, uavs=memory[1]) if self.placed else state), memory

    def plan(self, state: game.State, memory: Memory) -> Memory:
        """Find a placement; the present target is kept unless another is better."""
        key, targets = memory
        key, now = jax.random.split(key)

        def objective(uavs: Float[Array, "uavs 2"]) -> Float[Array, ""]:
            covered = coverage(uavs, state.traffic.position, state.served_by, state.parameters.reach)
            both: Float[Array, ""] = covered + connected(state, uavs)
            return both

        return key, maximise(now, objective, targets, self.particles, self.iterations)

    def act(self, state: game.State, memory: Memory) -> tuple[Int[Array, " uavs"], Memory]:
        """One step towards the placement."""
        return towards(state, memory[1]), memory


def maximise(
    key: PRNGKeyArray,
    objective: Callable[[Float[Array, "*point"]], Float[Array, ""]],
    first: Float[Array, "*point"],
    particles: int,
    iterations: int,
) -> Float[Array, "*point"]:
    """Global-best particle swarm over the unit cube.

    Args:
        objective: of one point; larger is better.
        first: where one particle starts, at rest; the others start anywhere. It is returned if nothing is better.
        particles, iterations: of the swarm.
    Source: Kennedy and Eberhart (1995), with the coefficients of Clerc and Kennedy (2002).
    """
    k_place, k_speed, k_run = jax.random.split(key, 3)
    shape = (particles, *first.shape)
    place = jax.random.uniform(k_place, shape).at[0].set(first)
    speed = jax.random.uniform(k_speed, shape, jnp.float32, -0.25, 0.25).at[0].set(0.0)
    value = jax.vmap(objective)(place)
    along = (particles,) + (1,) * first.ndim

    def fly(swarm: Swarm, key: PRNGKeyArray) -> tuple[Swarm, None]:
        place, speed, best, value = swarm
        own, common = jax.random.uniform(key, (2, *shape))
        leader = best[jnp.argmax(value)]
        speed = INERTIA * speed + PULL * own * (best - place) + PULL * common * (leader - place)
        moved = jnp.clip(place + speed, 0.0, 1.0)
        speed = jnp.where(moved == place + speed, speed, 0.0)  # a particle that meets the border loses its speed there
        found = jax.vmap(objective)(moved)
        better = found > value
        best = jnp.where(better.reshape(along), moved, best)
        return (moved, speed, best, jnp.where(better, found, value)), None

    (_, _, best, value), _ = jax.lax.scan(fly, (place, speed, place, value), jax.random.split(k_run, iterations))
    return best[jnp.argmax(value)]
