"""An outlier causes an unscheduled set: taken at once, assessed, reported, and without other effects."""

from dataclasses import replace

import numpy as np
import pytest
from support.life_of_a_test import run
from support.memory_archive import MemoryArchive
from support.memory_line import KilledError, Line, healthy, memory_settings
from support.stored_files import read_set
from support.table_rows import lose_catalogue, table_rows

from analysis.assessment.confirmation import ALARM, STEP
from analysis.diagnosis.diagnose import UNDETERMINED
from analysis.diagnosis.hypotheses import COUPLING
from daq_service.assessment.confirmation import read_newest_confirmation
from daq_service.catalogue.rows import AssessmentRow, CommandRow, FeatureRow, SetRow
from daq_service.cli.maintenance.verify import verify_folder
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue
from hardware_drivers.measurement import SetKey, ShotKey

SETS, FIRST = 22, 17
"""The first sick set; the baseline ends with set 15."""
AFTER_FIRST, AFTER_THIRD = SetKey(FIRST, 1), SetKey(FIRST + 2, 1)


def settings(schedule=None, baseline=None, **alarms):
    """Return the settings of a test with the shortest possible baseline."""
    return memory_settings(
        schedule=schedule or {"phases": [{"until_h": 11.0, "interval_h": 0.5}]},
        baseline={"hours": 8.0, "minimum_sets": 15} | (baseline or {}),
        alarms={"decides_by": "k_of_n"} | alarms,
    )


def deviating(*sets, position="B", shift=1.0):
    """Return a script in which a transducer deviates in some scheduled sets and their confirmation sets."""
    return lambda key: healthy(key, shift * (key.position == position and key.set_index in sets))


def with_incident_wave(key):
    """Return the same shot with a healthy incident wave, so that a diagnosis is possible."""
    found = deviating(*range(FIRST, SETS))(key)
    noise = np.random.default_rng(
        [ord(key.position[0]), key.set_key.number, key.shot_index, 1]
    ).standard_normal(2)
    height_v, width_s = 0.5 * (1.0 + 0.01 * noise[0]), 65e-6 * (1.0 + 0.01 * noise[1])
    return replace(found, isw_amplitude_v=float(height_v), isw_fwhm_s=float(width_s))


@pytest.fixture
def line(tmp_path):
    return Line(tmp_path / "data", settings(), deviating(*range(FIRST, SETS)))


def shot_after_first(shot_index):
    """Return a shot of the confirmation set after the first sick one."""
    return ShotKey(position="B", set_index=FIRST, unscheduled_index=1, shot_index=shot_index)


def confirmation_rows(line, kind=SetRow):
    with line.catalogue() as catalogue:
        return catalogue.rows(kind, purpose="confirmation")


def key_of(confirmation):
    return SetKey(confirmation["set_index"], confirmation["unscheduled_index"])


def the_alarm(line):
    (row,) = (row for row in line.rows("alarms") if row.kind == "wall_change")
    return row


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Return an undisturbed test; read-only."""
    one = Line(tmp_path_factory.mktemp("whole"), settings(), deviating(*range(FIRST, SETS)))
    assert one.run()
    return one


def test_an_outlier_causes_an_immediate_confirmation_set_at_its_position(undisturbed):
    line = undisturbed
    first, third = confirmation_rows(line)
    assert [(row.position, row.set_key, row.state) for row in (first, third)] == [
        ("B", AFTER_FIRST, "done"),
        ("B", AFTER_THIRD, "done"),
    ]
    struck = line.instruments[0].struck
    after = struck.index(("D", FIRST, 3, 0)) + 1
    assert struck[after : after + 5] == [
        *(("B", AFTER_FIRST, shot, 0) for shot in range(4)),
        ("B", FIRST + 1, 0, 0),
    ]
    with line.catalogue() as catalogue:
        (planned,) = catalogue.rows(SetRow, position="B", set_index=FIRST)
        assert first.due_utc_ns == first.started_utc_ns == planned.ended_utc_ns
        assert first.due_h == pytest.approx(planned.due_h + (12 * 4.0 - 4.0) / 3600.0)
        confirmation = read_newest_confirmation(catalogue, "B")
        assert read_newest_confirmation(catalogue, "C") is None
    assert confirmation.confirms is True
    assert confirmation.distance_squared > confirmation.limit


def test_the_evidence_of_the_alarm_has_the_confirmation_result(undisturbed):
    changes = [row for row in undisturbed.rows("events") if row.position == "B" and row.topic == "alarms"]
    assert [row.kind for row in changes] == ["alarm_raised", "alarm_evidence_added"]
    proven = [row.payload["evidence"]["confirmation"] for row in changes]
    assert [key_of(confirmation) for confirmation in proven] == [AFTER_FIRST, AFTER_THIRD]
    assert the_alarm(undisturbed).evidence["confirmation"] == proven[1]
    assert proven[1]["confirms"] is True


def test_a_persistent_change_does_not_cause_a_confirmation_after_every_set(undisturbed):
    requests = [
        row.payload["reason"] for row in undisturbed.rows("events") if row.kind == "confirmation_asked"
    ]
    assert requests == [STEP, ALARM]


def test_a_single_odd_set_is_not_confirmed(line):
    line.script = lambda key: healthy(key, 1.0 * (key.position == "B" and key.set_key == SetKey(FIRST)))
    line.run()
    (row,) = confirmation_rows(line)
    assert row.set_key == AFTER_FIRST
    (assessment,) = confirmation_rows(line, AssessmentRow)
    assert (assessment.confirms, assessment.outlier, assessment.in_baseline) == (False, False, False)
    assert not [row for row in line.rows("alarms") if row.kind == "wall_change"]


def test_scheduled_sets_are_assessed_identically_with_and_without_confirmation_sets(undisturbed, line):
    without, line = line, undisturbed
    without.settings = settings(confirmation_sets_a_day=0)
    without.run()
    assert confirmation_rows(line)
    assert not confirmation_rows(without)

    def planned(item, table):
        # The diagnosis depends on confirmation sets.
        causes = ("averages", "diagnosis", "diagnosis_probability", "diagnosis_details")
        ordinal = {"assessments": ("id", *causes), "features": ("id", "sequence")}[table]
        return [replace(row, **dict.fromkeys(ordinal)) for row in item.rows(table)]

    for table in ("assessments", "features"):
        assert planned(line, table) == planned(without, table)
    assert line.rows("baselines") == without.rows("baselines")
    assert the_alarm(line).message == the_alarm(without).message
    with line.catalogue() as own, without.catalogue() as other:
        sizes = [{**item.counts(), "events": 0} for item in (own, other)]
        assert sizes[0] == sizes[1]
        assert sizes[0]["sets"] == SETS
        assert own.read_latest_rows()["B"].last_set.set_index == SETS - 1


def test_the_daily_budget_is_kept_and_a_command_does_not_count(line):
    line.settings = settings(confirmation_sets_a_day=1)

    line.order_at(
        ShotKey(position="D", set_index=FIRST + 1, shot_index=0), "strike", position="B", note="what is it?"
    )
    line.run()
    assert [row.set_key for row in confirmation_rows(line)] == [AFTER_FIRST, SetKey(FIRST + 1, 1)]
    requests = [row.payload for row in line.rows("events") if row.kind == "confirmation_asked"]
    assert [payload["author"] for payload in requests] == ["", "Ada"]
    assert requests[1]["reason"] == "what is it?"


def test_a_set_struck_before_the_baseline_is_stored_without_an_effect_on_it(undisturbed, line):
    line.order_at(ShotKey(position="C", set_index=3, shot_index=0), "strike", position="B")
    line.run()
    with line.catalogue() as catalogue:
        (command,) = catalogue.rows(CommandRow)
    assert command.result == "an unscheduled set is taken at B as soon as the recorder is free"
    early, *others = confirmation_rows(line)
    assert (early.set_key, early.state, early.n_valid) == (SetKey(3, 1), "done", 4)
    assert [row.set_key for row in others] == [AFTER_FIRST, AFTER_THIRD]
    features = [row for row in confirmation_rows(line, FeatureRow) if row.set_key == early.set_key]
    assert [row.tof_pp_s is not None for row in features] == [True] * 5
    assessment = confirmation_rows(line, AssessmentRow)[0]
    assert (assessment.reason, assessment.confirms, assessment.in_baseline, assessment.baseline_id) == (
        "no baseline yet",
        None,
        False,
        None,
    )
    own = {"sets": {"id": None}, "assessments": {"id": None}, "features": {"id": None, "sequence": None}}
    for table in ("sets", "assessments", "features", "baselines"):
        rows = [
            [replace(row, **own.get(table, {})) for row in item.rows(table)] for item in (line, undisturbed)
        ]
        assert rows[0] == rows[1], table
    assert the_alarm(line).message == the_alarm(undisturbed).message


def test_a_set_struck_before_the_baseline_survives_a_rebuild(line):
    line.order_at(ShotKey(position="C", set_index=3, shot_index=0), "strike", position="B")
    run(line)
    before = table_rows(line.folder)
    assert verify_folder(line.folder).damage == []
    lose_catalogue(line.folder)
    assert rebuild_folder_catalogue(line.folder, features_of=line.features_of).warnings == []
    assert table_rows(line.folder) == before
    assert "no baseline yet" in [row.reason for row in confirmation_rows(line, AssessmentRow)]


def test_a_pause_ends_a_confirmation_set(line):
    line.order_at(shot_after_first(1), "pause", note="hands in the rig")
    line.run()
    (row,) = confirmation_rows(line)
    assert (row.state, row.n_taken, row.reason) == ("partial", 2, "paused by Ada: hands in the rig")
    with line.catalogue() as catalogue:
        assert read_newest_confirmation(catalogue, "B").confirms is None
    assert all(index not in range(FIRST + 1, SETS) for _, index, _, _ in line.instruments[0].struck)


def test_a_restart_during_a_confirmation_set_continues_it_once(line):
    assert not line.run(stop=line.stop_at(shot_after_first(1)), archive=MemoryArchive(line.shelf))
    line.script = deviating(*range(FIRST, SETS))
    assert line.run(archive=MemoryArchive(line.shelf))
    first, _ = confirmation_rows(line)
    assert first.state == "done"
    again = [key for key in line.instruments[1].struck if key[1] == AFTER_FIRST]
    assert again == [("B", AFTER_FIRST, 2, 0), ("B", AFTER_FIRST, 3, 0)]
    assert [row.set_key for row in confirmation_rows(line)] == [AFTER_FIRST, AFTER_THIRD]


def test_a_confirmation_set_with_rows_is_neither_struck_again_nor_the_newest_set(line):
    next_set = ShotKey(position="B", set_index=FIRST + 1, shot_index=0)
    assert not line.run(stop=line.stop_at(next_set), archive=MemoryArchive(line.shelf))
    assert [row.set_key for row in confirmation_rows(line)] == [AFTER_FIRST]
    with line.catalogue() as catalogue:
        assert catalogue.read_latest_rows()["B"].last_set.set_key == SetKey(FIRST)
    line.script = deviating(*range(FIRST, SETS))
    assert line.run(archive=MemoryArchive(line.shelf))
    assert not [key for key in line.instruments[1].struck if key[1] == AFTER_FIRST]


def test_the_result_of_a_confirmation_set_survives_a_restart_and_a_rebuild(line):
    line.script = with_incident_wave
    run(line, stop=line.stop_at(shot_after_first(3)))
    line.script = with_incident_wave
    run(line)
    confirmations = [(row.set_key, row.diagnosis) for row in confirmation_rows(line, AssessmentRow)]
    assert confirmations == [(AFTER_FIRST, COUPLING), (AFTER_THIRD, COUPLING)]
    causes = {row.set_index: row.diagnosis for row in line.rows("assessments") if row.position == "B"}
    assert [causes[index] for index in (FIRST, FIRST + 1, SETS - 1)] == [UNDETERMINED, COUPLING, COUPLING]
    (alarm,) = (row for row in line.rows("alarms") if row.position == "B")
    assert alarm.kind == "transducer_change"
    assert key_of(alarm.evidence["confirmation"]) == AFTER_THIRD
    before = table_rows(line.folder)
    assert verify_folder(line.folder).damage == []
    files = {read_set(line.folder / row.file).set_key for row in confirmation_rows(line)}
    assert files == {AFTER_FIRST, AFTER_THIRD}
    lose_catalogue(line.folder)
    assert rebuild_folder_catalogue(line.folder, features_of=line.features_of).warnings == []
    assert table_rows(line.folder) == before
    assert verify_folder(line.folder).damage == []


class DyingArchive(MemoryArchive):
    """Archive that is killed before or after it stores a confirmation set."""

    def __init__(self, line, *, stored):
        super().__init__(line.shelf)
        self.stored = stored

    def store_set(self, record):
        done = super().store_set(record) if self.stored or not record.unscheduled_index else None
        if record.unscheduled_index:
            raise KilledError
        return done


@pytest.mark.parametrize("stored", [True, False])
def test_a_crash_at_its_file_leaves_one_confirmation_set(line, undisturbed, stored):
    with pytest.raises(KilledError):
        line.run(archive=DyingArchive(line, stored=stored))
    assert not confirmation_rows(line)
    line.run()
    facts = ("set_key", "position", "state", "n_taken", "due_utc_ns", "purpose")
    rows = [
        [tuple(getattr(row, name) for name in facts) for row in confirmation_rows(item)]
        for item in (line, undisturbed)
    ]
    assert rows[0] == rows[1]
    features = [
        [replace(row, id=None, sequence=None) for row in confirmation_rows(item, FeatureRow)]
        for item in (line, undisturbed)
    ]
    assert features[0] == features[1]


def test_no_confirmation_set_is_taken_if_it_would_delay_a_scheduled_set(line):
    line.settings = settings({"phases": [{"until_h": 0.44, "interval_h": 0.02}]}, {"hours": 0.32})
    line.run()
    assert not confirmation_rows(line)
    assert "confirmation" not in the_alarm(line).evidence


def test_a_confirmation_set_that_is_too_late_after_a_restart_is_closed_as_it_is(line):
    line.run(stop=line.stop_at(shot_after_first(0)), archive=MemoryArchive(line.shelf))
    line.script = deviating(*range(FIRST, SETS))
    line.run(start_h=9.6, archive=MemoryArchive(line.shelf))
    row = confirmation_rows(line)[0]
    assert (row.set_key, row.state, row.n_taken) == (AFTER_FIRST, "partial", 1)
    assert row.reason.startswith("it takes up to 29 s, and the next scheduled set is due in 0 s")
