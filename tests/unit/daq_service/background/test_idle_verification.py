"""Stored sets are verified in idle time, one at a time, never before a strike; corruption raises an alarm."""

import math
from hashlib import sha256
from types import SimpleNamespace

import pytest
from support.archived_sets import SET_INDEX, make_set, other_set
from support.filed_archive import FiledArchive
from support.machine import Machine, clock_in_seconds
from support.memory_line import Line, memory_settings
from support.small_experiment import AtOnce, BrokenExecutor

from daq_service.background.finalize_sets import SetFinalizer
from daq_service.background.task import BackgroundTask
from daq_service.background.verification import EVERY_S, QUIET_S, IdleVerification
from daq_service.catalogue.errors import CatalogueBusyError, CatalogueDamagedError
from daq_service.clock import parse_utc, wall
from daq_service.recording import session
from hardware_drivers.measurement import SetKey

LONG_S = 1000.0


class ReadingExecutor(AtOnce):
    """Executor double that reads in this thread and records the files."""

    def __init__(self):
        self.files = []

    def submit(self, work, /, *arguments, **named):
        self.files.append(arguments[0].name)
        return super().submit(work, *arguments, **named)


@pytest.fixture
def stored(tmp_path):
    """Return the files of three sets by their references."""
    archive = FiledArchive(tmp_path)
    records = [other_set(make_set(), SET_INDEX + n) for n in range(3)]
    return [archive.store_set(record).file for record in records]


class IdleBench:
    """Idle check of a folder with its own clock."""

    def __init__(self, folder, worker=None):
        self.now_s, self.lost, self.worker = 0.0, {}, worker or ReadingExecutor()
        self.finalizer = SetFinalizer(folder, FiledArchive(folder), start=lambda: self.worker)
        self.trouble, self.noted = None, {}
        self.check = IdleVerification(
            folder,
            self.finalizer,
            lambda: self.lost,
            self.sha256_of,
            self.note,
            machine=clock_in_seconds(lambda: self.now_s),
        )

    def sha256_of(self, set_index):
        if self.trouble is not None:
            raise self.trouble
        return self.noted.get(set_index)

    def note(self, set_index, file, sha256):
        if self.trouble is not None:
            raise self.trouble
        assert set_index not in self.noted
        self.noted[set_index] = sha256

    def steps(self, count, free_s=LONG_S):
        """Check a number of files, each at its time; return the corrupt ones."""
        for _ in range(count):
            self.check.run_for(free_s)
            self.check.run_for(free_s)
            self.now_s += EVERY_S
        return self.check.damaged


def test_files_are_verified_one_after_the_other_in_a_cycle(tmp_path, stored):
    idle = IdleBench(tmp_path)
    assert idle.steps(7) == {}
    assert [f"sets/{name}" for name in idle.worker.files] == [*stored, *stored, stored[0]]
    idle.check.run_for(LONG_S)
    idle.check.run_for(LONG_S)
    idle.check.run_for(LONG_S)
    assert len(idle.worker.files) == 8, "none before its time"


def test_no_file_is_verified_before_a_due_set_or_during_finalization(tmp_path, stored, monkeypatch):
    idle = IdleBench(tmp_path)
    idle.steps(3, free_s=QUIET_S)
    monkeypatch.setattr(SetFinalizer, "waits", True)
    idle.steps(3)
    assert idle.worker.files == []
    monkeypatch.undo()
    idle.steps(1)
    assert len(idle.worker.files) == 1


@pytest.mark.parametrize("trouble", [CatalogueBusyError("locked"), CatalogueDamagedError("page 3")])
def test_a_locked_catalogue_delays_the_check_but_not_the_test(tmp_path, stored, trouble):
    idle = IdleBench(tmp_path)
    idle.trouble = trouble
    assert idle.steps(3) == {}
    assert idle.worker.files == []
    idle.trouble = None
    idle.steps(3)
    assert [f"sets/{name}" for name in idle.worker.files] == stored


def test_an_intact_file_without_a_stored_sha256_gets_one(tmp_path, stored):
    """An older folder has no digests; a corrupt file must not get one."""
    idle = IdleBench(tmp_path)
    damaged, *sound = (tmp_path / file for file in stored)
    damaged.write_bytes(damaged.read_bytes()[:-2000])
    idle.check.run_for(LONG_S)
    idle.trouble = CatalogueBusyError("locked")
    idle.steps(2)
    idle.trouble = None
    assert list(idle.steps(6)) == [stored[0]]
    digests = [sha256(path.read_bytes()).hexdigest() for path in sound]
    assert idle.noted == dict(zip((SetKey(SET_INDEX + 1), SetKey(SET_INDEX + 2)), digests, strict=True))


def test_corruption_is_reported_until_it_is_repaired(tmp_path, stored):
    idle, path = IdleBench(tmp_path), tmp_path / stored[1]
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert list(idle.steps(3)) == [stored[1]]
    idle.lost = {stored[2]: "is missing"}
    (tmp_path / stored[2]).unlink()
    assert set(idle.steps(3)) == {stored[1], stored[2]}
    path.write_bytes(content)
    idle.lost = {}
    assert idle.steps(3) == {}


def test_corrupt_files_of_an_earlier_process_are_checked_first(tmp_path, stored):
    idle = IdleBench(tmp_path)
    idle.check.begin({stored[2]: "damaged", "sets/gone_by_now.h5": "damaged"})
    assert idle.check.damaged == {stored[2]: "damaged"}
    assert idle.steps(1) == {}
    assert idle.worker.files == [stored[2].removeprefix("sets/")]


def test_a_killed_worker_is_no_corruption(tmp_path, stored):
    assert IdleBench(tmp_path, BrokenExecutor()).steps(3) == {}


class IdleCheckDouble(BackgroundTask):
    """Idle check double with given corruption."""

    def __init__(self, damaged=()):
        self.damaged, self.known, self.free_s = dict(damaged), None, []

    def begin(self, known=None):
        self.known = dict(known or {})

    def run_for(self, seconds):
        self.free_s.append(seconds)


def alarms(line):
    return [(row.priority, row.state) for row in line.rows("alarms") if row.kind == "data_corrupt"]


def test_corruption_raises_an_alarm_that_clears_after_the_repair(tmp_path):
    line = Line(tmp_path)
    first = IdleCheckDouble({"sets/one.h5": "is missing"})
    line.run(idle_check=first)
    assert (alarms(line), first.known) == ([("high", "unacknowledged")], {})
    (alarm,) = (row for row in line.rows("alarms") if row.kind == "data_corrupt")
    assert alarm.message.startswith("1 data file corrupt or missing. First: sets/one.h5: is missing (")
    payloads = [row.payload for row in line.rows("events") if row.kind == "data_corrupt"]
    assert payloads == [{"file": "sets/one.h5", "description": "is missing"}]
    assert set(first.free_s) == {-math.inf}, "simulated time has no idle hours"
    second = IdleCheckDouble()
    line.run(idle_check=second)
    assert alarms(line) == [("high", "returned_unacknowledged")]
    assert second.known == {"sets/one.h5": "is missing"}


def test_in_real_time_the_check_gets_the_free_time_until_the_next_set(tmp_path, monkeypatch):
    monkeypatch.setattr(wall, "IDLE_INTERVAL_S", 60.0)
    settings = memory_settings(clock={"kind": "wall"})
    line, check = Line(tmp_path, settings=settings, listen_every_s=0.0), IdleCheckDouble()
    clock = Machine(parse_utc(settings.clock.epoch)).clock(None)
    assert line.run(clock=clock, idle_check=check)
    assert max(check.free_s) == pytest.approx(1800.0, abs=1.0)  # half an hour between sets; a strike's rest
    assert min(check.free_s) <= 0.0


def test_a_start_reads_few_files_of_an_older_folder_and_the_others_in_idle_time():
    """The files of a year take hours, and a start sends no heartbeat while it reads."""
    catalogue = SimpleNamespace(
        list_sets_without_digest=lambda: {index: f"sets/{index}.h5" for index in range(17_500)}
    )
    archive, noted = SimpleNamespace(digest=lambda file: f"of {file}"), []
    session._store_missing_digests(catalogue, archive, lambda *values: noted.append(values))
    assert noted == [(index, f"sets/{index}.h5", f"of sets/{index}.h5") for index in range(17_400, 17_500)]
