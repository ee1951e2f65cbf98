"""A lost catalogue is rebuilt row for row; what cannot be rebuilt is reported."""

import shutil
import threading
from dataclasses import replace

import pytest
from support.crashed_recorders import LongerRecords, features_by_key
from support.life_of_a_test import run
from support.memory_line import Line, healthy, memory_settings, silent
from support.refused_recorders import Stop, Time, record
from support.stored_files import read_set, set_files
from support.table_rows import lose_catalogue, table_rows

from daq_service.alarms.states import NOT_ASSESSED
from daq_service.archive.layout import build_set_image
from daq_service.assessment.results_in_file import read_set_results
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.errors import NoDataYetError, OtherExperimentError
from daq_service.catalogue.experiment_file import EXPERIMENT_FILE, HISTORY_FILE, read_experiment_file
from daq_service.catalogue.rows import AlarmRow, SetRow
from daq_service.catalogue.tables import metadata
from daq_service.clock import parse_utc
from daq_service.processes.lost_catalogue import is_catalogue_lost
from daq_service.recording.experiment import find_foreign_reason
from daq_service.recording.reassessment import restore_rows
from daq_service.recording.reassessment.rebuild import BUILDING, rebuild_folder_catalogue
from hardware_drivers.measurement import SetKey, ShotKey


def rebuild_catalogue(line, **options):
    return rebuild_folder_catalogue(line.folder, features_of=line.features_of, **options)


def not_computed(shot):
    raise AssertionError(f"the history has the features of {shot.key}")


@pytest.mark.parametrize("sets_of_a_commit", [5, 64], ids=["several commits", "one commit"])
def test_a_lost_catalogue_is_rebuilt_row_for_row(line, monkeypatch, sets_of_a_commit):
    monkeypatch.setattr(restore_rows, "_SETS_OF_A_COMMIT", sets_of_a_commit)
    before = table_rows(line.folder)
    lose_catalogue(line.folder)
    calls = []
    progress = lambda done, total: calls.append((done, total))  # noqa: E731
    result = rebuild_folder_catalogue(line.folder, features_of=not_computed, progress=progress)
    assert table_rows(line.folder) == before
    assert (result.kept, result.warnings, result.sets) == ("", [], len(set_files(line.folder)))
    assert calls[-1] == (result.sets, result.sets)
    assert not (line.folder / BUILDING).exists()


@pytest.fixture(scope="module")
def on_the_wall_clock(tmp_path_factory):
    folder, clock = tmp_path_factory.mktemp("wall") / "data", Time()
    assert record(folder, clock, LongerRecords(healthy), [], Stop(clock))
    return folder


@pytest.mark.parametrize(
    ("gone", "tables"),
    [((), set(metadata.tables)), ((EXPERIMENT_FILE, HISTORY_FILE), {"sets", "shots", "features"})],
    ids=["the catalogue", "all but the sets"],
)
def test_a_test_on_the_wall_clock_is_rebuilt_with_its_hour_0(on_the_wall_clock, tmp_path, gone, tables):
    folder = tmp_path / "data"
    shutil.copytree(on_the_wall_clock, folder)
    before = table_rows(folder)
    lose_catalogue(folder, *gone)
    rebuild_folder_catalogue(folder, features_of=features_by_key)
    after = table_rows(folder)
    assert {name: after[name] for name in tables} == {name: before[name] for name in tables}
    with open_catalogue(folder) as catalogue:
        assert catalogue.read_experiment().epoch_utc_ns == parse_utc("2026-01-01T00:00:00Z")


def test_the_history_alone_identifies_the_experiment(line):
    before, kept = table_rows(line.folder), read_experiment_file(line.folder)
    lose_catalogue(line.folder, EXPERIMENT_FILE)
    rebuild_catalogue(line)
    assert table_rows(line.folder) == before
    assert read_experiment_file(line.folder) == kept


def test_a_complete_catalogue_keeps_rows_that_only_a_history_could_restore(line):
    before = table_rows(line.folder)
    (line.folder / HISTORY_FILE).unlink()
    result = rebuild_catalogue(line)
    assert table_rows(line.folder) == before
    assert (line.folder / result.kept).exists()
    assert (line.folder / HISTORY_FILE).exists()


def test_a_delayed_alarm_is_raised_by_the_same_set_after_restart_and_rebuild(tmp_path):
    kinds = {"few_valid_shots": {"on_delay_s": 3000.0, "off_delay_s": 3000.0}}

    def script(key):
        return silent("noisy") if key.position == "D" and 2 <= key.set_index < 8 else healthy(key)

    line = Line(
        tmp_path / "delayed",
        memory_settings(alarms={"kinds": kinds}, quality={"retire_after_sets": 0, "restrikes_per_set": 0}),
        script,
    )
    run(line, stop=line.stop_at(ShotKey(position="D", set_index=4, shot_index=3)))
    assert line.rows("alarms") == []
    run(line)
    before = line.rows("alarms")
    # Two poor sets make the condition, 3,000 s are two intervals; the first good set is 8.
    (alarm,) = line.alarms()
    assert (alarm.kind, alarm.raised_set_index, alarm.state) == (
        "few_valid_shots",
        5,
        "returned_unacknowledged",
    )
    events = [
        (event.kind, event.set_index)
        for event in line.rows("events")
        if event.topic == "alarms" and event.payload.get("kind") != NOT_ASSESSED
    ]
    assert events == [
        *[("alarm_delay", 3), ("alarm_delay", 5), ("alarm_raised", 5)],
        *[("alarm_delay", 8), ("alarm_delay", 10), ("alarm_cleared", 10)],
    ]
    for files in ((), (EXPERIMENT_FILE, HISTORY_FILE)):
        lose_catalogue(line.folder, *files)
        assert rebuild_catalogue(line).warnings == []
        assert line.rows("alarms") == before


def test_a_missing_line_of_the_history_costs_only_that_line_and_causes_a_warning(line):
    before = table_rows(line.folder)
    path = line.folder / HISTORY_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    number = next(n for n, text in enumerate(lines) if b'"kind":"pause"' in text)
    del lines[number]
    path.write_bytes(b"".join(lines))
    lose_catalogue(line.folder)
    result = rebuild_catalogue(line)
    assert any("history" in warning and f"{number + 1}" in warning for warning in result.warnings)
    after = table_rows(line.folder)
    assert [row for row in before["events"] if row not in after["events"]] == [
        row for row in before["events"] if row[4] == "pause"
    ]
    assert {name for name in before if before[name] != after[name]} == {"events", "counts"}


def test_a_lost_line_that_a_set_implies_gets_its_id_again(line):
    before = table_rows(line.folder)
    path = line.folder / HISTORY_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    number = next(n for n, text in enumerate(lines) if b'"kind":"set_features"' in text)
    lines[number] = lines[number].replace(b"set_features", b"set_Features")
    path.write_bytes(b"".join(lines))
    lose_catalogue(line.folder)
    assert rebuild_catalogue(line).warnings
    after = table_rows(line.folder)
    assert [row[0] for row in after["events"]] == [row[0] for row in before["events"]]
    # When it was written is lost, and so are the checksum's bits.
    assert [(*row[:2], *row[3:-1]) for row in after["events"]] == [
        (*row[:2], *row[3:-1]) for row in before["events"]
    ]


def test_a_set_without_its_file_keeps_its_rows(line):
    with open_catalogue(line.folder) as catalogue:
        sets = catalogue.rows(SetRow)
        alarms = catalogue.rows(AlarmRow)
    set_files(line.folder)[6].unlink()
    lose_catalogue(line.folder)
    result = rebuild_catalogue(line)
    assert any("set 6" in warning for warning in result.warnings)
    with open_catalogue(line.folder) as catalogue:
        assert catalogue.rows(SetRow) == sets
        assert catalogue.rows(AlarmRow) == alarms


def test_a_replaced_file_causes_a_warning(line):
    with open_catalogue(line.folder) as catalogue:
        digest = catalogue.rows(SetRow, set_index=1)[0].file_sha256
    lose_catalogue(line.folder)
    file = set_files(line.folder)[1]
    file.write_bytes(file.read_bytes() + b" ")
    assert any("SHA-256" in warning for warning in rebuild_catalogue(line).warnings)
    with open_catalogue(line.folder) as catalogue:
        assert catalogue.rows(SetRow, set_index=1)[0].file_sha256 == digest


def test_results_are_computed_again_and_a_different_copy_causes_a_warning(line):
    before = table_rows(line.folder)
    file = set_files(line.folder)[1]
    with open_catalogue(line.folder) as catalogue:
        copy = {name: dict(columns) for name, columns in read_set_results(catalogue, SetKey(1)).items()}
    copy["features"]["tof_pp_s"] = [1.0, *copy["features"]["tof_pp_s"][1:]]
    file.write_bytes(build_set_image(replace(read_set(file), results=copy)))
    lose_catalogue(line.folder)
    warnings = rebuild_catalogue(line).warnings
    assert any(
        "set 1, its file: features" in warning and "in the file 1.0" in warning for warning in warnings
    )
    assert table_rows(line.folder)["features"] == before["features"]


def test_sets_of_two_experiments_are_refused_by_name(line, tmp_path):
    other = Line(tmp_path / "other", settings=memory_settings(chain={"drop_height_m": 3e-3}))
    stop = threading.Event()
    # Within the second set: the journal keeps one that is cut short, and the first one has its file.
    other.script = lambda key: (key.set_index == 1 and stop.set()) or healthy(key)
    run(other, stop=stop)
    (stray,) = (other.folder / "sets").glob("*.h5")
    shutil.copy(stray, line.folder / "sets" / stray.name.replace("000000", "000099"))
    before = table_rows(line.folder)
    with pytest.raises(OtherExperimentError, match=r"set_000099.*configuration") as refusal:
        rebuild_catalogue(line)
    assert other.settings.configuration_hash() in str(refusal.value)
    assert table_rows(line.folder) == before
    assert not (line.folder / BUILDING).exists()


def test_a_catalogue_of_another_hour_0_is_refused(line, tmp_path):
    with open_catalogue(line.folder, writer=True) as catalogue:
        row = catalogue.read_experiment()
        catalogue.restore_rows([replace(row, epoch_utc_ns=row.epoch_utc_ns + 1)])
    with pytest.raises(OtherExperimentError, match="two tests"):
        rebuild_catalogue(line)


def test_a_folder_without_a_test_is_refused(tmp_path):
    with pytest.raises(NoDataYetError, match="neither catalogue nor sets"):
        rebuild_folder_catalogue(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_catalogue_is_lost_if_a_started_test_lacks_it(line, tmp_path):
    assert not is_catalogue_lost(tmp_path)
    assert not is_catalogue_lost(line.folder)
    (line.folder / "catalogue.sqlite").write_bytes(b"")
    assert is_catalogue_lost(line.folder)
    lose_catalogue(line.folder)
    assert is_catalogue_lost(line.folder)
    (line.folder / HISTORY_FILE).unlink()
    assert is_catalogue_lost(line.folder)


def test_a_set_with_another_hour_0_is_rejected_in_each_format(line):
    with open_catalogue(line.folder) as catalogue:
        experiment = catalogue.read_experiment()
    record = read_set(set_files(line.folder)[0])
    older = {name: value for name, value in record.provenance.items() if name != "experiment"}
    assert find_foreign_reason(record, experiment) == ""
    assert find_foreign_reason(replace(record, provenance=older), experiment) == ""
    later = replace(record, due_utc_ns=record.due_utc_ns + 10**9, provenance=older)
    assert "hour 0 at 2024-01-01T00:00:01" in find_foreign_reason(later, experiment)
    other = {**record.provenance, "experiment": {"name": "other", "epoch_utc_ns": 0}}
    assert "hour 0 at 1970" in find_foreign_reason(replace(record, provenance=other), experiment)
