"""`GET /metrics`: figures of the service, in the text format of Prometheus.

Figures counted elsewhere are read at each scrape; only the requests are counted here. A
service has its own registry, so that two in one process share nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import accumulate

from fastapi import APIRouter, Request, Response
from prometheus_client import CollectorRegistry, Histogram, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from truepath.catalogue.errors import StorageUnavailable
from truepath.machines.cell_counters import CellCounts
from truepath.machines.cell_status import CellStatus
from truepath.machines.machine_cells import Machines
from truepath.measurement.time_limits import BOUNDS_S, DurationHistogram
from truepath.service.api.problems import declare_problems
from truepath.service.api.route_roles import find_route
from truepath.service.api.routes.events import count_streams
from truepath.service.api.service import Service
from truepath_drivers import host_clock

_STREAMS = "/events"
_REQUEST_BOUNDS_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_AWAY = frozenset({"starting", "down"})
_EXAMPLE = 'truepath_cell_up{machine="mill-3"} 1.0\n'
_TEXT = {
    "description": "Text format 0.0.4 of Prometheus.",
    "content": {"text/plain": {"schema": {"type": "string"}, "example": _EXAMPLE}},
}

_Value = Callable[[CellStatus, CellCounts], float]
_GAUGES: tuple[tuple[str, str, _Value], ...] = (
    (
        "truepath_cell_up",
        "Whether the cell process lives.",
        lambda status, _: status.state not in _AWAY,
    ),
    (
        "truepath_cell_connected",
        "Whether tracker and controller answer.",
        lambda status, _: status.connected,
    ),
    (
        "truepath_recorder_queue_depth",
        "What waits to be written to the Run.",
        lambda _, counts: counts.queue_depth,
    ),
)
_COUNTERS: tuple[tuple[str, str, _Value], ...] = (
    (
        "truepath_cell_restarts",
        "Cell processes that ended.",
        lambda status, _: status.restarts,
    ),
    (
        "truepath_tracker_samples",
        "Samples recorded.",
        lambda _, counts: counts.samples,
    ),
    (
        "truepath_tracker_lost_samples",
        "Samples missing.",
        lambda _, counts: counts.lost_samples,
    ),
    (
        "truepath_tracker_gaps",
        "Places where samples are missing.",
        lambda _, counts: counts.gaps,
    ),
    (
        "truepath_tracker_crc_errors",
        "Frames refused.",
        lambda _, counts: counts.crc_errors,
    ),
)

router = APIRouter(tags=["system"])


class ServiceMetrics:
    """The figures of one service.

    service : None only to describe the interface
    """

    def __init__(self, service: Service | None) -> None:
        self.registry = CollectorRegistry()
        self._requests = Histogram(
            "truepath_request_seconds",
            "Time to answer a request, event streams left out.",
            ("method", "route", "status"),
            buckets=_REQUEST_BOUNDS_S,
            registry=self.registry,
        )
        if service is not None:
            self.registry.register(_ServiceCollector(service))
            ProcessCollector(registry=self.registry)

    def count_request(self, method: str, path: str, status: int, took_s: float) -> None:
        """Count an answered request by the template of its route."""
        _, _, route = find_route(method, path).partition(" ")
        if not route.endswith(_STREAMS):
            known = self._requests.labels(method, route or "none", str(status))
            known.observe(took_s)

    def render(self) -> bytes:
        """All figures as text."""
        return generate_latest(self.registry)


class RequestTimer:
    """Times every request; plain ASGI, outside all other middleware."""

    def __init__(self, app: ASGIApp, metrics: ServiceMetrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and time its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun_s, status = host_clock.now_s(), 0
        method, path = scope["method"], scope["path"]

        async def send_noted(message: Message) -> None:
            nonlocal status
            status = message.get("status", status)
            await send(message)

        try:
            await self._app(scope, receive, send_noted)
        finally:
            if status:
                took_s = host_clock.now_s() - begun_s
                self._metrics.count_request(method, path, status, took_s)


@router.get(
    "/metrics", response_class=Response, responses={200: _TEXT, **declare_problems()}
)
def get_metrics(request: Request) -> Response:
    """Return the numbers of the service for a plant's monitoring."""
    metrics: ServiceMetrics = request.app.state.metrics
    return Response(
        metrics.render(), headers={"Content-Type": CONTENT_TYPE_PLAIN_0_0_4}
    )


class _ServiceCollector(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def describe(self) -> Iterable[Metric]:
        """Empty: the names are not read before the first scrape."""
        return ()

    def collect(self) -> Iterator[Metric]:
        service = self._service
        info = {"version": service.version, "simulated": str(service.simulated).lower()}
        yield InfoMetricFamily("truepath", "The service.", value=info)
        yield _gauge("truepath_event_streams", "Open streams.", count_streams(service))
        free = service.free_bytes()
        yield _gauge("truepath_disk_free_bytes", "Free for Runs and results.", free)
        yield from _collect_jobs(service)
        yield from _collect_cells(service.machines)


def _collect_jobs(service: Service) -> Iterator[Metric]:
    try:
        counts = service.store.count_by_state()
    except StorageUnavailable:
        yield _gauge("truepath_catalogue_up", "Whether the catalogue answers.", 0)
        return
    yield _gauge("truepath_catalogue_up", "Whether the catalogue answers.", 1)
    family = GaugeMetricFamily(
        "truepath_jobs", "Jobs in the catalogue.", labels=("kind", "state")
    )
    for (kind, state), count in counts.items():
        family.add_metric((str(kind), str(state)), count)
    yield family


def _collect_cells(machines: Machines) -> Iterator[Metric]:
    read = {
        one.id: (one.cell.status, one.cell.counters.read())
        for one in machines.list_all()
    }
    for name, text, value in _GAUGES:
        family = GaugeMetricFamily(name, text, labels=("machine",))
        for machine, (status, counts) in read.items():
            family.add_metric((machine,), value(status, counts))
        yield family
    for name, text, value in _COUNTERS:
        family = CounterMetricFamily(name, text, labels=("machine",))
        for machine, (status, counts) in read.items():
            family.add_metric((machine,), value(status, counts))
        yield family
    yield from _collect_durations({one: counts for one, (_, counts) in read.items()})


def _collect_durations(read: dict[str, CellCounts]) -> Iterator[Metric]:
    commits = HistogramMetricFamily(
        "truepath_recorder_commit_seconds",
        "Time of a commit to the Run, its fsync included.",
        labels=("machine",),
    )
    commands = HistogramMetricFamily(
        "truepath_cell_command_seconds",
        "Time until the cell has confirmed a command.",
        labels=("machine", "command"),
    )
    for machine, counts in read.items():
        _add_durations(commits, (machine,), counts.commits)
        for command, durations in counts.commands.items():
            _add_durations(commands, (machine, command), durations)
    yield commits
    yield commands


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=value)


def _add_durations(
    family: HistogramMetricFamily, labels: tuple[str, ...], durations: DurationHistogram
) -> None:
    bounds = [*(str(bound) for bound in BOUNDS_S), "+Inf"]
    upto = list(zip(bounds, accumulate(durations.counts), strict=True))
    family.add_metric(labels, upto, durations.total_s)
