"""Check Python and the packages that this configuration needs."""

from __future__ import annotations

import importlib
import platform
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, requires
from importlib.metadata import version as installed_version

from daq_service.cli.doctor.check import Check, State, Value
from daq_service.processes.installation import MODULES

OLDEST_PYTHON = (3, 11)
ALWAYS = ("numpy", "scipy", "h5py", "pydantic", "sqlalchemy", "fastapi")
COMPILED = ("numpy", "scipy.signal", "h5py")
"""Imported too: what does not load is usually a binary that fits another Python, numpy or processor."""

LOAD_ERRORS = (ImportError, OSError, ValueError, RuntimeError, AttributeError, SystemError, TypeError)
"""How a binary fails that was built for something else: a missing symbol, another numpy's layout."""

_MINIMUM = re.compile(r"^([A-Za-z0-9_.-]+)(?:\[[^\]]*\])?\s*>=\s*([0-9][0-9.]*)")


def check_software(
    needed: Iterable[str],
    *,
    installed: Callable[[str], str] = installed_version,
    load: Callable[[str], object] = importlib.import_module,
) -> list[Check]:
    """Compare Python and installed packages with their minimum versions, and import the compiled ones.

    A missing or outdated package fails.

    Parameters
    ----------
    needed
        Packages that the instruments need.
    installed
        Return the version of an installed package; raises PackageNotFoundError.
    load
        Import a module by its name.
    """
    required = map(_MINIMUM.match, requires("solimon") or ())
    oldest = {match[1]: match[2] for match in required if match}
    checks = [_check_python(), _check_package("solimon", "", installed)]
    names = dict.fromkeys((*ALWAYS, *needed))
    compiled = [*COMPILED, *(name for name in names if name == "numba")]
    checks += [_check_package(name, oldest.get(name, ""), installed) for name in names]
    return [*checks, _check_binaries(load, compiled)]


EXTRAS = {"grpcio": "grpc", "niscope": "niscope", "npTDMS": "tdms", "pyvisa": "visa", "pyvisa-py": "visa"}
EXTRAS |= dict.fromkeys(MODULES["twin"], "twin")


def _check_python() -> Check:
    """Check that Python has at least version `OLDEST_PYTHON` and is a 64-bit build."""
    bits = 64 if sys.maxsize > 2**32 else 32
    fits = sys.version_info[:2] >= OLDEST_PYTHON and bits == 64
    version, system = platform.python_version(), platform.platform()
    values: Mapping[str, Value] = {"version": version, "bits": bits, "platform": system}
    remedy = f"install Python {'.'.join(map(str, OLDEST_PYTHON))} or later, 64 bit"
    found = f"{version}, {bits} bit, {system}"
    return Check("software", "python", "ok" if fits else "fail", found, remedy, values)


def _check_package(name: str, oldest: str, installed: Callable[[str], str]) -> Check:
    """Check that a package is installed in at least version ``oldest``; any version if that is empty.

    ``installed`` returns a version or raises PackageNotFoundError, which fails the check.
    """
    requirement = f"solimon[{EXTRAS[name]}]" if name in EXTRAS else "solimon" if oldest else name
    remedy = f'install it: python -m pip install "{requirement}"'
    try:
        found = installed(name)
    except PackageNotFoundError:
        return Check("software", name, "fail", "not installed", remedy)
    state: State = "ok" if _parse_version_numbers(found) >= _parse_version_numbers(oldest) else "fail"
    text = found + (f" (at least {oldest})" if oldest else "")
    return Check("software", name, state, text, remedy, {"version": found, "oldest": oldest or None})


def _check_binaries(load: Callable[[str], object], compiled: Sequence[str]) -> Check:
    """Check that each compiled package can be imported; the check lists every failure.

    ``load`` imports a module by its name.
    """
    broken = {}
    for name in compiled:
        try:
            load(name)
        except LOAD_ERRORS as error:
            broken[name] = f"{type(error).__name__}: {error}"
    failures = "; ".join(f"{name} does not load ({reason})" for name, reason in broken.items())
    remedy = f"install again: python -m pip install --force-reinstall {' '.join(broken)}"
    found = failures or f"{', '.join(compiled)} load"
    return Check("software", "compiled packages", "fail" if broken else "ok", found, remedy)


def _parse_version_numbers(text: str) -> tuple[int, ...]:
    """Parse the leading numbers of a version: ``1.26.4rc1`` gives (1, 26, 4); empty if it has none."""
    match = re.match(r"\d+(?:\.\d+)*", text)
    return tuple(int(part) for part in match[0].split(".")) if match else ()
