"""A data folder filled through the real catalogue and archive with an invented test."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import httpx2
import numpy as np

from analysis.assessment.confirmation import STEP
from analysis.waves.features import FEATURE_NAMES, extract_features
from daq_service.acquisition.schedule import build_unscheduled_set, plan_sets
from daq_service.alarms.operator_actions import acknowledge_alarm, reset_alarm, shelve
from daq_service.alarms.states import Change, Moment, build_alarm_texts
from daq_service.archive import PositionRecord, SetRecord
from daq_service.assessment.confirmation import CONFIRMATION_ASKED, Confirmation
from daq_service.background.live_figure import LiveFigure
from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.rows import (
    AlarmRow,
    AnnotationRow,
    AssessmentRow,
    BaselineRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    SetRow,
    ThicknessRow,
    WallRow,
    as_dict,
)
from daq_service.catalogue.writer import build_event_payload
from daq_service.clock import TimeLine, parse_utc
from daq_service.processes.data_folder import hold_recorder_lock
from daq_service.processes.heartbeat import Heartbeat
from daq_service.processes.recorder_state import FAREWELLS
from daq_service.recording.set_assessor import build_shot_row
from daq_service.settings.tree import Settings
from hardware_drivers.measurement import PulseEchoRecord, SetKey, Shot, ShotKey, Stamp
from hardware_drivers.nanoseconds import NS_PER_H, NS_PER_S
from support.empty_catalogue import empty_catalogue
from support.filed_archive import FiledArchive
from support.served_web import served
from support.synthetic_records import Scene

N_BASELINE = 48
LIMIT_F, LIMIT_PAPER = 24.3, 12.1
LIMIT_CHART = 59.0
PULSE_ECHO = Scene(
    n_samples=2000, pretrigger_samples=0, rate_hz=100e6, width_s=1e-6, isw_time_s=3e-6, tof_s=4e-6
)


def depth(position: str, hour: float) -> float:
    """Return the wall loss fraction: B and C become thinner, D stays."""
    return {"B": 0.7, "C": 0.55}.get(position, 0.0) * max(0.0, hour - 40.0) / 310.0


def frozen_baseline(position: str, **columns: object) -> BaselineRow:
    """Return the row of a baseline as the recorder freezes it."""
    p = len(FEATURE_NAMES)
    row = BaselineRow(
        name=f"{position}-baseline-1",
        position=position,
        created_utc_ns=parse_utc("2024-01-02T00:00:00Z"),
        first_set_index=0,
        last_set_index=N_BASELINE - 1,
        n_sets=N_BASELINE,
        feature_names=list(FEATURE_NAMES),
        mean=[0.0] * p,
        covariance=np.eye(p).tolist(),
        limit_f_predictive=LIMIT_F,
        limit_mean_3sd=LIMIT_PAPER,
        approval="automatic",
        provenance={"set_indices": list(range(N_BASELINE)), "suspects": [], "warnings": []},
        limits={"f_predictive": LIMIT_F, "paper_mean_3sd": LIMIT_PAPER, "mewma": LIMIT_CHART},
    )
    return replace(row, **columns)


class FilledFolder:
    """Data folder that gets sets as from a recorder: file first, then rows and events."""

    def __init__(
        self, folder: Path, settings: Settings, *, shots_per_set: int = 1, exists: bool = False
    ) -> None:
        self.folder, self.settings, self.shots_per_set = folder, settings, shots_per_set
        self.epoch_ns = parse_utc(settings.clock.epoch)
        self.due = plan_sets(settings.schedule.phases, self.epoch_ns, end_h=settings.schedule.end_h)
        if not exists:
            (folder / "catalogue.sqlite").write_bytes(empty_catalogue())
        self.catalogue = open_catalogue(folder, writer=True)
        if not exists:
            self.catalogue.create_experiment(
                name=settings.name,
                configuration_hash=settings.configuration_hash(),
                configuration=settings.model_dump(mode="json"),
                epoch_utc_ns=self.epoch_ns,
                clock=settings.clock.kind,
                solimon_version="0",
            )
        self.archive = FiledArchive(folder)
        self.live = LiveFigure(folder, settings.rig.kind)
        self._ownership = ExitStack()
        self._ownership.enter_context(hold_recorder_lock(folder))
        self.beat()
        if not exists:
            self.say("recorder_started", 0)

    def recorder_ends(self) -> None:
        """Free the folder's lock, as the end of the recorder's process does."""
        self._ownership.close()

    def close(self) -> None:
        self._ownership.close()
        self.catalogue.close()

    def beat(self, doing: str = "waiting", *, line: TimeLine | None = None) -> None:
        Heartbeat(self.folder, deadline_s=3600.0, time_line=lambda: line).beat(doing)

    def say(self, kind: str, utc_ns: int | None = None, **payload: object) -> int:
        if kind in FAREWELLS:
            heartbeat = Heartbeat(self.folder, deadline_s=3600.0)
            heartbeat.stage = "ended"
            heartbeat.beat("leaving")
        return self.catalogue.add_service_event(utc_ns=utc_ns or self.epoch_ns, kind=kind, payload=payload)

    def scene(self, position: str, hour: float) -> Scene:
        lost = depth(position, hour)
        return Scene(
            tof_s=330e-6 * (1.0 + 0.14 * lost), amplitude_ratio=0.5 * (1.0 - 0.6 * lost), noise_fraction=0.004
        )

    def features(self, position: str, index: int, hour: float) -> dict[str, float]:
        scene = self.scene(position, hour)
        rng = np.random.default_rng([ord(position), index])
        tof = scene.tof_s * (1.0 + 0.002 * rng.standard_normal())
        ratio = scene.amplitude_ratio * (1.0 + 0.012 * rng.standard_normal())
        return {
            "tof_pp_s": tof,
            "tof_ac_s": tof,
            "amplitude_ratio": ratio,
            "autocorrelation_coefficient": ratio / (1.0 + ratio**2),
            "psw_area_v_s": 3.3e-4 * ratio,
            "tof_mf_s": tof,
            "isw_amplitude_v": scene.isw_v,
            "psw_amplitude_v": scene.isw_v * ratio,
            "ssw_amplitude_v": math.nan,
            "isw_time_s": scene.isw_time_s,
            "psw_time_s": scene.isw_time_s + tof,
            "ssw_time_s": math.nan,
            "isw_fwhm_s": 65e-6,
            "psw_isw_area_ratio": ratio,
            "noise_rms_v": 0.02,
        }

    def add_set(
        self, index: int, *, stored: bool = True, shown: bool = False, assessed: bool = True
    ) -> list[int]:
        """Add one set of all positions; return the ids of its events."""
        due = self.due[index]
        commit = SetCommit()
        records = self._records(due)
        file = None
        if stored:
            stored_set = self.archive.store_set(self._set_record(due, records))
            file = stored_set.file
        for position, place in self.settings.positions.items():
            its = [record for record in records if record.key.position == position]
            commit.sets.append(
                SetRow(
                    set_index=index,
                    position=position,
                    method=place.method,
                    due_utc_ns=due.due_utc_ns,
                    due_h=due.due_h,
                    state="done",
                    n_planned=len(its),
                    n_taken=len(its),
                    n_valid=len(its),
                    started_utc_ns=due.due_utc_ns,
                    ended_utc_ns=due.due_utc_ns,
                    file=file,
                )
            )
            commit.shots += [build_shot_row(record, valid=True, flags=()) for record in its]
            common = {
                "set_index": index,
                "position": position,
                "due_h": due.due_h,
                "quality": "good",
                "extractor_version": "1",
            }
            if place.method == "pulse_echo":
                commit.thickness.append(
                    ThicknessRow(**common, sequence=its[0].sequence, **self.thickness(index, due.due_h))
                )
            else:
                found = self.features(position, index, due.due_h)
                for record in its:
                    commit.features.append(
                        FeatureRow(
                            **common,
                            shot_index=record.key.shot_index,
                            sequence=record.sequence,
                            n_valid=1,
                            **found,
                        )
                    )
                commit.features.append(
                    FeatureRow(**common, shot_index=None, sequence=None, n_valid=len(its), **found)
                )
                if assessed:
                    commit.assessments.append(self.assessment(position, index, due.due_h))
                    if index >= N_BASELINE:
                        commit.wall.append(WallRow(**common, **self.wall(position, due.due_h)))
            commit.events += self._events(due, position, place.method)
        committed = self.catalogue.commit_set(commit)
        if shown:
            self.show(records, due.due_h)
        return committed.event_ids

    def wall(self, position: str, hour: float) -> dict[str, float]:
        wall = 6.35e-3 * (1.0 - depth(position, hour))
        return {
            "thickness_m": wall,
            "interval_low_m": 0.95 * wall,
            "interval_high_m": min(6.35e-3, 1.05 * wall),
            "loss_rate_m_per_s": 4e-9,
        }

    def thickness(self, index: int, hour: float) -> dict[str, float]:
        rng = np.random.default_rng([65, index])
        wall = 6.35e-3 - 2.15e-3 * max(0.0, hour - 20.0) / 280.0 + 4e-6 * rng.standard_normal()
        return {
            "travel_time_s": 2 * wall / 5900.0,
            "thickness_m": wall,
            "thickness_loss_m": 6.35e-3 - wall,
            "correlation_coefficient": 0.98,
            "interval_low_m": wall - 1e-5,
            "interval_high_m": wall + 2e-5,
        }

    def assessment(self, position: str, index: int, hour: float) -> AssessmentRow:
        in_baseline = index < N_BASELINE
        rng = np.random.default_rng([ord(position), index, 1])
        distance = float(rng.chisquare(5)) + (120.0 * depth(position, hour)) ** 2 / 4.0
        return AssessmentRow(
            set_index=index,
            position=position,
            due_h=hour,
            baseline_id=None,
            in_baseline=in_baseline,
            distance_squared=distance,
            limit_name="f_predictive",
            limit_f_predictive=LIMIT_F,
            limit_mean_3sd=LIMIT_PAPER,
            outlier=None if in_baseline else distance > LIMIT_F,
            outlier_mean_3sd=None if in_baseline else distance > LIMIT_PAPER,
            reason=None,
            contributions={"tof_pp_s": distance},
            mewma_statistic=None if in_baseline else 0.6 * distance,
            mewma_alarm=None if in_baseline else 0.6 * distance > LIMIT_CHART,
            limits={"f_predictive": LIMIT_F, "paper_mean_3sd": LIMIT_PAPER, "mewma": LIMIT_CHART},
        )

    def add_confirmation(
        self, position: str, planned_set: int, authors: tuple[str, ...] = ("",), file: str | None = None
    ) -> SetKey:
        """Add an unscheduled set, a minute after a scheduled one, that confirms it; return its key.

        ``authors`` asked for it, of which "" is suspicion.
        """
        planned = self.due[planned_set]
        due = build_unscheduled_set(1, planned, planned.due_utc_ns + 60 * NS_PER_S, position)
        transaction = SetCommit()
        for author in authors:
            asked = Confirmation(due=due, reason=STEP, author=author).payload()
            moment = Moment(utc_ns=due.due_utc_ns, due_h=due.due_h, set_index=planned_set)
            transaction.events.append(moment.event("service", CONFIRMATION_ASKED, asked, position=position))
        its = {**due.set_key._asdict(), "position": position, "due_h": due.due_h}
        row = SetRow(
            **its,
            method=self.settings.positions[position].method,
            due_utc_ns=due.due_utc_ns,
            state="done",
            n_planned=self.shots_per_set,
            purpose="confirmation",
            file=file,
        )
        transaction.sets.append(row)
        common = {"quality": "good", "extractor_version": "1", "n_valid": self.shots_per_set}
        found = self.features(position, planned_set, due.due_h)
        transaction.features.append(FeatureRow(**its, **common, **found, shot_index=None, sequence=None))
        assessment = self.assessment(position, planned_set, due.due_h)
        transaction.assessments.append(replace(assessment, **its, distance_squared=400.0, confirms=True))
        self.catalogue.commit_set(transaction)
        return due.set_key

    def add_alarm(
        self,
        position: str | None,
        index: int,
        *,
        priority: str = "high",
        kind: str = "wall_change",
        message: str | None = None,
        state: str = "unacknowledged",
        evidence: dict[str, object] | None = None,
    ) -> int:
        due = self.due[index]
        evidence = evidence or {
            "formula": "D = (x - mean)^T K^-1 (x - mean), equation 16",
            "rule": {"k": 3, "n": 5},
            "set_index": index,
            "distance_squared": 30.5,
            "limit_name": "f_predictive",
            "limit": LIMIT_F,
            "contributions": {"tof_pp_s": 21.4, "amplitude_ratio": 9.1},
        }
        row = AlarmRow(
            position=position,
            kind=kind,
            alarm_class="damage" if position else "diagnostic",
            priority=priority,
            state=state,
            raised_utc_ns=due.due_utc_ns,
            raised_h=due.due_h,
            raised_set_index=index,
            changed_utc_ns=due.due_utc_ns,
            message=message or build_alarm_texts(kind, position, evidence, due.due_h).message,
            evidence=evidence,
        )
        event = EventRow(
            utc_ns=due.due_utc_ns,
            topic="alarms",
            kind="alarm_raised",
            position=position,
            set_index=index,
            payload=build_event_payload(row),
        )
        commit = SetCommit(alarms=[row], events=[event], alarm_of_event={0: 0})
        return self.catalogue.commit_set(commit).alarm_ids[0]

    def add_environment(self, index: int) -> None:
        """Add supply and climate around a set: 10 V, 5 mA, a late climate reading without humidity."""
        due = self.due[index]
        row = EnvironmentRow(
            set_index=index,
            due_h=due.due_h,
            supply_state="on",
            supply_quality="good",
            supply_age_s=0.5,
            supply_tripped=None,
            voltage_v=10.0,
            voltage_min_v=9.98,
            voltage_max_v=10.02,
            current_a=0.005,
            current_min_a=0.0049,
            current_max_a=0.0051,
            charge_coulomb=18.0 * due.due_h,
            unknown_s=0.0,
            climate_quality="stale",
            climate_age_s=95.0,
            temperature_c=21.5,
            relative_humidity=None,
        )
        payload = {name: value for name, value in as_dict(row).items() if name != "id"}
        event = EventRow(
            utc_ns=due.due_utc_ns,
            topic="environment",
            kind="environment_read",
            set_index=index,
            payload=payload,
        )
        self.catalogue.commit_set(SetCommit(environment=[row], events=[event]))

    def annotate(
        self, from_h: float, text: str, *, to_h: float | None = None, position: str | None = None
    ) -> int:
        """Add a note, as the recorder does."""
        row = AnnotationRow(
            position=position,
            from_h=from_h,
            to_h=from_h if to_h is None else to_h,
            text=text,
            author="ann",
            written_utc_ns=self.due[0].due_utc_ns,
        )
        transaction = SetCommit()
        now = Moment(utc_ns=row.written_utc_ns, due_h=from_h, set_index=None)
        transaction.add_annotation(row, now.event("annotations", "annotation_added", {}, position=position))
        return self.catalogue.commit_set(transaction).annotation_ids[0]

    def show(self, records, hour: float) -> None:
        """Replace the live waveforms."""
        for record in records:
            found = extract_features(record.waveform) if isinstance(record, Shot) else None
            self.live.show(record, due_h=hour, features=found)

    def retire(self, position: str, index: int) -> None:
        """Disable a transducer: add its alarm, and the row of a scheduled set that it missed."""
        self.add_alarm(
            position, index, kind="transducer_disabled", message=f"10 sets running with nothing at {position}"
        )
        due, method = self.due[index], self.settings.positions[position].method
        row = SetRow(
            set_index=index,
            position=position,
            method=method,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            state="disabled",
            reason="hole",
            n_planned=0,
        )
        event = EventRow(
            utc_ns=due.due_utc_ns,
            topic="sets",
            kind="set_disabled",
            position=position,
            set_index=index,
            payload={},
        )
        self.catalogue.commit_set(SetCommit(sets=[row], events=[event]))

    def enable(self, position: str) -> None:
        """Reset the alarm that disabled a transducer, as the recorder does."""
        alarms = self.catalogue.rows(AlarmRow, position=position, active=True)
        (row,) = [alarm for alarm in alarms if alarm.kind == "transducer_disabled"]
        moment = Moment(utc_ns=row.raised_utc_ns, due_h=row.raised_h, set_index=None)
        self._build_change(reset_alarm(row, "ann", "put right", moment), moment)

    def _build_change(self, change: Change, moment: Moment) -> None:
        event = EventRow(
            utc_ns=moment.utc_ns,
            topic="alarms",
            kind=change.event_kind,
            position=change.row.position,
            payload=build_event_payload(change.row, last="id"),
        )
        self.catalogue.commit_set(SetCommit(alarms=[change.row], events=[event], alarm_of_event={0: 0}))

    def shelve(self, alarm_id: int, reason: str, *, for_h: float) -> None:
        """Shelve an alarm, as the recorder does, once when raised and once at the present time."""
        row = self.catalogue.alarm(alarm_id)
        moment = Moment(utc_ns=row.raised_utc_ns, due_h=row.raised_h, set_index=None)
        self._build_change(shelve(row, "ann", reason, for_h, moment, time.time_ns()), moment)

    def acknowledge(self, alarm_id: int, command) -> None:
        """Execute an acknowledgement as the recorder does."""
        row = self.catalogue.alarm(alarm_id)
        moment = Moment(utc_ns=row.raised_utc_ns, due_h=row.raised_h, set_index=None)
        self._build_change(acknowledge_alarm(row, command.author, command.arguments["note"], moment), moment)
        self.catalogue.finish_command(command.id, "done", "acknowledged")

    def records(self, index: int):
        """Return the records of a set, the same at every call."""
        return self._records(self.due[index])

    def show_set(self, index: int) -> None:
        self.show(self._records(self.due[index]), self.due[index].due_h)

    def _records(self, due) -> list[Shot | PulseEchoRecord]:
        records: list[Shot | PulseEchoRecord] = []
        sequence = 100 * due.set_index + 1
        for position, place in self.settings.positions.items():
            count = 1 if place.method == "pulse_echo" else self.shots_per_set
            for shot in range(count):
                key = ShotKey(position=position, set_index=due.set_index, shot_index=shot)
                stamp = Stamp(
                    utc_ns=due.due_utc_ns + 4 * shot * 1_000_000_000,
                    mono_ns=due.due_utc_ns,
                    boot_id="simulated",
                )
                if place.method == "pulse_echo":
                    waveform = PULSE_ECHO.waveform(sequence)
                    records.append(
                        PulseEchoRecord(
                            sequence=sequence,
                            key=key,
                            stamp=stamp,
                            waveform=waveform,
                            gain_db=40.0,
                            offset_v=0.0,
                            averages=16,
                        )
                    )
                else:
                    waveform = self.scene(position, due.due_h).waveform(sequence)
                    records.append(Shot(sequence=sequence, key=key, stamp=stamp, waveform=waveform))
                sequence += 1
        return records

    def _set_record(self, due, records) -> SetRecord:
        return SetRecord(
            set_index=due.set_index,
            due_utc_ns=due.due_utc_ns,
            due_h=due.due_h,
            started_utc_ns=due.due_utc_ns,
            ended_utc_ns=due.due_utc_ns + NS_PER_H // 60,
            rig_kind="simulated",
            positions=[
                PositionRecord(
                    position=name,
                    method=place.method,
                    n_planned=1 if place.method == "pulse_echo" else self.shots_per_set,
                )
                for name, place in self.settings.positions.items()
            ],
            shots=[record for record in records if isinstance(record, Shot)],
            echoes=[record for record in records if isinstance(record, PulseEchoRecord)],
        )

    def _events(self, due, position: str, method: str) -> list[EventRow]:
        kinds = (
            [("sets", "set_done"), ("thickness", "thickness_read")]
            if method == "pulse_echo"
            else [("sets", "set_done"), ("features", "set_features"), ("assessments", "set_assessed")]
        )
        return [
            EventRow(
                utc_ns=due.due_utc_ns,
                topic=topic,
                kind=kind,
                position=position,
                set_index=due.set_index,
                payload={"due_h": due.due_h},
            )
            for topic, kind in kinds
        ]


@contextmanager
def filled_folder(
    folder: Path, settings: Settings | None = None, *, sets: int = 0, stored: bool = False, **options: object
) -> Iterator[FilledFolder]:
    """Yield a folder with that many sets, with their records where ``stored``; close it at the end."""
    filled = FilledFolder(folder, settings or Settings(), **options)
    try:
        for index in range(sets):
            filled.add_set(index, stored=stored)
        yield filled
    finally:
        filled.close()


@contextmanager
def served_folder(
    folder: Path, *arguments: object, **options: object
) -> Iterator[tuple[FilledFolder, httpx2.Client]]:
    """Yield a filled folder and a client of its web service."""
    with (
        filled_folder(folder, *arguments, **options) as filled,
        served(filled.settings, folder) as service,
        service.client() as client,
    ):
        yield filled, client
