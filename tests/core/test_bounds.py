"""Every key of a scenario with values that nobody meant: it validates, or is refused in one line."""

from __future__ import annotations

import types
import typing

import pytest
from pydantic import BaseModel

from skyrelay.core.errors import ScenarioError, SkyRelayError
from skyrelay.core.scenario import MAX_POSITIONS, Scenario, load_scenario, validate
from skyrelay.simulation.world import World

EXTREMES = [
    0,
    -1,
    1,
    1e-300,
    1e18,
    1e308,
    float("nan"),
    float("inf"),
    float("-inf"),
    True,
    False,
    "",
    "x" * 10_000,
    "\x00",
    "/dev/null",
    [],
    [0, 1e308],
    [[]],
    {},
    2**31,
    2**63,
    10**400,
]
SMALL = {
    "mobility": {"source": "random-waypoint", "vehicles": 6, "area": 1500.0},
    "zones": {"columns": 1, "rows": 2},
    "fleet": {"uavs": 3},
    "coordination": {"steps": 2, "period_steps": 1},
    "obstacles": {"buildings": [{"polygon": [[0, 0], [90, 0], [90, 60]], "height": 20}]},
}


def models(annotation):
    """The models inside an annotation, whatever is around them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from models(inner)


def numeric(annotation):
    """Whether a number may stand there, and nothing else but nothing."""
    if typing.get_origin(annotation) in (types.UnionType, typing.Union):
        return all(numeric(kind) for kind in typing.get_args(annotation) if kind is not types.NoneType)
    if typing.get_origin(annotation) is typing.Annotated:
        return numeric(typing.get_args(annotation)[0])
    return annotation in (int, float)


def fields(model=Scenario, path=()):
    """Path and annotation of every key, those of a building behind its place in the list."""
    for name, field in model.model_fields.items():
        yield (*path, name), field.annotation
        for inner in models(field.annotation):
            below = (*path, name) if len(path) == 0 else (*path, name, 0)
            yield from fields(inner, below)


def mutated(path, value):
    """The small scenario with one key replaced."""

    def put(tree, keys):
        head, *rest = keys
        below = tree[head] if isinstance(tree, list) else tree.get(head, {})
        new = put(below, rest) if rest else value
        return [new, *tree[1:]] if isinstance(tree, list) else tree | {head: new}

    return put(SMALL, path)


def refusal(call):
    """The lines of an error of ours; any other is a test's failure."""
    try:
        call()
    except SkyRelayError as fault:
        return str(fault).splitlines()
    return []


FIELDS = dict(fields())
NUMBERS = [path for path, annotation in FIELDS.items() if numeric(annotation)]


def test_the_walk_finds_the_keys():
    assert {("seed",), ("fleet", "range"), ("obstacles", "buildings", 0, "height"), ("chain", "chain_id")} <= set(
        NUMBERS
    )
    assert ("fleet", "bandwidth") in FIELDS
    assert len(FIELDS) > 55


@pytest.mark.parametrize("path", FIELDS, ids=lambda path: ".".join(map(str, path)))
def test_an_extreme_value_validates_or_is_one_line(path):
    for value in EXTREMES:
        lines = refusal(lambda value=value: validate(mutated(path, value), "scenario.toml"))
        assert len(lines) <= 1
        assert all(len(line) < 1000 for line in lines)


@pytest.mark.parametrize("path", NUMBERS, ids=lambda path: ".".join(map(str, path)))
def test_a_number_is_a_finite_number_of_a_sensible_size(path):
    for value in (True, False, "1", [], float("nan"), float("inf"), 1e308, 10**400, -1e18):
        with pytest.raises(ScenarioError):
            validate(mutated(path, value), "scenario.toml")


def test_whole_numbers_may_stand_for_fractions():
    assert validate({"fleet": {"speed": 20, "battery": [10, 90]}}).fleet.battery == (10.0, 90.0)


@pytest.mark.parametrize("path", FIELDS, ids=lambda path: ".".join(map(str, path)))
def test_what_validates_has_a_world(path):
    """The seed's draws, the deployment and the law of flight, for each extreme that passed."""
    for value in EXTREMES:
        try:
            scenario = validate(mutated(path, value), "scenario.toml")
        except ScenarioError:
            continue
        if scenario.chain.url or scenario.fleet.uavs > 1000 or scenario.zones.rows * scenario.zones.columns > 100:
            continue  # no network here, and nothing that takes minutes
        assert len(refusal(lambda scenario=scenario: World.of(scenario))) <= 1


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("mobility.vehicles=999999999999", ["mobility.vehicles", "1000000"]),
        ("selection.max_demand=1e18", ["selection.max_demand", "2147483.647"]),
        ("fleet.range=1e300", ["fleet.range", "1000000"]),
        ("chain.confirmations=false", ["chain.confirmations", "False", "integer"]),
        ("chain.keystore=/dev/null", ["chain", "chain.url beside chain.keystore"]),
        ("coordination.step_seconds=1e-300", ["coordination.step_seconds", "0.01"]),
        ("coordination.step_seconds=1e18", ["coordination.step_seconds", "3600"]),
        ("energy.charge_per_minute=1e308", ["energy.charge_per_minute", "6000"]),
        ("fleet.uavs=40.0", ["fleet.uavs", "integer"]),
    ],
)
def test_what_passed_once(override, parts):
    with pytest.raises(ScenarioError) as fault:
        load_scenario("bologna", [override])
    for part in parts:
        assert part in str(fault.value)


def test_a_run_fits_into_memory_and_its_zones_can_be_counted():
    with pytest.raises(ScenarioError, match=f"{MAX_POSITIONS:,}"):
        validate({"mobility": {"source": "manhattan", "vehicles": 1_000_000}, "coordination": {"steps": 1000}})
    with pytest.raises(ScenarioError, match="10,000 zones"):
        validate({"zones": {"columns": 1000, "rows": 1000}})


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "seed = " + "9" * 5000, "seed = 1" + " " * (17 * 2**20)])
def test_a_hostile_file_is_one_line(tmp_path, text):
    path = tmp_path / "hostile.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=r"hostile\.toml") as fault:
        load_scenario(path)
    assert len(str(fault.value).splitlines()) == 1
