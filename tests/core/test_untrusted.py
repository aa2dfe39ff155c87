import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrelay.core.untrusted import parse_json

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
