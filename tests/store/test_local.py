"""The store in a folder: what goes in comes back, or is refused by name."""

import multiprocessing
from pathlib import Path

import pytest

from skyrelay.core.errors import StoreError
from skyrelay.store.cid import CHUNK_BYTES, DAG_PB, Cid, Link, cid_of, encode_node
from skyrelay.store.local import LocalStore
from skyrelay.store.model_store import MAX_MODEL_BYTES, StoredModel


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
    with pytest.raises(StoreError, match=f"expected at most {MAX_MODEL_BYTES} bytes"):
        store.get(store_tree(store, [Link(leaf, MAX_MODEL_BYTES, 5)] * 3))
    cid = leaf
    for _ in range(40):
        cid = store_tree(store, [Link(cid, 5, 5)])
    with pytest.raises(StoreError, match="does not fit its parent"):
        store.verify(cid)


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
