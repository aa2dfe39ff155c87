"""The audit of a whole run folder: its chain first, then every file beside it."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from skyrelay.airspace.law import Law
from skyrelay.audit.measures import check_charging, check_metrics, check_summary
from skyrelay.audit.payments import check_payments
from skyrelay.audit.tables import Compared, check_accounts, check_flight, check_periods, one_demand_each
from skyrelay.chain.abi import Event
from skyrelay.chain.accounts import signer
from skyrelay.chain.client import Settings
from skyrelay.chain.embedded.chain import account_of, signing_members
from skyrelay.chain.node.chain import NodeChain
from skyrelay.chain.proof.audit import AuditReport, Progress, audit_node, audit_run, in_silence
from skyrelay.chain.proof.replay import Difference
from skyrelay.chain.proof.root import TrustRoot
from skyrelay.core.errors import RunFolderError, SkyRelayError, StoreError
from skyrelay.core.resolved import resolve
from skyrelay.protocol.history import History
from skyrelay.report.page import render
from skyrelay.runfolder.figures import over_the_run
from skyrelay.runfolder.folder import STORE, SUMMARY
from skyrelay.runfolder.manifest import MANIFEST, Manifest, entries, read_manifest
from skyrelay.runfolder.reader import Run, read_rows, read_run
from skyrelay.simulation.consortium import members_sign
from skyrelay.store.cid import Cid
from skyrelay.store.local import LocalStore

UNCHECKED = (
    "where vehicles and UAVs were between selections, and UAVs' moves and batteries there (no member signs them)",
    "who would have been served had the fleet hovered (the columns and figures called static_*)",
    "demands of vehicles that never proposed",
    "chain_seconds, wall_seconds, attribution, name, selected_by and decided_by (but the CIDs) in summary.json",
    "scenario.toml beyond the rules of selection and what the summary repeats",
    "the charts in figures/, but for their digests in the manifest",
)
"""What neither the chain nor a rule gives, so that a forger could have written it."""


def audit_folder(folder: Path, progress: Progress = in_silence, *, head: str | None = None) -> AuditReport:
    """Audit a run folder.

    Args:
        progress: is told the name of each stage.
        head: hash of the record's last block, from elsewhere; None: any record.
    Raises:
        RunFolderError: the folder has no chain's record or no summary.
    """
    report = audit_run(folder, progress, head=head)
    compared = Compared(report)
    _check_manifest(compared, folder, report)
    try:
        run = read_run(folder)
        rows = {name: read_rows(folder, name) for name in ("accounts", "fleet", "members", "proposals", "candidates")}
    except RunFolderError as error:
        place = error.place.removeprefix(f"{folder}/")
        report.differences.append(Difference(place, str(error.value or "not readable"), error.expected))
        return report
    progress("working the tables out from the chain")
    told = _history(compared, run, report)
    if told is None:
        return report
    check_accounts(compared, told, rows["accounts"], _derivation(run))
    _check_scenario(compared, run, told)
    summary = run.summary
    in_order = summary.chain_url is None
    check_periods(compared, told, rows, run.scenario.selection, in_order)
    check_flight(compared, told, run.vehicles, run.uavs, summary.period_steps, run.grid, in_order)
    progress("working the figures out from the tables")
    law = Law.of(resolve(run.scenario, run.grid), run.grid)
    demands = one_demand_each(compared, rows["members"])
    clock = (summary.period_steps, summary.step_seconds)
    check_metrics(compared, run.metrics, run.vehicles, run.uavs, law, told, demands, clock)
    mined = {
        "transactions": len(report.gas),
        "gas_used": sum(report.gas),
        "model_cids": sorted(str(Cid.from_bytes(told.cids[one], "chain")) for one in told.models if one in told.cids),
    }
    tables = {name: getattr(run, name) for name in ("proposals", "metrics", "vehicles", "uavs", "charging")}
    if law.places:
        check_charging(compared, run.charging, run.uavs, law)
    check_summary(compared, summary, told, tables, mined, law)
    check_payments(compared, run, read_rows(folder, "payments"), report.blocks)
    progress("hashing the stored policies and drawing the page again")
    _check_store(compared, run, told.cids.values())
    _check_page(compared, run)
    report.unchecked += UNCHECKED
    if not in_order:
        report.unchecked.append(
            "where members on hosts of their own were at selections at which they told the chain nothing, and what a "
            "vehicle weighed whose host did not say (QoU 0)"
        )
    if (method := run.scenario.selection.method) != "two-sided":
        report.unchecked.append(
            f"whom each vehicle asks: the method {method} was worked out outside of the contract, which checks "
            "candidates and bandwidth only"
        )
    return report


def _derivation(run: Run) -> Callable[[str], str] | None:
    """How the run's addresses follow from its names; None where keys that nobody has told give them."""
    if run.summary.chain_url is not None:
        return None
    return signing_members().account if members_sign(run.scenario) else account_of


def audit_node_folder(
    folder: Path, chain: NodeChain, progress: Progress = in_silence, *, root: TrustRoot | None = None
) -> AuditReport:
    """Audit the folder of a run on a node: its contract on that chain, then the files that need no order of events.

    Args:
        chain: the node, or another one of its network.
        progress: is told the name of each stage.
        root: what the reader knows of the chain; None: nothing, and that its blocks must be sealed.
    Raises:
        RunFolderError: a file of the folder is missing or does not fit.
        ChainError: the chain is out of reach, or has no such contract.
    """
    run = read_run(folder)
    report = audit_node(chain, run.summary.contract, progress, root=root)
    report.subject = f"{folder}: {report.subject}"
    compared = Compared(report)
    _check_manifest(compared, folder, report)
    found = Counter((name, args) for name, args in zip(run.events["name"], run.events["args"], strict=True))
    for event in report.events:
        compared.count("rows of the events table")
        found[event.name, json.dumps(event.args)] -= 1
    for (name, args), number in found.items():
        if number:
            compared.differs("events.parquet", f"{name} {args}", f"{number:+} rows", "as many as on the chain")
    for key, value in over_the_run(run.metrics, run.vehicles).items():
        compared.count("summary entries")
        if getattr(run.summary, key) != value:
            compared.differs(SUMMARY, key, getattr(run.summary, key), value)
    cids = {event.args["modelId"]: event.args["cid"] for event in report.events if event.name == "ModelRegistered"}
    _check_store(compared, run, [bytes.fromhex(cid[2:]) for cid in cids.values()])
    _check_page(compared, run)
    report.unchecked += (
        "every table but events.parquet, and the summary's counts: a network orders as it likes",
        *UNCHECKED,
    )
    return report


def _history(compared: Compared, run: Run, report: AuditReport) -> History | None:
    """The chain's events, each with its step; None where the table of events does not fit, which then is noted."""
    steps = run.events["step"].tolist()
    if len(steps) != len(report.events):
        return None
    last = run.summary.steps
    if np.any(np.diff(run.events["step"]) < 0) or min(steps, default=0) < 0 or max(steps, default=0) > last:
        compared.differs("events.parquet", "step", "out of order", f"0 to {last}, in order")
        return None
    # Where the run is not the chain's clock, only the order of the blocks says when something was.
    timed = run.summary.chain_url is None
    for event, step in zip(report.events if timed else (), steps if timed else (), strict=True):
        mined, due = report.timestamps.get(event.block), 1 + math.floor(step * run.summary.step_seconds)
        if mined is not None and mined != due and not (step == 0 and mined < due):
            compared.differs("events.parquet", f"block {event.block}: step", step, f"that of {mined} s")
    names = dict(zip(run.accounts["address"], run.accounts["name"], strict=True))
    told = History(names, run.summary.periods, run.summary.period_steps, run.scenario.reselections)
    at = dict(zip(((event.block, event.transaction) for event in report.events), steps, strict=True))
    for event in report.told:
        told.hear(event, at[event.block, event.transaction])  # what a claim stands for: as its transaction
    told.open(run.summary.periods - 1)
    return told


def _check_manifest(compared: Compared, folder: Path, report: AuditReport) -> None:
    """The files are those of the manifest, and a party of the chain has signed it."""
    try:
        manifest = read_manifest(folder)
    except RunFolderError as error:
        report.differences.append(Difference(MANIFEST, str(error.value or "not readable"), error.expected))
        return
    found = entries(folder)
    compared.count("files of the manifest", len(manifest.files))
    for name in sorted(found.keys() | manifest.files.keys()):
        if found.get(name) != manifest.files.get(name):
            is_there = "is not there" if name not in found else "other bytes" if name in manifest.files else "a file"
            compared.differs(MANIFEST, name, is_there, "what the manifest has" if name in manifest.files else "none")
    digest = hashlib.sha256(manifest.message).hexdigest()
    report.given["manifest"] = f"{digest} (the SHA-256 of the files' digests)"
    if manifest.signature is None:
        report.unchecked.append("who wrote the manifest: it is unsigned, as the embedded chain's accounts have no keys")
        return
    wrong = wrong_signature(manifest, report.events)
    if wrong is not None:
        compared.differs(MANIFEST, "signature", wrong, "that of a party of the chain")


def wrong_signature(manifest: Manifest, events: Sequence[Event]) -> str | None:
    """Who has signed, if that is no account with a role on the chain; None where all is well."""
    address = signer(manifest.message, bytes.fromhex(manifest.signature or ""))
    roles = {event.args["account"] for event in events if event.name == "RoleGranted"}
    return None if address is not None and address == manifest.signer and address in roles else address or "nobody"


def _check_scenario(compared: Compared, run: Run, told: History) -> None:
    """The rules that the contract was deployed with, and what summary and scenario both say."""
    scenario, summary = run.scenario, run.summary
    settings = Settings.of(scenario.selection)
    wanted = {
        "qouWeights": [round(weight * 1e6) for weight in settings.qou_weights],
        "qovWeights": [round(weight * 1e6) for weight in settings.qov_weights],
        "maxBandwidth": settings.max_bandwidth,
        "maxDemand": settings.max_demand,
        "maxPayment": settings.max_payment,
        "maxDistance": round(settings.max_distance * 10),
        "rangeGate": settings.range_gate,
    }
    for key, value in wanted.items():
        compared.count("rules of the scenario")
        compared.same("scenario.toml", f"selection ({key})", value, told.parameters.get(key))
    for key, found, value in (
        ("name", summary.name, scenario.name),
        ("seed", summary.seed, scenario.seed),
        ("steps", summary.steps, scenario.coordination.steps),
        ("period_steps", summary.period_steps, scenario.coordination.period_steps),
        ("step_seconds", summary.step_seconds, scenario.coordination.step_seconds),
        ("range_m", summary.range_m, scenario.fleet.range),
        ("uavs", summary.uavs, scenario.fleet.uavs),
    ):
        compared.count("summary entries")
        compared.same(SUMMARY, key, found, value)


def _check_store(compared: Compared, run: Run, cids: Iterable[bytes]) -> None:
    """Every block in the folder's store is what its name says, and every policy of the chain is there whole."""
    if run.scenario.store.url is not None:
        return
    store = LocalStore(run.path / STORE)
    for path in sorted((run.path / STORE / "blocks").glob("*/*")):
        compared.count("stored blocks")
        try:
            cid = Cid.parse(path.name, "block")
            sound = path.is_file() and path.stat().st_size < 2**24 and cid.names(path.read_bytes())
        except (SkyRelayError, OSError):
            sound = False
        if not sound:
            compared.differs(STORE, path.name, "other bytes", "those that its name is the hash of")
    for registered in cids:
        try:
            store.verify(Cid.from_bytes(registered, "chain"))
        except StoreError as error:
            compared.differs(STORE, error.place, error.value, error.expected)


def _check_page(compared: Compared, run: Run) -> None:
    """The page is the one that this version draws from these tables."""
    page = run.path / "report.html"
    compared.count("pages")
    try:
        text = render(run)
        drawn = page.stat().st_size == len(text.encode()) and page.read_text(encoding="utf-8") == text
    except (OSError, ValueError, RunFolderError):
        drawn = False
    if not drawn:
        compared.differs(page.name, "its text", "another", "what `skyrelay report` draws from the tables")
