"""Where jobs run: in this process, in processes on all cores, or on a Dask cluster.

All three are executors of `concurrent.futures`.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, get_context, parent_process
from typing import Any, Callable, Iterator

from ..errors import MapRacingError, ParameterError

__all__ = ["SerialExecutor", "carried_out", "check_workers", "open_executor"]

# One race uses one core. Without these, each process would start one linear-algebra thread per
# core.
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
_PATIENCE = 10.0  # for a scheduler to answer [s]


class SerialExecutor(Executor):
    """Runs each job immediately, in this process."""

    def submit(self, fn: Callable, *args: Any, **kwargs: Any) -> Future:
        """Run a job immediately; a keyboard interrupt is raised, not stored in the future."""
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def carried_out(
    executor: Executor, capacity: int, draw: Callable[[], tuple | None]
) -> Iterator[tuple[Any, Any]]:
    """Carry out jobs, with enough of them submitted to keep an executor busy.

    Parameters
    ----------
    executor : concurrent.futures.Executor
    capacity : int
        Largest number of submitted jobs.
    draw : callable
        Returns the next job as ``(name, function, *arguments)``, or None if there is none before
        another result.

    Yields
    ------
    name, result
        In the order in which they end.

    Raises
    ------
    MapRacingError
        If a process died.
    """
    running = {}
    try:
        while True:
            while len(running) < capacity:
                job = draw()
                if job is None:
                    break
                with _interruptions_later():
                    running[executor.submit(*job[1:])] = job[0]
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)
    finally:
        for future in running:
            future.cancel()


@contextmanager
def _interruptions_later():
    """Hold Ctrl-C back, also from a process that starts here and cannot yet ignore it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _result(future):
    try:
        return future.result()
    except (BrokenProcessPool, CancelledError):
        raise MapRacingError(
            "a process died; what was finished is on disk: run again to continue"
        ) from None


def check_workers(jobs: int | None, scheduler: str | None) -> None:
    """Refuse arguments that `open_executor` cannot use.

    Raises
    ------
    ParameterError
        If the number of jobs is not positive, or both arguments are given.
    """
    if jobs is not None and jobs < 1:
        raise ParameterError(f"jobs: expected at least 1, got {jobs}")
    if scheduler is not None and jobs is not None:
        raise ParameterError("jobs: expected none with a scheduler, whose workers decide")


@contextmanager
def open_executor(
    jobs: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[Executor, int]]:
    """An executor, and how many jobs keep it busy.

    Parameters
    ----------
    jobs : int, optional
        Processes; 1 is this one. Default: one for each available core.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``tcp://host:8786``; needs the package ``distributed``
        here, and this package on its workers.

    Raises
    ------
    ParameterError
        As `check_workers`.
    MapRacingError
        If the scheduler does not answer, or Dask is not installed.
    """
    check_workers(jobs, scheduler)
    if scheduler is not None:
        with _dask(scheduler) as given:
            yield given
        return
    jobs = jobs or _cores()
    if jobs == 1:
        yield SerialExecutor(), 1
        return
    # Spawned, not forked: this process may have threads. Numpy reads the environment on import.
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin_work)
        with pool:
            # Twice as many, so that a job is always waiting for each process.
            yield pool, 2 * jobs
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _cores():
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


def _begin_work():
    """Set up a process: ignore keyboard interrupts, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch():
        connection.wait([parent_process().sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _dask(address):
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    except ImportError:
        raise MapRacingError(
            "a scheduler needs the package distributed: pip install 'map_racing[cluster]'"
        ) from None
    try:
        # A client that failed to connect stops its event loop when it is garbage-collected, which
        # can block the next one: only connect to a scheduler that answers.
        socket.create_connection(get_address_host_port(address), timeout=_PATIENCE).close()
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:  # distributed's timeout is an OSError
        raise MapRacingError(f"{address}: no Dask scheduler answers: {error}") from None
    with client:
        # Not from `scheduler_info`, which some versions truncate to five workers.
        threads = sum(client.nthreads().values())
        if not threads:
            raise MapRacingError(f"{address}: the Dask scheduler has no workers")
        yield client.get_executor(), 4 * threads
