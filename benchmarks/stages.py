"""Where an eigen-solution spends its time: seconds and processor seconds of each stage, without those inside of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import scipy.linalg as sl
import scipy.sparse as sp

from morembs.linalg import eigen, lanczos, sturm
from morembs.linalg.space import Columns, Space
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.statics import Statics

# What counts as which stage: where the function is looked up, its name, the stage.
_STAGES: tuple[tuple[Any, str, str], ...] = (
    (Statics, "apply", "solves"),
    (sturm.ShiftedInverse, "apply", "solves_shifted"),
    (sturm.ShiftedInverse, "__init__", "count"),
    (eigen, "count_below", "count"),
    (sp.csr_array, "__matmul__", "products"),
    (Lower, "__matmul__", "products"),
    (Space, "orthogonalize_once", "orthogonal"),
    (lanczos, "orthonormal_pair", "orthogonal"),
    (Columns, "multiply", "vectors"),
    (Columns, "multiply_into", "vectors"),
    (sl, "eigh", "small"),
)
NAMES = tuple(dict.fromkeys(stage for *_, stage in _STAGES))
REST = "rest"


class Stages:
    """Seconds and processor seconds by stage; a stage inside another one counts for itself alone."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys((*NAMES, REST), 0.0)
        self.processor = dict.fromkeys((*NAMES, REST), 0.0)
        self._running: list[str] = []
        self._since = (0.0, 0.0)

    def _switch(self) -> None:
        now = time.perf_counter(), time.process_time()
        if self._running:
            self.seconds[self._running[-1]] += now[0] - self._since[0]
            self.processor[self._running[-1]] += now[1] - self._since[1]
        self._since = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """What runs inside counts as ``name``."""
        self._switch()
        self._running.append(name)
        try:
            yield
        finally:
            self._switch()
            self._running.pop()

    def _timed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        def timed(*given: Any, **options: Any) -> Any:
            if not self._running:
                return function(*given, **options)
            with self.stage(name):
                return function(*given, **options)

        return timed

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Time all that runs inside, by stages; the rest is ``rest``."""
        kept = [(owner, name, getattr(owner, name)) for owner, name, _ in _STAGES]
        try:
            for (owner, name, function), (_, _, stage) in zip(kept, _STAGES, strict=True):
                setattr(owner, name, self._timed(function, stage))
            with self.stage(REST):
                yield
        finally:
            for owner, name, function in kept:
                setattr(owner, name, function)
