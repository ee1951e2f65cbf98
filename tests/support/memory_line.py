"""The recording line on a rig and an archive in memory: every test of it takes milliseconds.

The rig answers as a script says: features of a shot, or its record, None where nothing triggers, or the
instrument's error.
Only the catalogue is the real one.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from analysis.waves.features import ShotFeatures, extract_features
from daq_service.alarms.states import NOT_ASSESSED
from daq_service.background.disk_watch import DiskWatch
from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.verification import IdleVerification
from daq_service.catalogue import RecorderCatalogue, open_catalogue
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    BaselineRow,
    EventRow,
    FeatureRow,
    Row,
    SetRow,
    ShotRow,
    ThicknessRow,
)
from daq_service.clock import parse_utc
from daq_service.processes.heartbeat import Heartbeat, Stage, WebWatch
from daq_service.recording.computer_load import ComputerLoadWatch
from daq_service.recording.recorder import Recorder
from daq_service.recording.resources import LISTEN_EVERY_S, Host, Resources, SessionOptions
from daq_service.settings.file import load_settings
from daq_service.settings.tree import Settings
from hardware_drivers.errors import AcquisitionTimeoutError, InstrumentError
from hardware_drivers.instruments import Acquired, Clock, Echo, Rig
from hardware_drivers.measurement import Calibration, SetKey, Shot, ShotKey, Waveform
from simulator.clock import SimulatedClock
from support.empty_catalogue import empty_catalogue
from support.machine import clock_in_seconds
from support.memory_archive import MemoryArchive, Shelf

MEMORY: dict[str, Any] = {
    "schedule": {"phases": [{"until_h": 6.0, "interval_h": 0.5}], "shots_per_set": 4},
    "baseline": {"hours": 4.0, "minimum_sets": 7, "minimum_valid_shots": 3},
    "quality": {"restrikes_per_set": 2, "no_data_sets": 2, "retire_after_sets": 3},
    "alarms": {"hole_shots": 3, "hole_sets": 2},
}
SETS = 12
TABLES: Mapping[str, type[Row]] = {
    "sets": SetRow,
    "shots": ShotRow,
    "features": FeatureRow,
    "thickness": ThicknessRow,
    "assessments": AssessmentRow,
    "baselines": BaselineRow,
    "alarms": AlarmRow,
    "events": EventRow,
}
CALIBRATION = Calibration(coefficients_v=np.array([0.0, 1e-3]), resolution_bits=16, range_v=5.0)

Answer = ShotFeatures | Waveform | InstrumentError | None
Script = Callable[[ShotKey], Answer]


class KilledError(BaseException):
    """End of the recorder's process."""


@cache
def _default_settings() -> Settings:
    return load_settings(None, overrides=MEMORY)


def memory_settings(**tables: Mapping[str, Any]) -> Settings:
    """Return settings of twelve sets of a probe (A) and three transducers; ``tables`` override them."""
    if not tables:
        return _default_settings()
    over = {name: {**MEMORY.get(name, {}), **table} for name, table in tables.items()}
    return load_settings(None, overrides={**MEMORY, **over})


def healthy(key: ShotKey, shift: float = 0.0) -> ShotFeatures:
    """Return features of a healthy shot: each key has its own, the same in every run."""
    noise = np.random.default_rng([ord(key.position[0]), key.set_key.number, key.shot_index]).standard_normal(
        5
    )
    tof_pp, tof_ac, ratio, coefficient, area = (1.0 + 0.01 * noise + shift).tolist()
    return ShotFeatures(
        tof_pp_s=340e-6 * tof_pp,
        tof_ac_s=340e-6 * tof_ac,
        amplitude_ratio=0.5 * ratio,
        autocorrelation_coefficient=0.6 * coefficient,
        psw_area_v_s=1e-4 * area,
    )


def silent(flag: str = "no_psw") -> ShotFeatures:
    """Return features of an invalid shot."""
    return ShotFeatures(flags=(flag,), valid=False, quality="bad")


class ScriptedInstruments:
    """Striker, digitizer and pulse-echo unit that follow a script and log their calls."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.calls: list[tuple[str, ShotKey | None]] = []
        self._armed: ShotKey | None = None

    def arm(self, key: ShotKey) -> None:
        self.calls.append(("arm", key))
        self._armed = key

    def strike(self, key: ShotKey) -> None:
        assert key == self._armed, "the digitizer is armed for the shot that is struck"
        self.calls.append(("strike", key))

    def read(self, timeout_s: float) -> Acquired:
        assert self._armed is not None
        return Acquired(waveform=self._record(self._armed))

    def acquire(self, key: ShotKey, timeout_s: float) -> Echo:
        self.calls.append(("acquire", key))
        return Echo(waveform=self._record(key), gain_db=30.0, offset_v=0.0, averages=16)

    def disarm(self) -> None:
        self._armed = None

    def make_safe(self) -> None:
        self.calls.append(("make_safe", None))

    def _record(self, key: ShotKey) -> Waveform:
        scripted = self.script(key)
        if isinstance(scripted, InstrumentError):
            raise scripted
        if scripted is None:
            raise AcquisitionTimeoutError(f"no trigger at {key.position}")
        if isinstance(scripted, Waveform):
            return scripted
        counts = [ord(key.position[0]), *key.set_key, key.shot_index, key.attempt]
        return Waveform(
            counts=np.array(counts, dtype=np.int16),
            sample_rate_hz=1e7,
            pretrigger_samples=1,
            calibration=CALIBRATION,
        )

    @property
    def struck(self) -> list[tuple[str, int | SetKey, int, int]]:
        """Return every strike: position, set (its index if it is a scheduled one), shot, attempt."""
        keys = [key for call, key in self.calls if call == "strike" and key is not None]
        return [
            (
                key.position,
                key.set_key if key.unscheduled_index else key.set_index,
                key.shot_index,
                key.attempt,
            )
            for key in keys
        ]


class QuietHeartbeat:
    """Heartbeat that keeps its activities."""

    def __init__(self) -> None:
        self.activities: list[str] = []
        self.stage: Stage = ""
        self.at_the_first: Callable[[], None] = lambda: None

    def beat(self, doing: str, *, at_once: bool = False) -> None:
        self.activities.append(doing)
        act, self.at_the_first = self.at_the_first, lambda: None
        act()


class NoPicture:
    """Live figure without a viewer."""

    def due(self, position: str) -> bool:
        return False


@dataclass
class Line:
    """Data folder of a test, and the consecutive recorders on it."""

    folder: Path
    settings: Settings = field(default_factory=memory_settings)
    script: Script = healthy
    shelf: Shelf = field(default_factory=Shelf)
    instruments: list[ScriptedInstruments] = field(default_factory=list)
    heartbeat: QuietHeartbeat | Heartbeat = field(default_factory=QuietHeartbeat)
    listen_every_s: float = LISTEN_EVERY_S
    look_every_s: float = 0.001
    given: list[tuple[str, str, dict[str, Any]]] = field(default_factory=list)
    runs: bool = False

    def __post_init__(self) -> None:
        self.folder.mkdir(exist_ok=True)

    def stop_at(self, key: ShotKey) -> threading.Event:
        """Return a stop that is set when the record of a shot is read; the script goes on."""
        script, stop = self.script, threading.Event()

        def stopping(key_of_shot: ShotKey) -> Answer:
            if key_of_shot == key:
                stop.set()
            return script(key_of_shot)

        self.script = stopping
        return stop

    def run(
        self,
        *,
        cause: str = "it was off",
        stop: threading.Event | None = None,
        archive: MemoryArchive | None = None,
        start_h: float | None = None,
        clock: Clock | None = None,
        left_alone: threading.Event | None = None,
        mono_s: Callable[[], float] = time.monotonic,
        acknowledged: Callable[[int], None] = lambda shot_id: None,
        idle_check: IdleVerification | None = None,
        disk: DiskWatch | None = None,
        finalizer: SetFinalizer | None = None,
        machine: ComputerLoadWatch | None = None,
        web: WebWatch | None = None,
        notify: Callable[..., None] = lambda event, **values: None,
        **parts: Any,
    ) -> bool:
        """Run a recorder to its end, as `session.record_test` does.

        Parameters
        ----------
        start_h
            Where the clock stands; None: at the end of the last committed set, or within an open one.
        clock
            Another one than a simulated clock that stands there.
        parts
            Further parts of the rig.
        """
        with self.catalogue(writer=True) as catalogue:
            epoch_ns = self.epoch_ns(catalogue)
            ended = [ns for row in catalogue.rows(SetRow) if (ns := row.ended_utc_ns) is not None]
            start_ns = max(
                [*ended, *(item.last_utc_ns for item in self.shelf.open.values())], default=epoch_ns
            )
            if start_h is not None:
                start_ns = epoch_ns + round(start_h * 3.6e12)
            instruments = ScriptedInstruments(self.script)
            self.instruments.append(instruments)
            rig = Rig(
                kind="simulated",
                clock=clock or SimulatedClock(start_ns),
                **{"striker": instruments, "digitizer": instruments, "pulse_echo": instruments, **parts},
            )
            resources = Resources(
                settings=self.settings,
                archive=archive or MemoryArchive(self.shelf),
                catalogue=catalogue,
                rig=rig,
                heartbeat=self.heartbeat,
                live=NoPicture(),
                stop=stop or threading.Event(),
                report=notify,
                options=SessionOptions(
                    unsupervised=left_alone or threading.Event(), acknowledged=acknowledged
                ),
                host=Host(
                    machine=clock_in_seconds(mono_s),
                    listen_every_s=self.listen_every_s,
                    look_every_s=self.look_every_s,
                ),
                finalizer=finalizer,
                verification=idle_check,
                disk=disk,
                computer_load=machine,
                web=web,
            )
            recorder = Recorder(resources, features_of=self.features_of)
            self.runs, self.heartbeat.at_the_first = True, self._give_orders
            try:
                return recorder.run(not_running_reason=cause)
            finally:
                recorder.commands.expire_open_commands()
                self.runs = False

    def features_of(self, shot: Shot) -> ShotFeatures:
        """Return the scripted features of a shot, or extract them from a scripted record."""
        scripted = self.script(shot.key)
        if isinstance(scripted, Waveform):
            return extract_features(shot.waveform)
        assert isinstance(scripted, ShotFeatures), "only what was recorded is analysed"
        return scripted

    def epoch_ns(self, catalogue: RecorderCatalogue) -> int:
        """Return hour 0; the first call creates the experiment with these settings."""
        row = catalogue.create_experiment(
            name=self.settings.name,
            configuration_hash=self.settings.configuration_hash(),
            configuration=self.settings.model_dump(mode="json"),
            epoch_utc_ns=parse_utc(self.settings.clock.epoch),
            clock="simulated",
            solimon_version="0",
        )
        return int(row.epoch_utc_ns)

    @contextmanager
    def catalogue(self, *, writer: bool = False) -> Iterator[RecorderCatalogue]:
        """Open the catalogue of this folder; a new one is a copy of one that was migrated before."""
        target = self.folder / "catalogue.sqlite"
        if not target.exists():
            target.write_bytes(empty_catalogue())
        with open_catalogue(self.folder, writer=writer) as catalogue:
            yield catalogue

    def order(self, kind: str, author: str = "Ada", **arguments: Any) -> None:
        """Send a command to the running recorder, or to the next one when it starts."""
        self.given.append((author, kind, arguments))
        if self.runs:
            self._give_orders()

    def order_at(self, key: ShotKey, kind: str, **arguments: Any) -> None:
        """Let the script send a command once, when a shot is read; it is received before the next strike."""
        script, left = self.script, [key]

        def ordering(key_of_shot: ShotKey) -> Answer:
            if key_of_shot in left:
                left.clear()
                self.order(kind, **arguments)
            return script(key_of_shot)

        self.script, self.listen_every_s = ordering, 0.0

    def _give_orders(self) -> None:
        with self.catalogue() as catalogue:
            for given in self.given:
                catalogue.add_command(*given)
        self.given.clear()

    def alarms(self) -> list[Any]:
        """Return rows of alarms, except those about baselines too short for limits."""
        return [row for row in self.rows("alarms") if row.kind != NOT_ASSESSED]

    def rows(self, table: str, position: str | None = None) -> Sequence[Any]:
        """Return rows of a table, of one position where it has one; baselines without their time."""
        with self.catalogue() as catalogue:
            rows = catalogue.rows(TABLES[table], position=position)
        return [replace(row, created_utc_ns=0) for row in rows] if table == "baselines" else rows
