"""`/metrics` in OpenMetrics for Prometheus and Grafana: present values only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import get_args

from fastapi import APIRouter, Request
from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric
from prometheus_client.openmetrics.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector
from pydantic import TypeAdapter
from starlette.responses import Response

from daq_service.assessment.position_status import (
    PositionStatus,
    age_of,
    is_stale,
    latest_rows,
    limit_of,
    status_of,
)
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import AlarmRow, CommandRow, Quality
from daq_service.processes.disk_policy import LEVELS, outlook
from daq_service.processes.recorder_state import RecorderStatus, read_recorder_state
from daq_service.settings.tree import ScheduleSettings
from daq_service.shared_file import packaged_table
from daq_service.web.answers.models import problems
from daq_service.web.answers.version import distribution_version
from daq_service.web.context import Context, ContextOf, Freshness
from hardware_drivers.nanoseconds import NS_PER_S

probes = APIRouter(tags=["health"])
DESCRIPTIONS = TypeAdapter(dict[str, str]).validate_python(packaged_table(__file__))
S_PER_H = 3600.0

Labels = tuple[str, ...]
OPENMETRICS: dict[int | str, dict[str, object]] = {
    200: {"content": {"application/openmetrics-text": {"schema": {"type": "string"}}}},
    **problems(503),
}


@probes.get("/metrics", response_class=Response, responses=OPENMETRICS)
def get_metrics(request: Request, context: ContextOf) -> Response:
    """Return state, age and newest values of positions, and metrics of alarms, recorder, disk and service."""
    return exposition(chain(of_service(), of_clients(context), of_test(context)), request)


def exposition(metrics: Iterable[Metric], request: Request) -> Response:
    """Return metrics in the format of Prometheus, followed by the response times of this service."""
    registry = CollectorRegistry()
    registry.register(_FixedMetrics(metrics))
    present, times = (
        bytes(generate_latest(part))  # type: ignore[no-untyped-call] # the package does not annotate it
        for part in (registry, request.app.state.answer_times.registry)
    )
    return Response(present.removesuffix(b"# EOF\n") + times, media_type=CONTENT_TYPE_LATEST)


class _FixedMetrics(Collector):
    """Metrics that were read for one response."""

    def __init__(self, metrics: Iterable[Metric]) -> None:
        self._metrics = list(metrics)

    def collect(self) -> Iterable[Metric]:
        """Return the metrics, as `prometheus_client` calls for them."""
        return self._metrics


def of_service() -> Iterator[Metric]:
    """Yield the version of the service."""
    yield InfoMetricFamily("solimon", "Version of solimon", {"version": distribution_version()})


def of_clients(context: Context) -> Iterator[Metric]:
    """Yield the numbers of open streams of a test."""
    yield _gauge("stream_clients", context.hub.clients)
    yield _gauge("waveform_clients", context.live.clients)


def of_test(context: Context) -> Iterator[Metric]:
    """Yield the present metrics of a test; without data, only the status of its recorder."""
    yield from _of_notifications(context)
    has_data = context.has_data()
    yield _gauge("has_data", has_data)
    if has_data:
        yield from _of_data(context, context.freshness())
    else:
        yield _recorder(read_recorder_state(context.data_folder, []).status)


def _of_notifications(context: Context) -> Iterator[Metric]:
    """Yield the metrics of the receivers of notifications."""
    queues = context.notifications.queues.values()
    sent = CounterMetricFamily("solimon_notifications_sent", "Messages taken", labels=("receiver",))
    failed = CounterMetricFamily("solimon_notifications_failed", "Failed attempts", labels=("receiver",))
    for queue in queues:
        sent.add_metric((queue.name,), queue.state.sent)
        failed.add_metric((queue.name,), queue.state.failed)
    yield sent
    yield failed
    waiting: dict[Labels, int] = {(queue.name,): queue.state.waiting for queue in queues}
    yield _gauges("notifications_waiting", waiting, "receiver")


COUNTS = ("sets", "missed_sets", "partial_sets", "shots", "pulse_echo_records")


def _of_data(context: Context, fresh: Freshness) -> Iterator[Metric]:
    """Yield the metrics of recorder, stored data and disk."""
    catalogue = context.catalogue()
    yield _recorder(fresh.recorder.status)
    yield _gauge("heartbeat_age_seconds", fresh.recorder.beat_age_s)
    yield _gauge("write_age_seconds", fresh.wall_age_s)
    yield _gauge("test_hours", fresh.now_h)
    yield _gauge("paused", catalogue.paused() is not None)
    counts = catalogue.counts()
    for name in COUNTS:
        yield _counter(name, counts[name])
    yield _counter("alarms", catalogue.newest_id(AlarmRow))
    yield _counter("orders", catalogue.newest_id(CommandRow))
    disk = outlook(context.data_folder, context.settings.storage, context.settings.schedule, catalogue)
    yield _gauge("disk_free_bytes", disk.free_bytes)
    yield _gauge("disk_size_bytes", disk.total_bytes)
    yield _gauge("disk_needed_bytes", disk.needed_bytes)
    yield _states("disk_level", {(): disk.level}, LEVELS)
    active = map(fresh.standing, catalogue.rows(AlarmRow, active=True))
    numbers: Counter[Labels] = Counter(
        (row.kind, row.priority, row.state, row.position or "", row.suppressed or "") for row in active
    )
    labels = ("kind", "priority", "state", "position", "suppressed")
    yield _gauges("alarms_active", numbers, *labels)
    latest = latest_rows(catalogue, fresh, context.settings.positions)
    yield from _of_positions(context.settings.schedule, context.settings.thinnest_m, fresh, latest)


VALUES = (
    ("outlier", "last_assessment", "outlier"),
    ("distance_squared", "last_assessment", "distance_squared"),
    ("time_of_flight_seconds", "last_feature", "tof_pp_s"),
    ("amplitude_ratio", "last_feature", "amplitude_ratio"),
    ("thickness_meters", "last_thickness", "thickness_m"),
    ("thickness_loss_meters", "last_thickness", "thickness_loss_m"),
    ("last_set_shots", "last_set", "n_taken"),
    ("last_set_missed_shots", "last_set", "n_missed"),
)
"""Newest values of a position: metric, row and its column."""


def _of_positions(
    schedule: ScheduleSettings, thinnest_m: float, fresh: Freshness, summaries: Mapping[str, LatestRows]
) -> Iterator[Metric]:
    """Yield the metrics of each position, from its latest rows."""

    def gauge(name: str, value: Callable[[LatestRows], float | None]) -> Metric:
        samples: dict[Labels, float | None] = {(place,): value(last) for place, last in summaries.items()}
        return _gauges(name, samples, "position")

    def states(name: str, state: Callable[[LatestRows], str | None], known: object) -> Metric:
        present: dict[Labels, str | None] = {(place,): state(last) for place, last in summaries.items()}
        return _states(name, present, get_args(known), "position")

    def age_s(last: LatestRows) -> float | None:
        hours = age_of(last, fresh)
        return None if hours is None else S_PER_H * hours

    def value_of(row: str, column: str) -> Callable[[LatestRows], float | None]:
        return lambda last: getattr(getattr(last, row), column, None)

    def limit_of_row(row: str) -> Callable[[LatestRows], float | None]:
        return lambda last: None if getattr(last, row) is None else limit_of(last, thinnest_m)

    yield states("position_state", status_of, PositionStatus)
    yield states("quality", _quality, Quality)
    yield gauge(
        "stale",
        lambda last: is_stale(schedule, fresh, age_of(last, fresh)),
    )
    yield gauge("data_age_seconds", age_s)
    for name, row, column in VALUES:
        yield gauge(name, value_of(row, column))
    yield gauge("distance_squared_limit", limit_of_row("last_assessment"))
    yield gauge("thickness_limit_meters", limit_of_row("last_thickness"))
    yield gauge("last_set_start_delay_seconds", _delay_s)


def _quality(summary: LatestRows) -> str | None:
    """Return the quality of the newest result of a position."""
    measured = summary.last_feature or summary.last_thickness
    return None if measured is None else measured.quality


def _delay_s(summary: LatestRows) -> float | None:
    """Return the time in s from the due time of the newest set to its first strike."""
    row = summary.last_set
    if row is None or row.started_utc_ns is None:
        return None
    return (row.started_utc_ns - row.due_utc_ns) / NS_PER_S


def _recorder(status: str) -> Metric:
    """Return the metric of the recorder's state."""
    return _states("recorder_state", {(): status}, get_args(RecorderStatus))


def _counter(name: str, number: int) -> Metric:
    """Return a counter."""
    return CounterMetricFamily(f"solimon_{name}", DESCRIPTIONS[name], value=number)


def _gauge(name: str, number: float | None) -> Metric:
    """Return a gauge; without a value it is absent."""
    return _gauges(name, {(): number})


def _gauges(name: str, samples: Mapping[Labels, float | None], *labels: str) -> Metric:
    """Return a number by the values of its labels; None is omitted."""
    family = GaugeMetricFamily(f"solimon_{name}", DESCRIPTIONS[name], labels=labels)
    for of_labels, number in samples.items():
        if number is not None:
            family.add_metric(of_labels, float(number))
    return family


def _states(name: str, present: Mapping[Labels, str | None], known: Iterable[str], *labels: str) -> Metric:
    """Return one sample per state, 1 for the present one."""
    samples = {
        (*of_labels, state): float(state == status)
        for of_labels, status in present.items()
        for state in known
        if status
    }
    return _gauges(name, samples, *labels, "state")
