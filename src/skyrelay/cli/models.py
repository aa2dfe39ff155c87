"""``skyrelay models``: add, list, get, verify and pin models by their content address."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.options import Json, help_alone, print_result
from skyrelay.core.errors import SkyRelayError, UsageError
from skyrelay.store.cid import Cid
from skyrelay.store.fallback import FallbackStore, open_store

DEFAULT_STORE = "models"

app = typer.Typer(
    help="Models by content address: a folder of blocks, or a Kubo node of the IPFS network.",
    callback=help_alone,
    invoke_without_command=True,
    rich_markup_mode=None,
)

Stores = Annotated[
    list[str] | None,
    typer.Option(
        "--store",
        metavar="PLACE",
        help="A folder, or http://HOST:PORT of a Kubo RPC endpoint; repeated: asked in this order.",
        show_default=DEFAULT_STORE,
    ),
]
Address = Annotated[str, typer.Argument(metavar="CID", help="The model's address, as `models add` prints it.")]


@app.command()
def add(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Models to keep.")],
    stores: Stores = None,
    as_json: Json = False,
) -> None:
    """Keep models in every store and print their addresses.

    For example:

      skyrelay models add policy.onnx

      skyrelay models add policy.onnx --store models --store http://127.0.0.1:5001
    """
    for file in files:
        if not file.is_file():
            raise UsageError(f"models add {file}", None, "a file that is there")
    store = _open(stores)
    print_result({str(file): str(store.put(file)) for file in files}, as_json)


@app.command("list")
def list_(stores: Stores = None, as_json: Json = False) -> None:
    """List the models that the stores keep, with their lengths in bytes.

    For example: skyrelay models list --store http://127.0.0.1:5001 --json
    """
    found = {str(model.cid): model.size for model in _open(stores).models()}
    if found or as_json:
        print_result(found, as_json)
    else:
        typer.echo("No models here; `skyrelay models add FILE` keeps one.", err=True)


@app.command()
def get(
    cid: Address,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Where the model goes.")],
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is already there.")] = False,
    stores: Stores = None,
    as_json: Json = False,
) -> None:
    """Fetch a model, check that it is what its address names, and only then write it.

    For example: skyrelay models get bafkrei... --out policy.onnx --store models --store http://127.0.0.1:5001
    """
    address = Cid.parse(cid, "models get: CID")
    if out.is_dir() or (out.exists() and not force):
        raise UsageError(f"--out {out}", None, "a file that is not there yet, or --force")
    size = _open(stores).fetch(address, out)
    print_result({"cid": cid, "file": str(out), "bytes": size}, as_json)


@app.command()
def verify(cid: Address, stores: Stores = None, as_json: Json = False) -> None:
    """Read a model from the first store that has it and hash all of it again; nothing is written.

    For example: skyrelay models verify bafkrei... --store http://127.0.0.1:5001
    """
    size = _open(stores).verify(Cid.parse(cid, "models verify: CID"))
    print_result({"cid": cid, "bytes": size, "verified": True}, as_json)


@app.command()
def pin(cid: Address, stores: Stores = None, as_json: Json = False) -> None:
    """Keep a model in the first store, fetching it from that store's network or from the next stores.

    For example: skyrelay models pin bafkrei... --store models --store http://127.0.0.1:5001
    """
    store = _open(stores)
    store.pin(Cid.parse(cid, "models pin: CID"))
    print_result({"cid": cid, "pinned": True}, as_json)


def _open(stores: list[str] | None) -> FallbackStore:
    return FallbackStore([open_store(place) for place in stores or [DEFAULT_STORE]], _warn)


def _warn(refusal: SkyRelayError) -> None:
    typer.echo(f"skyrelay: asked the next store: {refusal}", err=True)
