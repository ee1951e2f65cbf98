"""Replay of a stored test with other settings, and explanation of its alarms."""

import json
import pickle
import re
import shutil
from concurrent.futures import Executor, Future
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import h5py
import pytest
from support.command_line import solimon_here
from support.drifting_wall import RAISED, drifting_wall

from analysis.waves.features import EXTRACTOR_VERSION
from daq_service.assessment.baseline_lifecycle import approve_row
from daq_service.catalogue.rows import AlarmRow, AssessmentRow, BaselineRow, FeatureRow
from daq_service.cli.offline.evidence.replay import describe_replay
from daq_service.errors import UsageError
from daq_service.recording.reassessment import replay
from daq_service.recording.reassessment.changes import Onset, compare_alarm_onsets
from daq_service.recording.reassessment.other_settings import (
    apply_setting_changes,
    list_assessment_keys,
    parse_assignments,
)
from daq_service.recording.reassessment.replay import replay_test


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    return drifting_wall(tmp_path_factory.mktemp("drifting"))


@pytest.fixture
def changed_line(line, tmp_path):
    """Return a copy of the folder in whose catalogue some rows of B have other values."""

    def change(kind, set_index, **columns):
        folder = tmp_path / "changed"
        shutil.copytree(line.folder, folder)
        with replace(line, folder=folder).catalogue(writer=True) as catalogue:
            rows = catalogue.rows(kind, position="B", set_index=set_index)
            catalogue.restore_rows([replace(row, **columns) for row in rows])
        return folder

    return change


def alarm_id_of(line, kind, position):
    with line.catalogue() as catalogue:
        return next(
            row.id for row in catalogue.rows(AlarmRow) if (row.kind, row.position) == (kind, position)
        )


def explain(folder, alarm_id, out, *options):
    return solimon_here(
        "explain", str(alarm_id), "--data-dir", str(folder), "--out", str(out), *options, env={}
    )


def content_of(folder):
    """Return every file and its bytes, except the read marks of SQLite."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: path.read_bytes() for path in files if not path.name.endswith(("-shm", "-wal"))}


def raised_sets(onsets):
    return {(item.position, item.kind): item.set_index for item in onsets}


class CopyingExecutor(Executor):
    """Executor double that runs tasks immediately on copies, as another process does."""

    def submit(self, work, /, *arguments):
        future = Future()
        work, arguments = pickle.loads(pickle.dumps((work, arguments)))
        future.set_result(pickle.loads(pickle.dumps(work(*arguments))))
        return future


@pytest.mark.parametrize("extract_by", [None, ("processes", 2)])
def test_the_same_settings_change_nothing_and_leave_the_folder_as_it_is(line, extract_by, monkeypatch):
    monkeypatch.setattr(replay, "open_executor", lambda name, workers: nullcontext(CopyingExecutor()))
    before = content_of(line.folder)
    # There are two unscheduled sets: both outliers were confirmed.
    found = replay_test(line.folder, (), extract_by=extract_by)
    assert (found.sets, found.extracted, found.differences) == (25, extract_by is not None, [])
    assert raised_sets(found.alarms.kept) == RAISED
    assert [*found.alarms.come, *found.alarms.go, *found.alarms.moved] == []
    assert content_of(line.folder) == before


def test_averages_of_an_earlier_version_are_no_difference(changed_line, line):
    (row,) = [row for row in line.rows("assessments", "B") if row.set_index == 20]
    folder = changed_line(AssessmentRow, 20, averages=row.averages | {"changes_count": [5.0, 0.0]})
    assert replay_test(folder, ()).differences == []


def test_a_replay_keeps_commands_and_empty_sets_in_their_order(life):
    found = replay_test(life.folder, ())
    assert (found.differences, found.alarms.come, found.alarms.go, found.alarms.moved) == ([], [], [], [])
    assert {item.kind for item in found.alarms.kept} == {
        "few_valid_shots",
        "transducer_disabled",
        "not_assessed",
    }
    # D has two consecutive poor sets in set 3, and was enabled before it had four.
    later = replay_test(life.folder, ["quality.no_data_sets=4"]).alarms
    assert raised_sets(later.go) == {("D", "few_valid_shots"): 3}


def test_a_setting_moves_an_alarm(line):
    done = solimon_here("replay", str(line.folder), "--set", "alarms.k=2", "--json", env={})
    answer = json.loads(done.stdout)
    (moved,) = answer["alarms"]["moved"]
    assert done.returncode == 0
    assert (moved["stored"]["set_index"], moved["again"]["set_index"]) == (23, 22)
    assert answer["changed"] == {"alarms.k": 2}


def test_a_longer_baseline_is_reported_with_its_limits_and_changed_assessments(line):
    found = replay_test(line.folder, ["baseline.hours=8"])
    words = list(describe_replay(found))
    assert "stays  C no_reflection: set 22, hour 11.51" in words
    assert "baseline B: n_sets 15 -> 16" in words
    of_b = {(item.table, item.column): item for item in found.differences if item.position == "B"}
    assert (of_b["baseline", "n_sets"].stored, of_b["baseline", "n_sets"].again) == (15, 16)
    limit = of_b["baseline", "limits.f_predictive"]
    assert limit.again < limit.stored
    # Set 15 was assessed and is now part of the baseline.
    assert of_b["assessment", "in_baseline"].n_rows == 1
    assert of_b["assessment", "in_baseline"].first_set_index == 15
    assert "outlier, mewma_alarm, in_baseline, outlier_mean_3sd, reason in set 15; " in "\n".join(words)


@pytest.mark.parametrize(
    ("hours", "unjudged"),
    # C has a hole in set 22 and is not struck afterwards.
    [(7.5, []), (12.5, [("B", 24, 24), ("C", 24, 22)])],
)
def test_a_baseline_without_later_sets_is_reported_at_each_position(line, hours, unjudged):
    done = solimon_here("replay", str(line.folder), "--set", f"baseline.hours={hours}", "--json", env={})
    not_assessed = json.loads(done.stdout)["not_assessed"]
    assert [(item["position"], item["last_set_index"], item["last_set"]) for item in not_assessed] == unjudged
    for item in not_assessed:
        position, last_set = item["position"], item["last_set"]
        assert item["description"] == (
            f"no set is assessed at {position}: baseline.hours = {hours:g} makes the sets 0 to "
            f"{item['last_set_index']} the baseline, and the last one there is set {last_set}; "
            "give fewer hours"
        )
    output = solimon_here("replay", str(line.folder), "--set", f"baseline.hours={hours}", env={}).stdout
    assert [text for text in output.splitlines() if "no set is assessed" in text] == [
        item["description"] for item in not_assessed
    ]


def test_each_column_has_its_count_and_the_outliers_come_first(line):
    found = replay_test(line.folder, ["novelty.limit=paper_mean_3sd"])
    of_b = {
        item.column: item for item in found.differences if (item.table, item.position) == ("assessment", "B")
    }
    outlier = of_b["outlier"]
    assert of_b["limit_name"].n_rows > outlier.n_rows > 1
    (sentence,) = [words for words in describe_replay(found) if words.startswith("assessment B")]
    first = f"outlier in {outlier.n_rows} sets from set {outlier.first_set_index} on"
    assert f"{first}; limit_name in 25 sets from set 0 on" in sentence


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("schedule.shots_per_set=5", "does not affect the assessment; these do: features.of_set"),
        ("quality.restrikes_per_set=0", "quality.no_data_sets, quality.retire_after_sets"),
        ("alarms.decide_by=chart", "alarms.decides_by"),
        ("alarms.k", "write KEY=VALUE"),
        ("alarms.k=7", "k is 7; it must be at most n = 5"),
        ("alarms.decides_by=luck", "alarms.decides_by: Input should be 'chart' or 'k_of_n'"),
    ],
)
def test_a_setting_without_effect_or_invalid_is_rejected_with_the_valid_keys(line, given, message):
    done = solimon_here("replay", str(line.folder), "--set", given, env={})
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr


def test_every_key_can_be_set_also_below_a_table_of_names(line):
    with line.catalogue() as catalogue:
        configuration = catalogue.read_experiment().configuration
    given = parse_assignments(["alarms.kinds.wall_change.on_delay_s=3600", "novelty.limit=chi_square"])
    settings = apply_setting_changes(configuration, given)
    assert settings.alarms.kinds["wall_change"].on_delay_s == 3600.0
    assert settings.novelty.limit == "chi_square"
    assert settings.positions == line.settings.positions
    table = {key: configuration[key.split(".")[0]][key.split(".")[1]] for key in list_assessment_keys()}
    assert apply_setting_changes(
        configuration, parse_assignments([f"{key}={json.dumps(value)}" for key, value in table.items()])
    )
    with pytest.raises(UsageError, match="twice"):
        parse_assignments(["alarms.k=1", "alarms.k=2"])


def test_alarms_of_the_same_set_are_paired_before_the_others():
    def onset(set_index, position="B"):
        return Onset(
            position=position,
            kind="no_reflection",
            set_index=set_index,
            hour=0.5,
            priority="high",
            message="",
        )

    found = compare_alarm_onsets(
        [onset(3), onset(7), onset(9), onset(4, "C")], [onset(7), onset(5), onset(1, "D")]
    )
    assert [item.set_index for item in found.kept] == [7]
    assert [(item.stored.set_index, item.again.set_index) for item in found.moved] == [(3, 5)]
    assert [(item.position, item.set_index) for item in found.go] == [("B", 9), ("C", 4)]
    assert [(item.position, item.set_index) for item in found.come] == [("D", 1)]


def test_a_foreign_folder_and_an_unreadable_set_have_their_exit_codes(line, tmp_path):
    missing = solimon_here("replay", str(tmp_path / "nowhere"), env={})
    assert (missing.returncode, missing.stdout) == (2, "")
    assert "there is no data folder" in missing.stderr
    folder = tmp_path / "damaged"
    shutil.copytree(line.folder, folder)
    path = next(folder.glob("sets/*000004*"))
    path.write_bytes(path.read_bytes()[:5000])
    for options in ((), ("--extract",)):
        damaged = solimon_here("replay", str(folder), *options, env={})
        assert damaged.returncode == 4
        assert path.name in damaged.stderr
        assert "bring it back from a backup: solimon repair --from BACKUP" in damaged.stderr


def test_a_change_alarm_is_recomputed_on_a_self_contained_page(line, tmp_path):
    before = content_of(line.folder)
    done = explain(line.folder, alarm_id_of(line, "transducer_change", "B"), tmp_path, "--json")
    explanation = json.loads(done.stdout)
    assert done.returncode == 0
    assert content_of(line.folder) == before
    again = explanation["recomputed"]
    assert (explanation["agrees"], again["differences"], again["n_sets"], again["n_records"]) == (
        True,
        [],
        24,
        72,
    )
    assert [item["set_index"] for item in again["raised"]] == [23]
    # Set 23 is 9 sets into the drift of 0.8 us a set, and rests a little differently, by up to 0.8 us.
    pulses = again["pulses"]
    late = [at for at, time_s in enumerate(pulses["time_s"]) if 200e-6 < time_s < 500e-6]
    peaks = [max(late, key=pulses[name].__getitem__) for name in ("baseline_v", "set_v")]
    assert 5 <= peaks[1] - peaks[0] <= 10, "in steps of 1 us"
    page, facts = (Path(file).read_text(encoding="utf-8") for file in explanation["files"])
    assert json.loads(facts) == explanation
    assert page.count("<svg ") == 3
    assert " to B-baseline-1: " in explanation["sentences"][0]
    assert not re.search(r"<script|<link|<img|src=|href=.http|@import", page)
    for words in ("Distance squared of set 23", "the same set raises the same alarm", "Does not mean"):
        assert words in page


def test_a_hole_has_its_silent_shots_and_files_are_not_overwritten(line, tmp_path):
    hole = alarm_id_of(line, "no_reflection", "C")
    explanation = json.loads(explain(line.folder, hole, tmp_path, "--json").stdout)
    silent = {row["set_index"]: row["n"] for row in explanation["recomputed"]["shots_without_psw"]}
    assert explanation["agrees"]
    assert (silent[20], silent[21], silent[22]) == (0, 3, 3)
    assert explain(line.folder, hole, tmp_path).returncode == 2
    inside = explain(line.folder, hole, line.folder / "explained")
    assert (inside.returncode, (line.folder / "explained").exists()) == (2, False)


def test_a_different_stored_value_is_reported_with_both_values(changed_line, line, tmp_path):
    folder = changed_line(AssessmentRow, 20, distance_squared=1.0)
    done = explain(folder, alarm_id_of(line, "transducer_change", "B"), tmp_path / "out", "--json")
    explanation = json.loads(done.stdout)
    (difference,) = explanation["recomputed"]["differences"]
    assert (done.returncode, explanation["agrees"]) == (0, False)
    assert (difference["table"], difference["column"], difference["first_set_index"]) == (
        *("assessment", "distance_squared"),
        20,
    )
    assert difference["stored"] == 1.0
    assert difference["again"] > 1.0
    assert "what is stored differs in the 1 points" in explanation["description"]


@pytest.mark.parametrize(
    "after",
    [
        lambda row: approve_row(row, "ann", 2**60),
        lambda row: replace(
            row, state="retired", retired_utc_ns=2**60, retired_by="ann", retired_reason="coupled anew"
        ),
    ],
    ids=["signed", "retired"],
)
def test_later_baseline_commands_do_not_affect_the_explanation(after, line, tmp_path):
    folder = tmp_path / "later"
    shutil.copytree(line.folder, folder)
    with replace(line, folder=folder).catalogue(writer=True) as catalogue:
        catalogue.restore_rows([after(row) for row in catalogue.rows(BaselineRow, position="B")])
    done = explain(folder, alarm_id_of(line, "transducer_change", "B"), tmp_path / "out", "--json")
    explanation = json.loads(done.stdout)
    assert (explanation["agrees"], explanation["recomputed"]["differences"]) == (True, [])


def test_an_unknown_alarm_a_foreign_extractor_and_a_corrupt_set_are_reported(changed_line, line, tmp_path):
    change = alarm_id_of(line, "transducer_change", "B")
    unknown = explain(line.folder, 77, tmp_path / "out")
    assert unknown.returncode == 2
    assert "there are" in unknown.stderr
    assert f"{change} (transducer_change at B)" in unknown.stderr
    folder = changed_line(FeatureRow, 20, extractor_version="1.1")
    foreign = explain(folder, change, tmp_path / "out")
    assert foreign.returncode == 2
    assert f"of the extractor 1.1, this version of solimon has {EXTRACTOR_VERSION}" in foreign.stderr
    mixed = solimon_here("replay", str(folder), env={})
    assert mixed.returncode == 2
    assert f"the extractors 1.1 and {EXTRACTOR_VERSION}" in mixed.stderr
    with replace(line, folder=folder).catalogue(writer=True) as catalogue:
        rows = catalogue.rows(FeatureRow, position="B", set_index=20)
        catalogue.restore_rows([replace(row, extractor_version=EXTRACTOR_VERSION) for row in rows])
    path = next(folder.glob("sets/*000004*"))
    path.write_bytes(path.read_bytes()[:5000])
    damaged = explain(folder, change, tmp_path / "out")
    assert damaged.returncode == 4
    assert path.name in damaged.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("position", "code"), [("C", 0), ("B", 4)])
def test_a_corrupt_shot_of_another_position_does_not_matter(position, code, line, tmp_path):
    folder = tmp_path / "damaged"
    shutil.copytree(line.folder, folder)
    path = next(folder.glob("sets/*000004*"))
    with h5py.File(path, "r+") as file:
        file[f"entry/{position}_waveforms/waveform"][0, 100] += 1
    done = explain(folder, alarm_id_of(line, "transducer_change", "B"), tmp_path / "out", "--json")
    assert done.returncode == code, done.stderr
    if code:
        assert f"shot 0 of {position} (sequence" in done.stderr
    else:
        assert json.loads(done.stdout)["agrees"] is True


def test_an_alarm_from_a_command_is_shown_as_stored(life, tmp_path):
    explanation = json.loads(
        explain(life.folder, alarm_id_of(life, "transducer_disabled", "C"), tmp_path, "--json").stdout
    )
    assert (explanation["agrees"], explanation["recomputed"]) == (None, None)
    assert "a person's command" in explanation["why_not_recomputed"]
    assert "a loose cable" in explanation["alarm"]["message"]
    assert "alarm_reset" in [item["kind"] for item in explanation["history"]]
    assert "This alarm is not recomputed" in (
        tmp_path / f"alarm-{explanation['alarm']['id']}.html"
    ).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "arguments",
    [
        ("replay", "{}"),
        ("explain", "1", "--data-dir", "{}"),
        ("reproduce", "--from", "{}", "--out", "{}-out"),
        ("export", "--data-dir", "{}", "--hdf5", "{}.h5"),
    ],
)
def test_a_lost_catalogue_is_reported_with_the_rebuild_command(line, tmp_path, arguments):
    folder = tmp_path / "lost"
    shutil.copytree(line.folder, folder, ignore=shutil.ignore_patterns("catalogue.sqlite*"))
    done = solimon_here(*(word.format(folder) for word in arguments), env={})
    assert done.returncode == 4
    assert f"the catalogue of {folder} is lost" in done.stderr
    assert f"solimon rebuild --data-dir {folder}" in done.stderr


def test_a_folder_without_a_test_waits_for_the_recorder(tmp_path):
    done = solimon_here("replay", str(tmp_path), env={})
    assert done.returncode == 4
    assert "no data yet; start `solimon record` or wait for it" in done.stderr
