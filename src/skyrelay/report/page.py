"""The replay page: one self-contained HTML file (docs/decisions/0060-one-page-two-sources.md)."""

from __future__ import annotations

import html
from pathlib import Path

from skyrelay.core.files import write_text
from skyrelay.report.payload import encode
from skyrelay.report.template import filled
from skyrelay.runfolder.reader import Run, read_run
from skyrelay.runfolder.schema import Summary


def write_report(run_dir: Path) -> Path:
    """Write ``report.html`` into a run folder. The same folder gives the same bytes.

    Returns: the page's path; it opens from disk, and its security policy lets it load nothing else.
    Raises:
        RunFolderError: a file is missing or cannot be read, or a key, column or value is missing or does not fit.
    """
    run = read_run(run_dir)
    page = run_dir / "report.html"
    write_text(page, render(run))
    return page


def render(run: Run) -> str:
    """The page's text, with the run in it; it may load nothing."""
    return _fill(
        source="file",
        connect="",
        title=html.escape(f"SkyRelay · {run.summary.name} · seed {run.summary.seed}"),
        name=html.escape(run.summary.name),
        subtitle=f"seed {run.summary.seed}",
        sentence=html.escape(sentence(run)),
        tiles=_tiles(run.summary),
        about=_about(run),
        payload=encode(run),
    )


def render_live() -> str:
    """The page's text without a run: it asks the server that it came from for the feed, and may load nothing else."""
    return _fill(
        source="live",
        connect="; connect-src 'self'",
        title="SkyRelay · live",
        name="live",
        subtitle="",
        sentence="The fleet as it flies.",
        tiles="",
        about="",
        payload="",
    )


def _fill(**values: str) -> str:
    return filled("page.html", ["colours.css", "page.css"], "page.js", values)


def sentence(run: Run) -> str:
    """What one sees, in plain words."""
    summary = run.summary
    seconds = summary.period_steps * summary.step_seconds
    start = (
        f"Of {_count(summary.vehicles_per_period)} connected vehicles at a time, {_count(summary.served_per_period)} "
        f"get a UAV, {_chosen(run)} every {seconds:g} s from a fleet of {summary.uavs:,}."
    )
    if summary.in_range is None or summary.static_in_range is None:
        return start
    middle = (
        f" Flying {_flown(summary)}, the UAVs keep {_count(summary.in_range)} of them in range "
        f"({_count(summary.static_in_range)} if the fleet hovered and chose from where it hovers)"
    )
    if summary.connectivity is None:
        return f"{start}{middle}."
    return f"{start}{middle} and their teams linked {_percent(summary.connectivity)} of the time."


def _chosen(run: Run) -> str:
    method = run.scenario.selection.method
    return "chosen on chain" if method == "two-sided" else f"chosen by {method} outside of the chain,"


def _flown(summary: Summary) -> str:
    """Who decided; a record without it is of a version that flew learned policies only."""
    names = summary.decided_by
    if all(name.startswith("policy ") for name in names):
        return "a learned policy"
    return "the " + " and the ".join(names).replace("rule hovering", "rule that hovers")


def _tiles(summary: Summary) -> str:
    tiles = [
        (
            "In range",
            f"{_count(summary.in_range)} of {_count(summary.connected)}",
            f"connected vehicles at a time; hovering {_count(summary.static_in_range)}",
        ),
        ("Coverage of those served", _percent(summary.coverage), f"hovering {_percent(summary.static_coverage)}"),
        ("Connectivity", _percent(summary.connectivity), f"hovering {_percent(summary.static_connectivity)}"),
        (
            "Traffic carried",
            f"{_percent(summary.carried_share)}",
            f"of all demand; hovering {_percent(summary.static_carried_share)}",
        ),
        ("Mean QoU · QoV", f"{_number(summary.mean_qou)} · {_number(summary.mean_qov)}", "of 100"),
        ("Transactions", f"{summary.transactions:,}", f"in {summary.blocks:,} blocks"),
        ("Gas", _short(summary.gas_used), f"{_short(summary.gas_used / max(summary.transactions, 1))} a transaction"),
    ]
    return "\n".join(
        f'<div class="tile"><dt>{html.escape(name)}</dt>'
        f"<dd>{html.escape(value)}<small>{html.escape(note)}</small></dd></div>"
        for name, value, note in tiles
    )


def _about(run: Run) -> str:
    summary, mobility = run.summary, run.scenario.mobility
    source = (
        f"the trace “{Path(mobility.trace).stem}”" if mobility.source == "trace" else f"the {mobility.source} model"
    )
    share = f", {100 * mobility.penetration:g} % of them connected" if mobility.source == "trace" else ""
    rows = [
        ("Scenario", [f"{summary.name}, seed {summary.seed}"]),
        ("Movement", [f"vehicles from {source}{share}"]),
        ("Attribution", [summary.attribution] if summary.attribution else []),
        (
            "Area",
            [
                f"{summary.zones} zones of {summary.grid.side:.0f} m × {summary.grid.side:.0f} m; "
                f"radio range {summary.range_m:.0f} m"
            ],
        ),
        (
            "Time",
            [
                f"{summary.steps} steps of {summary.step_seconds:g} s; {summary.periods} selection periods; "
                f"computed in {summary.wall_seconds:.1f} s, {summary.chain_seconds:.1f} s of it on the chain"
            ],
        ),
        ("Selected by", [summary.selected_by] if summary.selected_by else []),
        ("Decided by", summary.decided_by),
        ("Policies (CID)", summary.model_cids),
        ("Contract", [summary.contract]),
        ("Chain head", [summary.chain_head]),
    ]
    return "\n".join(
        f"<div><dt>{html.escape(name)}</dt>{''.join(f'<dd>{html.escape(line)}</dd>' for line in lines)}</div>"
        for name, lines in rows
        if lines
    )


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f}\u00a0%"


def _count(value: float | None) -> str:
    return "–" if value is None else f"{value:,.0f}"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _short(value: float) -> str:
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.1f}{unit}"
    return f"{value:.0f}"
