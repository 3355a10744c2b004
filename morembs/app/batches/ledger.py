"""Which tasks begin where: what workers have, less what runs on them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from morembs.app.batches.workers import Worker

Key = TypeVar("Key")


def place_tasks(
    waiting: Iterable[tuple[Key, Worker]], running: Iterable[tuple[str, Worker]], present: Mapping[str, Worker]
) -> Iterator[tuple[Key, str]]:
    """Those of the tasks in ``waiting``, each with its needs, that may begin now, and on which worker.

    They come in their order, the longest first (Graham 1969). One that has room nowhere keeps the worker with the most
    free memory for itself: nothing that comes later in the order begins there, or it might wait for ever.
    """
    free = dict(present)
    for name, needs in running:
        if name in free:
            free[name] = _less(free[name], needs)
    for key, needs in waiting:
        open_now = {name: left for name, left in free.items() if left.slots > 0 and left.cores > 0}
        if not open_now:
            return
        fits = [name for name, left in open_now.items() if left.holds(needs)]
        if fits:
            name = max(fits, key=lambda each: (open_now[each].cores, open_now[each].bytes))
            free[name] = _less(free[name], needs)
            yield key, name
        else:
            lasting = [name for name, left in open_now.items() if left.seconds >= needs.seconds]
            if not lasting:
                continue  # all of them end too soon; others will come
            del free[max(lasting, key=lambda each: (present[each].bytes >= needs.bytes, open_now[each].bytes))]


def _less(worker: Worker, needs: Worker) -> Worker:
    return replace(worker, bytes=worker.bytes - needs.bytes, cores=worker.cores - needs.cores, slots=worker.slots - 1)
