"""The store in a folder: what goes in comes back, or is refused by name."""

import array
import filecmp
import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrelay.core.errors import StoreError
from skyrelay.store.cid import CHUNK_BYTES, DAG_PB, Cid, Link, cid_of, encode_node
from skyrelay.store.fallback import FallbackStore
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import MAX_IN_MEMORY, MAX_MODEL_BYTES, StoredModel


def content(size: int) -> bytes:
    return b"".join(i.to_bytes(4, "little") for i in range(-(-size // 4)))[:size]


SIZES = [0, 1, CHUNK_BYTES, CHUNK_BYTES + 1, 2_000_000]


@pytest.fixture
def store(tmp_path: Path) -> LocalStore:
    return LocalStore(tmp_path / "store")


@pytest.mark.parametrize("size", SIZES)
def test_what_is_put_comes_back(store, tmp_path, size):
    source = tmp_path / "model.onnx"
    source.write_bytes(content(size))
    cid = store.put(source)
    assert cid == cid_of(content(size)) == store.put(content(size))
    assert store.has(cid)
    assert store.get(cid) == content(size)
    assert store.fetch(cid, tmp_path / "deep" / "copy.onnx") == size == store.verify(cid)
    assert (tmp_path / "deep" / "copy.onnx").read_bytes() == content(size)
    assert store.models() == [StoredModel(cid, size)]


def test_a_folder_that_is_not_there_holds_nothing(store):
    cid = cid_of(b"x")
    assert not store.has(cid)
    assert store.models() == []
    with pytest.raises(StoreError, match=f"{cid}: is 'not here'; expected a model that was added here"):
        store.get(cid)
    assert not store.root.exists()


@pytest.mark.parametrize("damage", ["flip", "truncate", "empty", "exchange", "remove"])
@pytest.mark.parametrize("which", ["root", "leaf"])
def test_a_damaged_block_is_refused_by_name(store, tmp_path, damage, which):
    cid = store.put(content(CHUNK_BYTES + 100))
    block = cid if which == "root" else cid_of(content(CHUNK_BYTES))
    path = store.root / "blocks" / str(block)[-2:] / str(block)
    whole = path.read_bytes()
    if damage == "remove":
        path.unlink()
        assert not store.has(cid)
    else:
        flipped = bytes([whole[0] ^ 1]) + whole[1:]
        exchanged = content(CHUNK_BYTES + 4)[4:][: len(whole)]
        path.write_bytes({"flip": flipped, "truncate": whole[:-1], "empty": b"", "exchange": exchanged}[damage])
    out = tmp_path / "out.onnx"
    for read in (store.get, store.verify, store.pin, lambda c: store.fetch(c, out)):
        with pytest.raises(StoreError, match=str(block)):
            read(cid)
    assert list(tmp_path.glob("*out*")) == [], "nothing half-written"
    store.put(content(CHUNK_BYTES + 100))
    assert store.get(cid) == content(CHUNK_BYTES + 100), "adding it again heals it"


def store_tree(store: LocalStore, links: list[Link]) -> Cid:
    block = encode_node(links)
    cid = Cid.of_block(DAG_PB, block)
    store._write_block(cid, block)
    return cid


def test_a_node_that_announces_another_size_is_refused(store):
    leaf = store.put(b"12345")
    with pytest.raises(StoreError, match=r": is '5 bytes'; expected the 6"):
        store.get(store_tree(store, [Link(leaf, 6, 5)]))
    with pytest.raises(StoreError, match="does not fit its parent"):
        store.get(store_tree(store, [Link(store_tree(store, [Link(leaf, 5, 5)]), 9, 60)]))


def test_a_tree_made_to_be_huge_or_deep_is_refused(store):
    leaf = store.put(b"12345")
    huge = store_tree(store, [Link(leaf, MAX_MODEL_BYTES, 5)] * 3)
    with pytest.raises(StoreError, match=f"expected at most {MAX_MODEL_BYTES} bytes"):
        store.verify(huge)
    with pytest.raises(StoreError, match=f"expected at most {MAX_IN_MEMORY} bytes"):
        store.get(huge)
    cid = leaf
    for _ in range(40):
        cid = store_tree(store, [Link(cid, 5, 5)])
    with pytest.raises(StoreError, match="does not fit its parent"):
        store.verify(cid)


def test_one_block_that_is_linked_to_over_and_over_is_no_bomb(store, tmp_path):
    """Two blocks on the disk, and a file of a limit's length and more: it is not put together in memory."""
    leaf = store.put(b"x" * CHUNK_BYTES)
    node = store_tree(store, [Link(leaf, CHUNK_BYTES, CHUNK_BYTES)] * 44)
    bomb = store_tree(store, [Link(node, 44 * CHUNK_BYTES, 1)] * 10)
    with pytest.raises(StoreError, match=r"is 'a file of 461373440 bytes'; expected at most"):
        store.get(bomb)
    with pytest.raises(StoreError, match="expected at most 1000 bytes"):
        FallbackStore([store], lambda fault: pytest.fail(str(fault))).get(node, max_bytes=1000)
    assert len(store.get(node)) == 44 * CHUNK_BYTES


def test_small_chunks_are_refused_at_the_first(store):
    leaf = store.put(b"1")
    reads = []
    block = store._block
    store._block = lambda cid: reads.append(cid) or block(cid)
    node = store_tree(store, [Link(leaf, 1, 1)] * 174)
    tree = store_tree(store, [Link(node, 174, 1)] * 174)
    with pytest.raises(StoreError, match="a chunk of 1 bytes"):
        store.verify(tree)
    assert len(reads) < 10


def test_whether_a_tree_of_repeated_links_is_here_takes_no_longer_than_its_blocks(store):
    cid = store.put(b"12345")
    size = 5
    for _ in range(6):
        cid = store_tree(store, [Link(cid, size, 5)] * 100)
        size *= 100
    reads = []
    block = store._block
    store._block = lambda cid: reads.append(cid) or block(cid)
    assert store.has(cid)
    assert len(reads) == 6
    with pytest.raises(StoreError, match="levels"):
        store.has(store_tree(store, [Link(cid, size, 5)]))


def test_a_block_that_is_a_large_file_is_not_read_whole(store):
    cid = store.put(b"12345")
    with store._path(cid).open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(StoreError, match="damaged"):
        store.get(cid)


def test_a_name_that_is_no_address_in_the_pins_is_told(store):
    store.put(b"x")
    (store.root / "pins" / "notes.txt").write_text("")
    with pytest.raises(StoreError, match=r"pin: is 'notes\.txt'; expected a CIDv1"):
        store.models()


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="expected a folder that can be written"):
        LocalStore(tmp_path / "file").put(b"x")
    store = LocalStore(tmp_path / "store")
    with pytest.raises(StoreError, match="expected a path that can be written"):
        store.fetch(store.put(b"x"), tmp_path / "file" / "out")


def put_and_read(root: Path) -> bool:
    store = LocalStore(root)
    return all(store.get(store.put(content(size))) == content(size) for size in SIZES)


def test_several_processes_share_a_folder(store):
    with multiprocessing.get_context("spawn").Pool(3) as pool:
        assert all(pool.map(put_and_read, [store.root] * 6))
    assert {model.size for model in store.models()} == set(SIZES)
    assert not list(store.root.rglob(".*")), "no temporary file is left"


KEEP = """
import pathlib
from skyrelay.store.local import LocalStore
store = LocalStore(pathlib.Path("store"))
cid = store.put(pathlib.Path("model"))
size = store.fetch(cid, pathlib.Path("copy"))
print(size, *(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def test_a_large_model_passes_through_little_memory(tmp_path):
    with (tmp_path / "model").open("wb") as file:
        for start in range(0, 25_000_000, 250_000):
            file.write(array.array("I", range(start, start + 250_000)).tobytes())
    ran = subprocess.run([sys.executable, "-c", KEEP], cwd=tmp_path, capture_output=True, text=True, check=True)
    size, peak = map(int, ran.stdout.split())
    assert size == 100_000_000
    assert peak < 64 * 1024, "KiB"
    assert filecmp.cmp(tmp_path / "model", tmp_path / "copy", shallow=False)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_flipped_bit_of_any_block_is_found_and_the_block_named(tmp_path, data):
    store = LocalStore(tmp_path / "store")
    cid = store.put(content(CHUNK_BYTES + 100))
    path = data.draw(st.sampled_from(sorted((store.root / "blocks").rglob("baf*"))))
    whole = path.read_bytes()
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    path.write_bytes(whole[: bit // 8] + bytes([whole[bit // 8] ^ 1 << bit % 8]) + whole[bit // 8 + 1 :])
    with pytest.raises(StoreError, match=rf"block {path.name}: is 'damaged"):
        store.get(cid)
    path.write_bytes(whole)
    assert store.verify(cid) == CHUNK_BYTES + 100
