"""Folders made to hurt their reader: each is one line, whatever it claims of itself."""

import os
import tracemalloc

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrelay.core.errors import RunFolderError
from skyrelay.runfolder import reader
from skyrelay.runfolder.reader import read_rows, read_scenario, read_summary, read_table
from skyrelay.runfolder.writer import TableWriter

NAMES = ["a", "b", "a"]


@pytest.fixture
def folder(tmp_path):
    tables = TableWriter()
    tables.add("candidates", period=[0, 0, 1], vehicle=NAMES, uav="u", qou=[1.5, 2.5, 0.0])
    tables.write(tmp_path)
    return tmp_path


def rewrite(folder, **columns):
    table = pq.read_table(folder / "candidates.parquet")
    for name, values in columns.items():
        table = table.set_column(table.column_names.index(name), name, values)
    pq.write_table(table, folder / "candidates.parquet")


def test_what_was_written_is_read(folder):
    assert read_rows(folder, "candidates") == [
        {"period": 0, "vehicle": "a", "uav": "u", "qou": 1.5},
        {"period": 0, "vehicle": "b", "uav": "u", "qou": 2.5},
        {"period": 1, "vehicle": "a", "uav": "u", "qou": 0.0},
    ]
    assert read_table(folder, "fleet")["uav"].tolist() == []


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("vehicle", pa.array([["a"], ["b"], ["a"]]), "expected a column of string"),
        ("vehicle", pa.array([b"a", b"b", b"\xff"]), "expected a column of string"),
        ("vehicle", pa.array([b"a", b"b", b"\xff"]).view(pa.string()), "readable Parquet"),
        ("vehicle", pa.array(["a", None, "a"]), r"vehicle\[1\]: is 'null'"),
        ("qou", pa.array([{"x": 1.0}] * 3), "expected a column of double"),
        ("qou", pa.array(["1", "2", "3"]), "expected a column of double"),
        ("period", pa.array([0, 1, 2**40]), "expected a column of int32"),
        ("period", pa.array([0.5, 1.0, 2.0]), "expected a column of int32"),
        ("period", pa.array([True, False, True]), "expected a column of int32"),
    ],
)
def test_a_column_of_another_kind(folder, column, values, message):
    rewrite(folder, **{column: values})
    with pytest.raises(RunFolderError, match=message):
        read_table(folder, "candidates")


def test_a_column_twice(folder):
    table = pq.read_table(folder / "candidates.parquet")
    pq.write_table(table.append_column("qou", table["qou"]), folder / "candidates.parquet")
    with pytest.raises(RunFolderError, match="'qou' among its columns, once"):
        read_table(folder, "candidates")


def test_a_long_text_many_times_is_held_once(folder):
    """A file of some 100 kB that would be 20 GB as texts of their own."""
    text = "x" * 10**5
    many = pa.DictionaryArray.from_arrays(pa.array(np.zeros(200_000, dtype=np.int32)), pa.array([text]))
    table = pa.table({"period": np.zeros(200_000, np.int32), "vehicle": many, "uav": many, "qou": np.zeros(200_000)})
    pq.write_table(table, folder / "candidates.parquet")
    tracemalloc.start()
    read = read_table(folder, "candidates")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(read["vehicle"]) == 200_000
    assert read["vehicle"][-1] == text
    assert peak < 50e6


def test_a_text_that_is_too_long(folder):
    rewrite(folder, vehicle=pa.array(["a", "b", "x" * (reader.MAX_TEXT + 1)]))
    with pytest.raises(RunFolderError, match="a text of 1,048,577 bytes"):
        read_table(folder, "candidates")


@pytest.mark.parametrize(("bound", "message"), [("MAX_ROWS", "3 rows"), ("MAX_TABLE", "bytes unpacked")])
def test_more_than_is_read(folder, monkeypatch, bound, message):
    monkeypatch.setattr(reader, bound, 2)
    with pytest.raises(RunFolderError, match=message):
        read_table(folder, "candidates")


@pytest.mark.parametrize("bound", ["MAX_TABLE_FILE", "MAX_TEXT_FILE"])
def test_a_file_that_is_too_large(folder, monkeypatch, bound):
    monkeypatch.setattr(reader, bound, 10)
    (folder / "summary.json").write_text(" " * 11)
    (folder / "scenario.toml").write_text(" " * 11)
    reads = [read_table] if bound == "MAX_TABLE_FILE" else [read_summary, read_scenario]
    for read in reads:
        with pytest.raises(RunFolderError, match="at most 10 bytes"):
            read(*((folder, "candidates") if read is read_table else (folder,)))


def test_a_pipe_is_not_waited_for(tmp_path):
    for name in ("candidates.parquet", "summary.json", "scenario.toml"):
        os.mkfifo(tmp_path / name)
    for read in (lambda folder: read_table(folder, "candidates"), read_summary, read_scenario):
        with pytest.raises(RunFolderError, match="it is not there"):
            read(tmp_path)


def test_every_byte_of_a_table_may_be_wrong(folder):
    """A fault in any place is one of ours, or changes nothing that is read."""
    path = folder / "candidates.parquet"
    whole = path.read_bytes()
    sound = read_rows(folder, "candidates")
    refused = 0
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            read = read_rows(folder, "candidates")
        except RunFolderError:
            refused += 1
        else:
            assert len(read) <= len(sound)
    assert refused > len(whole) / 2


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 100_000, "9" * 5000, "null", "[]", '{"steps": 1e18}', "\ud800"]
)
def test_a_summary_that_is_none(tmp_path, text):
    (tmp_path / "summary.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(RunFolderError, match=r"summary\.json"):
        read_summary(tmp_path)
