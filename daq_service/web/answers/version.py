"""Versions the service tells."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

API_VERSION = "1.0.0"
"""Of the interface under /api/v1, not of the distribution."""


@cache  # to find it a file of some kB is parsed, each time
def distribution_version() -> str:
    """Version of the installed solimon, or "unknown" in a bare checkout."""
    try:
        return version("solimon")
    except PackageNotFoundError:
        return "unknown"
