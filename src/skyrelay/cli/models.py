"""``skyrelay models``: add, list, get, verify, pin, sign and retire models by their content address."""

from __future__ import annotations

import math
import os
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated

import typer

from skyrelay.cli.contract import retire
from skyrelay.cli.options import Json, help_alone, print_result, span
from skyrelay.core.errors import SkyRelayError, UsageError
from skyrelay.store.cid import PROFILE, Cid, cid_of
from skyrelay.store.fallback import FallbackStore, open_store
from skyrelay.store.model_store import MAX_IN_MEMORY

DEFAULT_STORE = "models"
ASKED = {
    "--name": "of the policy",
    "--uavs": "trained for: 3, or 2-4",
    "--vehicles": "trained for: 20, or 5-20",
    "--ratio": "zone side over range: 2, or 1.5-3",
    "--uav-step": "length of a move [zone sides]: 0.05",
    "--steps": "of a team in training",
    "--limits": "in words: where it should not fly",
}
"""What each part of a card is, for who is asked for it."""

app = typer.Typer(
    help="Models by content address: a folder of blocks, or a Kubo node of the IPFS network.",
    callback=help_alone,
    invoke_without_command=True,
    rich_markup_mode=None,
)

app.command()(retire)

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


@app.command()
def wrap(
    network: Annotated[Path, typer.Argument(metavar="NET.onnx", help="Input [batch, maps, n, n], output [batch, 9].")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Where the policy goes.")],
    name: Annotated[str | None, typer.Option("--name", help="Of the policy.", show_default=False)] = None,
    uavs: Annotated[
        str | None, typer.Option("--uavs", metavar="N|A-B", help="Trained for.", show_default=False)
    ] = None,
    vehicles: Annotated[
        str | None, typer.Option("--vehicles", metavar="N|A-B", help="Trained for.", show_default=False)
    ] = None,
    ratio: Annotated[
        str | None, typer.Option("--ratio", metavar="R|A-B", help="Zone side over range.", show_default=False)
    ] = None,
    uav_step: Annotated[
        str | None, typer.Option("--uav-step", metavar="S|A-B", help="A move [zone sides].", show_default=False)
    ] = None,
    steps: Annotated[
        int | None, typer.Option("--steps", min=1, help="Of a team in training.", show_default=False)
    ] = None,
    limits: Annotated[
        str | None, typer.Option("--limits", help="In words: where it should not fly.", show_default=False)
    ] = None,
    maps: Annotated[
        str, typer.Option("--maps", help="Beside the six: some of obstacles, energy, range, outlook, by comma.")
    ] = "",
    zoom: Annotated[int, typer.Option("--zoom", min=2, max=3, help="Of the full maps over n.")] = 2,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is already there.")] = False,
    as_json: Json = False,
) -> None:
    """Make a policy of a network from elsewhere: put its card in, and try it.

    On a terminal what was left out is asked for; elsewhere all of it is named at once. For example:

      skyrelay models wrap net.onnx --out policy.onnx --name mine --uavs 2-4 --vehicles 5-20 --ratio 2 --uav-step 0.05
      --steps 200000 --limits "open ground"
    """
    from skyrelay.core.files import atomic_path
    from skyrelay.policy.wrap import maps_of, shape_of
    from skyrelay.policy.wrap import wrap as wrapped

    if out.is_dir() or (out.exists() and not force):
        raise UsageError(f"--out {out}", None, "a file that is not there yet, or --force")
    content = _content(network)
    count, _ = shape_of(content, str(network))
    names = maps_of([option.strip() for option in maps.split(",") if option.strip()], count)
    typed = {
        "--name": name,
        "--uavs": uavs,
        "--vehicles": vehicles,
        "--ratio": ratio,
        "--uav-step": uav_step,
        "--steps": None if steps is None else str(steps),
        "--limits": limits,
    }
    told = _asked_for(typed)
    fields = {
        "name": told["--name"],
        "uavs": span("--uavs", told["--uavs"], 65535),
        "vehicles": span("--vehicles", told["--vehicles"], 65535),
        "ratio": _between("--ratio", told["--ratio"]),
        "uav_step": _between("--uav-step", told["--uav-step"]),
        "steps": span("--steps", told["--steps"], 2**53)[0],
        "limits": told["--limits"],
        "maps": names,
        "zoom": zoom,
    }
    policy = wrapped(content, fields, str(network))
    with atomic_path(out) as beside:
        beside.write_bytes(policy)
    print_result({"file": str(out), "bytes": len(policy), "cid": str(cid_of(policy))}, as_json)


def _content(path: Path) -> bytes:
    from skyrelay.policy.runtime import MAX_BYTES

    if not path.is_file():
        raise UsageError(f"models wrap {path}", None, "a file that is there")
    with path.open("rb") as file:
        return file.read(MAX_BYTES + 1)


def _asked_for(typed: dict[str, str | None]) -> dict[str, str]:
    """What was typed, and on a terminal what was left out, once it is asked for.

    Raises:
        UsageError: nobody can be asked; all that is missing is named.
    """
    lacking = [option for option, value in typed.items() if value is None]
    if lacking and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise UsageError("models wrap", f"without {', '.join(lacking)}", "what the card has to say")
    return {
        option: value if value is not None else typer.prompt(f"{option} ({ASKED[option]})", err=True)
        for option, value in typed.items()
    }


def _between(option: str, text: str) -> tuple[float, float]:
    """Two numbers from ``"2"`` or ``"1.5-3"``."""
    low, dash, high = text.partition("-")
    try:
        bounds = float(low), float(high) if dash else float(low)
    except ValueError:
        bounds = (0.0, 0.0)
    if not 0.0 < bounds[0] <= bounds[1] < math.inf:
        raise UsageError(option, text, "a number above 0, or a range such as 1.5-3")
    return bounds


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
def verify(
    model: Annotated[str, typer.Argument(metavar="CID|FILE", help="A model's address, or a file.")],
    keys: Annotated[
        list[Path] | None,
        typer.Option("--key", metavar="PUBLIC", help="Whose signature it must have; repeated: any of these."),
    ] = None,
    stores: Stores = None,
    as_json: Json = False,
) -> None:
    """Check a model: hash all of it again by its address; with --key its signature, its attestation and its time.

    Of a file nothing is asked of any store or network, nor is anything where the stores are folders.

    For example:

      skyrelay models verify bafkrei... --store http://127.0.0.1:5001

      skyrelay models verify signed.onnx --key key.pem.pub
    """
    from skyrelay.policy.signature import public_key
    from skyrelay.policy.signature import verify as verify_signature

    trusted = [public_key(path) for path in keys or ()]
    file = Path(model)
    if file.is_file():
        if not trusted:
            raise UsageError(f"models verify {model}", None, "--key PUBLIC: a file says nothing of itself without")
        content = _read(file)
    else:
        address = Cid.parse(model, "models verify: CID")
        store = _open(stores)
        content = store.get(address) if trusted else b""
        told = {"cid": model, "bytes": len(content) if trusted else store.verify(address), "verified": True}
    if file.is_file():
        told = {"file": model, "cid": str(cid_of(content)), "bytes": len(content), "verified": True}
    told["profile"] = PROFILE
    if trusted:
        attested = verify_signature(content, trusted, datetime.now(UTC), model)
        told |= {"key": attested.key, "issued": attested.issued.isoformat(), "expires": attested.expires.isoformat()}
        told["provenance"] = dict(attested.provenance)
    print_result(told, as_json)


@app.command()
def key(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Of the private key; FILE.pub gets the public one.")],
    as_json: Json = False,
) -> None:
    """Make a key to sign models with: P-256, encrypted by the password in SKYRELAY_KEYSTORE_PASSWORD (or _FILE).

    For example: skyrelay models key key.pem
    """
    from skyrelay.chain.accounts import keystore_password
    from skyrelay.policy.signature import key_id, new_key, public_key

    public = new_key(file, keystore_password())
    print_result({"private": str(file), "public": str(public), "key": key_id(public_key(public))}, as_json)


@app.command()
def sign(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A policy.")],
    key: Annotated[Path, typer.Option("--key", metavar="PRIVATE", help="As `models key` makes it.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Where the signed policy goes.")],
    days: Annotated[float, typer.Option("--days", min=0.001, max=3660, help="How long it may be flown.")] = 365.0,
    commit: Annotated[
        str | None, typer.Option("--commit", help="Of the code that trained it.", show_default="not stated")
    ] = None,
    bundle: Annotated[
        Path | None,
        typer.Option("--bundle", metavar="FILE", help="Write OpenSSF's bundle of the unsigned file too."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that are already there.")] = False,
    as_json: Json = False,
) -> None:
    """Sign a policy and say what made it: commit, and from its card command, seeds, versions and evaluation.

    The signature lies inside the file, which any reader of ONNX still reads; sign before `models add`.

    For example: skyrelay models sign policy.onnx --key key.pem --days 90 --commit 1f2e3d4 --out signed.onnx
    """
    from skyrelay.chain.accounts import PASSWORD, PASSWORD_FILE, keystore_password
    from skyrelay.core.files import write_bytes, write_text
    from skyrelay.policy import Policy
    from skyrelay.policy.signature import openssf_bundle, private_key, split
    from skyrelay.policy.signature import sign as signed_file

    for place in filter(None, (out, bundle)):
        if place.is_dir() or (place.exists() and not force):
            raise UsageError(str(place), None, "a file that is not there yet, or --force")
    given = PASSWORD in os.environ or PASSWORD_FILE in os.environ
    secret = private_key(key, keystore_password() if given else None)
    content = _read(file)
    card = Policy.load(content, str(file)).card.model_dump(mode="json")
    made_by = {name: card[name] for name in ("command", "preset", "seeds", "versions", "evaluation")}
    now = datetime.now(UTC).replace(microsecond=0)
    expires = now + timedelta(days=days)
    signed = signed_file(content, file.name, secret, {"commit": commit, **made_by}, now, expires)
    write_bytes(out, signed)
    if bundle is not None:
        write_text(bundle, openssf_bundle(split(content, str(file))[0], file.name, secret) + "\n")
    print_result({"file": str(out), "cid": str(cid_of(signed)), "expires": expires.isoformat()}, as_json)


@app.command()
def pin(cid: Address, stores: Stores = None, as_json: Json = False) -> None:
    """Keep a model in the first store, fetching it from that store's network or from the next stores.

    For example: skyrelay models pin bafkrei... --store models --store http://127.0.0.1:5001
    """
    store = _open(stores)
    store.pin(Cid.parse(cid, "models pin: CID"))
    print_result({"cid": cid, "pinned": True}, as_json)


def _read(file: Path) -> bytes:
    try:
        with file.open("rb") as source:
            content = source.read(MAX_IN_MEMORY + 1)
    except OSError as error:
        raise UsageError(str(file), error.strerror, "a readable model") from None
    if len(content) > MAX_IN_MEMORY:
        raise UsageError(str(file), f"over {MAX_IN_MEMORY} bytes", "a model")
    return content


def _open(stores: list[str] | None) -> FallbackStore:
    return FallbackStore([open_store(place) for place in stores or [DEFAULT_STORE]], _warn)


def _warn(refusal: SkyRelayError) -> None:
    typer.echo(f"skyrelay: asked the next store: {refusal}", err=True)
