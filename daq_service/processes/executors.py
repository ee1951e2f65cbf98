"""Executors of `concurrent.futures` by name: threads, processes that survive a killed worker, a Dask cluster.

All give the same digits: BLAS computes in one thread in each of them. The tasks of a killed worker are
repeated.
"""

from __future__ import annotations

import multiprocessing
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar
from urllib.parse import urlsplit

from daq_service.errors import BusyError, UsageError
from daq_service.processes.worker import leave_with_parent
from simulator.numerics.one_thread import use_one_blas_thread

T = TypeVar("T")

MOST_PROCESSES = 61
"""Windows waits for at most this many processes at once."""
MOST_TRIES = 3
"""Attempts of a task during which a worker died: the task itself may kill its worker."""
DASK = "dask://"
DASK_PORT = 8786
CONNECTED_WITHIN_S = 10.0
SAME_EVERYWHERE = ("solimon", "numpy", "scipy", "numba")
"""Packages whose versions must be the same on all workers: digits depend on them."""


def count_usable_cores() -> int:
    """Count the processor cores that this process may use (its affinity, or else all cores); at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def validate_executor_name(name: str, workers: int | None) -> str:
    """Return the name of an executor unchanged if it is valid; nothing is connected.

    Raises
    ------
    UsageError
        There is no such executor, or a number of workers is given for a cluster.
    """
    if name not in ("processes", "threads") and not (name.startswith(DASK) and urlsplit(name).hostname):
        raise UsageError(f"--executor {name}: give processes, threads, or dask://HOST or dask://HOST:PORT")
    if name.startswith(DASK) and workers is not None:
        raise UsageError("--workers does not belong to a cluster, which has its own; leave it out")
    return name


def prepare_worker() -> None:
    """Initialize a worker process: use one BLAS thread, ignore Ctrl-C, and end with the parent."""
    use_one_blas_thread().__enter__()
    leave_with_parent()


@contextmanager
def open_executor(name: str, workers: int) -> Iterator[Executor]:
    """Yield an executor; on exit pending tasks are canceled and running ones awaited.

    Parameters
    ----------
    name
        ``processes``, ``threads`` or ``dask://HOST`` (`validate_executor_name`).
    workers
        Processes (at most 61) or threads; a cluster has its own (`count_workers`).

    Raises
    ------
    UsageError
        The extra ``cluster`` is not installed, or a worker of the cluster has other versions.
    BusyError
        No scheduler answers within 10 s, or it has no worker.
    """
    if name.startswith(DASK):
        with _open_cluster(name) as on_cluster:
            yield on_cluster
        return
    executor = _ProcessExecutor(workers) if name == "processes" else ThreadPoolExecutor(workers)
    # Threads share the libraries' setting: without this, the end of one would give the others more threads.
    with use_one_blas_thread():
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def count_workers(executor: Executor, workers: int) -> int:
    """Return the number of parallel tasks: the threads of a cluster at connection, otherwise ``workers``."""
    return executor.n_workers if isinstance(executor, _ClusterExecutor) else workers


def list_worker_lost_errors() -> tuple[type[Exception], ...]:
    """Return the exception classes of a task whose worker processes died repeatedly, for ``except``.

    The one of Dask is included only if the package ``distributed`` is loaded.
    """
    distributed = sys.modules.get("distributed")
    return (BrokenExecutor,) if distributed is None else (BrokenExecutor, distributed.KilledWorker)


class _Task(Future[T]):
    """Task that may be submitted several times."""

    def __init__(self, call: Callable[[], T]) -> None:
        super().__init__()
        self.call, self.tries = call, 0
        self.attempt: Future[T] | None = None

    def cancel(self) -> bool:
        """Cancel the task unless its present attempt runs or has ended; return whether it is canceled."""
        return (self.attempt is None or self.attempt.cancel()) and super().cancel()


class _ProcessExecutor(Executor):
    """Pool of processes that is replaced when a killed worker breaks it.

    Processes are spawned, not forked: this works on every platform and copies no locked lock of a thread.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._lock, self._closed = min(workers, MOST_PROCESSES), threading.Lock(), False
        self._pool = self._start_pool()

    def submit(self, work: Callable[..., T], /, *args: object, **named: object) -> Future[T]:
        """Submit work to the pool; it is tried up to `MOST_TRIES` times if worker processes die.

        Raises RuntimeError after `shutdown`.
        """
        task = _Task(partial(work, *args, **named))
        self._submit_attempt(task)
        return task

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Accept no further work and end the worker processes; with ``wait`` block until they have ended."""
        with self._lock:
            self._closed, pool = True, self._pool
        pool.shutdown(wait, cancel_futures=cancel_futures)

    def _start_pool(self) -> ProcessPoolExecutor:
        """Create a pool of spawned worker processes; they start with their first tasks."""
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._workers, mp_context=context, initializer=prepare_worker)

    def _submit_attempt(self, task: _Task[T]) -> None:
        """Submit a task to the pool; if the pool is broken, to a new one.

        Raises RuntimeError after `shutdown`.
        """
        with self._lock:
            pool = self._pool
        try:  # without our lock: a pool that breaks holds its own lock during its callback
            attempt = pool.submit(task.call)
        except BrokenExecutor:
            attempt = self._replace_pool(pool).submit(task.call)
        task.attempt, task.tries = attempt, task.tries + 1
        attempt.add_done_callback(partial(self._finish_attempt, task, pool))

    def _replace_pool(self, broken: ProcessPoolExecutor) -> ProcessPoolExecutor:
        """Replace a broken pool, unless another thread has replaced it, and return the present pool."""
        with self._lock:
            if self._pool is broken:
                self._pool = self._start_pool()
            return self._pool

    def _finish_attempt(self, task: _Task[T], pool: ProcessPoolExecutor, attempt: Future[T]) -> None:
        """Set the result or exception of a task, or cancel it, as its attempt ended.

        The task is submitted again if its pool broke, tries remain and the executor is open.
        """
        if attempt.cancelled():
            Future.cancel(task)
            return
        error = attempt.exception()
        if isinstance(error, BrokenExecutor) and task.tries < MOST_TRIES and not self._closed:
            self._replace_pool(pool)
            self._submit_attempt(task)
        elif error is not None:
            task.set_exception(error)
        else:
            task.set_result(attempt.result())


class _ClusterExecutor(Executor):
    """Workers of a Dask cluster; its scheduler repeats the task of a worker that died on another one."""

    def __init__(self, client: Any) -> None:
        self._executor = client.get_executor(pure=False)
        self.n_workers = sum(client.nthreads().values())

    def submit(self, work: Callable[..., T], /, *args: object, **named: object) -> Future[T]:
        """Submit work to the cluster, where it runs with one BLAS thread; return its future."""
        future: Future[T] = self._executor.submit(_run_with_one_blas_thread, work, *args, **named)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Accept no further work; wait for running tasks only if ``wait`` and not ``cancel_futures``."""
        self._executor.shutdown(wait=wait and not cancel_futures)


def _run_with_one_blas_thread(work: Callable[..., T], *args: object, **named: object) -> T:
    """Call work with its arguments while BLAS uses one thread, and return its result."""
    with use_one_blas_thread():
        return work(*args, **named)


@contextmanager
def _open_cluster(name: str) -> Iterator[Executor]:
    """Connect to a Dask cluster (``dask://HOST:PORT``, default port 8786) and yield its executor.

    Raises UsageError if ``distributed`` is not installed or a worker has other versions, and BusyError if no
    scheduler answers within 10 s or it has no worker.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(f"{name} needs the extra: pip install 'solimon[cluster]'") from error
    parts = urlsplit(name)
    host_and_port = parts.hostname, parts.port or DASK_PORT
    address = f"tcp://{host_and_port[0]}:{host_and_port[1]}"
    try:  # a client without a scheduler leaves its thread behind
        socket.create_connection(host_and_port, timeout=CONNECTED_WITHIN_S).close()
        client: Any = Client(address, timeout=CONNECTED_WITHIN_S, set_as_default=False)
    except OSError as error:
        raise BusyError(
            f"no Dask scheduler answers at {address} within {CONNECTED_WITHIN_S:g} s; start `dask scheduler` "
            "there, or choose --executor processes"
        ) from error
    with client:
        own_versions = _list_versions()
        worker_versions = client.run(_list_versions)
        if not worker_versions:
            raise BusyError(f"the Dask scheduler at {address} has no worker; start `dask worker {address}`")
        for worker, versions in worker_versions.items():
            differences = ", ".join(
                f"{package} {versions[package]} (here {own_versions[package]})"
                for package in own_versions
                if versions[package] != own_versions[package]
            )
            if differences:
                raise UsageError(
                    f"the Dask worker {worker} has {differences}: its digits may differ; install the same"
                )
        executor = _ClusterExecutor(client)
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _list_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages in `SAME_EVERYWHERE` in this process, by name.

    "none" for a package that is not installed.
    """
    versions = {"python": sys.version.split()[0]} | dict.fromkeys(SAME_EVERYWHERE, "none")
    for name in SAME_EVERYWHERE:
        with suppress(PackageNotFoundError):  # numba: only the twin needs it
            versions[name] = version(name)
    return versions
