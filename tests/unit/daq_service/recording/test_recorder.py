"""The recording line on a rig in memory: sets taken, stored, missed and continued, and its end."""

import threading
from dataclasses import replace

import pytest
from support.machine import clock_in_seconds
from support.memory_archive import MemoryArchive
from support.memory_line import SETS, KilledError, Line, healthy, memory_settings, silent
from support.refused_calls import refuse

from daq_service.archive import ArchiveWriteError
from daq_service.background.disk_watch import DiskWatch
from daq_service.background.task import BackgroundTask
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.errors import CatalogueBusyError
from daq_service.clock import parse_utc
from daq_service.errors import RigError
from daq_service.processes.disk_policy import RESERVE_FILE
from daq_service.recording.persistence import Persistence
from daq_service.recording.set_assessor import SetAssessor
from daq_service.settings.tree import StorageSettings
from hardware_drivers.errors import BusyError, ConfigurationError, ConnectionLostError
from hardware_drivers.measurement import SetKey, ShotKey
from simulator.clock import SimulatedClock

TRANSDUCERS = ("B", "C", "D")


@pytest.fixture
def line(tmp_path):
    return Line(tmp_path / "data")


def states(line, position):
    return [row.state for row in line.rows("sets", position)]


def causes(line, position):
    return [row.reason for row in line.rows("sets", position)]


def events_of(line, kind):
    return [row for row in line.rows("events") if row.kind == kind]


def rig_alarms(line):
    return [row for row in line.rows("alarms") if row.kind == "instruments_unavailable"]


class WatchedArchive(MemoryArchive):
    """Archive that records how many sets have rows when one is stored, and is killed at some."""

    def __init__(self, line, refuse=()):
        super().__init__(line.shelf)
        self.line, self.refuse, self.seen = line, refuse, []

    def store_set(self, record):
        if record.set_index in self.refuse:
            raise KilledError
        self.seen.append((record.set_index, len(self.line.rows("sets", "B"))))
        return super().store_set(record)


def test_every_due_set_is_struck_in_order_and_has_its_rows(line):
    assert line.run()
    for position in "ABCD":
        assert [row.set_index for row in line.rows("sets", position)] == list(range(SETS))
        assert states(line, position) == ["done"] * SETS
    first = [(position, 0, shot, 0) for position in TRANSDUCERS for shot in range(4)]
    assert line.instruments[0].struck[:12] == first
    assert [shot.sequence for shot in line.rows("shots")] == list(range(1, 13 * SETS + 1))
    assert line.rows("events")[0].kind == "recorder_started"
    assert line.rows("events")[-1].kind == "schedule_done"


def test_a_set_is_durable_before_it_is_reported(line):
    archive = WatchedArchive(line)
    line.run(archive=archive)
    assert archive.seen == [(index, index) for index in range(SETS)]


class Seconds:
    """Monotonic clock that advances at each read."""

    def __init__(self, step_s=10.0):
        self.now_s, self.step_s = 0.0, step_s

    def __call__(self):
        self.now_s += self.step_s
        return self.now_s


class FullDisk(MemoryArchive):
    """Disk that accepts nothing from a set on, until a number of attempts."""

    def __init__(self, line, first, times, error=None):
        super().__init__(line.shelf)
        self.first, self.left = first, times
        self.error = error or ArchiveWriteError("No space left on device")

    def store_set(self, record):
        if record.set_index >= self.first and self.left:
            self.left -= 1
            raise self.error
        return super().store_set(record)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Return an undisturbed test; read-only."""
    one = Line(tmp_path_factory.mktemp("whole"))
    one.run()
    return one


def assert_same_rows(line, undisturbed):
    for table in ("sets", "shots", "features", "thickness", "assessments", "baselines"):
        assert line.rows(table) == undisturbed.rows(table), table


@pytest.mark.parametrize(
    "error", [ArchiveWriteError("No space left on device"), OSError(24, "Too many open files")]
)
def test_the_recorder_waits_for_a_full_disk_and_raises_an_alarm(line, undisturbed, error):
    assert line.run(archive=FullDisk(line, 3, 7, error), mono_s=Seconds())
    assert_same_rows(line, undisturbed)
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "write_failed"]
    assert (alarm.state, alarm.position) == ("returned_unacknowledged", None)
    assert str(error) in alarm.message
    assert any(f"1 jobs wait in memory for the disk: {error}" in doing for doing in line.heartbeat.activities)
    assert line.heartbeat.activities[-2].endswith(f"set {SETS - 1}"), "and no longer once it is over"
    assert line.heartbeat.activities[-1] == "leaving"


def test_in_real_time_sets_are_struck_on_and_stored_later(line, undisturbed):
    line.settings = memory_settings(clock={"kind": "wall"})
    disk = FullDisk(line, 3, 4)
    assert line.run(archive=disk, mono_s=Seconds(0.4))
    waited = [doing for doing in line.heartbeat.activities if "wait in memory" in doing]
    assert any(doing.startswith("taking set 5;") for doing in waited), "struck while set 3 was waiting"
    assert line.instruments[0].struck == undisturbed.instruments[0].struck
    for table in ("sets", "features", "assessments"):
        assert line.rows(table) == undisturbed.rows(table), table


def test_in_real_time_each_recorder_reports_its_first_due_set_once(line):
    line.settings, due = memory_settings(clock={"kind": "wall"}), []
    notify = lambda event, **values: due.append(values) if event == "due" else None  # noqa: E731
    line.run(stop=line.stop_at(ShotKey(position="B", set_index=3, shot_index=0)), notify=notify)
    line.run(start_h=1.75, notify=notify)
    epoch_ns = parse_utc(line.settings.clock.epoch)
    assert [(one["set_index"], one["due_h"], one["in_s"]) for one in due] == [
        (0, 0.5, 1800.0),
        (3, 2.0, 900.0),
    ]
    assert due[0]["due_utc_ns"] == epoch_ns + 1800 * 10**9


def test_sets_beyond_the_memory_are_missed_with_the_cause(line, monkeypatch):
    line.settings = memory_settings(clock={"kind": "wall"})
    monkeypatch.setattr(Persistence, "has_room", property(lambda backlog: len(backlog) < 2))
    disk, work = FullDisk(line, 3, 10**9), Persistence.run_for

    def freed(backlog, seconds):
        """Work, and free the disk when two sets and three gaps wait."""
        if len(backlog) >= 5:
            disk.left = 0
        work(backlog, seconds)

    monkeypatch.setattr(Persistence, "run_for", freed)
    assert line.run(archive=disk, mono_s=Seconds(100.0))  # each poll is late enough for another try
    assert states(line, "B") == ["done"] * 5 + ["missed"] * 3 + ["done"] * (SETS - 8)
    assert causes(line, "B")[5] == "the memory for what waits is full: No space left on device"


LOCKED = CatalogueBusyError("database is locked")


def refuse_commits(monkeypatch, when, *, times, **options):
    refuse(monkeypatch, RecorderCatalogue, "commit_set", LOCKED, times=times, when=when, **options)


def of_set_4(catalogue, transaction):
    return any(row.set_index == 4 for row in transaction.sets)


@pytest.mark.parametrize("stored_all_the_same", [False, True])
def test_a_commit_that_failed_is_repeated_and_never_doubled(
    line, undisturbed, monkeypatch, stored_all_the_same
):
    before = RecorderCatalogue.commit_set if stored_all_the_same else lambda *_: None
    refuse_commits(monkeypatch, of_set_4, times=3, before=before)
    assert line.run(mono_s=Seconds())
    assert_same_rows(line, undisturbed)
    assert "write_failed" in {row.kind for row in line.rows("alarms")}


def test_a_set_missed_while_another_program_locks_the_catalogue_has_that_as_its_cause(line, monkeypatch):
    line.settings = memory_settings(clock={"kind": "wall"})
    clock = SimulatedClock(parse_utc(line.settings.clock.epoch))

    def two_sets_later(*_):
        clock.wait_until(clock.utc_ns() + 2 * 1800 * 10**9, lambda: True)

    refuse_commits(monkeypatch, of_set_4, times=2, before=two_sets_later)
    assert line.run(clock=clock, mono_s=Seconds())
    missed = {row.reason for row in line.rows("sets", "B") if row.state == "missed"}
    assert missed == {"the recorder waited for the disk: database is locked"}


def test_the_recorder_waits_for_the_last_event_of_a_test(line, monkeypatch):
    is_last = lambda catalogue, *, kind, **values: kind == "schedule_done"  # noqa: E731
    refuse(monkeypatch, RecorderCatalogue, "add_service_event", LOCKED, times=2, when=is_last)
    assert line.run(mono_s=Seconds())
    assert "schedule_done" in {row.kind for row in line.rows("events")}
    assert {row.state for row in line.alarms()} == {"returned_unacknowledged"}


LAST_OF_SET_3 = ShotKey(position="D", set_index=3, shot_index=3)


def test_a_stop_does_not_wait_for_the_disk(line, caplog):
    stop = line.stop_at(LAST_OF_SET_3)
    assert not line.run(archive=FullDisk(line, 3, 10**9), stop=stop, mono_s=Seconds())
    assert len(line.rows("sets", "B")) == 3
    assert "jobs are lost that no disk took" in caplog.text


class SlowWorker(BackgroundTask):
    """Worker that finishes a set at every fourth poll."""

    trouble, damaged = "", {}

    def __init__(self):
        self.n_under_way = self.most = self.looks = 0

    @property
    def waits(self):
        return self.n_under_way > 0

    def after_set(self, set_index):
        self.n_under_way += 1
        self.most = max(self.most, self.n_under_way)

    def run_for(self, seconds=0.0):
        self.looks += 1
        self.n_under_way -= self.looks % 4 == 0 and self.n_under_way > 0

    retry_failed_sets = run_for


def test_simulated_time_does_not_outrun_the_files(line, monkeypatch):
    monkeypatch.setattr("daq_service.recording.waiting.MOST_UNDER_WAY", 2)
    worker = SlowWorker()
    assert line.run(archive=MemoryArchive(line.shelf), finalizer=worker)
    assert (worker.most, worker.n_under_way) == (3, 0)
    assert states(line, "B") == ["done"] * SETS


def test_the_alarm_of_sets_without_files_is_stored_though_the_catalogue_refused_it_first(line, monkeypatch):
    worker = SlowWorker()
    worker.trouble = "no file can be made"
    of_the_alarm = lambda _, transaction: any(row.kind == "write_failed" for row in transaction.alarms)  # noqa: E731
    refuse_commits(monkeypatch, of_the_alarm, times=3)
    assert line.run(finalizer=worker, mono_s=Seconds())
    (alarm,) = [row for row in line.alarms() if row.kind == "write_failed"]
    assert (alarm.state, "no file can be made" in alarm.message) == ("unacknowledged", True)


class Volume:
    """Volume of 100 GB that fills when a set is struck and is freed after a number of reads."""

    def __init__(self, line, set_index, free_gb, looks):
        self.line, self.set_index, self.free_gb, self.left = line, set_index, free_gb, looks
        line.script = self.script

    def script(self, key):
        self.struck = key.set_index
        return healthy(key)

    def __call__(self, folder):
        full = self.left and getattr(self, "struck", 0) >= self.set_index
        self.left -= bool(full)
        return round((self.free_gb if full else 50.0) * 1e9), 10**11

    def watch(self):
        return DiskWatch(
            self.line.folder, StorageSettings(reserve_mb=1), usage=self, machine=clock_in_seconds(Seconds())
        )


def test_below_five_percent_free_no_data_are_stored(line, undisturbed):
    assert line.run(disk=Volume(line, 3, 4.9, 30).watch(), mono_s=Seconds())
    assert_same_rows(line, undisturbed)
    alarms = {row.kind: row for row in line.alarms()}
    assert alarms["disk_space"].priority == "high"
    assert alarms["disk_space"].message.startswith("Disk full, recording stopped. 4.90 GB free (hour ")
    assert {row.state for row in alarms.values()} == {"returned_unacknowledged"}
    assert [row.payload["level"] for row in events_of(line, "disk_space")] == ["stop", "ample"]
    assert any(
        "below 5% (storage.stop_free_fraction) nothing is stored" in doing
        for doing in line.heartbeat.activities
    )


def test_in_real_time_below_five_percent_free_no_shot_is_acknowledged(line, undisturbed):
    line.settings = memory_settings(clock={"kind": "wall"})
    volume, archive, at = Volume(line, 3, 4.9, 60), MemoryArchive(line.shelf), []
    assert line.run(
        disk=volume.watch(),
        mono_s=Seconds(),
        archive=archive,
        acknowledged=lambda shot_id: at.append((shot_id, volume.left)),
    )
    assert line.instruments[0].struck == undisturbed.instruments[0].struck
    assert line.rows("sets") == undisturbed.rows("sets")
    assert {left for _, left in at} == {60, 0}, "before the volume was full and after it was freed"
    assert sorted(shot_id for shot_id, _ in at) == [row.sequence for row in line.rows("shots")]


@pytest.mark.parametrize(
    ("free_gb", "level", "alarms"), [(15.0, "warn", []), (9.0, "alarm", [("disk_space", "medium")])]
)
def test_above_five_percent_free_the_test_continues_with_an_event_or_an_alarm(
    line, undisturbed, free_gb, level, alarms
):
    assert line.run(disk=Volume(line, 3, free_gb, 10).watch(), mono_s=Seconds())
    assert [row.payload["level"] for row in events_of(line, "disk_space")] == [level, "ample"]
    assert [(row.kind, row.priority) for row in line.alarms()] == alarms
    assert_same_rows(line, undisturbed)


def test_a_stop_stores_pending_data_in_the_remaining_space(line, caplog):
    disk = Volume(line, 2, 4.9, 10**9).watch()
    line.settings = memory_settings(clock={"kind": "wall"})
    assert not line.run(disk=disk, stop=line.stop_at(LAST_OF_SET_3), mono_s=Seconds(1.0))
    assert states(line, "B") == ["done"] * 4
    assert not (line.folder / RESERVE_FILE).exists()
    assert "jobs are lost" not in caplog.text


def test_a_restart_gives_the_rows_of_an_uninterrupted_run(line, undisturbed):
    for count in (2, 5):  # within the baseline, twice
        with pytest.raises(KilledError):
            line.run(archive=WatchedArchive(line, refuse={count}))
    line.run()
    assert_same_rows(line, undisturbed)
    assert line.rows("alarms") == undisturbed.rows("alarms")


def test_a_file_without_rows_is_taken_over_and_not_struck_again(line, undisturbed):
    orphan = next(record for record in undisturbed.shelf.sets.values() if record.set_index == 0)
    MemoryArchive(line.shelf).store_set(orphan)
    line.run()
    assert line.instruments[0].struck[0] == ("B", 1, 0, 0)
    assert line.rows("features", "B") == undisturbed.rows("features", "B")
    assert line.rows("shots", "B") == undisturbed.rows("shots", "B")


def test_a_corrupt_file_without_rows_is_quarantined_with_an_alarm(line, undisturbed):
    for record in list(undisturbed.shelf.sets.values())[:2]:
        stored = MemoryArchive(line.shelf).store_set(record)
        line.shelf.damaged |= {(stored.file, item.sequence) for item in record.records}
    line.run(start_h=1.2)  # set 0 is over, set 1 is still due
    assert (states(line, "B")[0], states(line, "B")[1]) == ("missed", "done")
    assert causes(line, "B")[0].startswith("its file was damaged and is set aside (memory/sets/set_000000")
    assert line.instruments[0].struck[0] == ("B", 1, 0, 0)
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "data_corrupt"]
    assert (alarm.state, len(alarm.evidence["set_aside"])) == ("unacknowledged", 2)
    line.shelf.quarantine.clear()  # a person has looked at them
    line.run()
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "data_corrupt"]
    assert alarm.state == "returned_unacknowledged"


def test_an_alarm_lost_in_a_crash_is_raised_by_the_next_start(line, undisturbed):
    archive = MemoryArchive(line.shelf)
    archive.set_aside(archive.store_set(next(iter(undisturbed.shelf.sets.values()))).file)
    line.run()
    assert [row.kind for row in line.alarms()] == ["data_corrupt"]


def test_a_recorder_without_its_supervisor_reports_it(line):
    stop, left_alone = threading.Event(), threading.Event()
    stop.set()
    left_alone.set()
    assert not line.run(stop=stop, left_alone=left_alone)
    assert line.rows("events")[-1].kind == "recorder_left_alone"
    assert line.rows("sets") == [], "before the first strike it leaves the set due"


def test_sets_whose_time_is_over_are_missed_with_the_cause(line):
    line.run(cause="the power was out", start_h=2.2)
    assert states(line, "B") == ["missed"] * 3 + ["done"] * (SETS - 3)
    assert causes(line, "B")[:3] == ["the power was out"] * 3
    assert [row.n_planned for row in line.rows("sets", "A")] == [1] * SETS
    # The set of hour 2 is late, not lost: the next one is due at hour 2.5.
    assert line.instruments[0].struck[0] == ("B", 3, 0, 0)


def test_a_poor_shot_is_struck_again_within_the_budget_and_the_better_one_counts(line):
    def script(key):
        poor = key.position == "C" and key.set_index == 0 and key.attempt == 0
        return silent("noisy") if poor else healthy(key)

    line.script = script
    line.run()
    of_c = [strike for strike in line.instruments[0].struck if strike[:2] == ("C", 0)]
    assert of_c == [
        ("C", 0, 0, 0),
        ("C", 0, 0, 1),
        ("C", 0, 1, 0),
        ("C", 0, 1, 1),
        ("C", 0, 2, 0),
        ("C", 0, 3, 0),
    ]
    shots = [shot for shot in line.rows("shots", "C") if shot.set_index == 0]
    assert [shot.outcome for shot in shots] == ["superseded", "accepted"] * 2 + ["accepted"] * 2
    row = line.rows("sets", "C")[0]
    assert (row.n_taken, row.n_restrikes, row.n_valid, row.state) == (6, 2, 2, "done")


def test_a_shot_whose_repetition_counts_is_not_averaged_in(line):
    def script(key):
        noisy = replace(healthy(key, shift=1.0), flags=("noisy",), quality="suspect")
        first = ShotKey(position="C", set_index=0, shot_index=0)
        return noisy if key == first else healthy(key)

    line.script = script
    line.run()
    shots = [ShotKey(position="C", set_index=0, shot_index=shot) for shot in range(4)]
    (row,) = [row for row in line.rows("features", "C") if row.set_index == 0 and row.sequence is None]
    mean = sum(healthy(key).amplitude_ratio for key in shots) / 4
    assert row.amplitude_ratio == pytest.approx(mean, rel=1e-12)  # a mean in another order: rounding only


def test_a_set_without_records_has_rows_with_causes_and_no_file(line):
    silences = lambda key: key.set_index == 2 or (key.position, key.set_index) == ("B", 1)  # noqa: E731
    line.script = lambda key: None if silences(key) else healthy(key)
    line.run()
    assert {states(line, position)[2] for position in "ABCD"} == {"missed"}
    assert SetKey(2) not in MemoryArchive(line.shelf).sets()
    for row in line.rows("sets", "B")[1:3]:
        assert (row.state, row.n_taken, row.n_missed, row.n_restrikes) == ("missed", 0, 6, 2)
        assert (row.reason, row.file) == ("6 missed: no trigger at B", None)
    assert states(line, "C")[1] == "done"


@pytest.mark.parametrize("kind", [BusyError, ConnectionLostError])
def test_a_temporary_rig_error_costs_only_its_set(line, kind):
    trouble = kind("the chassis reboots")
    line.script = lambda key: trouble if key.set_index == 0 and key.position != "A" else healthy(key)
    assert line.run()
    assert states(line, "B")[:3] == ["missed", "done", "done"]
    assert states(line, "A") == ["done"] * SETS
    (alarm,) = rig_alarms(line)
    assert (alarm.state, alarm.position) == ("returned_unacknowledged", None)
    assert alarm.evidence["error_message"] == "the chassis reboots"


def losing(line, *sets):
    """Let the connection be lost at every shot of B in these sets; two shots are too few to end a set."""
    lost = ConnectionLostError("board is gone")
    line.script = lambda key: lost if key.set_index in sets and key.position == "B" else healthy(key)


def of_two_shots(*positions):
    settings = memory_settings(
        schedule={"shots_per_set": 2}, baseline={"minimum_valid_shots": 2}, alarms={"hole_shots": 2}
    )
    return settings.model_copy(update={"positions": {name: settings.positions[name] for name in positions}})


def test_a_long_loss_of_the_rig_disables_no_transducer(line):
    losing(line, 1, 2, 3, 4)
    assert line.run()
    assert states(line, "B") == ["done"] + ["missed"] * 4 + ["done"] * (SETS - 5)
    assert {(row.position, row.kind) for row in line.alarms()} == {(None, "instruments_unavailable")}


def test_a_rig_that_answers_nothing_in_short_sets_raises_the_alarm(line):
    line.settings = of_two_shots("A", "B")
    losing(line, 1, 2)
    assert line.run()
    (alarm,) = rig_alarms(line)
    assert (alarm.raised_set_index, alarm.state) == (1, "returned_unacknowledged")
    assert alarm.message.startswith("Instruments not responding, sets are missed. Board is gone (hour 1.0).")


def test_one_strike_that_is_answered_is_no_trouble_of_the_rig(line):
    line.settings = of_two_shots("A", "B", "C")
    losing(line, 1, 2)
    assert line.run()
    assert rig_alarms(line) == []


class PausingClock(SimulatedClock):
    """Clock with an operator who pauses the test while its third set is awaited, or once it is due."""

    def __init__(self, line, *, late):
        super().__init__(parse_utc(line.settings.clock.epoch))
        self.line, self.late = line, late
        self.due_ns = self.utc_ns() + round(1.5 * 3.6e12)

    def wait_until(self, utc_ns, idle):
        reached = self.late and super().wait_until(utc_ns, idle)
        if self.due_ns is not None and utc_ns >= self.due_ns:
            self.due_ns = None
            self.line.order("pause", note="why")
        return reached if self.late else super().wait_until(utc_ns, idle)


@pytest.mark.parametrize("late", [False, True])
def test_a_pause_does_not_report_that_the_rig_is_back(line, late):
    line.listen_every_s = 0.0
    losing(line, 1)
    assert line.run(clock=PausingClock(line, late=late))
    assert states(line, "B") == ["done"] + ["missed"] * (SETS - 1)
    assert [row.state for row in rig_alarms(line)] == ["unacknowledged"]


def test_a_poor_shot_at_the_end_of_a_cut_set_is_counted_as_it_was_struck(line):
    """A repetition is granted, and a pause comes before it: it was never made."""
    line.order_at(ShotKey(position="B", set_index=1, shot_index=0), "pause", note="door open")
    send = line.script

    def script(key):
        answer = send(key)
        return None if (key.set_index, key.position) == (1, "B") else answer

    line.script = script
    assert line.run()
    row = line.rows("sets", "B")[1]
    assert (row.state, row.n_missed, row.n_restrikes) == ("missed", 1, 0)
    assert row.reason == "paused by Ada: door open; 1 missed: no trigger at B"


def failing_at(*keys):
    """Return a script that raises a permanent error of the driver at these shots."""
    return lambda key: ConfigurationError("no such channel") if key in keys else healthy(key)


def test_a_rig_that_never_worked_ends_the_test_when_its_shots_are_stored(line):
    for index in (0, 1):  # the next start has no evidence, either
        line.script = failing_at(ShotKey(position="C", set_index=index, shot_index=2))
        message = rf"set {index} ended early: no such channel; the 6 shots before it are stored"
        with pytest.raises(RigError, match=message):
            line.run()
    assert states(line, "C") == ["partial"] * 2
    assert causes(line, "C")[0] == "no such channel"
    assert line.rows("sets", "C")[0].n_taken == 2
    assert states(line, "D") == ["missed"] * 2
    (alarm,) = rig_alarms(line)
    assert alarm.message.startswith("Instruments failed, recorder stopped. No such channel (hour 0.5).")


@pytest.mark.parametrize("restarted", [False, True])
def test_an_error_of_a_rig_that_has_worked_costs_sets_and_not_the_test(line, restarted):
    broken = [ShotKey(position="C", set_index=index, shot_index=2) for index in (1, 2, 3)]
    if restarted:
        with pytest.raises(KilledError):
            line.run(archive=WatchedArchive(line, refuse={1}))
    line.script = failing_at(*broken)
    assert line.run()
    assert states(line, "C")[:5] == ["done"] + ["partial"] * 3 + ["done"]
    (alarm,) = rig_alarms(line)
    assert alarm.state == "returned_unacknowledged"
    assert alarm.message.startswith("Instruments not responding, sets are missed. No such channel (")


def stop_in_set(line, key, **options):
    """Run with a journal until a stop or a kill after a shot."""
    archive, stop = MemoryArchive(line.shelf), line.stop_at(key)
    assert not line.run(stop=stop, archive=archive, **options)
    line.script = healthy
    return MemoryArchive(line.shelf)


@pytest.mark.parametrize("key", [("B", 0, 0), ("C", 1, 1), ("D", 7, 2)], ids=str)
def test_an_interrupted_set_continues_with_its_missing_strikes(line, undisturbed, key):
    position, set_index, shot_index = key
    archive = stop_in_set(line, ShotKey(position=position, set_index=set_index, shot_index=shot_index))
    assert len(line.rows("sets", "B")) == set_index
    assert line.rows("events")[-1].kind == "recorder_stopped"
    assert line.run(archive=archive)
    before, after = (instruments.struck for instruments in line.instruments)
    assert before + after == undisturbed.instruments[0].struck
    assert_same_rows(line, undisturbed)
    assert line.rows("alarms") == undisturbed.rows("alarms")
    assert archive.open_sets() == {}


def test_an_open_set_whose_time_is_over_keeps_its_records(line):
    archive = stop_in_set(line, ShotKey(position="C", set_index=1, shot_index=1))
    assert line.run(archive=archive, start_h=1.7, cause="the power was out")
    assert [states(line, position)[:3] for position in "ABCD"] == [
        ["done", "done", "done"],
        ["done", "done", "done"],
        ["done", "partial", "done"],
        ["done", "missed", "done"],
    ]
    assert (causes(line, "C")[1], causes(line, "D")[1]) == ("the power was out",) * 2
    ids = [row.sequence for row in sorted(line.rows("shots"), key=lambda row: row.sequence)]
    assert ids == sorted(set(ids)), "no id is used twice"
    assert archive.open_sets() == {}


def test_a_pause_after_a_restart_keeps_the_records_of_an_open_set(line):
    archive = stop_in_set(line, ShotKey(position="C", set_index=1, shot_index=1))
    line.order("pause", note="hands in the rig")
    line.listen_every_s = 0.0
    assert line.run(archive=archive)
    assert [states(line, position)[1] for position in "ABCD"] == ["done", "done", "partial", "missed"]
    assert len([row for row in line.rows("shots") if row.set_index == 1]) == 7
    assert archive.open_sets() == {}


def test_in_real_time_each_shot_is_acknowledged_before_the_next_strike(line):
    """A kill costs only the shot in progress."""
    line.settings = memory_settings(clock={"kind": "wall"})
    killed_at = ShotKey(position="B", set_index=0, shot_index=2)
    sequences = []

    def script(key):
        if key == killed_at:
            raise KilledError
        return healthy(key)

    line.script = script
    with pytest.raises(KilledError):
        line.run(archive=MemoryArchive(line.shelf), acknowledged=sequences.append)
    (opened,) = line.shelf.open.values()
    assert [item.sequence for item in opened.records] == sequences == [1, 2, 3]
    line.script = healthy
    assert line.run(archive=MemoryArchive(line.shelf), acknowledged=sequences.append)
    assert sequences == sorted(set(sequences))
    assert len(sequences) == len(line.rows("shots"))
    assert states(line, "B") == ["done"] * SETS


def test_a_failed_write_of_a_shot_is_reported_before_the_next_strike(line, monkeypatch):
    """A set of the paper takes two minutes; the report must not wait for its end."""
    line.settings = memory_settings(clock={"kind": "wall"})
    archive, strikes = MemoryArchive(line.shelf), []
    full = ArchiveWriteError("No space left on device")
    refuse(monkeypatch, archive, "sync", full, times=4, when=lambda: archive.shelf.open)

    def script(key):
        strikes.append((key.position, key.shot_index, line.heartbeat.activities[-1:]))
        return healthy(key)

    line.script = script
    assert line.run(archive=archive, mono_s=Seconds())
    (struck,) = next(doing for position, shot_index, doing in strikes if (position, shot_index) == ("B", 1))
    assert struck == "taking set 0; 1 jobs wait in memory for the disk: No space left on device"
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "write_failed"]
    assert alarm.state == "returned_unacknowledged"
    assert states(line, "B") == ["done"] * SETS


@pytest.mark.parametrize("stops_at", [("A", 0), ("D", 3)], ids=["first shot", "last shot"])
def test_a_stop_while_nothing_was_recorded_leaves_the_set_due(line, stops_at):
    stop = threading.Event()
    # Nothing triggers.
    line.script = lambda key: stop.set() if (key.position, key.shot_index) == stops_at else None
    assert not line.run(stop=stop)
    assert line.rows("sets") == []
    line.script = healthy
    assert line.run()
    assert states(line, "B") == ["done"] * SETS


def test_a_pause_ends_the_running_set(line):
    line.order_at(ShotKey(position="C", set_index=1, shot_index=1), "pause", note="hands in the rig")
    line.run()
    assert line.instruments[0].struck[-1] == ("C", 1, 1, 0)
    assert states(line, "C")[:3] == ["done", "partial", "missed"]
    assert causes(line, "D")[1] == "paused by Ada: hands in the rig"


def test_a_transducer_disabled_during_a_set_is_not_struck_again(line):
    line.order_at(ShotKey(position="B", set_index=1, shot_index=1), "disable", position="C")
    line.run()
    assert {strike[:2] for strike in line.instruments[0].struck if strike[1] == 1} == {("B", 1), ("D", 1)}
    assert states(line, "C")[:3] == ["done", "missed", "disabled"]


def test_a_disabled_transducer_is_not_struck_and_the_others_are(line):
    line.order("disable", position="C")
    line.run()
    assert {strike[0] for strike in line.instruments[0].struck} == {"B", "D"}
    assert states(line, "C") == ["disabled"] * SETS
    assert [row.n_planned for row in line.rows("sets", "C")] == [0] * SETS
    assert states(line, "B") == ["done"] * SETS


def test_a_transducer_without_any_record_raises_no_data_and_is_then_disabled(line):
    line.script = lambda key: None
    line.run()
    alarms = {row.kind: row.raised_set_index for row in line.rows("alarms") if row.position == "D"}
    assert alarms == {"few_valid_shots": 1, "transducer_disabled": 2}
    assert states(line, "D") == ["missed"] * 3 + ["disabled"] * (SETS - 3)


def test_the_baseline_ends_with_the_set_at_its_last_hour(line):
    line.run()
    baselines = line.rows("baselines")
    assert [row.position for row in baselines] == list(TRANSDUCERS)
    assert {(row.first_set_index, row.last_set_index, row.n_sets) for row in baselines} == {(0, 7, 8)}


def test_a_dry_run_raises_no_alarm_repeats_no_strike_and_is_marked(line):
    line.script = lambda key: silent("noisy")
    line.run(dry_run=True)
    assert [row for row in line.rows("alarms") if row.position in TRANSDUCERS] == []
    assert {strike[3] for strike in line.instruments[0].struck} == {0}
    assert events_of(line, "recorder_started")[0].payload["dry_run"] is True
    assert {tuple(shot.flags) for shot in line.rows("shots", "B")} == {("dry_run",)}


def test_a_waiting_recorder_sends_heartbeats(line):
    line.run()
    activities = line.heartbeat.activities
    waits = [f"waiting for set {index}" for index in range(SETS)]
    assert [doing for doing in dict.fromkeys(activities) if doing in waits] == waits
    storing = activities.index("storing set 1")
    assert activities.index("taking set 1") < storing < activities.index("taking set 2")


class CalibratingBoards:
    """Boards that count their self-calibrations."""

    def __init__(self, error=None):
        self.count, self.error = 0, error

    def self_calibrate(self):
        self.count += 1
        if self.error is not None:
            raise self.error
        return {"0x1234": "calibrated"}


@pytest.mark.parametrize(("interval_h", "times"), [(1.0, 6), (2.5, 3), (0.0, 0)])
def test_boards_calibrate_themselves_as_often_as_configured(line, interval_h, times):
    boards = CalibratingBoards()
    line.run(self_calibrating=boards, self_calibration_interval_h=interval_h)
    assert boards.count == times
    assert len(events_of(line, "self_calibrated")) == times


def test_a_failed_self_calibration_is_reported_and_ends_the_test_only_if_permanent(line):
    boards = CalibratingBoards(BusyError("MAX holds the board"))
    line.run(self_calibrating=boards, self_calibration_interval_h=24.0)
    assert events_of(line, "self_calibrated")[0].payload == {"failed": "MAX holds the board"}
    assert states(line, "B") == ["done"] * SETS


def test_a_self_calibration_that_can_never_work_ends_the_test(line):
    boards = CalibratingBoards(ConfigurationError("no such board"))
    with pytest.raises(RigError, match="self-calibration before set 0 failed: no such board"):
        line.run(self_calibrating=boards, self_calibration_interval_h=24.0)


@pytest.mark.parametrize(("listen_every_s", "most"), [(1e9, 2), (0.0, 10**6)])
def test_a_look_at_commands_comes_at_most_once_per_interval(line, monkeypatch, listen_every_s, most):
    polls, open_commands = [], RecorderCatalogue.list_open_commands
    monkeypatch.setattr(
        RecorderCatalogue, "list_open_commands", lambda catalogue: polls.append(1) or open_commands(catalogue)
    )
    line.listen_every_s = listen_every_s
    assert line.run()
    assert 0 < len(polls) - 2 <= most  # the start and the end close what an earlier recorder left
    assert (len(polls) > 5) == (most > 2), "between shots too"


def test_a_catalogue_that_cannot_be_read_before_a_set_does_not_end_the_test(line, undisturbed, monkeypatch):
    failures = refuse(monkeypatch, SetAssessor, "adopt", LOCKED, times=2)
    assert line.run(mono_s=Seconds())
    assert_same_rows(line, undisturbed)
    assert next(failures, None) is None, "it was refused twice"
