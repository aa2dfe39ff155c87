import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.core.errors import UsageError
from skyrelay.core.untrusted import MAX_VALUES, hex_bytes, hex_number, parse_json, parse_toml, read_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(VALUES, st.booleans())
def test_what_is_small_and_flat_is_read_as_it_is(value, ascii_only):
    text = json.dumps(value, ensure_ascii=ascii_only)
    assert parse_json(text, size=10**6, depth=200) == json.loads(text)


def depth_of(value):
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return 0 if inner is None else 1 + max(map(depth_of, inner), default=0)


@given(VALUES)
def test_brackets_in_texts_are_no_levels(value):
    levels = depth_of(value)
    assert parse_json(json.dumps(value), size=10**6, depth=levels) == value
    if levels:
        with pytest.raises(ValueError, match="levels"):
            parse_json(json.dumps(value), size=10**6, depth=levels - 1)


@pytest.mark.parametrize(
    "text",
    ["[" * 400_000, '{"a":' * 400_000, '"' + "[" * 100 + "[" * 400_000, "9" * 5000, "\ud800", b"\xff", '{"a": 1', ""],
)
def test_what_is_no_json_or_too_much_is_a_value_error(text):
    with pytest.raises(ValueError):
        parse_json(text, size=10**7)


def test_length_is_bounded_before_anything_is_read():
    with pytest.raises(ValueError, match="at most 10 are read"):
        parse_json(b" " * 11, size=10)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_other_encodings_are_none(encoding):
    # U+225B has the bytes of a quote and a bracket: counted as bytes, the text would be one long string.
    with pytest.raises(ValueError):
        parse_json(('["\u225b",' + "[" * 100_000).encode(encoding))


def test_a_byte_order_mark_is_no_part_of_the_text():
    assert parse_json(b"\xef\xbb\xbf[1]") == parse_json("\ufeff[1]") == [1]


@pytest.mark.parametrize(
    "text",
    [
        "[" * 200_000,
        '{"a":' * 200_000,
        '[{"a":' * 100_000,
        '["\\\\",' + "[" * 200_000,
        '["\\"]",' + "[" * 200_000,
        '["\\\\\\"[",' + "[" * 200_000 + "]" * 200_000 + "]",
        "[" * (32 + 1) + "]" * (32 + 1),
    ],
)
def test_deep_text_is_refused_wherever_the_brackets_hide(text: str) -> None:
    with pytest.raises(ValueError, match="more than 32 levels"):
        parse_json(text)


def test_brackets_in_strings_are_no_depth() -> None:
    value = ["[" * 500 + '"\\', {"{[": "]" * 300}]
    assert parse_json(json.dumps(value)) == value
    deep = "[" * 32 + "]" * 32
    assert parse_json(deep) == json.loads(deep)


def test_long_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("[" + "1," * 100 + "1]")
    with pytest.raises(ValueError, match="at most 100"):
        read_json(tmp_path / "file", size=100)
    assert len(read_json(tmp_path / "file")) == 101


@pytest.mark.parametrize("module", ["skyrelay.chain.accounts", "skyrelay.chain.node.devnet", "skyrelay.cli.main"])
def test_no_import_raises_the_recursion_limit(module: str) -> None:
    program = f"import sys; before = sys.getrecursionlimit(); import {module}; assert sys.getrecursionlimit() == before"
    subprocess.run([sys.executable, "-c", program], check=True, env={"PYTHONPATH": ":".join(sys.path)})


def test_the_number_of_values_is_bounded_as_well():
    with pytest.raises(ValueError, match="values"):
        parse_json(b"[" + b"0," * (MAX_VALUES + 1) + b"0]")


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5_000 + "]" * 5_000, "a = " + "{a=" * 5_000 + "1" + "}" * 5_000, "a = " + "9" * 5_000, "a ="],
)
def test_what_is_no_toml_or_too_deep_is_a_value_error(text):
    with pytest.raises(ValueError):
        parse_toml(f"a = {text}")


@given(st.binary(max_size=40))
def test_hexadecimal_data_has_one_spelling(data):
    assert hex_bytes("0x" + data.hex()) == data
    for other in (data.hex(), " 0x" + data.hex(), "0x" + data.hex() + " ", "0x" + data.hex() + "0", "0X" + data.hex()):
        with pytest.raises(ValueError):
            hex_bytes(other)


@given(st.integers(0, 2**256 - 1))
def test_hexadecimal_numbers_have_no_signs_and_an_end(number):
    assert hex_number(hex(number)) == number
    for other in (
        f"-{hex(number)}",
        f"0x-{number:x}",
        f"0x_{number:x}",
        f"0x {number:x}",
        "0x" + "f" * 65,
        "0x",
        number,
    ):
        with pytest.raises(ValueError):
            hex_number(other)


def test_an_error_can_quote_a_number_of_any_length_and_a_table_of_any_depth():
    assert "a number of 400,000 bits" in str(UsageError("seed", (1 << 400_000) - 1, "a seed"))
    deep = {}
    for _ in range(100_000):
        deep = {"a": deep}
    assert str(UsageError("name", deep, "a name")) == "name: is a dict; expected a name"
    while deep:  # or its end would be as deep
        deep = deep["a"]


def test_an_error_quotes_no_name_and_password_of_an_address():
    told = str(UsageError("chain.chain_id", "https://user:hunter2@node.example:8545/x", "a number"))
    assert told == "chain.chain_id: is 'https://...@node.example:8545/x'; expected a number"
