from pathlib import Path

import pytest

import daq_service.processes.data_folder
from daq_service.errors import BusyError, StorageError
from daq_service.processes.data_folder import own_data_folder, prepare_data_folder


def test_a_folder_is_made_with_its_parts_and_nothing_else(tmp_path: Path) -> None:
    prepare_data_folder(tmp_path / "a" / "b")
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["live", "logs", "sets"]


def test_preparing_twice_changes_nothing(tmp_path: Path) -> None:
    prepare_data_folder(tmp_path)
    (tmp_path / "sets" / "kept.h5").write_bytes(b"x")
    prepare_data_folder(tmp_path)
    assert (tmp_path / "sets" / "kept.h5").read_bytes() == b"x"


def test_a_network_folder_is_refused_with_its_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daq_service.processes.data_folder, "network_filesystem", lambda path: "nfs4")
    with pytest.raises(StorageError, match="network file system") as refusal:
        prepare_data_folder(tmp_path)
    assert "nfs4" in str(refusal.value)
    assert refusal.value.exit_code == 4


def test_a_folder_of_documents_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(StorageError, match=r"thesis\.tex"):
        prepare_data_folder(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_folder_that_refuses_writing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, data: bytes) -> int:
        raise OSError(30, "Read-only file system", str(self))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(StorageError, match="Read-only file system"):
        prepare_data_folder(tmp_path)


def test_only_one_owner_at_a_time(tmp_path: Path) -> None:
    with own_data_folder(tmp_path):
        with pytest.raises(BusyError, match="another recorder owns") as refusal, own_data_folder(tmp_path):
            pytest.fail("two owners")
        assert "process" in str(refusal.value)
        assert refusal.value.exit_code == 5
    with own_data_folder(tmp_path):
        pass  # free again
