"""Data folders that earlier versions recorded, unpacked for tests."""

from __future__ import annotations

import tarfile
from pathlib import Path

FOLDERS = Path(__file__).parents[1] / "fixtures" / "folders"


def unpack_folder(commit: str, folder: Path) -> None:
    """Unpack the data folder of a commit; Python 3.11.0 to 3.11.3 have no filter for archives."""
    with tarfile.open(FOLDERS / f"{commit}.tar.xz") as archive:
        archive.extractall(folder, **({"filter": "data"} if hasattr(tarfile, "data_filter") else {}))
