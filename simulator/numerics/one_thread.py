"""One thread for dense linear algebra, so that its digits do not depend on how many cores are free.

OpenBLAS splits sums by its number of threads: two machines, or one machine on a busy day, would keep
reductions that differ in the last bits. The matrices here are small enough that more threads gain nothing.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _find_blas_libraries() -> ThreadpoolController:
    """Return the controller of the loaded numerical libraries; cached, because the search is slow."""
    import scipy.linalg  # noqa: F401 its library must be loaded before we look

    return ThreadpoolController()


def use_one_blas_thread() -> AbstractContextManager[object]:
    """Return a context manager that limits BLAS to one thread in the whole process."""
    limiter: AbstractContextManager[object] = _find_blas_libraries().limit(limits=1, user_api="blas")
    return limiter


@cache
def describe_blas_libraries() -> tuple[str, ...]:
    """List every BLAS in use by library, version and processor kind, which determine the last digits."""
    found = _find_blas_libraries().select(user_api="blas").info()
    return tuple(
        sorted(
            f"{library['internal_api']} {library['version']} {library.get('architecture')}"
            for library in found
        )
    )
