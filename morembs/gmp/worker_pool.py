"""Static equilibria and samples on several processes; the result is the same for any number of them.

Every process has one BLAS thread and starts with the equilibrium without load, so that the same analysis of the
sparse solver serves all tangents whoever computes them.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from threading import Thread
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from morembs.errors import InputError, SolverError
from morembs.gmp.equilibria import Equilibrium, NotFollowedError
from morembs.linalg.sparse.threads import limit_threads

Floats = NDArray[np.float64]
Task = tuple[Any, ...]


class Work(Protocol):
    """What a process does for one component."""

    def fresh(self) -> Work:
        """The same for a process of its own; nothing of a sparse solver is shared."""

    def toward(self, X: Floats, modes: Floats, t: Floats) -> Equilibrium:
        """From a known equilibrium to the end angles t (2,); raises NotFollowedError."""

    def sample(self, equilibrium: Equilibrium) -> Any:
        """What the tables hold at an equilibrium."""


class _Worker:
    """The work of this process; forked processes take it over from their parent without any copying of objects."""

    work: Work
    stack: ExitStack


def _follow() -> None:
    """End this process when its parent is gone, which nobody else would tell it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin(work: Work) -> None:
    Thread(target=_follow, daemon=True).start()
    # Also no threads of OpenMP: those of the parent are not there after a fork.
    _Worker.stack = ExitStack()
    _Worker.stack.enter_context(threadpool_limits(1))
    _Worker.work = work.fresh()


def _done(work: Work, what: str, task: Task) -> Any:
    """A failure to follow equilibria is a result, so that a batch has the same first failure in any order."""
    try:
        return getattr(work, what)(*task)
    except NotFollowedError as error:
        return error


def _there(what: str, task: Task) -> Any:
    return _done(_Worker.work, what, task)


class WorkerPool:
    """Does tasks of one ``work`` on ``workers`` processes, or in this one where there is one; a context manager.

    Raises:
        InputError: no worker, or several on a system that cannot fork processes.
    """

    def __init__(self, work: Work, workers: int) -> None:
        if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
            raise InputError(f"workers = {workers!r} was given; expected 1 or more")
        if workers > 1 and "fork" not in multiprocessing.get_all_start_methods():
            raise InputError(f"workers = {workers} was given; this system cannot fork processes, take workers = 1")
        self.work, self.workers = work, workers
        self._pool: ProcessPoolExecutor | None = None
        self._threads = ExitStack()

    def __enter__(self) -> Self:
        self._threads.enter_context(limit_threads(1))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._threads.close()

    def each(self, what: str, tasks: Sequence[Task]) -> Iterator[tuple[int, Any]]:
        """Number and result of every task, in the order in which they end; NotFollowedError errors are results.

        Raises:
            SolverError: a process was ended from outside.
        """
        if self.workers == 1 or not tasks:
            for number, task in enumerate(tasks):
                yield number, _done(self.work, what, task)
            return
        if self._pool is None:
            context = multiprocessing.get_context("fork")
            self._pool = ProcessPoolExecutor(
                self.workers, mp_context=context, initializer=_begin, initargs=(self.work,)
            )
        try:
            futures = {self._pool.submit(_there, what, task): number for number, task in enumerate(tasks)}
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise SolverError(
                f"one of {self.workers} processes was ended before its work was done, maybe for want of memory. Take "
                "fewer workers"
            ) from None
