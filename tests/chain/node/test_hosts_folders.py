"""Validators on several hosts: what each host's folder holds, and files that do not fit."""

import json
import tomllib

import pytest
import rlp
from eth_keys.datatypes import PrivateKey

from skyrelay.chain.node.hosts import write_hosts
from skyrelay.core.errors import UsageError

OWN = PrivateKey(b"\x07" * 32)


def hosts_file(folder, text):
    path = folder / "hosts.toml"
    path.write_text(text)
    return path


def host(name, address, more=""):
    return f'[[host]]\nname = "{name}"\naddress = "{address}"\n{more}\n'


def test_each_folder_has_its_own_key_all_peers_and_the_same_genesis(tmp_path):
    own = f'public_key = "{OWN.public_key.to_hex()}"'
    text = "chain_id = 99\nperiod = 2\n" + host("alpha", "192.0.2.1") + host("beta", "2001:db8::2", "p2p_port = 30400")
    founded = write_hosts(tmp_path / "net", hosts_file(tmp_path, text + host("gamma", "192.0.2.3", own)))
    homes = {name: tmp_path / "net" / "hosts" / name for name in ("alpha", "beta", "gamma")}
    assert founded.keyless == ("gamma",)
    assert founded.validators["gamma"].address == OWN.public_key.to_checksum_address()
    genesis = {(home / "genesis.json").read_bytes() for home in homes.values()}
    assert len(genesis) == 1
    told = json.loads(genesis.pop())
    assert (told["config"]["chainId"], told["config"]["qbft"]["blockperiodseconds"]) == (99, 2)
    named = rlp.decode(bytes.fromhex(told["extraData"][2:]))[1]
    assert named == sorted(bytes.fromhex(node.address[2:]) for node in founded.validators.values())
    for name, home in homes.items():
        config = tomllib.loads((home / "config.toml").read_text())
        assert config["Node"]["HTTPHost"] == "127.0.0.1", "JSON-RPC is on loopback alone"
        peers = config["Node"]["P2P"]["StaticNodes"]
        assert sorted(peers) == sorted(node.enode for other, node in founded.validators.items() if other != name)
        assert (home / "start.sh").stat().st_mode & 0o100
    beta = tomllib.loads((homes["beta"] / "config.toml").read_text())
    assert beta["Node"]["P2P"]["ListenAddr"] == "[2001:db8::2]:30400"
    assert not (homes["gamma"] / "geth" / "nodekey").exists()
    secrets = [(homes[name] / "geth" / "nodekey") for name in ("alpha", "beta")]
    for name, secret in zip(("alpha", "beta"), secrets, strict=True):
        assert secret.stat().st_mode & 0o077 == 0
        key = PrivateKey(bytes.fromhex(secret.read_text()))
        assert key.public_key.to_checksum_address() == founded.validators[name].address
        others = [path for path in (tmp_path / "net").rglob("*") if path.is_file() and path != secret]
        assert not [path for path in others if secret.read_bytes() in path.read_bytes()], "nobody else has it"


def test_a_host_without_its_key_says_so(tmp_path, subprocess_run):
    own = f'public_key = "{OWN.public_key.to_hex()}"'
    write_hosts(tmp_path / "net", hosts_file(tmp_path, host("alpha", "192.0.2.1", own)))
    done = subprocess_run([tmp_path / "net" / "hosts" / "alpha" / "start.sh"])
    assert done.returncode == 2
    assert "geth/nodekey is missing" in done.stderr


@pytest.fixture
def subprocess_run():
    import subprocess

    return lambda command: subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "host: expected Field required"),
        ("host = 3", "host: is 3; expected a valid list"),
        (host("alpha", "example.org"), "host.0.address: is 'example.org'; expected an IP address"),
        (host("alpha", "0.0.0.0"), "expected the address of one host"),  # noqa: S104
        (host("alpha", "fe80::1%eth0"), "expected the address of one host"),
        (host("../alpha", "192.0.2.1"), "host.0.name"),
        (host("alpha", "192.0.2.1") * 2, "name: is 'alpha'; expected each host's own"),
        (host("alpha", "192.0.2.1") + host("beta", "192.0.2.1"), "address and p2p_port"),
        (host("alpha", "192.0.2.1", "p2p_port = 0"), "host.0.p2p_port: is 0"),
        (host("alpha", "192.0.2.1", "rpc_port = true"), "host.0.rpc_port: is True"),
        (host("alpha", "192.0.2.1", 'public_key = "00"'), "host.0.public_key"),
        (host("alpha", "192.0.2.1", f'public_key = "{"11" * 64}"'), "a secp256k1 public key"),
        (host("alpha", "192.0.2.1", "color = 1"), "host.0.color: expected Extra inputs"),
        ("chain_id = 0\n" + host("alpha", "192.0.2.1"), "chain_id: is 0"),
        ("[[host", "expected TOML"),
    ],
)
def test_a_file_that_does_not_fit_is_one_line_and_leaves_nothing(tmp_path, text, told):
    file = hosts_file(tmp_path, text)
    with pytest.raises(UsageError) as refused:
        write_hosts(tmp_path / "net", file)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == [file]
