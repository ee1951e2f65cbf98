"""Build of the double of NI's C library, and the environment in which a process finds it.

`nidaqmx` asks `ctypes.util.find_library` for ``nidaqmx``. On Linux that looks into LD_LIBRARY_PATH with
the linker (``ld`` and ``objdump`` of binutils must be on the client's PATH) and loads what it finds by
its soname; the dynamic loader reads LD_LIBRARY_PATH when a process starts, so it must be set before.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import platformdirs

from simulator.doubles.errors import LibraryBuildError
from simulator.doubles.transports.c_source import generate_library_source

DEFAULT_CACHE_FOLDER: Final = platformdirs.user_cache_path("solimon", appauthor=False) / "doubles"
"""The user's cache folder; hand in another one to keep tests apart."""

SONAMES: Final[Mapping[str, str]] = {"nidaqmx": "libnidaqmx.so.1", "niScope": "libniscope.so.1"}
"""File and soname of each library."""

EMPTY_COMPANIONS: Final[Mapping[str, tuple[str, ...]]] = {"niScope": ("libnitclk.so.1",)}
"""Libraries that a vendor package opens next to its own and never calls: `niscope` leaks without NI-TClk."""

EMPTY_SOURCE: Final = "int double_without_functions;\n"

FLAGS: Final = ("-shared", "-fPIC", "-O1", "-pthread")

COMPILE_TIMEOUT_S = 120.0


def find_unavailability_reason() -> str:
    """Return why no library can be built or found on this machine, with a remedy; empty if one can.

    It needs Linux, a C compiler, and ``ld`` and ``objdump`` on the PATH.
    """
    if not sys.platform.startswith("linux"):
        return f"the double of NI's C library runs on Linux only, this is {sys.platform}"
    if _find_compiler() is None:
        return "no C compiler found (cc, gcc or clang): install one, e.g. `apt install gcc`"
    missing = [tool for tool in ("ld", "objdump") if shutil.which(tool) is None]
    if missing:
        return f"{' and '.join(missing)} not on the PATH: install binutils, ctypes finds libraries with it"
    return ""


def build_library(library: str = "nidaqmx", cache: Path = DEFAULT_CACHE_FOLDER) -> Path:
    """Build one shared library, and its empty companions, unless the cache holds it; return its folder.

    The folder's name is a hash of source and compiler flags, and it appears by one rename, so it is complete
    or absent when several processes build at the same time.

    Raises
    ------
    LibraryBuildError
        Not Linux, no compiler, or the compiler refused; the message says what to install.
    KeyError
        `SONAMES` has no such library.
    """
    source, soname = generate_library_source(library), SONAMES[library]
    companions = EMPTY_COMPANIONS.get(library, ())
    made_of = "\0".join([source, *FLAGS, *companions, platform.machine()])
    digest = hashlib.blake2b(made_of.encode(), digest_size=12).hexdigest()
    folder = cache / f"{library}-{digest}"
    if (folder / soname).exists():
        return folder
    reason = find_unavailability_reason()
    if reason:
        raise LibraryBuildError(f"cannot build {soname}: {reason}")
    cache.mkdir(parents=True, exist_ok=True)
    building = Path(tempfile.mkdtemp(prefix=f"{library}-building-", dir=cache))
    try:
        _compile_library(source, FLAGS, building / soname)
        for companion in companions:
            _compile_library(EMPTY_SOURCE, FLAGS, building / companion)
        for name in (soname, *companions):
            # `ld -lnidaqmx` looks for the name without a version.
            (building / name.removesuffix(".1")).symlink_to(name)
        building.rename(folder)
    except OSError:
        if not (folder / soname).exists():
            raise
        # Another process was first; its folder is the same.
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return folder


def build_environment(
    wire: str, *folders: Path, environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the environment in which a process with an unmodified vendor package uses the double.

    Parameters
    ----------
    wire
        ``host:port`` of the running double.
    folders
        Folders of the libraries (`build_library`), put before those of ``LD_LIBRARY_PATH``.
    environment
        Variables to start from; None: those of this process.
    """
    start = dict(os.environ if environment is None else environment)
    before = start.get("LD_LIBRARY_PATH", "")
    path = [str(folder) for folder in folders] + ([before] if before else [])
    return start | {"SOLIMON_DOUBLES": wire, "LD_LIBRARY_PATH": os.pathsep.join(path)}


def _find_compiler() -> str | None:
    """Return the path of the C compiler (cc, gcc or clang, in this order); None if there is none."""
    return next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)


def _compile_library(source: str, flags: tuple[str, ...], target: Path) -> None:
    """Compile a C source to a shared library with its file name as the soname; the source stays next to it.

    Raises
    ------
    LibraryBuildError
        There is no compiler, or it fails; the message has its output.
    subprocess.TimeoutExpired
        It takes longer than `COMPILE_TIMEOUT_S`.
    """
    compiler = _find_compiler()
    if compiler is None:
        raise LibraryBuildError(f"cannot build {target.name}: no C compiler found")
    written = target.with_suffix(".c")
    written.write_text(source, encoding="utf-8")
    done = subprocess.run(
        [compiler, *flags, f"-Wl,-soname,{target.name}", "-o", str(target), str(written)],
        capture_output=True,
        text=True,
        timeout=COMPILE_TIMEOUT_S,
        check=False,
    )
    if done.returncode != 0:
        raise LibraryBuildError(f"{compiler} cannot build {target.name}:\n{done.stderr.strip()}")
