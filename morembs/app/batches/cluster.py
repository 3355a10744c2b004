"""Workers of dask, of a running scheduler or started by a queue. The only file that imports
dask.distributed.

A worker starts a process for each task, as this machine would, and that ends with the worker. Which task goes where is
decided by the coordinator alone; resources of dask, ``MB`` and ``cores``, keep what other batches take apart. Nothing
that dask itself counts or repeats is relied on: a task whose worker is gone is reported as lost, and that is all.
"""

from __future__ import annotations

import itertools
import logging
import queue
import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from threading import Lock
from typing import Any

import distributed
from distributed.deploy.adaptive import Adaptive

from morembs.app.batches.admission import Probes, admit_workers
from morembs.app.batches.children import Children
from morembs.app.batches.cluster_file import Place
from morembs.app.batches.queues import queue_of, room_of
from morembs.app.batches.tolerances import TOL
from morembs.app.batches.workers import Finished, Heard, Task, Worker
from morembs.base import stopping
from morembs.base.closing import Closing
from morembs.base.errors import InputError

# Tasks that run on this worker, by their batch.
_running: dict[str, int] = {}
_lock = Lock()


def workers_of(given: Any, folders: Iterable[Path], tell: Callable[[str], None]) -> DaskWorkers:
    """Workers of a client, of a scheduler or of a queue.

    Args:
        given: a client of dask, or a place.
        folders: where results go, which every worker has to see.
        tell: hears what becomes of the workers.

    Raises:
        InputError: no scheduler, no worker, or a worker that cannot be used.
    """
    if not isinstance(given, Place):
        if given.asynchronous:
            raise InputError("an asynchronous client of dask was given; expected Client(...) of a plain program")
        return DaskWorkers(given, folders, tell)
    _quiet()
    if given.address is not None:
        return DaskWorkers(_client(given.address), folders, tell, own=True)
    cluster = queue_of(given)
    try:
        client = _client(cluster)
        return DaskWorkers(client, folders, tell, own=True, cluster=cluster, place=given)
    except BaseException:
        cluster.close()
        raise


def _client(scheduler: Any) -> Any:
    new: Any = distributed.Client
    try:
        return new(scheduler, timeout=TOL.scheduler_seconds)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"no scheduler answers at {scheduler}; start one with: dask scheduler", kind="program"
        ) from error


def _quiet() -> None:
    """Turn the logs of dask off: messages of this module say which workers come and go."""
    for name in list(logging.Logger.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


class DaskWorkers(Closing):
    """Workers that ``client`` knows.

    Args:
        own: whether the client is closed with them.
        cluster, place: of a queue, which has as many workers started as there is work for.
    """

    limits = True

    def __init__(
        self,
        client: Any,
        folders: Iterable[Path],
        tell: Callable[[str], None],
        *,
        own: bool = False,
        cluster: Any = None,
        place: Place | None = None,
    ) -> None:
        self._client, self._tell, self._own, self._cluster, self._place = client, tell, own, cluster, place
        self._batch = secrets.token_hex(8)
        self._news: queue.Queue[Heard | Finished] = queue.Queue()
        self._tasks: dict[int, tuple[str, Any]] = {}
        self._admitted: dict[str, tuple[Worker, float]] = {}
        self._refused: set[str] = set()
        self._looked, self._told, self._wanted, self._begun = 0.0, time.monotonic(), 1, False
        self._lifetime = float("inf") if place is None else place.seconds
        self._probes = Probes(folders)
        client.subscribe_topic(self._batch, self._receive_event)
        try:
            if cluster is not None:
                wanted = self  # what the cluster asks again and again, in its own thread

                class WantedWorkers(Adaptive):
                    async def target(self) -> int:
                        return wanted._wanted

                cluster.adapt(minimum=0, maximum=self.count, Adaptive=WantedWorkers)
            else:
                self._wait_for_workers()
        except BaseException:
            self.close()
            raise

    @property
    def present(self) -> Mapping[str, Worker]:
        """Those that may be used now."""
        now = time.monotonic()
        rooms = self._admitted.items()
        return {name: replace(room, seconds=room.seconds - now + since) for name, (room, since) in rooms}

    @property
    def largest(self) -> Worker:
        """The most that one of them has; of a queue, what was asked for."""
        if self._place is not None:
            return room_of(self._place)
        rooms = [room for room, _ in self._admitted.values()]
        return max(rooms, key=lambda room: (room.bytes, room.cores), default=Worker(bytes=0.0, cores=1, slots=1))

    @property
    def count(self) -> int:
        """How many there are, of a queue at most."""
        return len(self._admitted) if self._place is None else self._place.workers

    def threads(self, asked: int | None, tasks: int) -> int:
        """One where nothing is asked for: there are many jobs, and the same body comes out everywhere."""
        return asked or 1

    def want(self, needs: Iterable[Worker]) -> None:
        """As many workers of a queue as tasks have work for."""
        if self._place is None:
            return
        room, max_workers = self.largest, self.count
        some = list(itertools.islice(needs, max_workers * room.slots))
        if len(some) == max_workers * room.slots:
            self._wanted = max_workers
            return
        shares = [max(each.bytes / room.bytes, each.cores / room.cores) for each in some]
        self._wanted = min(max_workers, max(-int(-sum(shares) // 1), sum(share > 0.5 for share in shares)))

    def start(self, task: Task, worker: str) -> None:
        """Begin a task on the worker of that address."""
        resources = {"MB": task.bytes / 1e6, "cores": task.cores}
        future = self._client.submit(
            _work,
            asdict(task),
            self._batch,
            key=f"morembs-{self._batch}-{task.number}",
            workers=[worker],
            allow_other_workers=False,
            resources=resources,
            retries=0,
            pure=False,
        )
        self._tasks[task.number] = worker, future
        future.add_done_callback(lambda done: self._receive_end(task.number, done))

    def next(self) -> Heard | Finished | None:
        """What is heard next; None from time to time."""
        stopping.check()
        if time.monotonic() - self._looked > TOL.workers_look_seconds:
            self._look()
        try:
            news = self._news.get(timeout=TOL.workers_look_seconds / 2)
        except queue.Empty:
            return None
        if isinstance(news, Finished):
            _, future = self._tasks.pop(news.number, ("", None))
            if future is not None:
                future.release()
        return news

    def close(self) -> None:
        """End the processes of this batch, and leave."""
        # Whatever has become of the scheduler: the workers end what they run when they lose it.
        with suppress(Exception):
            if self._tasks:
                self._client.cancel([future for _, future in self._tasks.values()], force=True)
                self._tasks.clear()
                end = time.monotonic() + TOL.ended_seconds
                while time.monotonic() < end and any(self._client.run(_still, self._batch, on_error="ignore").values()):
                    time.sleep(TOL.ended_look_seconds)
            self._client.unsubscribe_topic(self._batch)
        self._probes.close()
        if self._own:
            with suppress(Exception):
                self._client.close()
        if self._cluster is not None:
            with suppress(Exception):
                self._cluster.close()

    def _receive_event(self, event: tuple[float, Mapping[str, Any]]) -> None:
        self._news.put(Heard(**event[1]))

    def _receive_end(self, number: int, future: Any) -> None:
        """A task is done, by the word of the scheduler; called in a thread of the client."""
        worker, _ = self._tasks.get(number, ("", None))
        if future.status == "finished":
            with suppress(Exception):
                result = future.result(timeout=TOL.scheduler_seconds)
                self._news.put(_report_loss(number, worker) if result is None else Finished(**result))
                return
        error = future.exception(timeout=TOL.scheduler_seconds) if future.status == "error" else None
        if error is None or isinstance(error, distributed.scheduler.KilledWorker):
            self._news.put(_report_loss(number, worker))
        else:
            self._news.put(Finished(number=number, code=1, printed="", message=f"{worker}: {error}", seconds=0.0))

    def _look(self) -> None:
        """Who has come and who has gone."""
        self._looked = time.monotonic()
        try:
            known = self._client.scheduler_info()["workers"]
        except (OSError, TimeoutError, ValueError, RuntimeError) as error:
            raise InputError(
                f"the scheduler does not answer any more ({error}); run again when it does", kind="program"
            ) from error
        for name in self._admitted.keys() - known.keys():
            del self._admitted[name]
            self._tell(f"worker {name} is gone")
        for number, (name, future) in list(self._tasks.items()):
            if name not in known:
                future.cancel(force=True)
                self._news.put(_report_loss(number, name))
        self._refused &= known.keys()
        fresh = {name: known[name] for name in known.keys() - self._admitted.keys() - self._refused}
        if fresh:
            rooms, faults = admit_workers(self._client, fresh, self._probes, self._lifetime)
            self._admitted |= {name: (room, self._looked) for name, room in rooms.items()}
            self._refuse(faults)
        if not self._admitted and self._looked - self._told > 60.0:
            self._told = self._looked
            self._tell("no workers now; waiting for some")

    def _refuse(self, faults: Mapping[str, str]) -> None:
        """Leave workers out; all of the batch where none has been taken before."""
        self._refused |= faults.keys()
        for fault in faults.values():
            if not self._begun:
                raise InputError(fault)
            self._tell(f"{fault}; left out")
        self._begun = self._begun or bool(self._admitted)

    def _wait_for_workers(self) -> None:
        end = time.monotonic() + TOL.scheduler_seconds
        while not self._admitted:
            stopping.check()
            self._look()
            if not self._admitted and time.monotonic() > end:
                address = self._client.scheduler.address
                raise InputError(
                    f"the scheduler at {address} has no workers; start some with: dask worker {address}", kind="program"
                )
            time.sleep(0.0 if self._admitted else TOL.scheduler_look_seconds)


def _report_loss(number: int, worker: str) -> Finished:
    return Finished(number=number, code=-9, printed="", message=f"its worker {worker} is gone", seconds=0.0, lost=True)


# What runs on workers.


def _work(task: Mapping[str, Any], batch: str) -> dict[str, Any] | None:
    """The process of a task from its begin to its end; None where nobody wants the result any more."""
    worker = distributed.get_worker()
    key, mine = worker.get_current_task(), Task(**task)
    room = Worker(bytes=mine.bytes, cores=mine.cores, slots=1)
    with _counted(batch), Children(room, mine.cores) as children:
        children.start(mine)
        while True:
            news = children.next()
            state = worker.state.tasks.get(key)
            if state is None or state.state == "cancelled":
                return None
            if isinstance(news, Finished):
                return asdict(news)
            if isinstance(news, Heard):
                worker.log_event(batch, asdict(news))


@contextmanager
def _counted(batch: str) -> Iterator[None]:
    """Count a task among those of its batch that run here."""
    with _lock:
        _running[batch] = _running.get(batch, 0) + 1
    try:
        yield
    finally:
        with _lock:
            _running[batch] -= 1


def _still(batch: str) -> int:
    """How many tasks of a batch run on this worker."""
    return _running.get(batch, 0)
