"""Checks of this installation: packages of extras that are missing, own packages that other files hide."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from daq_service.errors import UsageError

MODULES = {
    "client": ("httpx2", "pandas", "xarray"),
    "report": ("matplotlib",),
    "twin": ("numba", "llvmlite"),
}
"""Modules that an extra installs."""
OWN_PACKAGES = ("analysis", "hardware_drivers", "simulator")


class MissingExtraError(UsageError):
    """Error: modules of an extra are not installed; the message gives the command that installs them."""


class HiddenPackageError(UsageError, ImportError):
    """Error: a file outside of solimon has the name of one of its packages and is found first."""


def require_extras(*extras: str) -> None:
    """Raise MissingExtraError unless all modules of the extras are installed; none is imported."""
    missing = {extra: [name for name in MODULES[extra] if not _is_installed(name)] for extra in extras}
    modules = [name for names in missing.values() for name in names]
    if modules:
        needed = ",".join(extra for extra, names in missing.items() if names)
        be = "is" if len(modules) == 1 else "are"
        raise MissingExtraError(f'{", ".join(modules)} {be} not installed: pip install "solimon[{needed}]"')


def refuse_hidden_packages() -> None:
    """Raise HiddenPackageError if a file or folder hides one of `OWN_PACKAGES`; the message names it."""
    root = Path(__file__).parents[2]
    for name in OWN_PACKAGES:
        spec = find_spec(name)
        origin = Path(spec.origin if spec and spec.origin else root / name / "__init__.py")
        if not origin.samefile(root / name / "__init__.py"):
            hiding = origin.parent if origin.stem == "__init__" else origin
            raise HiddenPackageError(
                f"{hiding} hides the package {name!r} of solimon; rename it, or start in another folder"
            )


def _is_installed(module: str) -> bool:
    """Return whether a top-level module can be found."""
    try:
        return find_spec(module) is not None
    except ImportError:
        return False
