"""A file system that refuses calls below any program: Python, SQLite, HDF5 alike (`refusing_files.c`)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_suffix(".c")
needs_a_preload = pytest.mark.skipif(
    sys.platform != "linux" or not (shutil.which("cc") or shutil.which("gcc")),
    reason="only Linux preloads a library, which a C compiler builds",
)


def build(folder: Path, source: Path = SOURCE) -> Path:
    """Compile the library; return its path."""
    library = folder / f"{source.stem}.so"
    compiler = shutil.which("cc") or shutil.which("gcc")
    assert compiler is not None
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-o", library, source, "-ldl"],
        check=True,
    )
    return library


def with_support(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a program that imports `support` and the packages of this checkout."""
    tests = Path(__file__).parents[1]
    paths = [str(tests), str(tests.parent), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def refusing(
    library: Path,
    under: Path,
    *,
    calls: str,
    errno: int,
    when: str,
    log: Path,
    while_there: Path | None = None,
) -> dict[str, str]:
    """Return the environment of a program whose calls on files under a folder are refused."""
    return {
        **os.environ,
        "LD_PRELOAD": str(library),
        "REFUSE_UNDER": str(under),
        "REFUSE_CALLS": calls,
        "REFUSE_ERRNO": str(errno),
        "REFUSE_WHEN": when,
        "REFUSE_LOG": str(log),
        **({} if while_there is None else {"REFUSE_WHILE": str(while_there)}),
    }
