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
    find_data_age_h,
    find_limit,
    find_status,
    is_data_stale,
    read_latest_rows,
)
from daq_service.catalogue.reader import LatestRows
from daq_service.catalogue.rows import AlarmRow, CommandRow, Quality
from daq_service.processes.disk_policy import LEVELS, forecast_disk
from daq_service.processes.recorder_state import RecorderStatus, read_recorder_state
from daq_service.settings.tree import ScheduleSettings
from daq_service.shared_file import load_module_toml
from daq_service.web.answers.models import describe_errors
from daq_service.web.answers.version import read_installed_version
from daq_service.web.context import Context, ContextOf, Freshness
from hardware_drivers.nanoseconds import NS_PER_S

probes = APIRouter(tags=["health"])
DESCRIPTIONS = TypeAdapter(dict[str, str]).validate_python(load_module_toml(__file__))
S_PER_H = 3600.0

Labels = tuple[str, ...]
OPENMETRICS: dict[int | str, dict[str, object]] = {
    200: {"content": {"application/openmetrics-text": {"schema": {"type": "string"}}}},
    **describe_errors(503),
}


@probes.get("/metrics", response_class=Response, responses=OPENMETRICS)
def get_metrics(request: Request, context: ContextOf) -> Response:
    """Return state, age and newest values of positions, and metrics of alarms, recorder, disk and service."""
    return render_metrics(chain(collect_service(), collect_clients(context), collect_test(context)), request)


def render_metrics(metrics: Iterable[Metric], request: Request) -> Response:
    """Render metrics in OpenMetrics text format, followed by the response times of this service.

    The errors of the iterable ``metrics`` are raised.
    """
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
        """Return the metrics, as `prometheus_client` requires of a collector."""
        return self._metrics


def collect_service() -> Iterator[Metric]:
    """Yield the metric with the version of the service."""
    yield InfoMetricFamily("solimon", "Version of solimon", {"version": read_installed_version()})


def collect_clients(context: Context) -> Iterator[Metric]:
    """Yield the numbers of open event streams and live waveform streams of a test."""
    yield _build_gauge("stream_clients", context.hub.clients)
    yield _build_gauge("waveform_clients", context.live.clients)


def collect_test(context: Context) -> Iterator[Metric]:
    """Yield the present metrics of a test; without data, only receivers and the status of its recorder.

    Raises StorageError or a Problem if the catalogue becomes unreadable meanwhile, and OSError if the free
    disk space cannot be read.
    """
    yield from _collect_receiver_metrics(context)
    has_data = context.has_data()
    yield _build_gauge("has_data", has_data)
    if has_data:
        yield from _collect_data_metrics(context, context.read_freshness())
    else:
        yield _build_recorder_metric(read_recorder_state(context.data_folder, []).status)


def _collect_receiver_metrics(context: Context) -> Iterator[Metric]:
    """Yield numbers of sent messages, failed attempts and waiting changes of each receiver.

    They are counted since the start of the service.
    """
    queues = context.notifications.queues.values()
    sent = CounterMetricFamily("solimon_notifications_sent", "Messages taken", labels=("receiver",))
    failed = CounterMetricFamily("solimon_notifications_failed", "Failed attempts", labels=("receiver",))
    for queue in queues:
        sent.add_metric((queue.name,), queue.state.sent)
        failed.add_metric((queue.name,), queue.state.failed)
    yield sent
    yield failed
    waiting: dict[Labels, int] = {(queue.name,): queue.state.waiting for queue in queues}
    yield _build_labeled_gauge("notifications_waiting", waiting, "receiver")


COUNTS = ("sets", "missed_sets", "partial_sets", "shots", "pulse_echo_records")


def _collect_data_metrics(context: Context, fresh: Freshness) -> Iterator[Metric]:
    """Yield the metrics of recorder, stored data, disk, active alarms and positions.

    Raises StorageError or a Problem if the catalogue cannot be read, and OSError if the free disk space
    cannot.
    """
    catalogue = context.catalogue()
    yield _build_recorder_metric(fresh.recorder.status)
    yield _build_gauge("heartbeat_age_seconds", fresh.recorder.beat_age_s)
    yield _build_gauge("write_age_seconds", fresh.wall_age_s)
    yield _build_gauge("test_hours", fresh.now_h)
    yield _build_gauge("paused", catalogue.paused() is not None)
    counts = catalogue.counts()
    for name in COUNTS:
        yield _build_counter(name, counts[name])
    yield _build_counter("alarms", catalogue.find_newest_id(AlarmRow))
    yield _build_counter("orders", catalogue.find_newest_id(CommandRow))
    disk = forecast_disk(context.data_folder, context.settings.storage, context.settings.schedule, catalogue)
    yield _build_gauge("disk_free_bytes", disk.free_bytes)
    yield _build_gauge("disk_size_bytes", disk.total_bytes)
    yield _build_gauge("disk_needed_bytes", disk.needed_bytes)
    yield _build_state_gauge("disk_level", {(): disk.level}, LEVELS)
    active = map(fresh.expire_shelf, catalogue.rows(AlarmRow, active=True))
    numbers: Counter[Labels] = Counter(
        (row.kind, row.priority, row.state, row.position or "", row.suppressed or "") for row in active
    )
    labels = ("kind", "priority", "state", "position", "suppressed")
    yield _build_labeled_gauge("alarms_active", numbers, *labels)
    latest = read_latest_rows(catalogue, fresh, context.settings.positions)
    yield from _collect_positions(
        context.settings.schedule, context.settings.find_wall_limit_m, fresh, latest
    )


VALUES = (
    ("outlier", "last_assessment", "outlier"),
    ("distance_squared", "last_assessment", "distance_squared"),
    ("time_of_flight_seconds", "last_feature", "tof_pp_s"),
    ("amplitude_ratio", "last_feature", "amplitude_ratio"),
    ("thickness_meters", "last_thickness", "thickness_m"),
    ("thickness_loss_meters", "last_thickness", "thickness_loss_m"),
    ("wall_thickness_meters", "last_wall", "thickness_m"),
    ("wall_thickness_low_meters", "last_wall", "interval_low_m"),
    ("wall_thickness_high_meters", "last_wall", "interval_high_m"),
    ("last_set_shots", "last_set", "n_taken"),
    ("last_set_missed_shots", "last_set", "n_missed"),
)
"""Newest values of a position: metric, row and its column."""


def _collect_positions(
    schedule: ScheduleSettings,
    find_wall_limit_m: Callable[[str], float],
    fresh: Freshness,
    summaries: Mapping[str, LatestRows],
) -> Iterator[Metric]:
    """Yield the metrics of each position from its latest rows; ``find_wall_limit_m`` gives a probe's limit.

    Values that are not available have no sample.
    """

    def build_gauge(name: str, value: Callable[[LatestRows], float | None]) -> Metric:
        """Build a gauge with one sample per position."""
        samples: dict[Labels, float | None] = {(place,): value(last) for place, last in summaries.items()}
        return _build_labeled_gauge(name, samples, "position")

    def build_states(name: str, state: Callable[[LatestRows], str | None], known: object) -> Metric:
        """Build a state metric with one sample per position and state."""
        present: dict[Labels, str | None] = {(place,): state(last) for place, last in summaries.items()}
        return _build_state_gauge(name, present, get_args(known), "position")

    def compute_age_s(last: LatestRows) -> float | None:
        """Return the age of the newest data of a position in s; None without data."""
        hours = find_data_age_h(last, fresh)
        return None if hours is None else S_PER_H * hours

    def select_value(row: str, column: str) -> Callable[[LatestRows], float | None]:
        """Return a function that reads a column of the latest rows; None if the row is missing."""
        return lambda last: getattr(getattr(last, row), column, None)

    def select_limit(row: str) -> Callable[[LatestRows], float | None]:
        """Return a function that computes the alarm limit of a position; None if the row is missing."""
        return lambda last: (
            None if getattr(last, row) is None else find_limit(last, find_wall_limit_m(last.position))
        )

    yield build_states("position_state", find_status, PositionStatus)
    yield build_states("quality", _read_quality, Quality)
    yield build_gauge("stale", lambda last: is_data_stale(schedule, fresh, find_data_age_h(last, fresh)))
    yield build_gauge("data_age_seconds", compute_age_s)
    for name, row, column in VALUES:
        yield build_gauge(name, select_value(row, column))
    yield build_gauge("distance_squared_limit", select_limit("last_assessment"))
    yield build_gauge("thickness_limit_meters", select_limit("last_thickness"))
    yield build_gauge("last_set_start_delay_seconds", _compute_delay_s)


def _read_quality(summary: LatestRows) -> str | None:
    """Return the quality of the newest feature or thickness of a position; None without one."""
    measured = summary.last_feature or summary.last_thickness
    return None if measured is None else measured.quality


def _compute_delay_s(summary: LatestRows) -> float | None:
    """Return the delay of the start of the newest set after its due time, s; None if no set has started."""
    row = summary.last_set
    if row is None or row.started_utc_ns is None:
        return None
    return (row.started_utc_ns - row.due_utc_ns) / NS_PER_S


def _build_recorder_metric(status: str) -> Metric:
    """Build the state metric of the recorder: 1 for its status, 0 for the others."""
    return _build_state_gauge("recorder_state", {(): status}, get_args(RecorderStatus))


def _build_counter(name: str, number: int) -> Metric:
    """Build a counter ``solimon_NAME`` without labels; raise KeyError if the name has no description."""
    return CounterMetricFamily(f"solimon_{name}", DESCRIPTIONS[name], value=number)


def _build_gauge(name: str, number: float | None) -> Metric:
    """Build a gauge without labels, named ``solimon_NAME``; without a value it has no sample.

    Raises KeyError if the name has no description.
    """
    return _build_labeled_gauge(name, {(): number})


def _build_labeled_gauge(name: str, samples: Mapping[Labels, float | None], *labels: str) -> Metric:
    """Build a gauge ``solimon_NAME`` with a sample for each combination of labels; None has no sample.

    Raises KeyError if the name has no description.
    """
    family = GaugeMetricFamily(f"solimon_{name}", DESCRIPTIONS[name], labels=labels)
    for of_labels, number in samples.items():
        if number is not None:
            family.add_metric(of_labels, float(number))
    return family


def _build_state_gauge(
    name: str, present: Mapping[Labels, str | None], known: Iterable[str], *labels: str
) -> Metric:
    """Build a state metric: one sample per known state, 1 for the present one and 0 for the others.

    ``present`` gives the state by the values of ``labels``; combinations without a state have no sample.
    """
    samples = {
        (*of_labels, state): float(state == status)
        for of_labels, status in present.items()
        for state in known
        if status
    }
    return _build_labeled_gauge(name, samples, *labels, "state")
