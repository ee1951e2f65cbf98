import threading
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.new_experiment import new_catalogue

import daq_service.processes.data_folder
from daq_service.catalogue import open_catalogue
from daq_service.errors import BusyError, StorageError, UsageError
from daq_service.processes.data_folder import (
    CONFIGURATION_FILE,
    LOCK_FILE,
    FolderGoneError,
    hold_recorder_lock,
    is_file_locked,
    is_held,
    load_settings_and_folder,
    prepare_data_folder,
    remove_temporary_files,
    require_data_folder,
    write_configuration,
)
from daq_service.settings.tree import Settings


def test_a_folder_is_created_with_its_subfolders_only(tmp_path):
    prepare_data_folder(tmp_path / "a" / "b")
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["live", "logs", "sets"]


def test_preparing_twice_changes_nothing(tmp_path):
    prepare_data_folder(tmp_path)
    (tmp_path / "sets" / "kept.h5").write_bytes(b"x")
    prepare_data_folder(tmp_path)
    assert (tmp_path / "sets" / "kept.h5").read_bytes() == b"x"


def test_a_network_folder_is_refused_with_its_kind(tmp_path, monkeypatch):
    monkeypatch.setattr(daq_service.processes.data_folder, "find_network_type", lambda path: "nfs4")
    with pytest.raises(StorageError, match="network file system") as refusal:
        prepare_data_folder(tmp_path)
    assert "nfs4" in str(refusal.value)
    assert refusal.value.exit_code == 4


def test_a_folder_of_documents_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(StorageError, match=r"thesis\.tex"):
        prepare_data_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_read_only_folder_is_reported(tmp_path, monkeypatch):
    def refuse(self, data):
        raise OSError(30, "Read-only file system", str(self))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(StorageError, match="Read-only file system"):
        prepare_data_folder(tmp_path)


def test_an_optional_folder_that_cannot_be_created_is_a_warning(tmp_path, caplog):
    (tmp_path / "sets").mkdir()
    (tmp_path / "live").write_text("foreign")
    prepare_data_folder(tmp_path)
    assert "live cannot be made" in caplog.text
    assert (tmp_path / "live").read_text() == "foreign"


def test_remains_of_killed_writers_are_removed_and_no_other_file(tmp_path):
    prepare_data_folder(tmp_path)
    left = ["heartbeat.tmp", "configuration.tmp", ".write-test-0a", "live/B.tmp"]
    kept = ["configuration.json", "live/B.bin", "sets/set_000001_20240101T010000Z.h5"]
    for name in left + kept:
        (tmp_path / name).write_text("x")
    remove_temporary_files(tmp_path)
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert files == set(kept)


def test_any_number_of_readers_can_query_the_ownership_of_a_folder(tmp_path):
    assert is_held(tmp_path) is False
    with hold_recorder_lock(tmp_path):
        assert [is_held(tmp_path) for _ in range(3)] == [True] * 3
    with (tmp_path / LOCK_FILE).open("rb") as asking:
        assert is_file_locked(asking) is False
        assert is_held(tmp_path) is False, "who asks is no owner"
    (tmp_path / LOCK_FILE).unlink()
    (tmp_path / LOCK_FILE).mkdir()
    assert is_held(tmp_path) is None


def test_an_owner_waits_for_a_reader_of_the_lock(tmp_path):
    with hold_recorder_lock(tmp_path):
        pass
    with ExitStack() as asking:
        file = asking.enter_context((tmp_path / LOCK_FILE).open("rb"))
        assert not is_file_locked(file)  # holds it until it is closed
        closing = threading.Timer(0.05, asking.pop_all().close)
        closing.start()
        with hold_recorder_lock(tmp_path):
            pass
    closing.join()


def test_the_folder_of_a_started_test_is_never_created_again(tmp_path):
    folder = tmp_path / "data"
    for _ in range(2):  # gone, then an empty one in its place
        with pytest.raises(FolderGoneError, match="bring back the test"):
            prepare_data_folder(folder, may_create=False)
        assert not folder.exists() or not list(folder.iterdir())
        folder.mkdir(exist_ok=True)
    prepare_data_folder(folder)  # by the supervisor; its recorder may be killed before it takes the lock
    prepare_data_folder(folder, may_create=False)


def test_a_reader_is_refused_a_missing_or_foreign_folder(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "thesis.tex").write_text("precious")
    for name, message in {
        "solimno-data": "there is no data folder",
        "thesis": r"holds 'thesis\.tex'",
        "thesis/thesis.tex": "cannot be read",
    }.items():
        with pytest.raises(UsageError, match=message) as refusal:
            require_data_folder(tmp_path / name)
        assert refusal.value.exit_code == 2
        assert "--data-dir" in str(refusal.value)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis"]
    (tmp_path / "empty").mkdir()
    require_data_folder(tmp_path / "empty")
    prepare_data_folder(tmp_path / "ours")
    require_data_folder(tmp_path / "ours")


def test_only_one_owner_at_a_time(tmp_path):
    with hold_recorder_lock(tmp_path):
        second = hold_recorder_lock(tmp_path, patience_s=0.0)
        with pytest.raises(BusyError, match="another recorder owns") as refusal, second:
            pytest.fail("two owners")
        assert "process" in str(refusal.value)
        assert refusal.value.exit_code == 5
    with hold_recorder_lock(tmp_path):
        pass  # free again


@pytest.mark.parametrize("left", [b"", b'{"name": "tor', b'"foreign"', b'{"no_key": 1}', None])
def test_a_folders_own_configuration_is_a_hint(tmp_path, caplog, left):
    config = tmp_path / CONFIGURATION_FILE
    if left is not None:
        config.write_bytes(left)
    with pytest.raises(UsageError):
        load_settings_and_folder(config, tmp_path)  # no catalogue with newer values
    with open_catalogue(tmp_path, writer=True) as catalogue:
        catalogue.create_experiment(
            name="test",
            configuration_hash="0",
            configuration={"schedule": {"shots_per_set": 7}},
            epoch_utc_ns=0,
            clock="simulated",
            solimon_version="0",
        )
    settings, folder = load_settings_and_folder(config, None)
    assert (settings.schedule.shots_per_set, folder.parent) == (7, tmp_path)
    assert "the catalogue keeps" in caplog.text


def test_a_persons_own_file_is_never_replaced_by_the_catalogue(tmp_path):
    (tmp_path / "mine.json").write_text("{")
    with new_catalogue(tmp_path), pytest.raises(UsageError, match="not valid json"):
        load_settings_and_folder(tmp_path / "mine.json", tmp_path)


def test_the_configuration_is_written_whole(tmp_path):
    config = write_configuration(Settings(), tmp_path)
    assert load_settings_and_folder(config, tmp_path) == (Settings(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [CONFIGURATION_FILE]
