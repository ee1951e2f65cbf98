"""A stored test judged once more: what other settings change, and why an alarm stands."""

import json

import pytest
from support.command_line import solimon_here
from support.drifting_wall import RAISED, drifting_wall
from support.life_of_a_test import lived

from daq_service.cli.offline.evidence.changes import Onset, alarm_changes
from daq_service.cli.offline.evidence.other_settings import changed, judging_keys, parsed
from daq_service.cli.offline.evidence.replay import replayed
from daq_service.errors import UsageError


@pytest.fixture(scope="module")
def line(tmp_path_factory):
    return drifting_wall(tmp_path_factory.mktemp("drifting"))


def content_of(folder):
    """Every file and its bytes, but for what SQLite notes of its readers."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: path.read_bytes() for path in files if not path.name.endswith(("-shm", "-wal"))}


def raised(onsets):
    return {(one.position, one.kind): one.set_index for one in onsets}


@pytest.mark.parametrize("extract", [False, True])
def test_the_same_settings_change_nothing_and_leave_the_folder_as_it_is(line, extract):
    before = content_of(line.folder)
    found = replayed(line.folder, (), extract=extract)
    assert (found.sets, found.extracted, found.differences) == (25, extract, [])
    assert raised(found.alarms.kept) == RAISED
    assert [*found.alarms.come, *found.alarms.go, *found.alarms.moved] == []
    assert content_of(line.folder) == before


def test_what_people_did_and_sets_without_a_record_are_judged_where_they_stood(tmp_path):
    life = lived(tmp_path)
    found = replayed(life.folder, (), extract=False)
    assert (found.differences, found.alarms.come, found.alarms.go, found.alarms.moved) == ([], [], [], [])
    assert {one.kind for one in found.alarms.kept} == {"no_data", "retired"}
    # D has two poor sets running in set 3, and was reinstated before it had four.
    later = replayed(life.folder, ["quality.no_data_sets=4"], extract=False).alarms
    assert raised(later.go) == {("D", "no_data"): 3}


def test_a_setting_moves_an_alarm_and_says_so_in_both_forms(line):
    data, sooner = str(line.folder), ("--set", "alarms.k=2")
    done = solimon_here("replay", data, *sooner, "--json", env={})
    told = json.loads(done.stdout)
    (moved,) = told["alarms"]["moved"]
    assert done.returncode == 0
    assert (moved["stored"]["set_index"], moved["again"]["set_index"]) == (23, 22)
    assert told["changed"] == {"alarms.k": 2}
    words = solimon_here("replay", data, *sooner, env={}).stdout
    assert "moves  B wall_change: set 23, hour 12.00 -> set 22, hour 11.51, 0.49 h earlier" in words
    assert "stays  C hole: set 22" in words


def test_a_longer_baseline_is_told_with_its_limits_and_the_sets_that_are_judged_otherwise(line):
    found = replayed(line.folder, ["baseline.hours=8"], extract=False)
    of_b = {(one.table, one.column): one for one in found.differences if one.position == "B"}
    assert (of_b["baseline", "n_sets"].stored, of_b["baseline", "n_sets"].again) == (15, 16)
    limit = of_b["baseline", "limits.f_predictive"]
    assert limit.again < limit.stored
    # Set 15 was judged, and is part of the baseline now.
    assert of_b["verdict", "in_baseline"].n_rows == 1
    assert of_b["verdict", "in_baseline"].first_set_index == 15


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("schedule.shots_per_set=5", "does not say how records are judged; these do: features.of_set"),
        ("quality.restrikes_per_set=0", "quality.no_data_sets, quality.retire_after_sets"),
        ("alarms.decide_by=chart", "alarms.decides_by"),
        ("alarms.k", "write KEY=VALUE"),
        ("alarms.k=7", "k is 7; it must be at most n = 5"),
        ("alarms.decides_by=luck", "alarms.decides_by: Input should be 'chart' or 'k_of_n'"),
    ],
)
def test_what_does_not_judge_or_is_refused_is_named_with_what_may_be_set(line, given, told):
    done = solimon_here("replay", str(line.folder), "--set", given, env={})
    assert (done.returncode, done.stdout) == (2, "")
    assert told in done.stderr


def test_a_key_below_a_table_of_names_is_laid_over_and_every_key_can_be_set(line):
    with line.catalogue() as catalogue:
        configuration = catalogue.experiment_row().configuration
    given = parsed(["alarms.kinds.wall_change.on_delay_s=3600", "novelty.limit=chi_square"])
    settings = changed(configuration, given)
    assert settings.alarms.kinds["wall_change"].on_delay_s == 3600.0
    assert settings.novelty.limit == "chi_square"
    assert settings.positions == line.settings.positions
    table = {key: configuration[key.split(".")[0]][key.split(".")[1]] for key in judging_keys()}
    assert changed(configuration, parsed([f"{key}={json.dumps(value)}" for key, value in table.items()]))
    with pytest.raises(UsageError, match="twice"):
        parsed(["alarms.k=1", "alarms.k=2"])


def test_onsets_of_the_same_set_are_kept_and_the_others_are_paired_in_order():
    def onset(set_index, position="B"):
        return Onset(
            position=position, kind="hole", set_index=set_index, hour=0.5, severity="high", message=""
        )

    found = alarm_changes([onset(3), onset(7), onset(9), onset(4, "C")], [onset(7), onset(5), onset(1, "D")])
    assert [one.set_index for one in found.kept] == [7]
    assert [(one.stored.set_index, one.again.set_index) for one in found.moved] == [(3, 5)]
    assert [(one.position, one.set_index) for one in found.go] == [("B", 9), ("C", 4)]
    assert [(one.position, one.set_index) for one in found.come] == [("D", 1)]


def test_a_folder_that_is_none_and_a_set_that_cannot_be_read_have_their_exit_codes(line, tmp_path):
    missing = solimon_here("replay", str(tmp_path / "nowhere"), env={})
    assert (missing.returncode, missing.stdout) == (2, "")
    assert "there is no data folder" in missing.stderr
    path = next(line.folder.glob("sets/*000004*"))
    kept = path.read_bytes()
    try:
        path.write_bytes(kept[: len(kept) // 2])
        damaged = solimon_here("replay", str(line.folder), env={})
    finally:
        path.write_bytes(kept)
    assert damaged.returncode == 4
    assert path.name in damaged.stderr
