"""Year of 20 positions (350,000 sensor-sets): data read by every route, `solimon status` and a start.

    python benchmarks/year_of_20_positions.py [--folder F] [--sets N] [--rounds R] [--json]

A set every half hour, 19 transducers with ten shots and one probe, as `commit_set` stores them; a kept
``--folder`` is filled once. The archive holds a name for each set, the newest file is a real one. Each route
is asked in many ways, first and deep pages. "plain" is the obvious way to the same answer, measured in the
same run: one scan of the rows, without making anything of them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import sqlite3
import sys
import tempfile
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from analysis.diagnosis.diagnose import Diagnosis
from analysis.diagnosis.hypotheses import OK, PRIOR
from analysis.diagnosis.slopes import COMPONENTS
from analysis.statistics.named_limits import AVERAGE, LIMITS, MEWMA
from analysis.ultrasound.thickness import EXTRACTOR_VERSION as ECHO_EXTRACTOR
from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.acquisition.schedule import plan_sets
from daq_service.archive import FolderArchive, PositionRecord, SetRecord
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.records import build_reference
from daq_service.assessment.diagnosis_texts import build_diagnosis_details
from daq_service.background.live_figure import LiveFigure
from daq_service.catalogue import SetCommit, open_catalogue
from daq_service.catalogue.experiment_file import HISTORY_FILE
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.reported_rows import to_payload
from daq_service.catalogue.rows import (
    AlarmRow,
    AssessmentRow,
    EnvironmentRow,
    EventRow,
    FeatureRow,
    SetRow,
    ShotRow,
    ThicknessRow,
)
from daq_service.cli.status.facts import describe_status
from daq_service.clock import parse_utc
from daq_service.processes.heartbeat import Heartbeat
from daq_service.processes.lost_sets import find_lost_sets
from daq_service.recording import session
from daq_service.recording.recorder import Recorder
from daq_service.recording.resources import Resources
from daq_service.settings.tree import Settings
from daq_service.web.app import create_app
from daq_service.web.context import find_app_context
from daq_service.web.routes.stream import generate_frames
from daq_service.web.tables.choice import TABLES
from hardware_drivers.instruments import Rig
from hardware_drivers.measurement import Calibration, DueSet, PulseEchoRecord, Shot, ShotKey, Stamp, Waveform
from simulator.clock import SimulatedClock
from simulator.echo.pulse import build_echo_calibration, simulate_echo

SETS = 17_500
SETS_A_COMMIT = 25
FEWEST_A_ROUND = 10
"""A round asks each route so often, that 20 of them make a 99th percentile of 200 answers."""
LEFT_OUT = ("/api/v1/trends/", "/api/v1/fits/", "/api/v1/report", "/api/v1/waterfall/", "/api/v1/stream")
"""`history_at_any_zoom.py` and `waterfall.py` measure these; a report is a document of the whole test; the
stream is measured by its catch-up."""
CATCH_UP_EVENTS, STREAM, PAGES = 5000, "/api/v1/stream: catch-up on 5,000 events", 3
CALIBRATION = Calibration(coefficients_v=np.array([0.0, 1e-3]), resolution_bits=16, range_v=5.0)
NO_PSW_EVERY, MISSED_EVERY, ALARM_EVERY, COMMANDS = 997, 1499, 29, 200
STATUS, STARTS = "what `solimon status` reads", 3


def year_settings() -> Settings:
    """Return 20 positions and a set every half hour for the duration of `SETS`."""
    positions: dict[str, Any] = {"P00": {"method": "pulse_echo"}}
    positions |= {f"P{number:02d}": {"method": "solitary_wave"} for number in range(1, 20)}
    phases = [{"until_h": SETS / 2, "interval_h": 0.5}]
    return Settings(positions=positions, schedule={"phases": phases})


# The folder ------------------------------------------------------------------------------------------


def fill(folder: Path, settings: Settings, n_sets: int) -> None:
    """Store sets as a recorder does, many per transaction; return file names, and the last file itself."""
    due_sets = plan_sets(settings.schedule.phases, parse_utc(settings.clock.epoch))[:n_sets]
    rng, sequence = np.random.default_rng(0), 0
    with open_catalogue(folder, writer=True) as catalogue:
        catalogue.create_experiment(
            name=settings.name,
            configuration_hash=settings.configuration_hash(),
            configuration=settings.model_dump(mode="json"),
            epoch_utc_ns=parse_utc(settings.clock.epoch),
            clock="simulated",
            solimon_version="0",
        )
        catalogue.add_service_event(utc_ns=0, kind="recorder_started", payload={"dry_run": False})
        for first in range(0, n_sets, SETS_A_COMMIT):
            commit = SetCommit()
            for due in due_sets[first : first + SETS_A_COMMIT]:
                sequence = _add_set(commit, settings, due, sequence, rng)
            catalogue.commit_set(commit)
            print(f"\r{min(first + SETS_A_COMMIT, n_sets)} of {n_sets} sets", end="", file=sys.stderr)
        print(file=sys.stderr)
        for number in range(COMMANDS):
            command = catalogue.add_command("ann", "acknowledge_alarm", {"alarm_id": number + 1, "note": ""})
            catalogue.finish_command(command, "done", "")
    (folder / "sets").mkdir(exist_ok=True)
    # The first one that the probe took (`MISSED_EVERY`): what every later reading refers to.
    first, last = records_of(settings, due_sets[1], 0), records_of(settings, due_sets[-1], sequence)
    for due in (due_sets[0], *due_sets[2:-1]):
        path = folder / build_reference(due.set_key, due.due_utc_ns)
        path.write_bytes(b"a file without content is one that was lost")
    with closing(FolderArchive(folder)) as archive:
        for record in (first, last):
            archive.store_set(record)
            finalize_set(folder, record.set_key)
            archive.settle(record.set_key)
    Heartbeat(folder, deadline_s=1e9).beat("waiting")
    (folder / "live").mkdir(exist_ok=True)
    LiveFigure(folder, "simulated").show(last.echoes[0], due_h=due_sets[-1].due_h, features=None)


def _chart_and_diagnosis_columns(drawn: list[float]) -> dict[str, Any]:
    """Return chart, limits and diagnosis of an assessed set."""
    change = tuple(1e-3 * drawn[k % len(drawn)] for k in range(len(COMPONENTS)))
    cause = Diagnosis(
        cause=OK,
        probability=0.98,
        probabilities=PRIOR,
        abrupt=abs(drawn[0]) / 10.0,
        changes=dict(zip(COMPONENTS, change, strict=True)),
        confirmed=False,
        reseated=False,
        returned=False,
    )
    return {
        "cause": cause.cause,
        "diagnosis_probability": cause.probability,
        "diagnosis_details": build_diagnosis_details(cause),
        "chart": abs(drawn[1]),
        "mewma_alarm": False,
        "limits": {name: 24.3 + abs(drawn[2]) for name in LIMITS},
        "statistics": {limit.of: abs(drawn[3]) for limit in LIMITS.values()},
        "averages": {AVERAGE: drawn, MEWMA: drawn},
    }


def _add_set(
    commit: SetCommit, settings: Settings, due: DueSet, sequence: int, rng: np.random.Generator
) -> int:
    """Add all rows of a set to a commit; return the sequence of its last shot."""
    file = build_reference(due.set_key, due.due_utc_ns)
    values = rng.standard_normal((len(settings.positions), 5))
    for number, (position, place) in enumerate(settings.positions.items()):
        own: dict[str, Any] = {"set_index": due.set_index, "position": position}
        set_columns: dict[str, Any] = {**own, "due_h": due.due_h}
        missed = (due.set_index + number) % MISSED_EVERY == 0
        probe = place.method == "pulse_echo"
        extractor = ECHO_EXTRACTOR if probe else EXTRACTOR_VERSION
        found: dict[str, Any] = {**set_columns, "extractor_version": extractor, "quality": "good"}
        n_planned = 1 if probe else settings.schedule.shots_per_set
        n_taken = 0 if missed else n_planned
        commit.sets.append(
            SetRow(
                **own,
                method=place.method,
                due_utc_ns=due.due_utc_ns,
                due_h=due.due_h,
                started_utc_ns=due.due_utc_ns,
                ended_utc_ns=due.due_utc_ns + 10**9,
                state="missed" if missed else "done",
                reason="no trigger" if missed else None,
                n_planned=n_planned,
                n_taken=n_taken,
                n_valid=n_taken,
                n_missed=n_planned - n_taken,
                file=None if missed else file,
                file_sha256=None if missed else f"{due.set_index:064x}",
            )
        )
        _add_event(commit, due, "sets", f"set_{commit.sets[-1].state}", commit.sets[-1])
        for shot_index in range(n_taken):
            sequence += 1
            commit.shots.append(
                ShotRow(
                    **own,
                    sequence=sequence,
                    shot_index=shot_index,
                    attempt=0,
                    utc_ns=due.due_utc_ns + shot_index,
                    mono_ns=sequence,
                    boot_id="simulated",
                    crc32=sequence,
                    valid=True,
                    flags=["no_psw"] if sequence % NO_PSW_EVERY == 0 else [],
                )
            )
        if missed:
            continue
        if probe:
            wall_m = 6.35e-3 - 1e-7 * due.set_index
            read = ThicknessRow(
                **found, sequence=sequence, travel_time_s=wall_m / 2950.0, thickness_m=wall_m,
                thickness_loss_m=6.35e-3 - wall_m, correlation_coefficient=0.98,
            )  # fmt: skip
            commit.thickness.append(read)
            _add_event(commit, due, "thickness", "thickness_read", read)
            continue
        feature = _feature(found, values[number], n_taken)
        for shot_index in range(n_taken):
            shot = {**found, "shot_index": shot_index, "sequence": sequence - n_taken + 1 + shot_index}
            commit.features.append(_feature(shot, values[number], 1))
        commit.features.append(feature)
        _add_event(commit, due, "features", "set_features", feature)
        assessment = AssessmentRow(
            **set_columns,
            in_baseline=due.set_index < 48,
            distance_squared=5.0,
            limit_name="f_predictive",
            limit_f_predictive=24.3,
            limit_mean_3sd=12.1,
            outlier=None if due.set_index < 48 else False,
            contributions={"tof_pp_s": 1.0, "tof_ac_s": 1.0, "amplitude_ratio": 1.0},
            **({} if due.set_index < 48 else _chart_and_diagnosis_columns(values[number].tolist())),
        )
        commit.assessments.append(assessment)
        _add_event(commit, due, "assessments", "set_assessed", assessment)
    environment = EnvironmentRow(
        set_index=due.set_index, due_h=due.due_h, supply_state="on", supply_quality="good", supply_age_s=0.5,
        voltage_v=10.0, current_a=0.005, charge_coulomb=18.0 * due.due_h, climate_quality="good",
        temperature_c=21.5,
    )  # fmt: skip
    commit.environment.append(environment)
    _add_event(commit, due, "environment", "environment_read", environment)
    if due.set_index % ALARM_EVERY == 0:
        alarm = AlarmRow(
            position="P01", kind="few_valid_shots", alarm_class="diagnostic", priority="medium",
            raised_utc_ns=due.due_utc_ns, evidence={},
            state="unacknowledged" if due.set_index > 0.98 * SETS else "normal", raised_h=due.due_h,
            raised_set_index=due.set_index, changed_utc_ns=due.due_utc_ns, message="2 sets running",
        )  # fmt: skip
        commit.alarms.append(alarm)
        _add_event(commit, due, "alarms", "alarm_raised", alarm)
    return sequence


def _feature(found: dict[str, Any], noise: Any, n_valid: int) -> FeatureRow:
    tof_pp, tof_ac, ratio, coefficient, area = (1.0 + 0.01 * noise).tolist()
    columns = {"shot_index": None, "sequence": None, **found}
    return FeatureRow(
        **columns, n_valid=n_valid, tof_pp_s=3.3e-4 * tof_pp, tof_ac_s=3.3e-4 * tof_ac,
        amplitude_ratio=0.5 * ratio, autocorrelation_coefficient=0.6 * coefficient, psw_area_v_s=1e-4 * area,
        tof_mf_s=3.3e-4 * tof_pp, isw_amplitude_v=5.0, psw_amplitude_v=2.5, isw_time_s=5e-5, psw_time_s=4e-4,
        isw_fwhm_s=6.5e-5, psw_isw_area_ratio=0.5, noise_rms_v=0.02,
    )  # fmt: skip


def _add_event(commit: SetCommit, due: DueSet, topic: str, kind: str, row: Any) -> None:
    commit.events.append(
        EventRow(
            utc_ns=due.due_utc_ns,
            wall_utc_ns=due.due_utc_ns,
            topic=topic,
            kind=kind,
            position=getattr(row, "position", None),
            set_index=due.set_index,
            payload=to_payload(row),
        )
    )


def records_of(settings: Settings, due: DueSet, first: int) -> SetRecord:
    """Return a set with records, so that waveforms can be read; sequences count from ``first``."""
    rng, records, echo = np.random.default_rng(first), list[Any](), settings.twin.echo
    for position, place in settings.positions.items():
        for shot_index in range(1 if place.method == "pulse_echo" else settings.schedule.shots_per_set):
            taken: dict[str, Any] = {
                "sequence": first + len(records),
                "key": ShotKey(position=position, set_index=due.set_index, shot_index=shot_index),
                "stamp": Stamp(utc_ns=due.due_utc_ns, mono_ns=first, boot_id="simulated"),
            }
            if place.method == "pulse_echo":
                calibration = build_echo_calibration(echo)
                counts = np.rint(simulate_echo(6.35e-3, echo) / calibration.coefficients_v[1]).astype(
                    np.int16
                )
                wave = Waveform(
                    counts=counts, sample_rate_hz=echo.sample_rate_hz, pretrigger_samples=0,
                    calibration=calibration,
                )  # fmt: skip
                gain: dict[str, Any] = {"gain_db": 30.0, "offset_v": 0.0, "averages": 16}
                records.append(PulseEchoRecord(**taken, **gain, waveform=wave))
                continue
            wave = Waveform(
                counts=rng.normal(0.0, 300.0, 13_600).astype(np.int16), sample_rate_hz=1e7,
                pretrigger_samples=1000, calibration=CALIBRATION,
            )  # fmt: skip
            records.append(Shot(**taken, waveform=wave))
    return SetRecord(
        set_index=due.set_index,
        due_utc_ns=due.due_utc_ns,
        due_h=due.due_h,
        started_utc_ns=due.due_utc_ns,
        ended_utc_ns=due.due_utc_ns + 10**9,
        rig_kind="simulated",
        positions=[
            PositionRecord(position=name, method=place.method, n_planned=10)
            for name, place in settings.positions.items()
        ],
        shots=[record for record in records if isinstance(record, Shot)],
        echoes=[record for record in records if isinstance(record, PulseEchoRecord)],
        provenance={},
    )


# What is measured --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Seconds:
    """Wall time and processor time of a call; other people's work changes the latter less."""

    wall: float
    cpu: float
    call: str


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _since(began: tuple[float, float], call: str = "") -> Seconds:
    wall, cpu = _now()
    return Seconds(wall - began[0], cpu - began[1], call)


def times_s(function: Callable[[], object], rounds: int) -> list[Seconds]:
    """Return the seconds of each call."""
    taken = []
    for _ in range(rounds):
        began = _now()
        function()
        taken.append(_since(began))
    return taken


def queries(path: str, n_sets: int, chance: random.Random) -> list[str]:
    """Return queries of a route: plain, filtered, first and deep pages by the cursors."""
    end_h = n_sets / 2
    middle, position = round(chance.uniform(0.0, end_h), 1), f"P{chance.randrange(20):02d}"
    index = chance.randrange(n_sets)
    hours = [f"from_h={middle}", f"to_h={middle}", f"from_h={middle}&to_h={middle + 24}", "to_h=1",
             f"from_h={end_h - 1}"]  # fmt: skip
    named = [f"position={position}", *(f"position={position}&{part}" for part in hours)]
    queries_by_path = {
        "sets": [*hours, *named, "state=missed", "state=disabled", f"state=missed&position={position}",
                 f"state=done&position={position}", f"state=missed&from_h={middle}"],
        "features": [*hours, *named, f"set_index={index}", f"set_index={index}&{named[0]}",
                     *(f"scope=shot&{part}" for part in (*named, *hours))],
        "thickness": [*hours, *named, f"set_index={index}"],
        "assessments": [*hours, *named, f"set_index={index}"],
        "environment": hours,
        "alarms": ["active=true", "active=false", named[0]],
        "baselines": [named[0]],
    }  # fmt: skip
    if path.endswith("/tables/{table}"):  # of a position's day; what is asked for more costs more
        day = {table: hours[2] if table == "environment" else named[3] for table in TABLES}
        return [path.format(table=table) + f"?{query}" for table, query in day.items()]
    if path.endswith("/files/{name}"):
        last = plan_sets(year_settings().schedule.phases, parse_utc(year_settings().clock.epoch))[n_sets - 1]
        return [path.format(name=Path(build_reference(last.set_key, last.due_utc_ns)).name)]
    if path.endswith("/waveforms/{position}"):
        path += f"?first_set={n_sets - 1}&last_set={n_sets - 1}"
    path = path.replace("{set_index}", str(n_sets - 1)).replace("{shot_index}", "0")
    path = path.replace("{alarm_id}", str(chance.randint(1, 1 + (n_sets - 1) // ALARM_EVERY)))
    path = path.replace("{command_id}", str(chance.randrange(1, COMMANDS)))
    path = path.replace("{position}", "P00" if "live" in path else position)
    return [path, *(f"{path}?{query}" for query in queries_by_path.get(path.rpartition("/")[2], []))]


async def routes_s(folder: Path, settings: Settings, n_sets: int, rounds: int) -> dict[str, list[Seconds]]:
    """Return seconds of every answer by route, without a socket, and of the stream's catch-up."""
    app, chance = create_app(settings, folder), random.Random(0)
    taken: dict[str, list[Seconds]] = {}
    transport = httpx2.ASGITransport(app)
    async with (
        app.router.lifespan_context(app),
        httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1", verify=False) as client,
    ):
        for path, methods in app.openapi()["paths"].items():
            if "get" not in methods or path.startswith(LEFT_OUT):
                continue
            for _ in range(rounds):
                for queries_by_path in queries(path, n_sets, chance):
                    taken.setdefault(path, []).extend(
                        [took async for took in _pages_s(client, queries_by_path)]
                    )
            while len(taken[path]) < FEWEST_A_ROUND * rounds:
                taken[path].extend(
                    [took async for took in _pages_s(client, queries(path, n_sets, chance)[0])]
                )
        context = find_app_context(app)
        last = (await client.get("/api/v1/info")).json()["last_event_id"]
        for _ in range(FEWEST_A_ROUND * rounds):
            began = _now()
            stream = generate_frames(context, context.hub, None, last - CATCH_UP_EVENTS)
            async for chunk in stream:
                if b"id: %d\n" % last in chunk:
                    break
            await stream.aclose()
            taken.setdefault(STREAM, []).append(_since(began))
    return taken


async def _pages_s(client: httpx2.AsyncClient, queries_by_path: str) -> AsyncIterator[Seconds]:
    """Yield seconds of the first pages of a listing, or of the one answer."""
    url = httpx2.URL(queries_by_path)
    for _ in range(PAGES):
        began = _now()
        answer = await client.get(url)
        yield _since(began, f"{url}")
        answer.raise_for_status()
        is_json = answer.headers["content-type"].startswith("application/json")
        cursor = answer.json().get("next_cursor") if is_json else None
        if cursor is None:
            return
        url = url.copy_set_param("cursor", cursor)


def start_s(folder: Path, settings: Settings) -> dict[str, float]:
    """Return seconds of the reads at a start, by stage."""
    taken: dict[str, float] = {}
    began = time.perf_counter()

    def note(stage: str) -> None:
        nonlocal began
        taken[stage] = time.perf_counter() - began
        began = time.perf_counter()

    with open_catalogue(folder, writer=True, settings=settings) as catalogue:
        note("open")
        HistoryFollower(folder, catalogue).begin()
        note("history")
        assert not catalogue.list_sets_without_digest()
        note("digests")
        assert not find_lost_sets(folder, catalogue)
        note("files")
        with closing(FolderArchive(folder)) as archive:
            note("archive")
            resumed_ns = session._find_resume_utc_ns(catalogue, archive, 0)
            note("resume")
            rig = Rig(kind="simulated", clock=SimulatedClock(resumed_ns), striker=None, digitizer=None)  # type: ignore[arg-type]
            Recorder(
                Resources(
                    settings=settings, archive=archive, catalogue=catalogue, rig=rig,
                    heartbeat=Heartbeat(folder, deadline_s=1e9), live=LiveFigure(folder, "simulated"),
                    stop=threading.Event(), report=lambda event, **values: None,
                )
            )  # fmt: skip
            note("recorder")
    return taken | {"all": sum(taken.values())}


PLAIN = {
    "status": (
        "SELECT set_index, sum(n_taken) FROM sets GROUP BY set_index",
        "SELECT position, count(*) FROM shots GROUP BY position",
        "SELECT count(*) FROM events",
        "SELECT position, max(set_index) FROM features WHERE shot_index IS NULL GROUP BY position",
    ),
    "start": ("SELECT * FROM sets", "SELECT * FROM features WHERE shot_index IS NULL"),
    "routes": ("SELECT * FROM features WHERE position = 'P05' AND due_h >= 4000.0 ORDER BY id LIMIT 101",),
}


def plain_s(folder: Path, statements: tuple[str, ...]) -> float:
    """Return seconds of reading the same by scans, without making objects of the rows."""
    with closing(sqlite3.connect(f"file:{folder / 'catalogue.sqlite'}?mode=ro", uri=True)) as connection:
        began = time.perf_counter()
        for statement in statements:
            for _ in connection.execute(statement):
                pass
        return time.perf_counter() - began


def measure(folder: Path, n_sets: int, rounds: int) -> dict[str, Any]:
    """Return everything that is printed."""
    settings = year_settings()
    if not (folder / "catalogue.sqlite").exists():
        fill(folder, settings, n_sets)
    with open_catalogue(folder, writer=True, settings=settings) as catalogue:
        began = time.perf_counter()
        HistoryFollower(folder, catalogue).begin()
        print(f"a history of {(folder / HISTORY_FILE).stat().st_size / 1e9:.2f} GB was "
              f"brought up to date in {time.perf_counter() - began:.1f} s", file=sys.stderr)  # fmt: skip
    with closing(sqlite3.connect(folder / "catalogue.sqlite")) as connection:
        names = ("sets", "shots", "features", "assessments", "thickness", "environment", "events", "alarms")
        rows = {name: connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0] for name in names}
    status = times_s(lambda: describe_status(folder, settings), FEWEST_A_ROUND * rounds)
    starts = [start_s(folder, settings) for _ in range(STARTS)]
    routes = asyncio.run(routes_s(folder, settings, n_sets, rounds))
    return {
        "rows": rows,
        "catalogue_bytes": (folder / "catalogue.sqlite").stat().st_size,
        "answers": {
            name: {
                "n": len(taken),
                "first_s": taken[0].wall,
                "p50_s": float(np.median([took.wall for took in taken])),
                "p99_s": float(np.quantile([took.wall for took in taken], 0.99)),
                "p99_cpu_s": float(np.quantile([took.cpu for took in taken], 0.99)),
                "slowest": max(taken, key=lambda took: took.cpu).call,
            }
            for name, taken in {STATUS: status, **routes}.items()
        },
        "start_s": min(starts, key=lambda start: start["all"]),
        "plain_s": {name: plain_s(folder, statements) for name, statements in PLAIN.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--folder", type=Path, help="kept, and filled once; default: a temporary one")
    parser.add_argument("--sets", type=int, default=SETS)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = options.folder or Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        facts = measure(folder, options.sets, options.rounds)
    if options.json:
        print(json.dumps(facts))
        return
    print(", ".join(f"{number:,} {name}" for name, number in facts["rows"].items()))
    print(f"catalogue {facts['catalogue_bytes'] / 1e9:.2f} GB")
    print(f"{'answer':<56}{'n':>6}{'first ms':>10}{'p50 ms':>9}{'p99 ms':>9}{'p99 of CPU':>12}  slowest")
    for name, answer in facts["answers"].items():
        ms = [1e3 * answer[key] for key in ("first_s", "p50_s", "p99_s", "p99_cpu_s")]
        columns = f"{ms[0]:>10.1f}{ms[1]:>9.1f}{ms[2]:>9.1f}{ms[3]:>12.1f}"
        print(f"{name:<56}{answer['n']:>6}{columns}  {answer['slowest']}")
    stages = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in facts["start_s"].items())
    print(f"a start reads: {stages}")
    for name, seconds in facts["plain_s"].items():
        print(f"plain scan for {name}: {1e3 * seconds:.0f} ms")


if __name__ == "__main__":
    main()
