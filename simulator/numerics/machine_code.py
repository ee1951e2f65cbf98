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


class _FirstCompilation(event.Listener):
    """Listener that calls a function at the first compilation; loading from the cache is none."""

    def __init__(self, call: Callable[[], None]) -> None:
        """Keep the function."""
        self._call: Callable[[], None] | None = call

    def on_start(self, event: object) -> None:
        """Call the function, once only."""
        call, self._call = self._call, None
        if call is not None:
            call()

    def on_end(self, event: object) -> None:
        """Do nothing."""


@contextmanager
def call_at_first_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function when the first compilation within the context starts, in the thread that compiles."""
    with event.install_listener("numba:compile", _FirstCompilation(call)):
        yield
