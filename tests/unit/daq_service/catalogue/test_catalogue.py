"""The catalogue stores a set in one transaction and returns rows that are ready for JSON."""

import math
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from support import invented_rows
from support.filled_folder import filled_folder, frozen_baseline
from support.invented_rows import HOUR_0_NS, alarm_row, shot_row
from support.new_experiment import new_catalogue

from daq_service.catalogue import SetCommit, check_owner, connection, errors, open_catalogue, stored_rows
from daq_service.catalogue.errors import (
    CatalogueBusyError,
    CatalogueConflictError,
    CatalogueDamagedError,
    CatalogueError,
    CatalogueWriteError,
    NetworkFolderError,
    NoDataYetError,
    OtherExperimentError,
)
from daq_service.catalogue.rows import AssessmentRow, BaselineRow, FeatureRow, SetRow, ShotRow, ThicknessRow
from daq_service.catalogue.stored_rows import insert_rows
from daq_service.catalogue.tables import features
from daq_service.clock import boot_name, elapsed_ns
from daq_service.settings.tree import Settings
from daq_service.shared_file import retry
from hardware_drivers.measurement import SetKey

NAN = float("nan")


@pytest.fixture
def writer(tmp_path):
    with new_catalogue(tmp_path) as catalogue:
        yield catalogue


@pytest.fixture
def reader(tmp_path, writer):
    with open_catalogue(tmp_path) as catalogue:
        yield catalogue


def set_row(index, position, state="done", n_taken=2, **changes):
    return invented_rows.set_row(index, position, state=state, n_taken=n_taken, n_valid=n_taken, **changes)


def feature_row(index, position, shot_index, sequence=None, **changes):
    own = {"shot_index": shot_index, "sequence": sequence, "tof_pp_s": 3.3e-4 + 1e-6 * index}
    return invented_rows.feature_row(index, position, **{**own, **changes})


def assessment_row(index, position, in_baseline=False, **changes):
    own = {"in_baseline": in_baseline, "distance_squared": 4.5, "outlier": None if in_baseline else False}
    return invented_rows.assessment_row(index, position, **{**own, **changes})


def event_row(kind="set_done", topic="sets", **changes):
    return invented_rows.event_row(kind, topic, **{"payload": {"n": 1}, **changes})


def commit_of(index, positions="BC"):
    """Return a commit of two shots per position with mean feature, assessment and event; A has an echo."""
    rows = {name: [] for name in ("sets", "shots", "features", "assessments", "thickness", "events")}
    for number, position in enumerate(positions):
        sequence = 100 * index + 10 * number + 1
        rows["events"].append(event_row(position=position, set_index=index))
        if position == "A":
            rows["sets"].append(set_row(index, "A", n_taken=1))
            rows["shots"].append(shot_row(index, "A", 0, sequence))
            due = {"set_index": index, "due_h": float(index), "extractor_version": "1", "quality": "good"}
            rows["thickness"].append(ThicknessRow(position="A", sequence=sequence, thickness_m=0.006, **due))
            continue
        rows["sets"].append(set_row(index, position))
        rows["shots"] += [shot_row(index, position, k, sequence + k) for k in range(2)]
        rows["features"] += [feature_row(index, position, k, sequence + k) for k in range(2)]
        rows["features"].append(feature_row(index, position, None, n_valid=2))
        rows["assessments"].append(assessment_row(index, position))
    return SetCommit(**rows)


# Opening --------------------------------------------------------------------------------------


def test_before_the_recorder_there_is_no_data_yet(tmp_path):
    with pytest.raises(NoDataYetError, match="no data yet"):
        open_catalogue(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_catalogue_without_an_experiment_has_no_data_yet(tmp_path):
    with open_catalogue(tmp_path, writer=True), pytest.raises(NoDataYetError, match="has not started"):
        open_catalogue(tmp_path)


def test_an_empty_file_has_no_data_yet(tmp_path):
    (tmp_path / "catalogue.sqlite").write_bytes(b"")
    with pytest.raises(NoDataYetError):
        open_catalogue(tmp_path)


@pytest.mark.parametrize("writer", [False, True])
def test_a_file_that_is_no_database_is_corrupt(tmp_path, writer):
    (tmp_path / "catalogue.sqlite").write_bytes(b"not a database at all" * 100)
    with pytest.raises(CatalogueDamagedError, match=r"catalogue\.sqlite"):
        open_catalogue(tmp_path, writer=writer)


@pytest.mark.parametrize("often", [1, 10**9])
def test_an_incomplete_catalogue_is_read_again_and_a_corrupt_one_is_reported(tmp_path, monkeypatch, often):
    new_catalogue(tmp_path).close()
    found = iter(range(often))

    class IncompleteCatalogue(sqlite3.Connection):
        """Connection whose schema is inconsistent for a number of reads."""

        def execute(self, sql, *values):
            if "sqlite_master" in sql and next(found, None) is not None:
                error = sqlite3.DatabaseError("database disk image is malformed")
                error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
                raise error
            return super().execute(sql, *values)

    monkeypatch.setattr(connection.sqlite3, "connect", partial(sqlite3.connect, factory=IncompleteCatalogue))
    if often == 1:
        open_catalogue(tmp_path).close()
        assert next(found, None) is None
    else:
        with pytest.raises(CatalogueDamagedError, match="malformed"):
            open_catalogue(tmp_path)


def test_a_missing_folder_is_a_clear_error_at_once(tmp_path, monkeypatch):
    at_once = partial(retry, pause=lambda seconds: pytest.fail("nobody holds what is not there"))
    monkeypatch.setattr("daq_service.catalogue.connection.retry", at_once)
    with pytest.raises(CatalogueWriteError, match="give this user the right to write"):
        open_catalogue(tmp_path / "absent", writer=True)


def test_a_network_folder_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("daq_service.catalogue.store.find_network_type", lambda path: "nfs4")
    with pytest.raises(NetworkFolderError, match=r"\(nfs4\).*--data-dir"):
        open_catalogue(tmp_path, writer=True)


def test_a_folder_of_another_configuration_is_rejected_with_both_hashes(tmp_path):
    other = Settings(plate={"thickness_m": 0.006})
    with filled_folder(tmp_path):
        pass
    for look in (
        check_owner,
        lambda settings, folder: open_catalogue(folder, writer=True, settings=settings),
    ):
        with pytest.raises(OtherExperimentError) as caught:
            look(other, tmp_path)
        message = str(caught.value)
        assert Settings().configuration_hash() in message
        assert other.configuration_hash() in message
        assert "plate.thickness_m started with 0.00635, is 0.006 now" in message
        assert "--data-dir" in message


def test_the_experiment_is_made_once(tmp_path, writer):
    first = writer.read_experiment()
    other = {"configuration": {}, "epoch_utc_ns": 7, "clock": "wall", "solimon_version": "1"}
    assert writer.create_experiment(name="x", configuration_hash="0", **other) == first
    with pytest.raises(OtherExperimentError):
        writer.create_experiment(name="test", configuration_hash="cd" * 32, **other)
    assert writer.read_experiment() == first


def test_the_file_is_configured_to_survive_a_power_cut(tmp_path, writer):
    with writer.open_snapshot() as connection_:
        pragmas = {
            name: connection_.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys", "busy_timeout")
        }
    assert pragmas == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1, "busy_timeout": 5000}


def test_a_reader_cannot_change_anything_but_commands(reader):

    with pytest.raises(CatalogueWriteError, match="readonly"), reader.open_snapshot() as connection_:
        insert_rows(connection_, [replace(set_row(0, "B"), id=1)])


def test_a_folder_may_have_any_name(tmp_path):
    folder = tmp_path / "50 % of #1? größer"
    folder.mkdir()
    with new_catalogue(folder) as writer:
        writer.commit_set(commit_of(0))
    with open_catalogue(folder) as reader:
        assert reader.counts()["sets"] == 1, "after the end of the recorder, too"


# A set in one piece ---------------------------------------------------------------------------


def test_a_committed_set_reads_back_equal(writer, reader):
    commit = commit_of(3, "ABC")
    writer.commit_set(commit)
    for given, found in (
        (commit.sets, reader.rows(SetRow)),
        (commit.shots[1:3], reader.rows(ShotRow, position="B", set_index=3)),
        (commit.features[:2], reader.rows(FeatureRow, position="B", scope="shot")),
        (commit.features[2:3], reader.rows(FeatureRow, position="B", scope="set")),
        (commit.assessments, reader.rows(AssessmentRow)),
        (commit.thickness, reader.rows(ThicknessRow, position="A")),
    ):
        assert len(given) == len(found) > 0
        for row, stored in zip(given, found, strict=True):
            assert replace(stored, id=None) == row if hasattr(row, "id") else stored == row


def test_a_rejected_row_rejects_the_whole_set(writer, reader):
    writer.commit_set(commit_of(0))
    before = reader.counts(), reader.last_event_id()
    bad = commit_of(1)
    # The very last thing that is stored fails.
    events = [*bad.events, event_row(payload=None)]
    with pytest.raises(CatalogueConflictError, match="nothing was stored"):
        writer.commit_set(SetCommit(sets=bad.sets, shots=bad.shots, features=bad.features, events=events))
    assert (reader.counts(), reader.last_event_id()) == before
    assert writer.list_committed_sets() == {SetKey(0)}
    writer.commit_set(bad)
    assert writer.list_committed_sets() == {SetKey(0), SetKey(1)}


CONTRADICTING = {
    "set twice": SetCommit(sets=[set_row(0, "B")]),
    "sequence twice": SetCommit(shots=[shot_row(9, "B", 0, 1)]),
    "shot twice": SetCommit(shots=[shot_row(0, "B", 0, 999)]),
    "set feature twice": SetCommit(features=[feature_row(0, "B", None)]),
    "assessment twice": SetCommit(assessments=[assessment_row(0, "B")]),
    "no shot": SetCommit(features=[feature_row(9, "B", 0, sequence=4711)]),
    "incomplete": SetCommit(sets=[set_row(5, "B", method=None)]),
}


@pytest.mark.parametrize("commit", CONTRADICTING.values(), ids=CONTRADICTING)
def test_rows_that_contradict_the_stored_ones_are_refused(writer, commit):
    writer.commit_set(commit_of(0))
    with pytest.raises(CatalogueConflictError):
        writer.commit_set(commit)


@pytest.mark.parametrize("value", [NAN, math.inf, -math.inf, np.float64(NAN), np.float32(math.inf)])
def test_a_value_that_is_not_finite_is_stored_as_not_available(tmp_path, writer, reader, value):
    writer.commit_set(
        SetCommit(
            features=[feature_row(0, "B", None, tof_pp_s=value, psw_area_v_s=1.5)],
            assessments=[assessment_row(0, "B", contributions={"tof_pp_s": value})],
            events=[event_row(payload={"values": [value, 1.0]})],
        )
    )
    (row,) = reader.rows(FeatureRow, position="B", scope="set")
    assert (row.tof_pp_s, row.psw_area_v_s) == (None, 1.5)
    assert reader.rows(AssessmentRow, position="B")[0].contributions == {"tof_pp_s": None}
    assert reader.read_events_after(0)[-1].payload == {"values": [None, 1.0]}
    stored = sqlite3.connect(tmp_path / "catalogue.sqlite")
    assert stored.execute("SELECT typeof(tof_pp_s) FROM features").fetchall() == [("null",)]
    stored.close()


def test_numbers_of_numpy_are_stored_as_numbers(writer, reader):
    row = feature_row(np.int64(0), "B", None, tof_pp_s=np.float32(0.5), n_valid=np.int32(7))
    writer.commit_set(
        SetCommit(
            features=[row],
            baselines=[frozen_baseline("B", mean=np.array([3.3e-4]), covariance=np.array([[1e-12]]))],
            assessments=[assessment_row(0, "B", outlier=np.bool_(True))],
        )
    )
    (found,) = reader.rows(FeatureRow, position="B", scope="set")
    assert (found.set_index, found.tof_pp_s, found.n_valid) == (0, 0.5, 7)
    assert reader.rows(AssessmentRow, position="B")[0].outlier is True
    baseline = reader.baseline("B")
    assert (baseline.mean, baseline.covariance) == ([3.3e-4], [[1e-12]])


# Assessments in the baseline ------------------------------------------------------------------


def test_an_assessment_in_the_baseline_is_completed_in_its_row(writer, reader):
    writer.commit_set(
        SetCommit(assessments=[assessment_row(0, "B", True, distance_squared=None, reason="waiting")])
    )
    writer.commit_set(SetCommit(assessments=[assessment_row(1, "B", True, distance_squared=None)]))
    writer.commit_set(
        SetCommit(
            assessments=[
                assessment_row(0, "B", True, distance_squared=3.0, reason=None),
                assessment_row(2, "B", True, distance_squared=5.0),
            ]
        )
    )
    rows = reader.rows(AssessmentRow, position="B")
    assert [(row.set_index, row.distance_squared, row.reason) for row in rows] == [
        (0, 3.0, None),
        (1, None, None),
        (2, 5.0, None),
    ]


@pytest.mark.parametrize(
    ("before", "after"),
    [(False, False), (False, True), (True, False)],
    ids=["again", "into the baseline", "out of the baseline"],
)
def test_an_assessment_after_the_baseline_is_final_and_none_leaves_it(writer, reader, before, after):
    writer.commit_set(SetCommit(assessments=[assessment_row(5, "B", before)]))
    with pytest.raises(CatalogueConflictError):
        writer.commit_set(SetCommit(assessments=[assessment_row(5, "B", after, outlier=True)]))
    (row,) = reader.rows(AssessmentRow, position="B")
    assert (row.in_baseline, row.outlier) == (before, None if before else False)


def test_an_assessment_may_refer_to_the_baseline_of_the_same_commit(writer, reader):
    baselines, assessments = [frozen_baseline("B", id=17)], [assessment_row(0, "B", baseline_id=17)]
    committed = writer.commit_set(SetCommit(baselines=baselines, assessments=assessments))
    assert committed.baseline_ids == [17]
    assert reader.rows(AssessmentRow, position="B")[0].baseline_id == 17


# Events, alarms, commands ---------------------------------------------------------------------


def test_event_ids_follow_the_order_of_the_rows(writer, reader):
    first = writer.commit_set(SetCommit(events=[event_row(f"k{n}") for n in range(40)])).event_ids
    second = writer.add_service_event(utc_ns=1, kind="gap", payload={})
    assert first == sorted(first)
    assert second > first[-1] == first[0] + 39
    assert [row.kind for row in reader.read_events_after(first[0])][:2] == ["k1", "k2"]
    assert reader.last_event_id() == second


def test_an_event_has_the_time_of_writing_unless_given(writer, reader, monkeypatch):
    monkeypatch.setattr("daq_service.catalogue.writer.time.time_ns", lambda: 77)
    writer.commit_set(SetCommit(events=[event_row(), event_row(wall_utc_ns=5)]))
    assert [row.wall_utc_ns for row in reader.read_events_after(0)] == [77, 5]


def test_events_are_filtered_by_topic_and_paged(writer, reader):
    writer.commit_set(
        SetCommit(
            events=[event_row(topic=topic) for topic in ("sets", "alarms", "sets", "service", "alarms")]
        )
    )
    ids = [row.id for row in reader.read_events_after(0)]
    assert [row.id for row in reader.read_events_after(ids[0], {"alarms", "service"})] == [ids[1], *ids[3:]]
    assert [row.id for row in reader.read_events_after(ids[0], limit=2)] == ids[1:3]
    assert reader.read_events_after(0, []) == []


def test_before_the_first_event_the_last_id_is_zero(reader):
    assert reader.last_event_id() == 0
    assert reader.read_events_after(0) == []


def test_an_alarm_gets_its_id_and_its_event_names_it(writer, reader):
    committed = writer.commit_set(
        SetCommit(
            alarms=[alarm_row(), alarm_row("C")],
            events=[event_row(), event_row("alarm_raised", "alarms")],
            alarm_of_event={1: 1},
        )
    )
    assert reader.alarm(committed.alarm_ids[1]).position == "C"
    payloads = [row.payload for row in reader.read_events_after(0)]
    assert payloads == [{"n": 1}, {"n": 1, "alarm_id": committed.alarm_ids[1]}]


def test_an_alarm_with_its_id_is_changed(writer, reader):
    (alarm_id, other_id) = writer.commit_set(SetCommit(alarms=[alarm_row(), alarm_row("C")])).alarm_ids
    row = reader.alarm(alarm_id)
    changed = replace(row, state="acknowledged", acknowledged_by="me", acknowledged_utc_ns=5)
    assert writer.commit_set(SetCommit(alarms=[changed])).alarm_ids == [alarm_id]
    assert reader.alarm(alarm_id) == changed
    assert reader.alarm(other_id).state == "unacknowledged"


def test_an_alarm_that_does_not_exist_cannot_be_changed(writer, reader):
    with pytest.raises(CatalogueConflictError, match="no row 4711 of table alarms"):
        writer.commit_set(SetCommit(sets=[set_row(0, "B")], alarms=[alarm_row(id=4711)]))
    assert reader.rows(SetRow) == []


def test_a_command_and_its_result_are_exchanged_with_the_recorder(writer, reader):
    command_id = reader.add_command("operator", "acknowledge_alarm", {"alarm_id": 3, "note": "seen"})
    (pending,) = writer.list_open_commands()
    assert (pending.id, pending.author, pending.arguments) == (
        command_id,
        "operator",
        {"alarm_id": 3, "note": "seen"},
    )
    writer.finish_command(command_id, "rejected", "alarm 3 is normal")
    assert writer.list_open_commands() == []
    answered = reader.command(command_id)
    assert (answered.state, answered.result) == ("rejected", "alarm 3 is normal")
    assert answered.finished_wall_utc_ns >= answered.wall_utc_ns
    assert reader.command(99) is None


def test_a_command_has_one_result_with_a_known_state(writer, reader):
    command_id = reader.add_command("operator", "stop", {})
    with pytest.raises(CatalogueConflictError, match="done, rejected, expired, failed"):
        writer.finish_command(command_id, "finished")
    writer.start_command(command_id)
    assert [row.state for row in writer.list_open_commands()] == ["started"]
    with pytest.raises(CatalogueConflictError, match=f"no command {command_id} that is pending"):
        writer.start_command(command_id)
    writer.finish_command(command_id, "done")
    with pytest.raises(CatalogueConflictError, match=f"no command {command_id} that is pending or started"):
        writer.finish_command(command_id, "done")


def test_a_command_has_a_deadline_in_utc_and_in_this_boot(reader):
    row = reader.command(reader.add_command("operator", "stop", {}, within_s=7.0))
    assert row.deadline_wall_utc_ns - row.wall_utc_ns == 7 * 10**9
    assert 0 < row.deadline_boot_ns - elapsed_ns() <= 7 * 10**9
    assert row.boot_id == boot_name()


# Questions ------------------------------------------------------------------------------------


@pytest.fixture
def filled(writer, reader):
    for index in range(6):
        writer.commit_set(commit_of(index, "ABC"))
    return reader


def test_trends_have_columns(filled):
    assert filled.columns(FeatureRow, ["set_index", "tof_pp_s"], position="B", scope="set", first_h=4.0) == {
        "set_index": [4, 5],
        "tof_pp_s": [3.3e-4 + 1e-6 * 4, 3.3e-4 + 1e-6 * 5],
    }
    assert len(filled.columns(FeatureRow, ["due_h"], position="B", scope="shot")["due_h"]) == 12
    assert filled.columns(AssessmentRow, ["distance_squared"], position="B", limit=2) == {
        "distance_squared": [4.5, 4.5]
    }
    assert filled.columns(ThicknessRow, ["thickness_m"], position="A", last_h=1.0) == {
        "thickness_m": [0.006, 0.006]
    }
    assert filled.columns(FeatureRow, ["due_h"], position="X", scope="set") == {"due_h": []}
    assert filled.columns(FeatureRow, [], position="B", scope="set") == {}


def test_an_unknown_column_is_refused_by_name(filled):
    with pytest.raises(CatalogueError, match=r"\['tof'\] are not columns of 'features'"):
        filled.columns(FeatureRow, ["tof"], position="B", scope="set")


def test_recomputed_counts_leave_out_an_unscheduled_echo_as_its_commit_did(writer):
    row = set_row(0, "A", method="pulse_echo", unscheduled_index=1)
    writer.commit_set(SetCommit(sets=[row], shots=[shot_row(0, "A", 0, 7, unscheduled_index=1)]))
    before = writer.counts()
    assert before["pulse_echo_records"] == 0
    writer.recompute_counts()
    assert writer.counts() == before


def test_counts_separate_complete_missed_and_incomplete_sets(writer, filled):
    writer.commit_set(SetCommit(sets=[set_row(6, p, "missed", 0) for p in "ABC"], alarms=[alarm_row()]))
    writer.commit_set(
        SetCommit(
            sets=[set_row(7, "A", "missed", 0), set_row(7, "B", "partial", 1), set_row(7, "C")],
            shots=[shot_row(7, "B", 0, 701)],
        )
    )
    # A disabled position is not missed.
    writer.commit_set(SetCommit(sets=[set_row(8, "A"), set_row(8, "B", "disabled", 0), set_row(8, "C")]))
    assert filled.counts() == {
        "sets": 8,
        "missed_sets": 1,
        "partial_sets": 1,
        "shots": 6 * 4 + 1,
        "pulse_echo_records": 6,
        "events": 18,
        "active_alarms": 1,
    }


def test_the_newest_baseline_is_used_and_all_are_kept(writer, reader):
    assert reader.baseline("B") is None
    baselines = [frozen_baseline(name[0], name=name) for name in ("B-1", "C-1", "B-2")]
    writer.commit_set(SetCommit(baselines=baselines))
    assert reader.baseline("B").name == "B-2"
    assert [row.name for row in reader.rows(BaselineRow, position="B")] == ["B-1", "B-2"]


def test_a_restart_gets_the_finished_sets_and_the_next_sequence(writer):
    assert (writer.list_committed_sets(), writer.next_sequence()) == (set(), 1)
    writer.commit_set(commit_of(4, "B"))
    assert (writer.list_committed_sets(), writer.next_sequence()) == ({SetKey(4)}, 403)


# Several at once ------------------------------------------------------------------------------


def test_a_reader_sees_one_state_from_its_first_to_its_last_query(writer, reader):
    from sqlalchemy import func, select

    count = select(func.count()).select_from(features)
    with reader.open_snapshot() as connection_:
        before = connection_.execute(count).scalar_one()
        writer.commit_set(commit_of(0))
        assert connection_.execute(count).scalar_one() == before == 0
    assert len(reader.rows(FeatureRow, position="B", scope="set")) == 1


def test_an_unfinished_commit_neither_blocks_nor_is_visible(writer, reader):
    with writer._open_transaction("test") as connection_:
        insert_rows(connection_, [replace(set_row(0, "B"), id=1)])
        assert reader.rows(SetRow) == []
    assert len(reader.rows(SetRow)) == 1


def test_a_catalogue_may_be_shared_between_threads(writer, reader):
    def ask(number):
        if number % 5 == 0:
            writer.commit_set(commit_of(number))
        return reader.counts()["shots"] % 4

    with ThreadPoolExecutor(8) as pool:
        # Every commit has four shots and is seen completely or not at all.
        assert set(pool.map(ask, range(40))) == {0}
    assert reader.counts()["sets"] == 8


def test_a_writer_that_waits_too_long_raises_an_error(tmp_path, monkeypatch, writer):
    monkeypatch.setattr(errors, "BUSY_TIMEOUT_S", 0.01)
    holder = sqlite3.connect(tmp_path / "catalogue.sqlite", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    with open_catalogue(tmp_path) as reader, pytest.raises(CatalogueBusyError, match=r"for 0\.01 s"):
        reader.add_command("operator", "stop", {})
    holder.close()


def test_a_writer_waits_once_for_a_lock_and_not_in_each_transaction(tmp_path, monkeypatch, writer):
    monkeypatch.setattr(errors, "BUSY_TIMEOUT_S", 0.01)
    waits = []

    def note(statement):
        if statement.startswith("PRAGMA busy_timeout"):
            waits.append(int(statement.rpartition(" ")[2]))

    with writer.open_snapshot() as connection_:
        stored_rows.unwrap_sqlite(connection_).set_trace_callback(note)
    holder = sqlite3.connect(tmp_path / "catalogue.sqlite", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    for _ in range(4):
        with pytest.raises(CatalogueBusyError):
            writer.commit_set(commit_of(0))
    holder.close()
    writer.commit_set(commit_of(0))
    writer.commit_set(commit_of(1))
    assert waits == [10, 0, 0, 0, 0, 10]


def test_a_full_disk_rejects_the_set_and_keeps_the_stored_rows(writer, reader):
    writer.commit_set(commit_of(0))
    with writer.open_snapshot() as connection_:
        pages = connection_.exec_driver_sql("PRAGMA page_count").scalar()
        connection_.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
    big = [event_row(payload={"text": "x" * 10_000})] * 20
    with pytest.raises(CatalogueWriteError, match="free disk space or repair the disk"):
        writer.commit_set(SetCommit(sets=[set_row(1, "B")], events=big))
    assert writer.list_committed_sets() == {SetKey(0)}
    with writer.open_snapshot() as connection_:
        connection_.exec_driver_sql("PRAGMA max_page_count = 1000000")
    writer.commit_set(SetCommit(sets=[set_row(1, "B")], events=big))
    assert writer.list_committed_sets() == {SetKey(0), SetKey(1)}


def test_a_writer_that_sqlite_opened_read_only_connects_again(tmp_path, monkeypatch):
    """After one failed open, SQLite silently opens the file read-only: nothing would be stored."""
    new_catalogue(tmp_path).close()
    connect, refused = sqlite3.connect, []

    def once_for_reading(path, **options):
        if not refused:
            refused.append(path)
            path = path.replace("mode=rwc", "mode=ro")
        return connect(path, **options)

    monkeypatch.setattr(connection.sqlite3, "connect", once_for_reading)
    with open_catalogue(tmp_path, writer=True) as catalogue:
        catalogue.add_service_event(utc_ns=HOUR_0_NS, kind="gap", payload={})
        assert catalogue.last_event_id() == 1
    assert refused
