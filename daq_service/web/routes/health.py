"""`/healthz`, `/readyz` for machines; `/api/v1/health` for people."""

from __future__ import annotations

from dataclasses import asdict

from fastapi import APIRouter

from daq_service.processes.disk_policy import forecast_disk
from daq_service.processes.recorder_state import read_recorder_state
from daq_service.web.answers.json_answer import JsonAnswer
from daq_service.web.answers.models import Liveness, ServiceHealth, describe_errors
from daq_service.web.context import ContextOf

probes = APIRouter(tags=["health"])
router = APIRouter(tags=["health"])


@probes.get("/healthz", response_model=Liveness)
def get_liveness(context: ContextOf) -> JsonAnswer:
    """Return that the web process responds, and whether data are stored; if not, the recorder's status."""
    if context.has_data():
        return JsonAnswer({"status": "ok", "data": True, "recorder": None, "doing": None})
    recorder = read_recorder_state(context.data_folder, [])
    doing = recorder.beat.doing if recorder.beat and recorder.status == "running" else None
    return JsonAnswer({"status": "ok", "data": False, "recorder": recorder.status, "doing": doing})


@probes.get("/readyz", response_model=Liveness, responses=describe_errors(503))
def get_readiness(context: ContextOf) -> JsonAnswer:
    """Return 200 if data are stored and readable, else 503."""
    context.catalogue().last_event_id()
    return JsonAnswer({"status": "ok", "data": True})


@router.get("/health", response_model=ServiceHealth, responses=describe_errors(503))
def get_health(context: ContextOf) -> JsonAnswer:
    """Return status and heartbeat of the recorder, counts of stored data, open streams, and disk space.

    The forecast of the disk space assumes that later sets are as large as the newest one.
    """
    fresh = context.read_freshness()
    beat = fresh.recorder.beat
    settings, catalogue = context.settings, context.catalogue()
    disk = forecast_disk(context.data_folder, settings.storage, settings.schedule, catalogue)
    return JsonAnswer(
        {
            "as_of": fresh.as_of(),
            "recorder": {
                "state": fresh.recorder.status,
                "description": fresh.recorder.description,
                "doing": None if beat is None else beat.doing,
                "beat_age_s": fresh.recorder.beat_age_s,
                "deadline_s": None if beat is None else beat.deadline_s,
            },
            "counts": context.catalogue().counts(),
            "stream_clients": context.hub.clients,
            "waveform_clients": context.live.clients,
            "disk_free_bytes": disk.free_bytes,
            "disk": asdict(disk),
        }
    )
