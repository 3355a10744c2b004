"""MUMPS on several processes of MPI: its factor is spread over their memory, which may be that of several machines."""

from __future__ import annotations

import ctypes
import itertools
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from morembs.base.errors import OutputError, SolverError
from morembs.base.limits import PositiveCount
from morembs.linalg.sparse.mumps import MumpsSession, MumpsSolver
from morembs.linalg.sparse.mumps_codes import ARITHMETIC, Info, Job
from morembs.linalg.sparse.mumps_library import Library, parse_header, rank_files
from morembs.linalg.sparse.rank import ARRAYS, COUNTS, TOLD
from morembs.linalg.sparse.ranks import Ranks, why_not
from morembs.linalg.sparse.session import Session

_RUNNING: dict[tuple[int, Path | None, int], Ranks] = {}
_NUMBERS = itertools.count(1)
_LOCK = threading.RLock()


@dataclass(frozen=True)
class RanksLibrary(Library):
    """MUMPS on ``count`` ranks. Its structures stay here; their contents go there with each call, and come back."""

    count: int = 2
    scratch: Path | None = None
    numbers: dict[int, tuple[Ranks, int]] = field(default_factory=dict, compare=False)
    dtype: str = "float64"

    @property
    def _key(self) -> tuple[int, Path | None, int]:
        return self.count, self.scratch, os.getpid()

    @property
    def local(self) -> int:
        """How many of the ranks run on this machine."""
        return max((ranks.local for ranks, _ in self.numbers.values()), default=self.count)

    def call(self, data: Any, job: int) -> None:
        """Run one job on all ranks."""
        at = ctypes.addressof(data)
        if job == Job.NEW:
            with _LOCK:
                self.numbers[at] = self._begin_instance()
        ranks, number = self.numbers[at]
        if job == Job.END:
            self._end_instance(at, ranks, number)
            return
        if not ranks.alive:
            # Their folder is gone with them.
            raise ranks.died()
        command, rhs = self._command(ranks, number, data, job)
        answer = ranks.call(command)
        for name in TOLD:
            getattr(data, name)[:] = answer[name]
        if rhs is not None and answer["infog"][0] >= 0:
            rhs[:] = np.fromfile(ranks.folder / command["arrays"]["rhs"], dtype=rhs.dtype)

    def _begin_instance(self) -> tuple[Ranks, int]:
        ranks = _RUNNING.get(self._key)
        if ranks is None or not ranks.alive:
            ranks = _RUNNING[self._key] = Ranks(self.count, self.scratch)
        return ranks, next(_NUMBERS)

    def _end_instance(self, at: int, ranks: Ranks, number: int) -> None:
        """Free an instance; nothing where its ranks have ended."""
        del self.numbers[at]
        if ranks.alive:
            with suppress(SolverError):
                ranks.call(self._plain(number, Job.END))
            for file in ranks.folder.glob(f"{number}-*"):
                file.unlink(missing_ok=True)

    def _plain(self, number: int, job: int) -> dict[str, Any]:
        return {"instance": number, "job": job, "dtype": self.dtype}

    def _command(self, ranks: Ranks, number: int, data: Any, job: int) -> tuple[dict[str, Any], Any]:
        """The command for a job, its arrays in files; and the right-hand sides that the solution overwrites."""
        command = {**self._plain(number, job), "sym": int(data.sym)}
        if job == Job.NEW:
            return command, None
        arrays, rhs = {}, None
        for name, kind in ARRAYS.items():
            address, file = getattr(data, name), f"{number}-{name}-{time.monotonic_ns()}"
            if not address:
                continue
            size = {"perm_in": data.n, "rhs": data.nrhs * data.lrhs}.get(name, data.nnz)
            array = _at(address, size, np.dtype(kind or self.dtype))
            for old in ranks.folder.glob(f"{number}-{name}-*"):
                old.unlink()
            try:
                array.tofile(ranks.folder / file)
            except OSError as error:
                raise OutputError(
                    f"the scratch folder {ranks.folder.parent} has no room for {array.nbytes / 1e9:.2f} GB more "
                    f"({error.strerror}); make room, or give another scratch folder"
                ) from error
            arrays[name] = file
            rhs = array if name == "rhs" else rhs
        return {
            **command,
            "icntl": list(data.icntl),
            "cntl": list(data.cntl),
            "arrays": arrays,
            "ooc_tmpdir": data.ooc_tmpdir.decode(),
            "ooc_prefix": data.ooc_prefix.decode(),
            "counts": {name: int(getattr(data, name)) for name in COUNTS},
        }, rhs


def _at(address: int, size: int, dtype: np.dtype[Any]) -> Any:
    """The array (size,) at an address."""
    memory: Any = (ctypes.c_char * (size * dtype.itemsize)).from_address(address)
    return np.frombuffer(memory, dtype=dtype)


def _library(dtype: str) -> Library | str:
    """What the calls of two ranks go through, or why there are none."""
    return RankedMumps()._find_library(dtype)


class _RankedSession(MumpsSession):
    """An instance of MUMPS that is spread over ranks."""

    solver: RankedMumps
    library: RanksLibrary

    def _megabytes(self, memory: Info) -> int:
        # The next one is the sum over all ranks, of which some may be elsewhere.
        return min(self.instance.info(memory + 1), self._ranks() * self.instance.info(memory))

    def _ranks(self) -> int:
        return self.library.local


@dataclass(frozen=True, kw_only=True)
class RankedMumps(MumpsSolver):
    """The parallel MUMPS of the system (Debian: libmumps-dev, openmpi-bin) on ``ranks`` processes under mpirun.

    On one machine threads are faster and take less memory in all; on several, mpirun starts the processes where its
    own settings or the queue say, and this process has to run where rank 0 does.
    """

    name: ClassVar[str] = "mumps-ranks"
    session: ClassVar[type[Session]] = _RankedSession
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(_library)
    ranks: PositiveCount = 2

    def _find_library(self, dtype: str) -> Library | str:
        if reason := why_not():
            return reason
        files = rank_files(dtype)
        if isinstance(files, str):
            return files
        path, header = files
        version, layout = parse_header(header.read_text(encoding="latin-1"), ARITHMETIC[dtype])
        return RanksLibrary(path, version, layout, _elsewhere, count=self.ranks, scratch=self.scratch, dtype=dtype)


def _elsewhere(_: object) -> None:
    raise NotImplementedError("MUMPS runs in the ranks only")
