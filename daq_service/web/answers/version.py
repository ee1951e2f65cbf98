"""Versions of the service and its interface."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

API_VERSION = "1.0.0"
"""Version of the interface under /api/v1, not of the distribution."""


@cache  # each call would parse a file of some kB
def read_installed_version() -> str:
    """Return the version of the installed solimon, or "unknown" in a bare checkout. Cached."""
    try:
        return version("solimon")
    except PackageNotFoundError:
        return "unknown"
