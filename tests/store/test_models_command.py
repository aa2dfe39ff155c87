"""`skyrelay models`: what it prints, what it writes, what it refuses."""

import json
import socket

import pytest
from typer.testing import CliRunner

from skyrelay.cli.main import main
from skyrelay.cli.models import app
from skyrelay.core.errors import ModelError, StoreError, UsageError
from skyrelay.policy import Policy
from skyrelay.store.cid import cid_of
from skyrelay.store.local import LocalStore

MODEL = b"a model" * 1000
CID = str(cid_of(MODEL))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "policy.onnx").write_bytes(MODEL)
    return tmp_path


def run(*arguments):
    result = CliRunner().invoke(app, arguments, catch_exceptions=True)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_a_model_goes_in_and_out_by_its_address(folder):
    assert CID in run("add", "policy.onnx").stdout
    assert (folder / "models" / "pins" / CID).is_file(), "the default store"
    assert json.loads(run("add", "policy.onnx", "--json").stdout) == {"policy.onnx": CID}
    assert json.loads(run("list", "--json").stdout) == {CID: len(MODEL)}
    assert json.loads(run("verify", CID, "--json").stdout) == {
        "cid": CID,
        "bytes": len(MODEL),
        "verified": True,
        "profile": "unixfs-v1-2025",
    }
    assert json.loads(run("get", CID, "--out", "copy.onnx", "--json").stdout)["bytes"] == len(MODEL)
    assert (folder / "copy.onnx").read_bytes() == MODEL


def test_pin_brings_a_model_from_the_second_store_to_the_first_and_says_so(folder):
    LocalStore(folder / "far").put(MODEL)
    ran = run("pin", CID, "--store", "near", "--store", "far")
    assert "asked the next store: store near" in ran.stderr
    assert LocalStore(folder / "near").get(cid_of(MODEL)) == MODEL
    assert LocalStore(folder / "near").models()[0].cid == cid_of(MODEL)


def test_an_empty_store_says_what_to_do(folder):
    assert "skyrelay models add FILE" in run("list").stderr
    assert json.loads(run("list", "--json").stdout) == {}


def test_a_file_that_is_there_is_not_replaced_unasked(folder):
    run("add", "policy.onnx")
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"--out mine\.txt: expected a file that is not there yet, or --force"):
        run("get", CID, "--out", "mine.txt")
    assert (folder / "mine.txt").read_text() == "mine"
    run("get", CID, "--out", "mine.txt", "--force")
    assert (folder / "mine.txt").read_bytes() == MODEL


@pytest.mark.parametrize("command", [["verify"], ["pin"], ["get", "--out", "x"]])
def test_an_address_that_is_none_is_refused_before_anything_is_asked(folder, command):
    with pytest.raises(StoreError, match=rf"models {command[0]}: CID: is '\.\./\.\./etc/passwd'; expected a CIDv1"):
        run(command[0], "../../etc/passwd", *command[1:])
    assert sorted(path.name for path in folder.iterdir()) == ["policy.onnx"]


def test_a_file_that_is_not_there_stops_all_before_anything_is_kept(folder):
    with pytest.raises(UsageError, match=r"models add absent\.onnx: expected a file that is there"):
        run("add", "policy.onnx", "absent.onnx")
    assert not (folder / "models").exists()


def test_a_fault_is_one_line_and_status_2(folder, monkeypatch, capsys):
    run("add", "policy.onnx")
    path = folder / "models" / "blocks" / CID[-2:] / CID
    path.write_bytes(MODEL[:-1])
    monkeypatch.setattr("sys.argv", ["skyrelay", "models", "get", CID, "--out", "out.onnx"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert f"store models: block {CID}: is 'damaged (its 6999 bytes hash to bafkrei" in told[0]
    assert not (folder / "out.onnx").exists()


def test_a_policy_is_signed_published_and_verified_without_a_network(folder, monkeypatch):
    policy = folder / "generalist.onnx"
    policy.write_bytes(Policy.builtin("generalist").content)
    monkeypatch.setenv("SKYRELAY_KEYSTORE_PASSWORD", "a password")
    run("key", "ours.pem")
    run("key", "theirs.pem")
    signing = ("--key", "ours.pem", "--commit", "1f2e3d4", "--days", "30")
    made = json.loads(run("sign", "generalist.onnx", *signing, "--out", "signed.onnx", "--json").stdout)
    assert run("add", "signed.onnx").stdout.split()[-1] == made["cid"]

    def no_network(*_arguments):
        raise AssertionError("a network was asked")

    monkeypatch.setattr(socket.socket, "connect", no_network)
    for model in ("signed.onnx", made["cid"]):
        told = json.loads(run("verify", model, "--key", "theirs.pem.pub", "--key", "ours.pem.pub", "--json").stdout)
        assert told["cid"] == made["cid"]
        assert told["expires"] == made["expires"]
        assert told["profile"] == "unixfs-v1-2025"
        assert told["provenance"]["commit"] == "1f2e3d4"
        assert told["provenance"]["evaluation"]
    with pytest.raises(ModelError, match=r"by the key [0-9a-f]{64}'; expected one by a trusted key"):
        run("verify", "signed.onnx", "--key", "theirs.pem.pub")
    with pytest.raises(ModelError, match="without a signature"):
        run("verify", "generalist.onnx", "--key", "ours.pem.pub")
    with pytest.raises(UsageError, match="--key PUBLIC"):
        run("verify", "signed.onnx")
    with pytest.raises(UsageError, match="not there yet, or --force"):
        run("sign", "generalist.onnx", *signing, "--out", "signed.onnx")
