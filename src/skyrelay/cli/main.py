"""The command ``skyrelay``: registers the commands and turns faults into one line and an exit status."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer
from typer.exceptions import TyperException

import skyrelay
from skyrelay.cli import (
    agent,
    audit,
    baseline,
    bound,
    chain_devnet,
    chain_doctor,
    chain_gas,
    chain_serve,
    compare,
    contract,
    evaluate,
    explain,
    live,
    models,
    record,
    report,
    reproduce,
    run,
    scenario,
    select,
    trace,
    train,
    up,
    world,
)
from skyrelay.cli.options import help_alone
from skyrelay.core.errors import SkyRelayError
from skyrelay.core.extras import missing
from skyrelay.pilot.logs import say_as_json

app = typer.Typer(
    name="skyrelay",
    help="UAV relays for connected vehicles: selection on a consortium chain, learned coordination, audit.",
    epilog="Start with: skyrelay run",
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("run")(run.command)
app.command("up")(up.command)
app.command("agent")(agent.command)
app.command("world")(world.command)
app.command("scenario")(scenario.command)
app.command("report")(report.command)
app.command("live")(live.command)
app.command("audit")(audit.command)
app.command("bound")(bound.command)
app.command("deploy")(contract.deploy)
app.command("grant")(contract.grant)
app.command("revoke")(contract.revoke)
app.command("status")(contract.status)
app.command("accounts")(contract.accounts)
app.command("compare")(compare.command)
app.command("explain")(explain.command)
app.command("select")(select.command)
app.command("record")(record.command)
app.command("reproduce")(reproduce.command)
app.command("train")(train.command)
app.command("evaluate")(evaluate.command)
app.command("baseline")(baseline.command)
app.add_typer(models.app, name="models")
app.add_typer(trace.app, name="trace")

chain = typer.Typer(
    help="The contract's chain: a consortium on this machine, and what calls cost.",
    callback=help_alone,
    invoke_without_command=True,
)
chain.command("devnet")(chain_devnet.command)
chain.command("doctor")(chain_doctor.command)
chain.command("serve")(chain_serve.command)
chain.command("gas")(chain_gas.command)
app.add_typer(chain, name="chain")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(skyrelay.__version__)
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001 (its callback has ended the command)
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """UAV relays for connected vehicles: selection on a consortium chain, learned coordination, audit."""
    help_alone(context)


def main() -> None:
    """Entry point: status 0 done, 1 a check found differences, 2 bad input, 130 interrupted."""
    try:
        status = app(prog_name="skyrelay", standalone_mode=False)
    except TyperException as error:
        _stop(error.format_message(), 2)
    except SkyRelayError as error:
        _stop(str(error), error.exit_code)
    except ImportError as error:
        lacking = missing(error.name or "", error)
        if lacking is None:
            raise
        _stop(str(lacking), lacking.exit_code)
    except MemoryError:
        _stop("this machine has not the memory for it: expected fewer vehicles, UAVs, steps or episodes", 2)
    except (KeyboardInterrupt, typer.Abort):
        _stop("interrupted", 130)
    except BrokenPipeError:
        # The reader of a pipe has gone (`| head`): nothing more to say, and nothing to flush at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except OSError as error:
        # A place that may not be written, a full disk: wherever it is, the person at the keyboard can mend it.
        where = f"{error.filename}: " if error.filename is not None else ""
        _stop(f"{where}{error.strerror or error}; expected a place that can be read and written", 2)
    if status == 130:  # what Typer makes of KeyboardInterrupt
        _stop("interrupted", 130)
    sys.exit(status if isinstance(status, int) else 0)


def _stop(message: str, status: int) -> None:
    line = " ".join(message.split())
    if not say_as_json(line):
        typer.echo(f"skyrelay: {line}", err=True)
    sys.exit(status)
