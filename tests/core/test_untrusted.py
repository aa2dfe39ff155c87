import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.core.untrusted import parse_json, read_json

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
