"""Machine code of the loops that numba compiles, kept on disk where that can be done.

numba keeps it in `__pycache__` beside the loop's file, in the user's cache folder if that cannot be
written, or where NUMBA_CACHE_DIR says; if none of them can be written, it compiles anew in each process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function with ``numba.njit(**options)``."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            made: Callable[..., Any] = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder for the machine code can be written
            made = numba.njit(**options)(function)
        return made

    return decorate
