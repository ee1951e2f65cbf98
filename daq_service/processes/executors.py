"""Executors of `concurrent.futures` by name: threads, processes that outlive a killed one, a Dask cluster.

Each gives the same digits: BLAS computes in one thread in all of them. A worker that is killed costs the
tasks that were under way, which are done again.
"""

from __future__ import annotations

import multiprocessing
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from typing import Any
from urllib.parse import urlsplit

from daq_service.errors import BusyError, UsageError
from daq_service.processes.worker import leave_with_parent
from simulator.numerics.one_thread import one_blas_thread

MOST_PROCESSES = 61
"""Windows waits for no more at once."""
MOST_TRIES = 3
"""Of a task that was under way each time a worker died: maybe it is what kills them."""
DASK = "dask://"
DASK_PORT = 8786
CONNECTED_WITHIN_S = 10.0
SAME_EVERYWHERE = ("solimon", "numpy", "scipy", "numba")
"""Packages whose versions must be the same on all workers: digits depend on them."""


def usable_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def checked_name(name: str, workers: int | None) -> str:
    """Return the name of an executor.

    Raises
    ------
    UsageError
        There is no such executor, or a cluster is told how many workers it has.
    """
    if name not in ("processes", "threads") and not (name.startswith(DASK) and urlsplit(name).hostname):
        raise UsageError(f"--executor {name}: say processes, threads, or dask://HOST or dask://HOST:PORT")
    if name.startswith(DASK) and workers is not None:
        raise UsageError("--workers does not belong to a cluster, which has its own; leave it out")
    return name


def start_worker() -> None:
    """Prepare a worker process: one BLAS thread, and gone when its parent is."""
    one_blas_thread().__enter__()
    leave_with_parent()


@contextmanager
def opened_executor(name: str, workers: int) -> Iterator[Executor]:
    """Give an executor; leaving it early drops what has not begun and waits for what has.

    Parameters
    ----------
    name
        ``processes``, ``threads`` or ``dask://HOST`` (`checked_name`).
    workers
        Processes or threads; a cluster has its own (`workers_of`).

    Raises
    ------
    UsageError
        The extra ``cluster`` is not installed, or a worker of the cluster has other versions.
    BusyError
        No scheduler answers there, or it has no worker.
    """
    if name.startswith(DASK):
        with _cluster(name) as on_cluster:
            yield on_cluster
        return
    executor = _Processes(workers) if name == "processes" else ThreadPoolExecutor(workers)
    # Threads share the libraries' setting: without this one's end would give the others more BLAS threads.
    with one_blas_thread():
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def workers_of(executor: Executor, workers: int) -> int:
    """How many tasks an executor does at once; ``workers`` where it is no cluster."""
    return executor.n_workers if isinstance(executor, _OnCluster) else workers


def worker_lost() -> tuple[type[Exception], ...]:
    """Return what a task's result raises where its workers died again and again."""
    distributed = sys.modules.get("distributed")
    return (BrokenExecutor,) if distributed is None else (BrokenExecutor, distributed.KilledWorker)


class _Task(Future[Any]):
    """A task, which may be begun several times."""

    def __init__(self, call: Callable[[], Any]) -> None:
        super().__init__()
        self.call, self.tries = call, 0
        self.begun: Future[Any] | None = None

    def cancel(self) -> bool:
        """Cancel it unless it is under way."""
        return (self.begun is None or self.begun.cancel()) and super().cancel()


class _Processes(Executor):
    """A pool of processes that is made anew when one of them is killed, which breaks a pool.

    Processes are spawned, not forked: so it is on every platform, and no lock of this process's threads
    is copied in a locked state.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._lock, self._closed = min(workers, MOST_PROCESSES), threading.Lock(), False
        self._pool = self._made()

    def submit(self, work: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        task = _Task(partial(work, *args, **named))
        self._begin(task)
        return task

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._lock:
            self._closed, pool = True, self._pool
        pool.shutdown(wait, cancel_futures=cancel_futures)

    def _made(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self._workers, mp_context=context, initializer=start_worker)

    def _begin(self, task: _Task) -> None:
        with self._lock:
            pool = self._pool
        try:  # not under our lock: a pool that breaks holds its own while it tells us so
            begun = pool.submit(task.call)
        except BrokenExecutor:
            begun = self._renewed(pool).submit(task.call)
        task.begun, task.tries = begun, task.tries + 1
        begun.add_done_callback(partial(self._ended, task, pool))

    def _renewed(self, broken: ProcessPoolExecutor) -> ProcessPoolExecutor:
        with self._lock:
            if self._pool is broken:
                self._pool = self._made()
            return self._pool

    def _ended(self, task: _Task, pool: ProcessPoolExecutor, begun: Future[Any]) -> None:
        if begun.cancelled():
            Future.cancel(task)
            return
        error = begun.exception()
        if isinstance(error, BrokenExecutor) and task.tries < MOST_TRIES and not self._closed:
            self._renewed(pool)
            self._begin(task)
        elif error is not None:
            task.set_exception(error)
        else:
            task.set_result(begun.result())


class _OnCluster(Executor):
    """Workers of a Dask cluster; its scheduler gives the task of a worker that died to another one."""

    def __init__(self, client: Any) -> None:
        self._executor = client.get_executor(pure=False)
        self.n_workers = sum(client.nthreads().values())

    def submit(self, work: Callable[..., Any], /, *args: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(_in_one_thread, work, *args, **named)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)


def _in_one_thread(work: Callable[..., Any], *args: Any, **named: Any) -> Any:
    with one_blas_thread():
        return work(*args, **named)


@contextmanager
def _cluster(name: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(f"{name} needs the extra: pip install 'solimon[cluster]'") from error
    parts = urlsplit(name)
    place = parts.hostname, parts.port or DASK_PORT
    address = f"tcp://{place[0]}:{place[1]}"
    try:  # a client that finds nobody leaves its thread behind
        socket.create_connection(place, timeout=CONNECTED_WITHIN_S).close()
        client: Any = Client(address, timeout=CONNECTED_WITHIN_S, set_as_default=False)
    except OSError as error:
        raise BusyError(
            f"no Dask scheduler answers at {address} within {CONNECTED_WITHIN_S:g} s; start `dask scheduler` "
            "there, or choose --executor processes"
        ) from error
    with client:
        here = _versions()
        found = client.run(_versions)
        if not found:
            raise BusyError(f"the Dask scheduler at {address} has no worker; start `dask worker {address}`")
        for worker, there in found.items():
            other = ", ".join(
                f"{one} {there[one]} (here {here[one]})" for one in here if there[one] != here[one]
            )
            if other:
                raise UsageError(
                    f"the Dask worker {worker} has {other}: its digits may differ; install the same"
                )
        executor = _OnCluster(client)
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _versions() -> dict[str, str]:
    """Versions of a process that decide about digits."""
    return {"python": sys.version.split()[0], **{name: version(name) for name in SAME_EVERYWHERE}}
