"""The folder and the archive of the unit tests keep the same promises."""

from contextlib import ExitStack, closing

import h5py
import pytest
from archive_contract import ArchiveContract, JournalContract
from support.filed_archive import FiledArchive
from support.memory_archive import MemoryArchive

from daq_service.archive import FolderArchive, FolderSetReader
from daq_service.archive.journal import writer
from daq_service.archive.journal.frames import parse_frames


class OnDisk:
    @pytest.fixture
    def crash_while_storing(self, archive, monkeypatch):
        """End the process while a set is written to the journal."""

        def crash(record):
            def killed(*_):
                raise KeyboardInterrupt

            with monkeypatch.context() as patch:
                patch.setattr(writer, "write_all", killed)
                with pytest.raises(KeyboardInterrupt):
                    archive.store_set(record)
            archive.close()

        return crash


class TestFolderArchive(OnDisk, ArchiveContract):
    @pytest.fixture
    def archive(self, tmp_path):
        return FiledArchive(tmp_path)

    @pytest.fixture
    def reopened(self, tmp_path):
        return lambda: FiledArchive(tmp_path)

    @pytest.fixture
    def reader(self, tmp_path):
        return FolderSetReader(tmp_path)

    @pytest.fixture
    def damage(self, tmp_path):
        def flip(file, sequence):
            with h5py.File(tmp_path / file) as content:
                names = [name for name in content["entry/instrument"] if name != "name"]
                groups = [content["entry"][name] for name in names]
                (group,) = [group for group in groups if sequence in group["shot_id"][()]]
                row = group["shot_id"][()].tolist().index(sequence)
                offset = group[group.attrs["signal"]].id.get_chunk_info(row).byte_offset
            image = bytearray((tmp_path / file).read_bytes())
            image[offset + 40] ^= 0x10
            (tmp_path / file).write_bytes(image)

        return flip

    @pytest.fixture
    def lose(self, tmp_path):
        return lambda file: (tmp_path / file).unlink()

    def test_a_reader_makes_and_removes_nothing(self, archive, tmp_path):
        (tmp_path / "sets" / "set_000007_20240101T040000Z.tmp").touch()
        before = sorted(path.name for path in (tmp_path / "sets").iterdir())
        assert FolderSetReader(tmp_path).sets() == {}
        assert sorted(path.name for path in (tmp_path / "sets").iterdir()) == before != []
        assert FolderSetReader(tmp_path / "nowhere").sets() == {}
        assert not (tmp_path / "nowhere").exists()


class TestJournal(OnDisk, JournalContract):
    """Sets without a file: their records are in the journal only."""

    @pytest.fixture
    def archives(self):
        with ExitStack() as stack:
            yield stack

    @pytest.fixture
    def reopened(self, tmp_path, archives):
        return lambda: archives.enter_context(closing(FolderArchive(tmp_path)))

    @pytest.fixture
    def archive(self, reopened):
        return reopened()

    @pytest.fixture
    def reader(self, tmp_path):
        return FolderSetReader(tmp_path)

    @pytest.fixture
    def damage(self, tmp_path):
        def flip(file, sequence):
            (path,) = (tmp_path / "journal").iterdir()
            content = bytearray(path.read_bytes())
            (frame,) = [item for item in parse_frames(bytes(content)) if item.sequence == sequence]
            content[content.find(frame.counts) + 40] ^= 0x10
            path.write_bytes(content)

        return flip

    @pytest.fixture
    def lose(self, tmp_path):
        return lambda file: [path.unlink() for path in (tmp_path / "journal").iterdir()]


class TestMemoryArchive(JournalContract):
    @pytest.fixture
    def archive(self):
        return MemoryArchive()

    @pytest.fixture
    def reopened(self, archive):
        return lambda: MemoryArchive(archive.shelf)

    @pytest.fixture
    def reader(self, archive):
        return MemoryArchive(archive.shelf)

    @pytest.fixture
    def damage(self, archive):
        return lambda file, sequence: archive.shelf.damaged.add((file, sequence))

    @pytest.fixture
    def lose(self, archive):
        return archive.shelf.sets.pop

    @pytest.fixture
    def crash_while_storing(self):
        return lambda record: None
