import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from skyrelay.baselines.catalogue import BASELINES, evaluate_baseline
from skyrelay.baselines.cost import centralized_cost, decentralized_cost
from skyrelay.cli import baseline
from skyrelay.coordination.settings import Shape
from skyrelay.core.errors import UsageError
from skyrelay.learning.evaluation import starts, unseen_key
from skyrelay.learning.networks import PAPER
from skyrelay.learning.presets import games_of

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "baselines.md").read_text()


@pytest.fixture
def app():
    app = typer.Typer()
    app.command()(baseline.command)
    return app


def test_the_command_prints_the_evaluation_as_json(app):
    options = ["static", "--uavs", "2", "--vehicles", "4", "--episodes", "6", "--seed", "3", "--json"]
    result = json.loads(CliRunner().invoke(app, options, catch_exceptions=False).stdout)
    assert (result["baseline"], result["episodes"], result["seed"]) == ("static", 6, 3)
    domain, shape = games_of("paper", (2, 2), (4, 4), Shape.n)
    expected = evaluate_baseline("static", 3, starts(unseen_key(3), 6, shape, domain))
    assert {name: result[name] for name in expected} == expected


@pytest.mark.parametrize("options", [["stattic"], ["static", "--uavs", "0"], ["static", "--vehicles", "many"]])
def test_bad_input_is_named(app, options):
    with pytest.raises(UsageError):
        CliRunner().invoke(app, options, catch_exceptions=False)


def test_help_and_page_name_every_baseline(app):
    shown = " ".join(CliRunner().invoke(app, ["--help"], env={"COLUMNS": "300"}).stdout.split())
    for name in BASELINES:
        assert name in shown
        assert f"| `{name}` |" in PAGE


def test_the_page_tells_the_networks_weights():
    costs = [decentralized_cost(PAPER), *(centralized_cost(PAPER, uavs) for uavs in (2, 3, 4, 5))]
    for cost in costs:
        assert f"| {cost.parameters:,} |" in PAGE
        assert f"| {cost.operations / 1e6:.1f} MFLOP |" in PAGE
