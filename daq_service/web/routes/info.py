"""`/api/v1/info`: identity, rig, clock and schedule of the test."""

from __future__ import annotations

from fastapi import APIRouter

from daq_service.acquisition import schedule
from daq_service.catalogue import Catalogue
from daq_service.web.answers.json_answer import JsonAnswer, format_rfc3339
from daq_service.web.answers.models import Info, SupplyInfo, describe_errors
from daq_service.web.answers.version import read_installed_version
from daq_service.web.context import ContextOf, Freshness
from hardware_drivers.methods import PULSE_ECHO
from hardware_drivers.nanoseconds import NS_PER_S

router = APIRouter(tags=["info"])
RIG_LABELS = {
    "simulated": "physics twin",
    "playback": "playback of recorded shots",
    "laboratory": "laboratory rig",
    "mixed": "mixed rig",
}


@router.get("/info", response_model=Info, responses=describe_errors(503))
def get_info(context: ContextOf) -> JsonAnswer:
    """Return identity, version, rig, clock, schedule, limits, supply and positions of the test.

    Also its pause, the request to a person at present, the last event id and the freshness of the answer.
    """
    settings = context.settings
    fresh = context.read_freshness()
    catalogue = context.catalogue()
    row = catalogue.read_experiment()
    started = catalogue.read_last_service_event("recorder_started")
    hours = schedule.list_due_hours(settings.schedule.phases, end_h=settings.schedule.end_h)
    return JsonAnswer(
        {
            **{name: getattr(row, name) for name in ("name", "uuid", "site")},
            "version": read_installed_version(),
            "configuration_hash": row.configuration_hash,
            "rig": settings.rig.kind,
            "rig_label": RIG_LABELS.get(settings.rig.kind, settings.rig.kind),
            "rig_identity": {} if started is None else started.payload.get("rig_identity", {}),
            "instruments": [
                {"name": name, "kind": item.kind, "serves": settings.rig.find_served_positions(name)}
                for name, item in settings.rig.instruments.items()
            ],
            "clock": {
                "kind": settings.clock.kind,
                "epoch_utc": format_rfc3339(fresh.epoch_utc_ns),
                "pace_h_per_s": settings.clock.pace_h_per_s,
                "system_ahead_s": fresh.system_ahead_s,
                "can_finish_now": settings.clock.is_paced and fresh.recorder.status == "running",
            },
            "schedule": {
                "n_sets": len(hours),
                "end_h": hours[-1] if hours else 0.0,
                "baseline_h": settings.baseline.hours,
                "shots_per_set": settings.schedule.shots_per_set,
            },
            "limits": {
                "deciding": settings.novelty.limit,
                "decides_by": settings.alarms.decides_by,
                "false_alarms_per_sensor_year": settings.false_alarms_per_sensor_year(),
                "named": _list_limits(),
                "false_alarm_rate": settings.novelty.false_alarm_rate,
                "k": settings.alarms.k,
                "n": settings.alarms.n,
                "thickness_loss_fraction": settings.alarms.thickness_loss_fraction,
            },
            "supply": settings.rig.driven
            and {name: getattr(settings.rig.driven, name) for name in SupplyInfo.model_fields},
            "initial_thickness_m": settings.ultrasound.initial_thickness_m,
            "probe_delay_s": settings.ultrasound.delay_s,
            "probe_delay_is_assumed": settings.ultrasound.delay_is_assumed,
            "positions": [
                {
                    "position": name,
                    **{key: getattr(place, key) for key in ("label", "method", "serial_number")},
                    "calibration": place.calibration.model_dump(),
                    "minimum_wall_m": settings.find_wall_limit_m(name)
                    if place.method == PULSE_ECHO
                    else place.minimum_wall_m,
                }
                for name, place in settings.positions.items()
            ],
            "paused": catalogue.paused(),
            "asked": _read_current_request(catalogue, fresh),
            "dry_run": None if started is None else started.payload.get("dry_run"),
            "last_event_id": fresh.last_event_id,
            "as_of": fresh.as_of(),
        }
    )


def _list_limits() -> list[dict[str, str]]:
    """List every limit: its name, description, statistic (``of``) and unit."""
    from analysis.statistics.named_limits import LIMITS  # with SciPy, which is slow to import

    return [
        {"name": name, "description": limit.words, "of": limit.of, "unit": limit.unit}
        for name, limit in LIMITS.items()
    ]


def _read_current_request(catalogue: Catalogue, fresh: Freshness) -> dict[str, object] | None:
    """Return the latest request of a running recorder to a person, with the remaining time in s.

    None without one, or if it was withdrawn or its time is over.
    """
    event = catalogue.read_last_service_event("asked", "asked_over")
    if event is None or event.kind != "asked" or fresh.recorder.status != "running":
        return None
    remaining_s = event.payload["within_s"] - (fresh.now_utc_ns - event.utc_ns) / NS_PER_S
    return {**event.payload, "left_s": remaining_s} if remaining_s > 0.0 else None
