"""Machine code of the loops that numba compiles, cached on disk where possible.

numba keeps it in `__pycache__` next to the loop's file, in the user's cache folder if that cannot be
written, or where NUMBA_CACHE_DIR says; if none of them can be written, it compiles again in each process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba.core import event


def jit_compile(**options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Create a decorator that compiles a function by ``numba.njit(**options)``, cached if possible."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        """Compile a function by Numba, without the disk cache where none can be written."""
        try:
            kernel: Callable[..., Any] = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder for the machine code can be written
            kernel = numba.njit(**options)(function)
        return kernel

    return decorate


class _Compilations(event.Listener):
    """Listener that counts nested compilations; loading from the cache is no such event."""

    def __init__(self, report: Callable[[bool], None]) -> None:
        """Keep the callback; no compilation is in progress."""
        self._report, self._depth = report, 0

    def on_start(self, event: object) -> None:
        """Report the start of a compilation, unless another one is in progress."""
        self._depth += 1
        if self._depth == 1:
            self._report(True)

    def on_end(self, event: object) -> None:
        """Report the end of the outermost compilation."""
        self._depth -= 1
        if self._depth == 0:
            self._report(False)


@contextmanager
def report_compilation(report: Callable[[bool], None]) -> Iterator[None]:
    """Call ``report`` with True when a compilation starts, with False when it ends.

    It is called by the thread that compiles: one at a time, numba holds a lock meanwhile.
    """
    with event.install_listener("numba:compile", _Compilations(report)):
        yield
