"""Frequent queries use an index and return what reading every row would return."""

import random
import re

import pytest
from sqlalchemy import event, func, select
from support.invented_rows import alarm_row, assessment_row, event_row, feature_row, set_row, shot_row
from support.new_experiment import new_catalogue

from daq_service.catalogue import SetCommit, open_catalogue
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
from daq_service.catalogue.tables import events, shots
from daq_service.catalogue.trends import compute_trend_part, read_trend_bins
from daq_service.catalogue.writer import count_due_times
from hardware_drivers.measurement import SetKey

POSITIONS = {"A": "pulse_echo", "B": "solitary_wave", "C": "solitary_wave"}
GROWING = ("sets", "shots", "features", "thickness", "environment", "assessments", "events", "trend_blocks")


def random_catalogue(folder, seed):
    """Return a catalogue of a probe and two transducers, many sets incomplete, in the order of the plan."""
    chance, sequence = random.Random(seed), 0
    catalogue = new_catalogue(folder)
    for index in range(30):
        commit, due = SetCommit(), {"set_index": index, "due_h": index / 2}
        for position, method in POSITIONS.items():
            own = {**due, "position": position}
            state = chance.choice(["done", "done", "partial", "missed", "disabled"])
            n_taken = {"done": 2, "partial": 1}.get(state, 0)
            ended_ns = index if n_taken else None
            commit.sets.append(set_row(**own, ended_utc_ns=ended_ns, state=state, n_taken=n_taken))
            news = {"utc_ns": index, "position": position, "set_index": index, "payload": {"paused": ""}}
            commit.events.append(event_row(f"set_{state}", **news))
            found = {**own, "extractor_version": "1", "quality": "good"}
            for shot_index in range(n_taken):
                sequence += 1
                commit.shots.append(shot_row(index, position, shot_index, sequence))
                if method == "solitary_wave":
                    commit.features.append(feature_row(**own, shot_index=shot_index, sequence=sequence))
            if n_taken and method == "pulse_echo":
                time_s = chance.choice([None, 1e-6])
                commit.thickness.append(ThicknessRow(**found, sequence=sequence, travel_time_s=time_s))
            elif n_taken:
                commit.features.append(feature_row(**own, n_valid=n_taken))
                commit.assessments.append(assessment_row(**own))
        if chance.random() < 0.3:
            kind = chance.choice(["pause", "resume", "recorder_started"])
            commit.events.append(event_row(kind, "service", utc_ns=index, payload={"paused": f"by {index}"}))
            state = chance.choice(["normal", "acknowledged", "unacknowledged"])
            commit.alarms.append(alarm_row("B", "no_reflection", state=state))
        if chance.random() < 0.8:
            commit.environment.append(
                EnvironmentRow(**due, supply_state="on", supply_quality="good", climate_quality="good")
            )
        catalogue.commit_set(commit)
    return catalogue


def filtered_rows(rows, filters):
    """Apply the same filters to every row."""
    conditions = {
        "first_h": lambda row, hour: row.due_h >= hour,
        "last_h": lambda row, hour: row.due_h <= hour,
        "scope": lambda row, scope: (row.shot_index is None) == (scope == "set"),
        "active": lambda row, active: (row.state != "normal") == active,
    }
    for name, value in filters.items():
        holds = conditions.get(name, lambda row, value, name=name: getattr(row, name) == value)
        rows = [row for row in rows if holds(row, value)]
    return rows


HOURS = [{"first_h": 7.2}, {"last_h": 3.0}, {"first_h": 4.0, "last_h": 6.5}, {"first_h": 99.0}]
OF_A_POSITION = [{"position": position, **hours} for position in "ABX" for hours in ({}, *HOURS)]
OF_A_SET = [{"set_index": 5}, {"set_index": 5, "position": "B"}]
STATES = [{"state": state, **of} for state in ("missed", "done") for of in ({}, {"position": "B"}, HOURS[2])]
PLACES = [{}, *HOURS, *OF_A_POSITION, *OF_A_SET]
SCOPES = [{"scope": scope, **of} for scope in ("set", "shot") for of in PLACES]
ASKED = [
    *((SetRow, filters) for filters in [{}, *HOURS, *OF_A_POSITION, *STATES]),
    *((FeatureRow, filters) for filters in SCOPES),
    *((kind, filters) for kind in (ThicknessRow, AssessmentRow) for filters in PLACES),
    *((EnvironmentRow, filters) for filters in [{}, *HOURS]),
    *((AlarmRow, filters) for filters in [{}, {"active": True}, {"active": False}]),
    (ShotRow, {"position": "B", "set_index": 5}),
]  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_pages_by_index_equal_those_from_all_rows(tmp_path, seed):
    with random_catalogue(tmp_path, seed) as catalogue:
        for kind, filters in ASKED:
            expected = filtered_rows(catalogue.rows(kind), filters)
            assert catalogue.rows(kind, **filters) == expected, (kind, filters)
            if kind is ShotRow:
                continue
            pages, last = [], None
            while len(page := catalogue.rows(kind, limit=7, after_id=last, **filters)) == 7:
                pages, last = pages + page, page[-1].id
            assert pages + page == expected, (kind, filters)


@pytest.mark.parametrize("seed", range(3))
def test_counts_and_latest_rows_equal_those_from_all_rows(tmp_path, seed):
    with random_catalogue(tmp_path, seed) as catalogue:
        counts, rows = catalogue.counts(), catalogue.rows(SetRow)
        with catalogue.open_snapshot() as connection:
            expected = count_due_times(connection)
            n_events = connection.execute(select(func.count()).select_from(events)).scalar_one()
            echoes, all_shots = (
                connection.execute(select(func.count()).select_from(shots).where(query)).scalar_one()
                for query in (shots.c.position == "A", True)
            )
        expected |= {"events": n_events, "pulse_echo_records": echoes, "shots": all_shots - echoes}
        assert {name: counts[name] for name in expected} == expected
        assert counts["active_alarms"] == len(filtered_rows(catalogue.rows(AlarmRow), {"active": True}))
        for position, word in catalogue.read_latest_rows().items():
            for newest, kind, filters in (
                (word.last_set, SetRow, {}),
                (word.last_feature, FeatureRow, {"scope": "set"}),
                (word.last_assessment, AssessmentRow, {}),
                (word.last_thickness, ThicknessRow, {}),
            ):
                found = filtered_rows(catalogue.rows(kind), {"position": position, **filters})
                assert newest == max(found, key=lambda row: row.set_index, default=None)
        assert list(catalogue.read_latest_rows()) == ["A", "B", "C"]
        service_events = [row for row in catalogue.rows(EventRow) if row.topic == "service"]
        held = [row for row in service_events if row.kind in ("pause", "resume")]
        assert catalogue.rows(EventRow, topic="service") == service_events
        assert catalogue.read_last_service_event("pause", "resume") == (held[-1] if held else None)
        assert catalogue.read_last_service_event("recorder_stopped") is None
        assert catalogue.find_last_end_utc_ns() == max(row.ended_utc_ns or 0 for row in rows)
        assert catalogue.list_committed_sets() == {row.set_key for row in rows}
        assert catalogue.list_committed_sets({SetKey(3), SetKey(99)}) == {SetKey(3)}
        reading = filtered_rows(catalogue.rows(ThicknessRow), {"travel_time_s": 1e-6})
        assert catalogue.read_first_thickness("A") == reading[0]
        tried = [row for row in rows if row.position == "B" and row.n_taken]
        assert catalogue.read_last_rows(SetRow, "B", 4, tried=True) == tried[-4:]
        assert catalogue.read_last_rows(SetRow, "B", None, tried=True) == tried
        alike = {(position, state): [] for position in "ABC" for state in ("missed", "partial")}
        for row in rows:
            if row.state in ("missed", "partial"):
                alike[row.position, row.state].append(row)
        gaps, newest = catalogue.read_newest_gaps(2), [row for some in alike.values() for row in some[-2:]]
        assert len(gaps) > 2
        assert sorted(gaps, key=repr) == sorted(newest, key=repr)


def test_no_frequent_query_reads_every_row(tmp_path):
    with random_catalogue(tmp_path, 0), open_catalogue(tmp_path, writer=True) as catalogue:
        plans = []

        @event.listens_for(catalogue._engine, "before_cursor_execute")
        def explain(connection, cursor, sql, values, *_rest):
            if sql.startswith(("SELECT", "WITH")):
                steps = cursor.execute(f"EXPLAIN QUERY PLAN {sql}", values).fetchall()
                plans.append((sql, values, [step[-1] for step in steps]))

        for kind, filters in ASKED:
            for after_id in (None, 3):
                if kind is not ShotRow or after_id is None:
                    catalogue.rows(kind, limit=101, after_id=after_id, **filters)
        catalogue.counts()
        catalogue.read_latest_rows()
        catalogue.paused()
        catalogue.last_event_id()
        catalogue.read_events_after(7, ["alarms", "sets"])
        catalogue.read_events_after(7)
        catalogue.rows(EventRow, topic="alarms", kind="alarm_reset", position="B")
        catalogue.rows(EventRow, topic="alarms", position="B")
        for kind in (SetRow, FeatureRow, AssessmentRow):
            catalogue.rows(kind, purpose="confirmation")
        catalogue.rows(EventRow, topic="service")
        catalogue.list_open_commands()
        catalogue.command(1)
        catalogue.alarm(1)
        catalogue.read_last_environment()
        catalogue.read_last_rows(SetRow, "B", 64, tried=True)
        catalogue.read_newest_gaps(5)
        catalogue.read_last_rows(ThicknessRow, "A", 64)
        catalogue.find_last_end_utc_ns()
        catalogue.next_sequence()
        catalogue.list_committed_sets({SetKey(4)})
        catalogue.count_stored_sets("B", 3, 17)
        catalogue.read_last_rows(SetRow, "B", 1, last_h=13.1)
        for first_h, last_h in ((None, None), (2.2, 13.1)):
            for points in (1, 8):
                read_trend_bins(
                    catalogue, "B", first_h=first_h, last_h=last_h, points=points, most_bins=points
                )
            compute_trend_part(catalogue, "B", "tof_pp_s", first_h=first_h, last_h=last_h)
        last_of_a_block = set_row(31, due_h=15.5, state="missed")
        catalogue.commit_set(SetCommit(sets=[last_of_a_block]))
    for sql, values, steps in plans:
        for step in steps:
            if re.match(r"SCAN events USING INDEX ix_events_|SCAN \w+ USING INDEX ix_\w+_unscheduled$", step):
                continue  # which holds the few of one topic, or the few unscheduled sets
            scanned = re.match(r"SCAN (\w+)( USING)?", step)
            if scanned is not None and scanned[1] in GROWING:
                # In the order of the ids a page ends where it is full: every row belongs to it, or one in 11,
                # except for the few unscheduled sets.
                asked = re.sub(r"WHERE \w+\.unscheduled_index = \?", "", sql)
                filtered = "WHERE" in asked and "shot_index IS" not in asked
                page = "LIMIT" in sql and not scanned[2] and not filtered
                assert page, (sql, values, steps)
            # Only short lists are sorted: open commands, active alarms, resets of a position, shots of a set.
            few = "topic = " in sql or "FROM commands" in sql or "FROM alarms" in sql or "FROM shots" in sql
            assert step != "USE TEMP B-TREE FOR ORDER BY" or few, (sql, values, steps)


@pytest.mark.parametrize("kind", [SetRow, FeatureRow, AssessmentRow])
@pytest.mark.parametrize("ended", [{"last_h": 1.0}, {"last_set": 1}])
def test_the_end_of_a_range_limits_a_search_by_purpose(tmp_path, kind, ended):
    with random_catalogue(tmp_path, 0) as catalogue:
        steps = []

        @event.listens_for(catalogue._engine, "before_cursor_execute")
        def count(connection, *_rest):
            connection.connection.driver_connection.set_progress_handler(lambda: steps.append(1), 1)

        assert catalogue.rows(kind, purpose="planned", **ended)
        of_the_range = len(steps)
        assert catalogue.rows(kind, purpose="planned")
    # Two of 30 sets; a search costs some steps of its own.
    assert of_the_range < (len(steps) - of_the_range) / 4
