"""Verification, repair and backup of a folder, during a test and with every kind of corruption."""

import json
import os
import re
import shutil
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from support.archived_sets import make_set
from support.command_line import solimon_here
from support.damaging import flip
from support.earlier_folders import unpack_folder
from support.filed_archive import FiledArchive, journal_of
from support.kept_folder import SETS, lay_out, state_of
from support.served_web import served
from support.small_experiment import SMALL, disturbed_rig, rows_of, run, small_settings
from support.table_rows import execute

from daq_service.archive import FolderArchive, FolderSetReader
from daq_service.archive.finalize_set import finalize_set
from daq_service.archive.journal.reader import build_segment_path
from daq_service.assessment.results_in_file import read_set_results
from daq_service.catalogue import open_catalogue
from daq_service.catalogue.history import HistoryFollower
from daq_service.catalogue.rows import SetRow
from daq_service.cli.maintenance import backup, command
from daq_service.cli.maintenance.backup import back_up
from daq_service.cli.maintenance.verify import DamageKind, verify_folder
from daq_service.cli.status.facts import describe_status
from daq_service.commands.audit import Audit
from daq_service.errors import BusyError, StorageError, StorageUnavailableError
from daq_service.processes.data_folder import (
    CACHES,
    LOCKS,
    SOURCES,
    hold_recorder_lock,
    load_settings_for_reading,
)
from daq_service.processes.lost_sets import FILED_WITHIN_S, find_lost_sets
from daq_service.processes.notifications.delivery_log import Delivery, DeliveryLog
from daq_service.recording.reassessment.rebuild import rebuild_folder_catalogue
from hardware_drivers.measurement import SetKey

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "data-folder.md"
FILES = {
    index: f"sets/set_{index:06d}_20240101T{hour}00Z.h5"
    for index, hour in enumerate(("0030", "0100", "0130"))
}


@pytest.fixture
def folder(tmp_path):
    return lay_out(tmp_path / "data")


def solimon(*arguments):
    completed = solimon_here(*map(str, arguments), "--json", env={})
    return completed.returncode, json.loads(completed.stdout) if completed.stdout else completed.stderr


def kinds(folder):
    return sorted({(item.kind, item.file, item.shot_id) for item in verify_folder(folder).damage}, key=str)


def hit_a_record(folder, index):
    """Corrupt the first record of position B and return its id."""
    record = FolderSetReader(folder).read_set(FILES[index])
    shot = next(item for item in record.shots if item.key.position == "B")
    content = (folder / FILES[index]).read_bytes()
    # The high bytes of a record are deflated, the low ones stored as they are: noise.
    low = shot.waveform.counts.astype("<i2").view("u1").reshape(-1, 2)[:, 0].tobytes()
    flip(folder / FILES[index], content.index(low[1000:1064]))
    return shot.sequence


# verify --------------------------------------------------------------------------------------------


def test_an_intact_folder_passes_and_is_unchanged(folder):
    before = state_of(folder)
    code, answer = solimon("verify", "--data-dir", folder)
    assert (code, answer["ok"], answer["damage"]) == (0, True, [])
    assert answer["checked"].items() >= {"files": SETS, "shots": 10 * SETS, "sets_with_rows": SETS}.items()
    assert state_of(folder) == before


def test_each_corruption_is_reported_with_exit_code_4(folder):
    shot_id = hit_a_record(folder, 0)
    (folder / FILES[1]).write_bytes(b"")
    (folder / FILES[2]).unlink()
    before = state_of(folder)
    code, answer = solimon("verify", "--data-dir", folder)
    assert (code, answer["ok"]) == (4, False)
    found = {(item["kind"], item["file"], item["shot_id"]) for item in answer["damage"]}
    assert found == {
        ("shot", FILES[0], shot_id),
        ("set_touched", FILES[0], None),
        ("set_unreadable", FILES[1], None),
        ("set_touched", FILES[1], None),
        ("set_missing", FILES[2], None),
    }
    assert all(
        item["kind"] in get_args(DamageKind) and "repair --from BACKUP" in item["description"]
        for item in answer["damage"]
    )
    assert state_of(folder) == before


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE shots SET crc32 = crc32 + 1 WHERE sequence = 12",
        "UPDATE shots SET utc_ns = utc_ns + 1 WHERE sequence = 12",
        "UPDATE shots SET outcome = 'superseded' WHERE sequence = 12",
        "DELETE FROM shots WHERE sequence = 12",
        "UPDATE shots SET sequence = 999 WHERE sequence = (SELECT max(sequence) FROM shots)",
        "UPDATE sets SET due_h = due_h + 0.25 WHERE id = 6",
        "UPDATE sets SET n_taken = 2, state = 'partial' WHERE id = 6",
        "UPDATE sets SET file = NULL WHERE id = 6",
        "DELETE FROM sets WHERE id = 6",
        "DELETE FROM features WHERE set_index = 1 AND position = 'B' AND shot_index = 1",
        "DELETE FROM assessments WHERE set_index = 1 AND position = 'B'",
        "DELETE FROM thickness WHERE set_index = 1",
        "UPDATE experiment SET epoch_utc_ns = epoch_utc_ns + 3600000000000",
    ],
)
def test_a_row_that_differs_from_its_file_is_named(folder, sql):
    execute(folder, sql)
    assert {item.kind for item in verify_folder(folder).damage} >= {"row"}


@pytest.mark.parametrize(
    ("sql", "message"),
    [
        ("UPDATE features SET tof_pp_s = 1.0 WHERE sequence = 12", "features, shot_id 12: tof_pp_s is 1.0"),
        ("UPDATE shots SET flags = '[\"noisy\"]' WHERE sequence = 12", "shot_id 12: flags is 'noisy'"),
        ("UPDATE shots SET valid = 0 WHERE sequence = 12", "shot_id 12: valid is 0, in the file 1"),
        (
            "UPDATE features SET quality = 'bad' WHERE set_index = 1 AND position = 'C' AND sequence IS NULL",
            "set_features, position C: quality is 'bad', in the file 'good'",
        ),
        ("UPDATE thickness SET thickness_m = NULL WHERE set_index = 1", "position A: thickness_m is nan"),
        ("DELETE FROM features WHERE sequence = 12", "features, shot_id 12: there is no row"),
    ],
)
def test_results_are_compared_with_their_copy_in_the_file(folder, sql, message):
    execute(folder, sql)
    assert any(
        f"set 1, {message}" in item.description or message in item.description
        for item in verify_folder(folder).damage
    )


def test_missing_rows_before_later_ones_are_reported(folder):
    for table in ("events", "features", "assessments", "thickness", "shots", "sets"):
        execute(folder, f"DELETE FROM {table} WHERE set_index = 1")
    assert kinds(folder) == [("file_without_rows", FILES[1], None)]
    for table in ("events", "features", "assessments", "thickness", "shots", "sets"):
        execute(folder, f"DELETE FROM {table} WHERE set_index = 2")
    report = verify_folder(folder)
    assert (report.damage, report.checked["sets_without_rows"]) == ([], 2), "as a killed recorder leaves them"


def test_an_older_copy_of_the_catalogue_is_named_by_verify_and_status(folder):
    older = (folder / "catalogue.sqlite").read_bytes()
    with open_catalogue(folder, writer=True) as catalogue:
        catalogue.add_service_event(utc_ns=1, kind="recorder_stopped", payload={})
        HistoryFollower(folder, catalogue).begin()
    assert kinds(folder) == []
    assert describe_status(*reversed(load_settings_for_reading(None, folder)))["lost"] == {}
    (folder / "catalogue.sqlite").write_bytes(older)
    assert kinds(folder) == [("catalogue", "catalogue.sqlite", None)]
    ((file, what),) = describe_status(*reversed(load_settings_for_reading(None, folder)))["lost"].items()
    assert file == "catalogue.sqlite"
    assert "solimon rebuild" in what


def test_a_set_of_another_test_or_under_another_name_is_named(folder):
    (folder / FILES[1]).write_bytes((folder / FILES[0]).read_bytes())
    stranger = FiledArchive(folder).store_set(
        replace(make_set(), provenance={"configuration_hash": "ab" * 32}, trouble="")
    )
    assert kinds(folder) == [
        ("metadata", FILES[1], None),
        ("metadata", stranger.file, None),
        ("set_touched", FILES[1], None),
    ]


def audit_three(folder):
    for author in ("ann", "ben", "cleo"):
        Audit(folder).add(author=author, role="admin", source="terminal", what="pause", result="accepted")


def notify_three(folder):
    for receiver in ("ann", "ben", "cleo"):
        DeliveryLog(folder).append(Delivery(receiver=receiver, what="sent", result="a hole at B"))


@pytest.mark.parametrize(
    ("write_three", "kind", "file", "remedy"),
    [
        (audit_three, "audit", "audit.jsonl", "keep it, and check a backup"),
        (notify_three, "notifications", "notifications.jsonl", "a message may be repeated"),
    ],
)
@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda lines: [lines[0], lines[1].replace(b"ben", b"bob"), lines[2]], "damaged at line 2"),
        (lambda lines: [lines[0], lines[2]], "lacks its lines 2 to 2"),
        (lambda lines: [*lines[:2], lines[2][:40] + b"\n"], "damaged at line 3"),
    ],
    ids=["changed", "taken away", "torn"],
)
def test_a_changed_or_missing_line_of_a_log_is_corruption(
    folder, harm, message, write_three, kind, file, remedy
):
    write_three(folder)
    assert kinds(folder) == []
    path = folder / file
    path.write_bytes(b"".join(harm(path.read_bytes().splitlines(keepends=True))))
    code, answer = solimon("verify", "--data-dir", folder)
    assert code == 4
    (damage,) = answer["damage"]
    assert (damage["kind"], damage["file"]) == (kind, file)
    assert message in damage["description"]
    assert remedy in damage["description"]


def end_of_history(folder, *, lines):
    path = folder / "history.jsonl"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-lines]))


@pytest.mark.parametrize(
    "harm",
    [lambda folder: end_of_history(folder, lines=4), lambda folder: (folder / "history.jsonl").unlink()],
    ids=["cut off", "gone"],
)
def test_a_history_shorter_than_the_catalogue_is_corruption_until_the_next_start(folder, harm):
    harm(folder)
    code, answer = solimon("verify", "--data-dir", folder)
    assert code == 4
    (damage,) = answer["damage"]
    assert (damage["kind"], damage["file"]) == ("history", "history.jsonl")
    assert "history.jsonl ends before events" in damage["description"]
    assert run(small_settings(schedule={"end_h": (SETS + 1) * 0.5}), folder)
    assert kinds(folder) == []


@pytest.mark.parametrize(("behind_s", "damage"), [(0.9, []), (61.0, [("history", "history.jsonl", None)])])
def test_a_history_cut_by_a_crash_is_no_corruption(folder, behind_s, damage):
    end_of_history(folder, lines=12)
    ((last,),) = execute(folder, "SELECT max(id) FROM events")
    execute(folder, f"DELETE FROM events WHERE id = {last}")  # the farewell
    behind = f"iif(id = {last - 1}, {int(behind_s * 1e9)}, 0)"
    execute(folder, f"UPDATE events SET wall_utc_ns = {10**18} + id + {behind}")
    # The times were moved in the catalogue alone, which therefore differs from the history.
    found = [item for item in kinds(folder) if item[0] not in ("row", "catalogue")]
    assert found == damage


def test_foreign_files_are_listed_and_no_corruption(folder):
    (folder / "sets" / "notes.txt").write_text("wet")
    (folder / "sets" / "half.tmp").write_text("half")
    (folder / "quarantine").mkdir()
    (folder / "quarantine" / "set.h5").write_text("?")
    report = verify_folder(folder)
    assert report.damage == []
    assert [note.split(":")[0] for note in report.notes] == [
        "left over in sets",
        "not solimon's, in sets",
        "set aside in quarantine",
        "caches, not checked and safe to delete",
    ]


def test_caches_are_listed_and_a_test_goes_on_without_them(folder):
    """The page `data-folder.md` states the role of each file."""
    roles = dict(
        re.findall(r"(?m)^\| `([\w.]+)[/`][^|]*\|[^|]*\| (source|cache|lock)", PAGE.read_text("utf-8"))
    )
    for role, names in {"source": SOURCES, "cache": CACHES, "lock": LOCKS}.items():
        assert {name for name in roles if roles[name] == role} == names
    caches = [folder / name for name in CACHES if (folder / name).exists()]
    (note,) = verify_folder(folder).notes
    assert caches
    assert all(path.name in note for path in caches)
    for path in caches:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert (verify_folder(folder).damage, verify_folder(folder).notes) == ([], [])
    schedule = {**SMALL["schedule"], "end_h": (SETS + 1) * 0.5}
    assert run(small_settings(schedule=schedule), folder)
    with open_catalogue(folder) as catalogue:
        assert [row.state for row in catalogue.rows(SetRow, position="B")] == ["done"] * (SETS + 1)
    assert (folder / "tiles").exists()


def test_a_lost_or_foreign_catalogue_is_named_and_the_files_are_checked_all_the_same(folder):
    (folder / "catalogue.sqlite").write_bytes(b"no database at all" * 1000)
    (folder / FILES[1]).write_bytes(b"")
    assert {item.kind for item in verify_folder(folder).damage} == {"catalogue", "set_unreadable"}
    (folder / "catalogue.sqlite").unlink()
    assert {item.kind for item in verify_folder(folder).damage} == {"catalogue", "set_unreadable"}


def test_a_folder_without_a_test_does_not_pass(tmp_path):
    for place in (tmp_path, tmp_path / "gone"):
        code, answer = solimon("verify", "--data-dir", place)
        assert (code, "holds no test" in answer) == (4, True)


# During a recording --------------------------------------------------------------------------------


def test_verify_reports_no_corruption_while_a_test_runs(tmp_path):
    """The folder is verified and copied between strikes while sets move from the journal to files."""
    settings = small_settings(schedule={**SMALL["schedule"], "end_h": 2.0})
    data, copy, looked = tmp_path / "data", tmp_path / "copy", []

    def look(key, acquired):
        if (key.position, key.shot_index) == ("B", 1):
            looked.append(verify_folder(data))
            back_up(data, copy)
            looked.append(verify_folder(copy))
        return acquired

    assert run(settings, data, rig=disturbed_rig(look))
    assert [report.damage for report in looked] == [[]] * 8
    assert [report.checked["sets_with_rows"] for report in looked[2:]] == [1, 1, 2, 2, 3, 3]
    assert verify_folder(data).damage == []


def test_verify_never_takes_the_recorders_lock(folder, monkeypatch):
    given = []
    monkeypatch.setattr(command.os, "nice", given.append, raising=False)
    with hold_recorder_lock(folder):
        assert solimon("verify", "--data-dir", folder)[0] == 0
        assert given == [command.LOWEST_PRIORITY]
    assert solimon("verify", "--data-dir", folder)[0] == 0
    assert len(given) == 1


def test_repair_does_nothing_while_a_recorder_runs(folder, monkeypatch):
    def owned(_folder):
        raise BusyError("another recorder owns it")

    monkeypatch.setattr(command, "hold_recorder_lock", owned)
    assert solimon("repair", "--apply", "--data-dir", folder)[0] == 5
    assert solimon("repair", "--data-dir", folder)[0] == 0


READS = """
import sys
import daq_service.web.app, daq_service.web.server

print(*(name for name in ("pandas", "scipy", *%r) if name in sys.modules))

from pathlib import Path
from typing import get_args
from fastapi.testclient import TestClient
from daq_service.cli.maintenance.verify import verify_folder
from daq_service.processes.data_folder import load_settings_for_reading
from daq_service.web.app import create_app

settings, folder = load_settings_for_reading(None, Path(sys.argv[1]))
with TestClient(create_app(settings, folder)) as client:
    for path in ("info", "sets", "features", "assessments", "waveforms/B/1/1", "transducers/B"):
        assert client.get(f"/api/v1/{path}", headers={"Host": "127.0.0.1"}).status_code == 200, path
assert verify_folder(folder).damage == []
print(*(name for name in %r if name in sys.modules))
"""


def test_neither_readers_nor_the_web_service_load_compiler_plots_or_drivers(folder):
    heavy = ("numba", "llvmlite", "matplotlib", "nidaqmx", "niscope", "nitclk", "grpc", "nptdms", "serial")
    done = subprocess.run(
        [sys.executable, "-c", READS % (heavy, heavy), folder], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


# repair --------------------------------------------------------------------------------------------


def test_repair_lists_steps_and_restores_a_lost_set_only_from_a_matching_backup(folder, tmp_path):
    copy = tmp_path / "copy"
    back_up(folder, copy)
    contents = {index: (folder / file).read_bytes() for index, file in FILES.items()}
    hit_a_record(folder, 0)
    (folder / FILES[1]).unlink()
    (folder / "sets" / "half.tmp").write_text("half")
    before = state_of(folder)
    code, answer = solimon("repair", "--data-dir", folder, "--from", copy)
    assert (code, answer["applied"], state_of(folder) == before) == (4, False, True)
    does = {step["file"]: step["does"] for step in answer["steps"]}
    assert does == {"sets/half.tmp": "remove", FILES[0]: "from_backup", FILES[1]: "from_backup"}
    code, answer = solimon("repair", "--apply", "--data-dir", folder, "--from", copy)
    assert (code, answer["damage"]) == (0, [])
    assert {index: (folder / file).read_bytes() for index, file in FILES.items()} == contents
    assert [path.name for path in (folder / "quarantine").iterdir()] == [Path(FILES[0]).name]
    assert not (folder / "sets" / "half.tmp").exists()


def test_repair_without_a_backup_keeps_readable_data(folder, tmp_path):
    hit_a_record(folder, 0)
    (folder / FILES[1]).unlink()
    code, answer = solimon("repair", "--apply", "--data-dir", folder)
    assert (code, {step["does"] for step in answer["steps"]}) == (4, {"nothing"})
    assert (folder / FILES[0]).exists()
    copy = tmp_path / "copy"
    (copy / "sets").mkdir(parents=True)
    shutil.copy(folder / FILES[0], copy / FILES[0])  # damaged, too
    shutil.copy(folder / FILES[2], copy / FILES[1])  # another set
    code, answer = solimon("repair", "--apply", "--data-dir", folder, "--from", copy)
    assert (code, {step["does"] for step in answer["steps"]}) == (4, {"nothing"})


def test_repair_restores_a_file_from_the_journal_or_quarantines_it(folder):
    record = FolderSetReader(folder).read_set(FILES[2])
    content = (folder / FILES[2]).read_bytes()
    (folder / FILES[2]).unlink()
    with journal_of(folder, record):
        pass
    assert kinds(folder) == []
    (folder / FILES[2]).write_bytes(content[:1000])
    code, answer = solimon("repair", "--apply", "--data-dir", folder)
    assert (code, [step["does"] for step in answer["steps"]]) == (0, ["from_journal"])
    assert (folder / FILES[2]).read_bytes() == content
    for table in ("events", "features", "assessments", "thickness", "shots", "sets"):
        execute(folder, f"DELETE FROM {table} WHERE set_index = 2")
    build_segment_path(folder, 1).unlink()
    (folder / FILES[2]).write_bytes(content[:1000])
    code, answer = solimon("repair", "--apply", "--data-dir", folder)
    assert (code, [step["does"] for step in answer["steps"]]) == (0, ["set_aside"])
    assert not (folder / FILES[2]).exists()


# backup --------------------------------------------------------------------------------------------


def test_a_backup_is_whole_incremental_and_opens_elsewhere(folder, tmp_path):
    copy, before = tmp_path / "copy", state_of(folder)
    code, answer = solimon("backup", copy, "--data-dir", folder)
    assert (code, answer["present"]) == (0, 0)
    assert rows_of(copy) == rows_of(folder)
    assert not {"recorder.lock", "heartbeat.json", "live"} & {path.name for path in copy.iterdir()}
    assert solimon("verify", "--data-dir", copy)[1]["damage"] == []
    kept = state_of(copy)
    code, answer = solimon("backup", copy, "--data-dir", folder)
    assert (code, answer["files"], answer["present"]) == (0, 0, SETS)
    again = state_of(copy)
    assert {name: again[name] for name in FILES.values()} == {name: kept[name] for name in FILES.values()}
    code, answer = solimon("status", "--data-dir", copy)
    assert (code, answer["counts"]["sets"], answer["lost"]) == (0, SETS, {})
    assert answer["recorder"].startswith("finished")
    assert {name: state_of(folder)[name] for name in before} == before


def test_a_backup_is_refused_where_it_would_do_harm(folder, tmp_path):
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("all of it")
    for place, reason in (
        (folder / "copy", "overlap"),
        (tmp_path, "overlap"),
        (folder, "overlap"),
        (foreign, "is not empty and no backup"),
    ):
        code, answer = solimon("backup", place, "--data-dir", folder)
        assert (code, reason in answer) == (4, True), answer
    assert [path.name for path in foreign.iterdir()] == ["thesis.txt"]
    copy = tmp_path / "copy"
    back_up(folder, copy)
    execute(folder, "UPDATE experiment SET created_utc_ns = 1")
    with pytest.raises(StorageError, match="a backup of another test"):
        back_up(folder, copy)
    lay_out(folder)
    (copy / "recorder.lock").touch()
    with pytest.raises(StorageError, match="not a backup"):
        back_up(folder, copy)


def test_an_interrupted_backup_keeps_the_previous_one_and_can_continue(folder, tmp_path, monkeypatch):
    """The disk is full at each write in turn."""
    copy, real = tmp_path / "copy", backup.write_durably
    for refused in range(1, 2 + SETS):
        calls = []

        def full(path, content, *, temporary, calls=calls, refused=refused):
            calls.append(path)
            if len(calls) == refused:
                temporary.write_bytes(content[:10])
                raise OSError(28, "No space left on device")
            return real(path, content, temporary=temporary)

        monkeypatch.setattr(backup, "write_durably", full)
        with pytest.raises(StorageUnavailableError, match="No space left on device"):
            back_up(folder, copy)
        assert not (copy / "catalogue.sqlite").exists()
        shutil.rmtree(copy) if refused % 2 else None
    monkeypatch.undo()
    back_up(folder, copy)
    assert verify_folder(copy).damage == []
    assert [path.name for path in copy.rglob("*.tmp")] == []
    assert rows_of(copy) == rows_of(folder)


def test_a_copy_that_reads_back_different_is_removed(folder, tmp_path, monkeypatch):
    real = backup.write_durably

    def changed(path, content, *, temporary):
        return real(path, content[:-1] if path.suffix == ".h5" else content, temporary=temporary)

    monkeypatch.setattr(backup, "write_durably", changed)
    with pytest.raises(StorageUnavailableError, match="does not read as it was written"):
        back_up(folder, tmp_path / "copy")
    assert list((tmp_path / "copy").rglob("*.h5")) == []


def test_a_corrupt_file_never_replaces_a_good_copy_and_is_quarantined_in_a_new_backup(folder, tmp_path):
    good, new = tmp_path / "good", tmp_path / "new"
    back_up(folder, good)
    hit_a_record(folder, 0)
    back_up(folder, good)
    assert verify_folder(good).damage == []
    code, answer = solimon("backup", new, "--data-dir", folder)
    assert (code, [item["file"] for item in answer["damage"]]) == (4, [FILES[0]])
    assert kinds(new) == [("set_missing", FILES[0], None)]
    assert [path.name for path in (new / "quarantine").iterdir()] == [Path(FILES[0]).name]


def test_a_backup_names_every_lost_set_and_copies_the_others(folder, tmp_path):
    (folder / FILES[0]).write_bytes(b"")
    for index in (1, 2):
        (folder / FILES[index]).unlink()
    copy = tmp_path / "copy"
    code, answer = solimon("backup", copy, "--data-dir", folder)
    assert (code, answer["ok"]) == (4, False)
    damage = [(item["kind"], item["file"]) for item in answer["damage"]]
    assert damage == [("set_unreadable", FILES[0]), ("set_missing", FILES[1]), ("set_missing", FILES[2])]
    assert kinds(copy) == [("set_missing", FILES[index], None) for index in range(3)]


def test_a_set_that_waits_in_the_journal_is_in_the_copy_of_it(folder, tmp_path):
    record = FolderSetReader(folder).read_set(FILES[2])
    (folder / FILES[2]).unlink()
    with journal_of(folder, record):
        copy = tmp_path / "copy"
        back_up(folder, copy)
        assert verify_folder(copy).damage == []
        assert FolderSetReader(copy).read_set(FILES[2]).set_index == 2
        assert build_segment_path(copy, 1).stat().st_size < 10**6, "the room for what is to come is left out"
    with open_catalogue(folder) as catalogue:
        finalize_set(folder, SetKey(2), results=read_set_results(catalogue, SetKey(2)))
    with closing(FolderArchive(folder)) as archive:
        archive.settle(SetKey(2))
    back_up(folder, copy)
    assert list((copy / "journal").iterdir()) == []
    assert verify_folder(copy).damage == []


# Missing files are reported without a read ----------------------------------------------------------


def test_status_lists_missing_and_empty_sets(folder):
    with open_catalogue(folder) as catalogue:
        assert find_lost_sets(folder, catalogue) == {}
        (folder / FILES[0]).write_bytes(b"")
        (folder / FILES[2]).unlink()
        assert find_lost_sets(folder, catalogue) == {FILES[0]: "is empty", FILES[2]: "is missing"}
        shutil.rmtree(folder / "sets")
        assert set(find_lost_sets(folder, catalogue)) == set(FILES.values())
    assert set(solimon("status", "--data-dir", folder)[1]["lost"]) == set(FILES.values())
    assert "MISSING" in solimon_here("status", "--data-dir", str(folder), env={}).stdout


@pytest.mark.parametrize("left", [{"experiment.json", "history.jsonl"}, set()], ids=["all else", "sets"])
def test_status_and_web_service_report_a_lost_catalogue(folder, left):
    settings, _ = load_settings_for_reading(None, folder)
    for name in {"catalogue.sqlite", "experiment.json", "history.jsonl"} - left:
        (folder / name).unlink()
    remedy = f"`solimon rebuild --data-dir {folder}` makes it again"
    code, message = solimon("status", "--data-dir", folder)
    assert (code, remedy in message, "is lost" in message) == (4, True, True)
    with served(settings, folder) as service, service.client() as api:
        answer = api.get("/readyz")
        assert (answer.status_code, answer.json()["type"]) == (503, "urn:solimon:problem:catalogue-lost")
        assert remedy in answer.json()["detail"]
        rebuild_folder_catalogue(folder)
        assert api.get("/readyz").status_code == 200


def test_status_checks_the_newest_sets_and_all_after_a_removal(folder):
    first, *_, newest = FILES.values()
    with open_catalogue(folder) as catalogue:
        n_positions = len(catalogue.read_latest_rows())
        assert find_lost_sets(folder, catalogue, newest_rows=n_positions) == {}
        content, times_s = (folder / first).read_bytes(), (folder / newest).stat().st_mtime
        (folder / first).write_bytes(b"")
        assert find_lost_sets(folder, catalogue, newest_rows=n_positions) == {}, "an old one is not opened"
        (folder / first).write_bytes(content)
        (folder / newest).write_bytes(b"")
        assert find_lost_sets(folder, catalogue, newest_rows=n_positions) == {newest: "is empty"}
        (folder / newest).write_bytes(content)
        (folder / first).unlink()
        for after_s, expected in ((FILED_WITHIN_S + 1, {first: "is missing"}), (0, {})):
            os.utime(folder / newest, (times_s, times_s))
            os.utime(folder / "sets", (times_s + after_s, times_s + after_s))
            assert find_lost_sets(folder, catalogue, newest_rows=n_positions) == expected


@pytest.mark.parametrize("commit", [pytest.param("9c4a9b9", marks=pytest.mark.slow), "c3c2e28"])
def test_a_folder_of_an_earlier_version_is_verified_and_copied_unchanged(tmp_path, commit):
    folder = tmp_path / "data"
    unpack_folder(commit, folder)
    before = state_of(folder)
    report = verify_folder(folder)
    assert (report.damage, report.checked["files"] > 0) == ([], True)
    back_up(folder, tmp_path / "copy")
    assert verify_folder(tmp_path / "copy").damage == []
    assert state_of(folder) == before


def test_a_copy_is_served_with_the_configuration_that_its_catalogue_keeps(folder, tmp_path):
    back_up(folder, tmp_path / "copy")
    settings, place = load_settings_for_reading(None, tmp_path / "copy")
    assert (settings.schedule.shots_per_set, place) == (3, tmp_path / "copy")
    assert load_settings_for_reading(None, tmp_path / "new")[0].schedule.shots_per_set != 3
    with served(settings, place) as service, service.client() as client:
        assert client.get("/api/v1/info").json()["schedule"]["shots_per_set"] == 3


def test_the_text_output_lists_checks_and_one_corruption_per_line(folder):
    (folder / FILES[1]).unlink()
    completed = solimon_here("verify", "--data-dir", str(folder), env={})
    lines = completed.stdout.splitlines()
    assert lines[0].startswith(f"set_missing        {FILES[1]}: rows point at it")
    assert lines[-1] == "damage    1, named above"
    assert any(line.startswith("checked   ") and line.endswith(" MB") for line in lines)
    completed = solimon_here("repair", "--data-dir", str(folder), env={})
    assert completed.stdout.startswith(f"nothing       {FILES[1]}: ")
