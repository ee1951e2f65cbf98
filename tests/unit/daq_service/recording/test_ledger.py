"""What is taken becomes rows and alarms in one transaction, and what a restart knows of it."""

from contextlib import contextmanager

import pytest
from support.memory_archive import MemoryArchive
from support.memory_line import SETS, Line, healthy, memory_settings, silent

from daq_service.acquisition.schedule import plan
from daq_service.catalogue import RecorderCatalogue
from daq_service.catalogue.errors import CatalogueWriteError
from daq_service.recording.cost import Cost
from daq_service.recording.ledger import Ledger
from hardware_drivers.errors import ConnectionLostError
from hardware_drivers.instruments import Rig


@pytest.fixture
def line(tmp_path):
    folder = tmp_path / "data"
    folder.mkdir()
    return Line(folder)


class Drive:
    """A corrosion drive that notes its trips and the rows that it is asked for."""

    def __init__(self):
        self.trips, self.rows = [], 0

    def trip(self, reason, hour):
        self.trips.append((reason, hour))

    def add_row(self, transaction, due, moment):
        self.rows += 1


@contextmanager
def ledger_of(line):
    """A ledger that goes on where the line's last recorder stopped."""
    with line.catalogue(writer=True) as catalogue:
        line.epoch_ns(catalogue)
        rig = Rig(kind="simulated", clock=None, striker=None, digitizer=None)
        yield Ledger(line.settings, MemoryArchive(line.shelf), catalogue, rig, Cost())


@contextmanager
def recorded(line, count):
    """A folder whose recorder judged so many sets, the records of all, and a ledger that goes on."""
    line.run()
    records = {record.set_index: (record, file) for file, record in line.shelf.sets.items()}
    again = Line(line.folder.parent / "again", line.settings, line.script, line.shelf)
    again.folder.mkdir()
    with ledger_of(again) as ledger:
        for index in range(count):
            judge(ledger, again, *records[index])
    with ledger_of(again) as ledger:
        yield ledger, again, records


def due_of(line, index):
    with line.catalogue(writer=True) as catalogue:
        return plan(line.settings.schedule.phases, line.epoch_ns(catalogue))[index]


def judge(ledger, line, record, file):
    features = {shot.sequence: line.features_of(shot) for shot in record.shots}
    ledger.judge(due_of(line, record.set_index), record, file, features)


def test_a_restart_after_any_set_judges_as_if_it_had_never_been_away(line):
    line.settings = memory_settings(
        schedule={"phases": [{"until_h": 11.0, "interval_h": 0.5}]},
        baseline={"hours": 8.0, "minimum_sets": 15},
    )
    wall = {"B": 0.01, "C": 0.0, "D": 0.1}
    line.script = lambda key: healthy(key, shift=wall.get(key.position, 0.0) * max(0, key.set_index - 15))
    line.run()
    expected = {name: line.rows(name) for name in ("verdicts", "alarms", "features", "baselines")}
    assert any(row.kind == "wall_change" for row in expected["alarms"])
    again = Line(line.folder.parent / "again", line.settings, line.script)
    again.folder.mkdir()
    for record in sorted(line.shelf.sets.values(), key=lambda record: record.set_index):
        with ledger_of(again) as ledger:  # a new one for every set
            judge(ledger, again, record, f"sets/{record.set_index}")
    assert {name: again.rows(name) for name in expected} == expected


def test_a_hole_trips_the_drive_at_once_and_once(line):
    line.script = lambda key: silent() if key.position == "C" and key.set_index >= 3 else healthy(key)
    with recorded(line, 3) as (ledger, again, records):
        ledger.drive = drive = Drive()
        judge(ledger, again, *records[3])
        assert drive.trips == []
        judge(ledger, again, *records[4])
        ((reason, hour),) = drive.trips
        assert "no reflected wave at C in 4 of 4 shots, 2 sets running" in reason
        assert hour == 2.5
        assert ledger.retired().keys() == {"C"}
        assert drive.rows == 2


def test_a_reinstated_transducer_retires_anew_only_for_what_came_after(line):
    line.script = lambda key: silent("noisy") if key.position == "D" else healthy(key)
    with recorded(line, 2) as (ledger, again, records):
        ledger.reinstated("D")
        judge(ledger, again, *records[2])
        assert "D" not in ledger.retired()


def test_an_alarm_keeps_the_id_that_the_catalogue_gave(line):
    line.script = lambda key: silent("noisy") if key.position == "D" else healthy(key)
    with recorded(line, 2) as (ledger, again, _):
        alarm = ledger.alarms["D", "no_data"]
        assert again.rows("alarms")[alarm.id - 1].kind == "no_data"
        event = [row for row in again.rows("events") if row.kind == "alarm_raised"][-1]
        assert event.payload["alarm_id"] == alarm.id


def test_rows_alarms_and_events_of_a_set_are_one_transaction(line, monkeypatch):
    with recorded(line, 2) as (ledger, again, records):
        before = {name: len(again.rows(name)) for name in ("sets", "shots", "features", "verdicts", "events")}
        ledger_commit = RecorderCatalogue.commit_set

        def refused(self, commit):
            raise CatalogueWriteError("the disk is full")

        monkeypatch.setattr(RecorderCatalogue, "commit_set", refused)
        with pytest.raises(CatalogueWriteError):
            judge(ledger, again, *records[2])
        assert {name: len(again.rows(name)) for name in before} == before
        monkeypatch.setattr(RecorderCatalogue, "commit_set", ledger_commit)


def test_every_position_has_a_row_in_every_set(line):
    line.order("retire", position="B")
    line.script = lambda key: None if key.position == "A" and key.set_index == 1 else healthy(key)
    line.run()
    rows = line.rows("sets")
    assert sorted((row.set_index, row.position) for row in rows) == [
        (index, position) for index in range(SETS) for position in "ABCD"
    ]
    missed = rows[[(row.set_index, row.position) for row in rows].index((1, "A"))]
    assert (missed.state, missed.n_missed, missed.cause) == (
        "missed",
        1,
        "1 missed: no trigger at A",
    )


def test_the_rig_s_alarm_names_a_method_that_nobody_answers(line):
    lost = ConnectionLostError("the probe's board is gone")
    line.script = lambda key: lost if key.position == "A" and key.set_index == 2 else healthy(key)
    line.run()
    (alarm,) = [row for row in line.rows("alarms") if row.kind == "rig_unavailable"]
    assert alarm.raised_set_index == 2
    assert "the probe's board is gone" in alarm.message
    assert alarm.state == "returned_unacknowledged"
