"""What an agent's process counts, for Prometheus: read where it is counted, at the moment somebody asks.

This is the only place that knows prometheus-client.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from socketserver import ThreadingMixIn
from types import TracebackType
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client import CollectorRegistry, Histogram, make_wsgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from skyrelay.core.errors import UsageError
from skyrelay.pilot.access import Access

Reading = Callable[[], float | Mapping[str, float]]
"""A figure, or one for each value of its label."""


class Metrics:
    """Figures of one process.

    Args:
        member: a name for the process, which labels all of them.
    """

    def __init__(self, member: str) -> None:
        self._member = member
        self._registry = CollectorRegistry()
        self._readings: list[tuple[str, str, str, str, Reading]] = []
        self._registry.register(_Readings(self._families))
        self._decisions = Histogram(
            "skyrelay_decision_seconds",
            "Time from a UAV's beacons to its move",
            labelnames=("member",),
            buckets=(0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.05, 0.25),
            registry=self._registry,
        ).labels(member)

    def counter(self, name: str, text: str, read: Reading, label: str = "") -> None:
        """A figure that only grows, ``skyrelay_NAME_total``; with a ``label``, one for each value of it."""
        self._readings.append(("counter", name, text, label, read))

    def gauge(self, name: str, text: str, read: Reading, label: str = "") -> None:
        """A figure that goes up and down, ``skyrelay_NAME``."""
        self._readings.append(("gauge", name, text, label, read))

    def decided(self, seconds: float) -> None:
        """A UAV has decided."""
        self._decisions.observe(seconds)

    def serve(self, listen: str, token: str | None = None) -> MetricsServer:
        """Answer ``/metrics``, once the server is entered.

        Raises:
            UsageError: the address is none or taken, or is not loopback and there is no token.
        """
        return MetricsServer(self._registry, Access(listen, token, "--metrics"), listen)

    def _families(self) -> Iterable[Metric]:
        for kind, name, text, label, read in self._readings:
            family: CounterMetricFamily | GaugeMetricFamily
            labels = ["member", label] if label else ["member"]
            cls = CounterMetricFamily if kind == "counter" else GaugeMetricFamily
            family = cls(f"skyrelay_{name}", text, labels=labels)
            value = read()
            if isinstance(value, Mapping):
                for key, number in value.items():
                    family.add_metric([self._member, key], number)
            else:
                family.add_metric([self._member], value)
            yield family


class _Readings(Collector):
    def __init__(self, families: Callable[[], Iterable[Metric]]) -> None:
        self._families = families

    def collect(self) -> Iterable[Metric]:
        return self._families()


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _Handler(WSGIRequestHandler):
    timeout = 10.0

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: somebody asks every few seconds."""


class MetricsServer:
    """Answers ``/metrics`` while it is entered; see `Metrics.serve`."""

    def __init__(self, registry: CollectorRegistry, access: Access, listen: str) -> None:
        self._access, self._metrics = access, make_wsgi_app(registry)
        try:
            self._http = make_server(*access.address, self._answer, server_class=_Server, handler_class=_Handler)
        except OSError as error:
            raise UsageError("--metrics", listen, f"an address that is free ({error.strerror})") from None

    @property
    def url(self) -> str:
        """Where it answers."""
        host, port = self._http.server_address[:2]
        return f"http://{host!s}:{port}/metrics"

    def __enter__(self) -> MetricsServer:
        threading.Thread(target=self._http.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.shutdown()
        self._http.server_close()

    def _answer(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        if not self._access.allows(environ.get("HTTP_AUTHORIZATION")):
            start_response("401 Unauthorized", [("content-type", "text/plain")])
            return [b"the server's token is expected\n"]
        if environ.get("PATH_INFO") != "/metrics":
            start_response("404 Not Found", [("content-type", "text/plain")])
            return [b"/metrics is all there is\n"]
        answer: Iterable[bytes] = self._metrics(environ, start_response)
        return answer
