"""The audit finds nothing where nothing is wrong, and names whatever was changed."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from chain_rounds import World, write_run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrelay.chain.abi import Event
from skyrelay.chain.embedded.chain import EmbeddedChain
from skyrelay.chain.embedded.ledger import FILE_NAME, content_hash
from skyrelay.chain.proof.audit import audit_run
from skyrelay.chain.proof.reference import ReferenceContract
from skyrelay.chain.proof.replay import replay
from skyrelay.core.errors import RunFolderError


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_run(folder)
    return folder


@pytest.fixture(scope="module")
def small_chain(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A record that is quick to execute again."""
    folder = tmp_path_factory.mktemp("small")

    def build(world: World) -> None:
        world.propose(1.0)
        world.allocate(100)

    write_run(folder, build, uavs=2, vehicles=4)
    return (folder / "chain" / FILE_NAME).read_bytes()


@pytest.fixture(scope="module")
def events(run: Path) -> list[Event]:
    from skyrelay.chain.client import IovClient

    address = json.loads((run / "summary.json").read_text())["contract"]
    with EmbeddedChain(run / "chain") as chain:
        return IovClient.connect(chain, address).events()


@pytest.fixture
def copy(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "run"))


def test_an_honest_run_agrees(run: Path) -> None:
    report = audit_run(run)
    assert report.differences == []
    assert min(report.checked.values()) > 0
    names = {"blocks", "proposals", "selections by UAVs", "model assignments", "role changes", "ratings", "withdrawals"}
    assert names <= report.checked.keys()


# One byte of the record


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_byte_that_is_flipped_is_named(small_chain: bytes, tmp_path: Path, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(small_chain) - 1))
    bits = data.draw(st.integers(1, 255))
    changed = bytearray(small_chain)
    changed[place] ^= bits
    (tmp_path / FILE_NAME).write_bytes(changed)
    differences = replay(tmp_path).differences
    assert differences
    line = small_chain[:place].count(b"\n")
    assert any(re.match(rf"block {line}\b", difference.place) for difference in differences)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_record_that_is_cut_is_named(small_chain: bytes, tmp_path: Path, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(small_chain) - 1))
    (tmp_path / FILE_NAME).write_bytes(small_chain[:cut])
    result = replay(tmp_path)
    at_a_boundary = cut == 0 or small_chain[cut - 1 : cut] == b"\n"
    # A whole last block that is missing is found by the head that the summary names.
    assert result.differences or (at_a_boundary and result.head.encode()[2:] not in small_chain.splitlines()[-1])


# A field of the record, by someone who writes all hashes anew


def leaves(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(tree, dict):
        return [leaf for key, value in tree.items() for leaf in leaves(value, (*path, key))]
    if isinstance(tree, list):
        return [leaf for index, value in enumerate(tree) for leaf in leaves(value, (*path, index))]
    return [path]


def other(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if value is None:
        return "0x" + "12" * 20
    if not value:
        return "12"
    return value[:-1] + ("1" if value[-1] == "0" else "0")


def rewritten(content: bytes, change: Callable[[dict[str, Any]], None], at: int) -> bytes:
    """The record with one block changed and every hash from there on made to fit."""
    lines, parent = [], None
    for number, line in enumerate(content.splitlines()):
        tree = json.loads(line[65:])
        if number == at:
            change(tree)
        if parent is not None and number > at:
            tree["parent"] = parent
        body = json.dumps(tree, separators=(",", ":")).encode()
        parent = content_hash(body)
        lines.append(parent[2:].encode() + b" " + body + b"\n")
    return b"".join(lines)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_field_that_is_changed_is_named_though_all_hashes_fit(
    small_chain: bytes, tmp_path: Path, data: st.DataObject
) -> None:
    trees = [json.loads(line[65:]) for line in small_chain.splitlines()]
    number = data.draw(st.integers(1, len(trees) - 1))
    path = data.draw(st.sampled_from(leaves(trees[number])))

    def change(tree: dict[str, Any]) -> None:
        for key in path[:-1]:
            tree = tree[key]
        tree[path[-1]] = other(tree[path[-1]])

    (tmp_path / FILE_NAME).write_bytes(rewritten(small_chain, change, number))
    differences = replay(tmp_path).differences
    if path == ("timestamp",):
        return  # a time is the caller's to choose: only the head in the summary tells that it was another
    assert differences
    assert any(re.match(rf"block {number}\b", difference.place) for difference in differences)


def test_a_rewritten_time_is_found_by_the_head(copy: Path) -> None:
    def later(tree: dict[str, Any]) -> None:
        tree["timestamp"] += 1

    path = copy / "chain" / FILE_NAME
    content = path.read_bytes()
    path.write_bytes(rewritten(content, later, content.count(b"\n") - 1))
    assert any(difference.place == "summary.json: chain_head" for difference in audit_run(copy).differences)


# What lies beside the record


def test_another_head_contract_or_count_in_the_summary(copy: Path) -> None:
    path = copy / "summary.json"
    summary = json.loads(path.read_text())
    for key in ("chain_head", "contract", "blocks"):
        path.write_text(json.dumps(summary | {key: other(summary[key])}))
        assert [difference.place for difference in audit_run(copy).differences] == [f"summary.json: {key}"]


@pytest.mark.parametrize("text", ["{", "[]", "\x80"])
def test_a_damaged_summary_is_a_difference(copy: Path, text: str) -> None:
    (copy / "summary.json").write_text(text, encoding="latin-1")
    assert [difference.place for difference in audit_run(copy).differences] == ["summary.json"]


@pytest.mark.parametrize("column", ["block", "tx", "log", "name", "args"])
def test_another_event_in_the_table(copy: Path, column: str) -> None:
    path = copy / "events.parquet"
    columns = pq.read_table(path).to_pydict()
    columns[column][7] = other(columns[column][7])
    pq.write_table(pa.table(columns), path)
    (difference,) = audit_run(copy).differences
    assert difference.place == f"events.parquet: row 7, {column}"


def test_a_missing_or_damaged_table_of_events(copy: Path) -> None:
    path = copy / "events.parquet"
    table = pq.read_table(path)
    pq.write_table(table.slice(1), path)
    assert audit_run(copy).differences[0].place == "events.parquet: rows"
    path.write_bytes(b"PAR1, but no more")
    assert [difference.place for difference in audit_run(copy).differences] == ["events.parquet"]


def test_a_folder_without_a_record_is_bad_input(tmp_path: Path, copy: Path) -> None:
    with pytest.raises(RunFolderError, match=re.escape("chain/blocks.jsonl")):
        audit_run(tmp_path)
    (copy / "summary.json").unlink()
    with pytest.raises(RunFolderError, match="the summary of a run"):
        audit_run(copy)


# The reference: a contract that lied would be caught, though its chain is sound


def nobody(event: Event) -> None:
    """Of an event with no signature, and no claim."""


def follow(events: Sequence[Event]) -> list[str]:
    """Differences when the events are taken as the chain's, whoever sent them."""
    reference = ReferenceContract(nobody, lambda block: 98 + block, nobody, nobody, ("0x", 1))
    reference.follow(events)
    return [str(difference) for difference in reference.differences]


def changed(events: list[Event], name: str, nth: int, **args: Any) -> list[Event]:
    at = [i for i, event in enumerate(events) if event.name == name][nth]
    return [*events[:at], replace(events[at], args={**events[at].args, **args}), *events[at + 1 :]]


def test_the_reference_follows_an_honest_contract(events: list[Event]) -> None:
    assert follow(events) == []


def test_a_wrong_quality_is_named(events: list[Event]) -> None:
    proposal = next(event for event in events if event.name == "VehSelectionSubmitted")
    for key in ("qov", "score"):
        lie = changed(events, "VehSelectionSubmitted", 0, **{key: proposal.args[key] - 1})
        assert any(f"VehSelectionSubmitted: {'QoV' if key == 'qov' else key}" in line for line in follow(lie))


def test_a_wrong_selection_is_named(events: list[Event]) -> None:
    allocations = [event for event in events if event.name == "UAVAllocated"]
    nth = next(i for i, event in enumerate(allocations) if len(event.args["selected"]) > 1)
    selected = allocations[nth].args["selected"]
    for lie in (selected[:-1], selected[::-1]):
        assert any(
            "UAVAllocated: selected" in line for line in follow(changed(events, "UAVAllocated", nth, selected=lie))
        )


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("UAVRegistered", {"index": 6}),
        ("UAVUpdated", {"bandwidth": 20_001}),
        ("VehicleRegistered", {"reputation": 9_999}),
        ("UAVAllocated", {"committed": 1}),
        ("UAVAllocated", {"decided": 900}),
        ("ZoneAllocated", {"selectedVehicles": 900}),
        ("ZoneAllocated", {"round": 77}),
        ("ZoneListsReset", {"period": 77}),
        ("ModelAssigned", {"selectedUAVs": 900}),
        ("ModelAssigned", {"modelId": "0x" + "00" * 32}),
        ("ModelRegistered", {"modelId": "0x" + "00" * 32}),
        ("ReputationSet", {"reputation": 10_001}),
        ("MemberRated", {"reputation": 1}),
        ("RoleGranted", {"role": "0x" + "12" * 32}),
        ("UAVSubmissionReset", {"session": 77}),
        ("VehSelectionWithdrawn", {"index": 77}),
        ("VehSelectionSubmitted", {"round": 77}),
        ("VehSelectionSubmitted", {"demand": 0}),
        ("VehSelectionSubmitted", {"session": 77}),
        ("VehSelectionSubmitted", {"payment": 701}),
        ("VehSelectionSubmitted", {"reputation": 10_001}),
        ("VehSelectionSubmitted", {"uavX": 77}),
        ("ZonePieceAllocated", {"cursor": 77}),
        ("ModelRegistered", {"owner": "0x" + "12" * 20}),
        ("MemberSuspended", {"member": "0x" + "12" * 20}),
        ("DefaultAdminTransferScheduled", {"acceptSchedule": 77}),
    ],
)
def test_each_kind_of_event_is_checked(events: list[Event], name: str, args: dict[str, Any]) -> None:
    lie = changed(events, name, -1, **args)
    assert any(f": {name}: " in line for line in follow(lie))


@pytest.mark.parametrize(
    "name",
    [
        "Deployed",
        "RoleGranted",
        "UAVRegistered",
        "VehicleRegistered",
        "ZoneOpened",
        "UAVZoneUpdated",
        "VehSelectionSubmitted",
        "UAVAllocated",
        "ZoneAllocated",
        "ZoneListsReset",
    ],
)
def test_an_event_left_out_is_noticed_by_those_after_it(events: list[Event], name: str) -> None:
    at = next(i for i, event in enumerate(events) if event.name == name)
    assert follow(events[:at] + events[at + 1 :])


def test_a_sender_without_the_right_is_named(events: list[Event]) -> None:
    reference = ReferenceContract(lambda event: "0x" + "99" * 20, lambda block: 98 + block, nobody, nobody, ("0x", 1))
    reference.follow(events)
    named = {difference.place.rsplit(": ", 1)[1] for difference in reference.differences}
    assert {"UAVRegistered", "VehSelectionSubmitted", "UAVAllocated", "ModelAssigned", "ReputationSet"} <= named
