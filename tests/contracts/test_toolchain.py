"""What needs node and the npm packages of contracts/: `npm ci` there first. Run by `make test-contracts`."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

CONTRACTS = Path(__file__).parents[2] / "contracts"
ARTIFACTS = CONTRACTS.parent / "src" / "skyrelay" / "chain" / "artifacts"


def npm(*arguments: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("npm")
    if program is None:
        pytest.fail("npm is not on PATH: tests marked `contracts` need Node.js 20 or later")
    if not (CONTRACTS / "node_modules" / "solc").is_dir():
        pytest.fail("contracts/node_modules is not there: run `npm ci` in contracts/")
    return subprocess.run([program, "run", *arguments], cwd=CONTRACTS, capture_output=True, text=True, check=False)


@pytest.mark.contracts
def test_committed_artifacts_are_what_the_sources_give():
    done = npm("check")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.contracts
def test_foundry_unit_fuzz_and_invariant_tests_pass():
    done = npm("test")
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-2000:]
    assert re.search(r"0 failed", done.stdout)


@pytest.mark.contracts
def test_slither_has_nothing_to_say():
    slither = os.environ.get("SLITHER") or shutil.which("slither")
    if slither is None:
        pytest.fail(
            "slither is not on PATH (nor in $SLITHER): pip install slither-analyzer==0.11.6 in a venv of its own"
        )
    environment = {**os.environ, "SLITHER": slither}
    done = subprocess.run(
        ["npm", "run", "slither"], cwd=CONTRACTS, capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-8000:]


def test_foundry_compiles_with_the_settings_of_the_artifacts():
    profiles = tomllib.loads((CONTRACTS / "foundry.toml").read_text())["profile"]
    profile = profiles["default"] | profiles["source"]
    settings = json.loads((CONTRACTS / "settings.json").read_text())
    assert profile["evm_version"] == settings["evmVersion"] == "london"
    assert profile["via_ir"] == settings["viaIR"]
    assert profile["optimizer"] == settings["optimizer"]["enabled"]
    assert profile["optimizer_runs"] == settings["optimizer"]["runs"]
    assert profile["bytecode_hash"] == settings["metadata"]["bytecodeHash"]
    assert profile["cbor_metadata"] == settings["metadata"]["appendCBOR"]


def test_both_parts_lay_their_storage_out_alike():
    """The extension works on the contract's storage: what it knows of it must be where the contract has it."""
    contract, extension = (
        json.loads((ARTIFACTS / f"{name}.json").read_text())["storageLayout"]["storage"]
        for name in ("SkyRelay", "SkyRelayExtension")
    )
    assert extension[: len(contract)] == contract
    assert [entry["label"] for entry in extension[len(contract) :]][:1] == ["_roles"]


def test_no_function_of_the_two_parts_has_the_same_selector_but_for_the_roles_names():
    methods = {}
    for name in ("SkyRelay", "SkyRelayExtension"):
        abi = json.loads((ARTIFACTS / f"{name}.json").read_text())
        methods[name] = abi["methodIdentifiers"]
    extension = methods["SkyRelayExtension"]
    assert extension.items() <= methods["SkyRelay"].items()
    assert len(set(methods["SkyRelay"].values())) == len(methods["SkyRelay"])


def test_the_lock_file_names_no_registry():
    lock = (CONTRACTS / "package-lock.json").read_text()
    assert "resolved" not in lock
    assert all("integrity" in entry for path, entry in json.loads(lock)["packages"].items() if path)
