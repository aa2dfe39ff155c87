"""The bus with certificates: nobody reads on the way, and who has none of the fleet's is not let in."""

import datetime
import ipaddress
import socket
import threading

import pytest
import tomli_w
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from processes import free_port, until

from skyrelay.core.errors import BusError, UsageError
from skyrelay.pilot.bus import Bus, Certificates
from skyrelay.pilot.config import BusAccess, load_config

SECRET = b"where v017 is: 12.5 7.25"


def pem(key):
    kind, plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    return key.private_bytes(serialization.Encoding.PEM, kind, plain)


def certified(name, key, issuer, signing, *, authority):
    now = datetime.datetime.now(datetime.UTC)
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    builder = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)]))
        .issuer_name(x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, issuer)]))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(hours=1))
        .add_extension(x509.BasicConstraints(ca=authority, path_length=None), critical=True)
        .add_extension(address, critical=False)
    )
    return builder.sign(signing, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


@pytest.fixture(scope="module")
def fleets(tmp_path_factory):
    """Certificates of two fleets, each with an authority of its own."""
    made = []
    for name in ("ours", "theirs"):
        folder = tmp_path_factory.mktemp(name)
        signing, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
        (folder / "ca.pem").write_bytes(certified(name, signing, name, signing, authority=True))
        (folder / "host.pem").write_bytes(certified("host", key, name, signing, authority=False))
        (folder / "host-key.pem").write_bytes(pem(key))
        made.append(Certificates(*(folder / file for file in ("ca.pem", "host.pem", "host-key.pem"))))
    return made


class Wire:
    """A way to a port that somebody listens in on."""

    def __init__(self, port):
        self._to, self._server, self.heard = port, socket.create_server(("127.0.0.1", 0)), bytearray()
        self.port = self._server.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            near = self._server.accept()[0]
            far = socket.create_connection(("127.0.0.1", self._to))
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one, other):
        try:
            while content := one.recv(65536):
                self.heard += content
                other.sendall(content)
        except OSError:
            return


def talk(kind, certificates):
    """One peer tells another, whom it reaches by a wire only; what was heard on the wire."""
    port = free_port()
    wire = Wire(port)
    with (
        Bus("hearer", listen=[f"{kind}/127.0.0.1:{port}"], certificates=certificates) as hearer,
        Bus("sender", [f"{kind}/127.0.0.1:{wire.port}"], [], certificates=certificates) as sender,
    ):
        heard = hearer.subscribe("skyrelay/places")
        until(lambda: sender.publish("skyrelay/places", SECRET) or heard.take(0.05))
    return bytes(wire.heard)


def test_who_listens_in_on_the_way_reads_nothing(fleets):
    assert SECRET in talk("tcp", None)
    encrypted = talk("tls", fleets[0])
    assert len(encrypted) > len(SECRET)
    assert SECRET not in encrypted
    assert b"skyrelay/places" not in encrypted


def test_who_has_no_certificate_of_the_fleet_s_authority_is_not_let_in(fleets):
    ours, theirs = fleets
    place = f"127.0.0.1:{free_port()}"
    with Bus("server", listen=[f"tls/{place}"], certificates=ours) as server:
        for certificates, kind in ((theirs, "tls"), (None, "tcp")):
            with pytest.raises(BusError, match="a peer that answers"):
                Bus("stranger", [f"{kind}/{place}"], [], certificates=certificates, patience=0.5)
        mixed = Certificates(ours.authority, theirs.certificate, theirs.key)  # it takes ours for true, and has another
        try:
            with Bus("stranger", [f"tls/{place}"], [], certificates=mixed, patience=0.5) as stranger:
                assert stranger.peers == 0
        except BusError:
            pass
        assert server.peers == 0
        with Bus("member", [f"tls/{place}"], [], certificates=ours):
            until(lambda: server.peers == 1)


def test_a_file_that_is_not_there_is_one_line(fleets, tmp_path):
    missing = Certificates(fleets[0].authority, fleets[0].certificate, tmp_path / "none.pem")
    with pytest.raises(BusError, match=r"none\.pem: expected a file in PEM"):
        Bus("peer", listen=[f"tls/127.0.0.1:{free_port()}"], certificates=missing)


@pytest.mark.parametrize(
    "bus",
    [
        {"connect": ["tls/127.0.0.1:7447"]},
        {"connect": ["tcp/127.0.0.1:7447"], "tls": {"authority": "a", "certificate": "b", "key": "c"}},
        {"connect": ["tls/127.0.0.1:7447"], "tls": {"authority": "a"}},
    ],
)
def test_half_of_it_in_a_file_is_one_line(tmp_path, bus):
    file = tmp_path / "uavs.toml"
    area = {"x0": 0.0, "y0": 0.0, "side": 1.0, "columns": 1, "rows": 1}
    chain = {"urls": ["http://127.0.0.1:1"], "chain_id": 1, "contract": "0x" + "a" * 40, "keystore": "k"}
    tree = {"name": "uavs", "scenario": "s", "area": area, "chain": chain, "store": {"path": "s"}, "bus": bus}
    file.write_text(tomli_w.dumps(tree))
    with pytest.raises(UsageError, match=r"bus|tls"):
        load_config(file)
    file.write_text(tomli_w.dumps(tree | {"bus": {"connect": ["tls/127.0.0.1:7447"], "tls": dict.fromkeys(TLS, "x")}}))
    access = load_config(file).bus
    assert access.certificates() == Certificates(*[tmp_path / "x"] * 3)
    assert access.listens() == ["tls/127.0.0.1:0"]
    assert BusAccess().certificates() is None


TLS = ("authority", "certificate", "key")
