"""A short experiment on a coarse twin, through the real recorder, archive and catalogue."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from daq_service.catalogue import open_catalogue
from daq_service.catalogue.connection import FILE_NAME
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    FeatureRow,
    SetRow,
    ShotRow,
    ThicknessRow,
)
from daq_service.processes.data_folder import hold_recorder_lock, prepare_data_folder
from daq_service.recording.resources import Host, SessionOptions
from daq_service.recording.session import record_test
from daq_service.rig.open_rig import open_rig
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.instruments import Acquired, Clock, Rig
from hardware_drivers.measurement import ShotKey
from support.empty_catalogue import empty_catalogue

SMALL: dict[str, Any] = {
    "schedule": {
        "phases": [{"until_h": 12.0, "interval_h": 0.5}],
        "shots_per_set": 3,
    },
    # A coarse mesh: the recorder does not care how good the physics is.
    "plate": {"elements_per_edge": 16},
    "baseline": {"hours": 9.0, "minimum_valid_shots": 2},
    "alarms": {"hole_shots": 2},
}
SETS = 24
RigOpener = Callable[[Settings, Clock, int], AbstractContextManager[Rig]]


def small_settings(**tables: Mapping[str, Any]) -> Settings:
    """Return settings of the short experiment; ``tables`` override them."""
    overrides = {name: {**SMALL.get(name, {}), **table} for name, table in tables.items()}
    return load_settings(None, overrides={**SMALL, **overrides})


class AtOnce(Executor):
    """Executor that runs in this thread: no process has to start."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments, **named))
        except Exception as error:  # noqa: BLE001 - an executor hands over whatever it is
            future.set_exception(error)
        return future


class BrokenExecutor(Executor):
    """Executor whose worker was killed."""

    def submit(self, work: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenProcessPool("killed"))
        return future


def run(
    settings: Settings,
    folder: Path,
    *,
    rig: RigOpener = open_rig,
    stop: threading.Event | None = None,
    restart_reason: str = "",
    **options: Any,
) -> bool:
    """Record to the end, or until ``stop``; ``options`` are of `SessionOptions` and `Host`."""
    named = {item.name for item in fields(Host)}
    host = {"worker": AtOnce, **{name: options.pop(name) for name in named & options.keys()}}
    prepare_data_folder(folder)
    if not (folder / FILE_NAME).exists():
        (folder / FILE_NAME).write_bytes(empty_catalogue())
    with hold_recorder_lock(folder):
        return record_test(
            settings,
            folder,
            rig,
            stop=stop or threading.Event(),
            report=lambda event, **values: None,
            options=SessionOptions(restart_reason=restart_reason, **options),
            host=Host(**host),
        )


def rows_of(folder: Path) -> dict[str, Sequence[Any]]:
    """Return every row that a repeated experiment must repeat, without the time of writing."""
    with open_catalogue(folder) as catalogue:
        return {
            # A file shows by which end of the schedule its recorder went.
            "sets": [replace(row, file_sha256=None) for row in catalogue.rows(SetRow, purpose="any")],
            "set_features": catalogue.rows(FeatureRow, scope="set", purpose="any"),
            "shot_features": catalogue.rows(FeatureRow, scope="shot", purpose="any"),
            "thickness": catalogue.rows(ThicknessRow),
            "assessments": catalogue.rows(AssessmentRow, purpose="any"),
            "baselines": [replace(row, created_utc_ns=0) for row in catalogue.rows(BaselineRow)],
            "alarms": catalogue.rows(AlarmRow),
            "shots": catalogue.rows(ShotRow, purpose="any"),
        }


class DisturbedDigitizer:
    """Digitizer of the twin with a disturbance at chosen shots."""

    def __init__(self, digitizer: Any, disturb: Callable[[ShotKey, Acquired], Acquired]) -> None:
        self._digitizer = digitizer
        self._disturb = disturb
        self._key: ShotKey | None = None

    def arm(self, key: ShotKey) -> None:
        self._key = key
        self._digitizer.arm(key)

    def read(self, timeout_s: float) -> Acquired:
        assert self._key is not None
        acquired: Acquired = self._digitizer.read(timeout_s)
        return self._disturb(self._key, acquired)

    def disarm(self) -> None:
        self._digitizer.disarm()


def disturbed_rig(disturb: Callable[[ShotKey, Acquired], Acquired]) -> RigOpener:
    """Open the twin with each record passed through ``disturb``, which may raise."""

    @contextmanager
    def opener(settings: Settings, clock: Clock, epoch_utc_ns: int) -> Iterator[Rig]:
        with open_rig(settings, clock, epoch_utc_ns) as rig:
            yield replace(rig, digitizer=DisturbedDigitizer(rig.digitizer, disturb))

    return opener
