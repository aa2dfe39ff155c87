"""Prometheus' endpoint and the logs."""

import io
import json
import logging
import subprocess

import pytest
import requests
from prometheus_client.parser import text_string_to_metric_families
from town_of_processes import skyrelay

from skyrelay.chain.accounts import Keyring
from skyrelay.cli.ending import one_line_for_the_unforeseen
from skyrelay.core.errors import ChainError, HostError, UsageError
from skyrelay.pilot.logs import LOGGER, Redactor, configure
from skyrelay.pilot.metrics import Metrics
from skyrelay.protocol.beacon import BeaconGate, Session
from skyrelay.protocol.messages import Beacon


@pytest.fixture(autouse=True)
def _logger_as_it_was(monkeypatch):
    """What configures the process's logger does so for one test."""
    logger = logging.getLogger(LOGGER)
    for name in ("handlers", "level", "propagate"):
        monkeypatch.setattr(logger, name, getattr(logger, name))


def samples(text):
    return {
        (sample.name, *(value for key, value in sorted(sample.labels.items()) if key != "member")): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_a_gates_counts_are_there_when_asked_for():
    contract, ring = ("0x" + "c0" * 20, 1), Keyring(b"k" * 32)
    uav = ring.account("uav")
    gate = BeaconGate(contract, {uav}, set(), {1}, patience=5.0)
    session = Session(uav, contract, lambda message: ring.vouch(uav, message), 0.0, 100.0)
    metrics = Metrics("host one")
    metrics.counter("beacons_admitted", "Beacons let in", lambda: gate.admitted)
    metrics.counter("beacons_dropped", "Beacons dropped", gate.dropped_by_reason, label="reason")
    metrics.gauge("battery_percent", "Battery", lambda: 71.5)
    with metrics.serve("127.0.0.1:0") as server:
        before = samples(requests.get(server.url, timeout=10).text)
        assert before["skyrelay_beacons_admitted_total",] == 0
        raw = session.seal(Beacon(uav, 1, None, (0.0, 0.0), 1.0))
        for content in (raw, raw, b"nonsense", b""):
            gate.admit(content, 1.0)
        metrics.decided(0.0003)
        answer = requests.get(server.url, timeout=10)
        after = samples(answer.text)
        assert 'member="host one"' in answer.text
        assert requests.get(server.url.replace("/metrics", "/"), timeout=10).status_code == 404
    assert after["skyrelay_beacons_admitted_total",] == 1
    assert after["skyrelay_beacons_dropped_total", "replayed"] == 1
    assert after["skyrelay_beacons_dropped_total", "malformed"] == 2
    assert after["skyrelay_beacons_dropped_total", "forged"] == 0
    assert after["skyrelay_battery_percent",] == 71.5
    assert after["skyrelay_decision_seconds_bucket", "0.0005"] == 1
    assert after["skyrelay_decision_seconds_bucket", "0.0002"] == 0


def test_elsewhere_than_on_loopback_only_with_a_token():
    with pytest.raises(UsageError, match=r"--metrics: is .*a token"):
        Metrics("x").serve("0.0.0.0:0")
    with Metrics("x").serve("0.0.0.0:0", token="a secret") as server:  # noqa: S106
        url = server.url.replace("0.0.0.0", "127.0.0.1")  # noqa: S104
        assert requests.get(url, timeout=10).status_code == 401
        allowed = requests.get(url, headers={"authorization": "Bearer a secret"}, timeout=10)
        assert allowed.status_code == 200
        with pytest.raises(UsageError, match="an address that is free"):
            Metrics("y").serve(url.removeprefix("http://").removesuffix("/metrics"))


def test_json_lines(monkeypatch):
    monkeypatch.setenv("SKYRELAY_KEYSTORE_PASSWORD", "correct horse")
    monkeypatch.setenv("SKYRELAY_KEYSTORE_PASSWORD_FILE", "where/it/is")
    stream = io.StringIO()
    logger = configure("uav 3", as_json=True, stream=stream)
    logger.info("opened with %s", "correct horse", extra={"fields": {"block": 7, "url": "http://me:pw@192.0.2.1:1"}})
    try:
        int("correct horse")
    except ValueError:
        logger.exception("a line\nand another")
    first, second = (json.loads(line) for line in stream.getvalue().splitlines())
    assert first["message"] == "opened with [redacted]"
    assert (first["level"], first["member"], first["block"]) == ("info", "uav 3", 7)
    assert first["url"] == "http://[redacted]@192.0.2.1:1"
    assert second["message"] == "a line\nand another"
    assert "[redacted]" in second["trace"]
    assert "correct horse" not in stream.getvalue()


def test_lines_for_people_keep_no_secret_either(monkeypatch):
    monkeypatch.setenv("SKYRELAY_CHAIN_TOKEN", "s3cret-token")
    stream = io.StringIO()
    configure("x", as_json=False, stream=stream).info("Authorization: Bearer abc.def and s3cret-token")
    assert stream.getvalue() == "Authorization: Bearer [redacted] and [redacted]\n"


def test_the_longer_secret_is_hidden_whole():
    assert Redactor(["secret", "secret and more", "x"])("secret and more, x") == "[redacted], x"


def test_the_last_words_of_a_process_that_speaks_json_are_json(tmp_path):
    agent = skyrelay("agent", "uav", "--config", tmp_path / "none.toml", "--log-json", stderr=subprocess.PIPE)
    _, told = agent.communicate(timeout=120)
    assert agent.returncode == 2
    (line,) = map(json.loads, told.splitlines())
    assert line["level"] == "error"
    assert "a readable TOML file" in line["message"]


@pytest.mark.parametrize(("level", "lines"), [(logging.INFO, 0), (logging.DEBUG, 1)])
def test_what_nobody_has_foreseen_is_one_line_and_its_trace_is_for_who_debugs(level, lines):
    stream = io.StringIO()
    logger = configure("one", as_json=True, stream=stream, level=level)
    told = pytest.raises(HostError, match=r"^host one: is 'ZeroDivisionError: division by zero'; expected")
    with told as caught, one_line_for_the_unforeseen("host one", logger):
        1 / 0  # noqa: B018
    assert caught.value.exit_code not in (0, 2)  # so that `up` starts it again
    written = stream.getvalue().splitlines()
    assert len(written) == lines
    assert all("ZeroDivisionError" in json.loads(line)["trace"] for line in written)
    with pytest.raises(ChainError), one_line_for_the_unforeseen("host one", logger):
        raise ChainError("chain", None, "an answer")
