"""Online selection: the same as selecting anew, and only what changed is touched."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from selection_tables import drawn, settings_drawn, uavs_at, vehicles_at

from skyrelay.core.errors import UsageError
from skyrelay.core.scenario import Selection as Settings
from skyrelay.selection import is_valid, select
from skyrelay.selection.online import Churn, OnlineSelection

PLACES = (0, 500, 1000, 2999, 3000, 5000)


def chosen(table, rows):
    columns = {name: getattr(table, name)[rows] for name in table.__dataclass_fields__ if name != "ids"}
    return type(table)(ids=tuple(table.ids[row] for row in rows), **columns)


def changed(table, rows, **columns):
    """The table with new values in some rows."""
    new = {name: getattr(table, name).copy() for name in table.__dataclass_fields__ if name != "ids"}
    for name, values in columns.items():
        new[name][rows] = values
    return type(table)(ids=table.ids, **new)


@st.composite
def members(draw, make, prefix, least, columns):
    """Any of a dozen members, in any order, with few distinct values."""
    names = draw(st.lists(st.integers(0, 11), unique=True, min_size=least, max_size=9))
    if draw(st.booleans()):
        names.sort()
    values = {
        name: draw(st.lists(st.sampled_from(options), min_size=len(names), max_size=len(names)))
        for name, options in columns.items()
    }
    x = values.pop("x")
    return make(x, ids=[f"{prefix}{name}" for name in names], **values)


vehicles_drawn = members(
    vehicles_at,
    "v",
    0,
    {"x": PLACES, "zone": (1, 1, 2), "demand": (1000, 2000, 4000), "payment": (0, 700), "reputation": (0, 100)},
)
uavs_drawn = members(
    uavs_at,
    "u",
    0,
    {"x": PLACES, "zone": (1, 1, 2), "bandwidth": (0, 3500, 4000), "battery": (0, 50, 100), "reputation": (0, 100)},
)


def incumbents(vehicles, uavs, before):
    """[V] from a mapping of ids."""
    index = {name: number for number, name in enumerate(uavs.ids)}
    return np.array([index.get(before.get(name), -1) for name in vehicles.ids], dtype=np.int64)


def follow(online, periods, rule, rounds, hysteresis):
    """Play periods, each against selecting anew; yields what the online selection says."""
    serving = {}
    for vehicles, uavs in periods:
        period = online.update(vehicles, uavs)
        anew = select(
            vehicles,
            uavs,
            settings=rule,
            rounds=rounds,
            incumbent=incumbents(vehicles, uavs, serving),
            hysteresis=hysteresis,
        )
        np.testing.assert_array_equal(period.assignment, anew.assignment)
        now = {v: uavs.ids[u] for v, u in zip(vehicles.ids, period.assignment.tolist(), strict=True) if u >= 0}
        both = serving.keys() & now.keys()
        assert period.churn.kept == sum(serving[name] == now[name] for name in both)
        assert period.churn.changed == sum(serving[name] != now[name] for name in both)
        assert period.churn.gained == len(now.keys() - serving.keys())
        assert period.churn.lost == len((serving.keys() - now.keys()) & set(vehicles.ids))
        serving = now
        yield period


@given(
    st.lists(st.tuples(vehicles_drawn, uavs_drawn), min_size=2, max_size=4),
    settings_drawn,
    st.sampled_from((1, 2, "full")),
    st.sampled_from((0.0, 6.0)),
)
def test_the_same_as_selecting_anew_whatever_comes_and_goes(periods, rule, rounds, hysteresis):
    for _ in follow(OnlineSelection(rule, rounds, hysteresis), periods, rule, rounds, hysteresis):
        pass


@pytest.mark.parametrize("rounds", [1, "full"])
@pytest.mark.parametrize("hysteresis", [0.0, 4.0])
def test_a_city_of_small_changes_equals_selecting_anew(rounds, hysteresis):
    generator = np.random.default_rng(8)
    rule = Settings()
    vehicles, uavs = drawn(8, vehicles=400, uavs=60, side=9000.0, zones=4)
    periods = []
    for _ in range(8):
        periods.append((vehicles, uavs))
        moving = generator.choice(len(vehicles), 12, replace=False)
        vehicles = changed(vehicles, moving, x=generator.uniform(0, 9000, 12), zone=generator.integers(1, 5, 12))
        vehicles = chosen(vehicles, np.sort(generator.permutation(len(vehicles))[5:]))
        draining = generator.choice(len(uavs), 3, replace=False)
        uavs = changed(uavs, draining, battery=uavs.battery[draining] * 0.7)
        uavs = chosen(uavs, np.sort(generator.permutation(len(uavs))[1:]))
    for number, period in enumerate(
        follow(OnlineSelection(rule, rounds, hysteresis), periods, rule, rounds, hysteresis)
    ):
        assert is_valid(*periods[number], period.assignment, rule)
        if number and rounds == 1:
            assert period.searched < len(periods[number][0]) / 3
            assert 0 < period.allocated < len(periods[number][1])


def test_nothing_changed_touches_nothing():
    for rounds in (1, "full"):
        tables = drawn(2, vehicles=50, uavs=10)
        online = OnlineSelection(rounds=rounds)
        first, again = online.update(*tables), online.update(*tables)
        assert first.searched == 50
        assert (again.searched, again.allocated) == (0, 0)
        served = int((first.assignment >= 0).sum())
        assert first.churn == Churn(arrived=50, left=0, kept=0, changed=0, gained=served, lost=0)
        assert again.churn == Churn(arrived=0, left=0, kept=served, changed=0, gained=0, lost=0)


def test_one_vehicle_that_moved_is_the_only_one_searched():
    vehicles, uavs = drawn(2, vehicles=50, uavs=10)
    online = OnlineSelection()
    online.update(vehicles, uavs)
    period = online.update(changed(vehicles, [7], x=vehicles.x[7] + 1.0), uavs)
    assert period.searched == 1
    assert period.allocated <= 2


def test_zones_without_a_change_are_left_alone_with_many_rounds():
    vehicles, uavs = drawn(4, vehicles=200, uavs=40, zones=5)
    online = OnlineSelection(rounds="full")
    online.update(vehicles, uavs)
    row = int(np.argmax(vehicles.zone == 3))
    period = online.update(changed(vehicles, [row], demand=1500.0), uavs)
    assert period.searched == (vehicles.zone == 3).sum()


def test_hysteresis_trades_quality_for_fewer_handovers():
    vehicles, uavs = drawn(3, vehicles=300, uavs=80, side=6000.0)
    counts = {}
    for hysteresis in (0.0, 3.0, 10.0):
        online = OnlineSelection(hysteresis=hysteresis)
        counts[hysteresis] = 0
        moving = vehicles
        walk = np.random.default_rng(3)
        for _ in range(6):
            counts[hysteresis] += online.update(moving, uavs).churn.changed
            moving = changed(moving, slice(None), x=moving.x + walk.normal(0, 400, len(moving)))
    assert counts[0.0] > counts[3.0] > counts[10.0]


@pytest.mark.parametrize("arguments", [{"rounds": 0}, {"hysteresis": -1.0}, {"hysteresis": float("inf")}])
def test_an_option_that_does_not_fit_is_refused(arguments):
    with pytest.raises(UsageError):
        OnlineSelection(**arguments)


def test_everybody_may_leave():
    vehicles, uavs = drawn(2, vehicles=20, uavs=5)
    for rounds in (1, "full"):
        online = OnlineSelection(rounds=rounds)
        online.update(vehicles, uavs)
        period = online.update(chosen(vehicles, np.arange(0)), chosen(uavs, np.arange(0)))
        assert len(period.assignment) == 0
        assert period.churn.left == 20
