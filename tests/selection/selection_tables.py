"""Vehicles and UAVs for the tests of selection."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from skyrelay.core.entities import UavTable, VehicleTable
from skyrelay.core.scenario import Selection as Settings


def vehicles_at(x, y=None, zone=None, demand=None, payment=None, reputation=None, ids=None):
    x = np.asarray(x, dtype=float)
    count = len(x)

    def column(value, default):
        return np.full(count, default, dtype=float) if value is None else np.asarray(value, dtype=float)

    return VehicleTable(
        ids=tuple(ids) if ids is not None else tuple(f"v{i}" for i in range(count)),
        x=x,
        y=column(y, 0.0),
        zone=np.ones(count, dtype=np.int64) if zone is None else np.asarray(zone, dtype=np.int64),
        demand=column(demand, 2000.0),
        payment=column(payment, 300.0),
        reputation=column(reputation, 50.0),
    )


def uavs_at(x, y=None, zone=None, bandwidth=None, battery=None, reputation=None, ids=None):
    x = np.asarray(x, dtype=float)
    count = len(x)

    def column(value, default):
        return np.full(count, default, dtype=float) if value is None else np.asarray(value, dtype=float)

    return UavTable(
        ids=tuple(ids) if ids is not None else tuple(f"u{i}" for i in range(count)),
        x=x,
        y=column(y, 0.0),
        zone=np.ones(count, dtype=np.int64) if zone is None else np.asarray(zone, dtype=np.int64),
        bandwidth=column(bandwidth, 10000.0),
        battery=column(battery, 80.0),
        reputation=column(reputation, 60.0),
    )


def drawn(seed, vehicles=60, uavs=15, side=6000.0, zones=1, whole=True, equal_demand=None):
    """Tables as the paper draws them; whole numbers of kbit/s unless ``whole`` is false."""
    generator = np.random.default_rng(seed)
    demand = generator.uniform(1000, 4000, vehicles)
    bandwidth = generator.uniform(0, 20000, uavs)
    if whole:
        demand, bandwidth = np.round(demand), np.round(bandwidth)
    if equal_demand is not None:
        demand = np.full(vehicles, float(equal_demand))
    return (
        vehicles_at(
            generator.uniform(0, side, vehicles),
            generator.uniform(0, side, vehicles),
            generator.integers(1, zones + 1, vehicles),
            demand,
            generator.uniform(0, 700, vehicles),
            generator.uniform(1, 100, vehicles),
        ),
        uavs_at(
            generator.uniform(0, side, uavs),
            generator.uniform(0, side, uavs),
            generator.integers(1, zones + 1, uavs),
            bandwidth,
            generator.uniform(1, 100, uavs),
            generator.uniform(1, 100, uavs),
        ),
    )


def _columns(count, values):
    return st.lists(st.sampled_from(values), min_size=count, max_size=count)


@st.composite
def tables(draw, max_vehicles=9, max_uavs=5, demands=(1000, 1500, 2000, 4000)):
    """Small tables of few distinct values, so that equal scores, full UAVs and empty zones are common."""
    v, u = draw(st.integers(0, max_vehicles)), draw(st.integers(0, max_uavs))
    places = (0, 500, 1000, 2999, 3000, 5000)
    return (
        vehicles_at(
            draw(_columns(v, places)),
            draw(_columns(v, places)),
            draw(_columns(v, (1, 1, 2))),
            draw(_columns(v, demands)),
            draw(_columns(v, (0, 350, 700))),
            draw(_columns(v, (0, 40, 100))),
        ),
        uavs_at(
            draw(_columns(u, places)),
            draw(_columns(u, places)),
            draw(_columns(u, (1, 1, 2))),
            draw(_columns(u, (0, 1000, 3500, 4000, 8000))),
            draw(_columns(u, (0, 50, 100))),
            draw(_columns(u, (0, 100))),
        ),
    )


settings_drawn = st.builds(
    Settings,
    candidates=st.sampled_from(("range", "zone")),
    qou_weights=st.sampled_from(((0.25, 0.25, 0.25, 0.25), (0.0, 0.0, 0.0, 1.0), (0.5, 0.2, 0.3, 0.0))),
    qov_weights=st.sampled_from(((0.25, 0.25, 0.25, 0.25), (1.0, 0.0, 0.0, 0.0), (0.0, 0.4, 0.1, 0.5))),
)
