"""A short test's data folder, recorded once a process and written again for each test that corrupts it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from support.small_experiment import SMALL, run, small_settings

SETS = 3


@cache
def recorded() -> Mapping[str, bytes]:
    """Return the files of a finished test, by their paths."""
    settings = small_settings(schedule={**SMALL["schedule"], "end_h": SETS * 0.5})
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "data"
        assert run(settings, folder)
        return {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file()
        }


def lay_out(folder: Path) -> Path:
    """Write that folder to a path, and return it."""
    if folder.exists():
        shutil.rmtree(folder)
    for name, content in recorded().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def state_of(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """Return every file and folder with its time and bytes: reading must not change them."""
    return {
        path.relative_to(folder).as_posix(): (
            path.stat().st_ino,
            path.stat().st_mtime_ns,
            path.read_bytes() if path.is_file() else b"",
        )
        for path in folder.rglob("*")
    }
