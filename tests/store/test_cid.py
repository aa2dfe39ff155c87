"""Addresses are those of `ipfs add` under the profile unixfs-v1-2025; the known answers were printed by a real Kubo."""

import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrelay.core.errors import StoreError
from skyrelay.store.cid import (
    CHUNK_BYTES,
    DAG_PB,
    LINKS_PER_NODE,
    RAW,
    Cid,
    Importer,
    Link,
    cid_of,
    decode_node,
    encode_node,
)

HELLO = "bafkreifjjcie6lypi6ny7amxnfftagclbuxndqonfipmb64f2km2devei4"  # of "hello world\n", as in IPFS's own documents


def counters(size: int) -> bytes:
    """Bytes without a period that a chunk could hide: the 32-bit counters 0, 1, 2, ..., cut at ``size``."""
    return b"".join(i.to_bytes(4, "little") for i in range(-(-size // 4)))[:size]


KNOWN = json.loads(Path(__file__).with_name("known_cids.json").read_text())["cids"]

STREAM = """
import array, sys
from skyrelay.store.cid import Importer
size = int(sys.argv[1])
importer = Importer()
for start in range(0, size, 1_000_000):
    importer.update(array.array("I", range(start // 4, start // 4 + 250_000)).tobytes()[: size - start])
print(importer.finish(), *(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


@pytest.mark.parametrize("size", KNOWN)
def test_kubo_gives_the_same_address_and_memory_stays_small(size):
    ran = subprocess.run([sys.executable, "-c", STREAM, size], capture_output=True, text=True, check=True)
    cid, peak = ran.stdout.split()
    assert cid == KNOWN[size]
    assert int(peak) < 64 * 1024, "KiB"


def test_a_file_of_one_chunk_is_its_leaf():
    assert str(cid_of(b"hello world\n")) == HELLO


@given(st.binary(max_size=64), st.sampled_from([RAW, DAG_PB]))
def test_text_and_bytes_name_the_same_block(block, codec):
    cid = Cid.of_block(codec, block)
    assert Cid.parse(str(cid)) == cid
    assert Cid.from_bytes(bytes(cid)) == cid
    assert cid.names(block)
    assert not cid.names(block + b"\0")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "hello",
        HELLO.upper(),
        HELLO + " ",
        HELLO[:-1],
        HELLO[:-1] + "5",  # bits behind the last letter
        "z" + HELLO[1:],
        "../" + HELLO[3:],
        "b" + "1" * 58,
        "QmT78zSuBmuS4z925WZfrqQ1qHaJ56DQaTfyMUF7F8ff5o",
        "bafyrei" + HELLO[7:],  # dag-cbor
        "é" * 59,
    ],
)
def test_another_spelling_is_refused(text):
    with pytest.raises(StoreError, match=r"command line: CID: is .*expected a CIDv1"):
        Cid.parse(text, "command line: CID")


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_the_address_does_not_depend_on_how_the_bytes_arrive(data):
    content = counters(2 * CHUNK_BYTES + 17)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(content)), max_size=6)))
    importer = Importer()
    for start, end in zip([0, *cuts], [*cuts, len(content)], strict=True):
        importer.update(content[start:end])
    assert importer.finish() == cid_of(content) == cid_of(io.BytesIO(content))
    assert importer.file_bytes == len(content)


links = st.lists(
    st.builds(
        Link,
        st.builds(Cid, st.sampled_from([RAW, DAG_PB]), st.binary(min_size=32, max_size=32)),
        st.integers(1, 2**40),
        st.integers(0, 2**40),
    ),
    min_size=1,
    max_size=LINKS_PER_NODE,
)


@given(links)
def test_a_node_reads_back_as_it_was_written(children):
    block = encode_node(children)
    assert decode_node(block, Cid.of_block(DAG_PB, block)) == children


@given(st.binary(max_size=200))
def test_other_bytes_are_no_node(block):
    with pytest.raises(StoreError, match="expected a node of a file"):
        decode_node(block, Cid.of_block(DAG_PB, block))


@given(links, st.data())
def test_a_changed_node_is_refused_or_names_other_children(children, data):
    block = bytearray(encode_node(children))
    at = data.draw(st.integers(0, len(block) - 1))
    block[at] ^= data.draw(st.integers(1, 255))
    cid = Cid.of_block(DAG_PB, bytes(block))
    try:
        read = decode_node(bytes(block), cid)
    except StoreError:
        return
    assert read != children


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(StoreError, match=r"absent\.onnx: is 'No such file or directory'; expected a file"):
        cid_of(tmp_path / "absent.onnx")
