"""MUMPS on several processes of MPI: its factor is spread over their memory, which may be that of several machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from morembs.base.errors import InputError
from morembs.linalg.sparse.mumps import _MumpsSolver
from morembs.linalg.sparse.mumps_instance import Instance
from morembs.linalg.sparse.mumps_library import ARITHMETIC, Library, parse_header, rank_files
from morembs.linalg.sparse.ranks import RanksLibrary, why_not


def _library(dtype: str) -> Library | str:
    """What the calls of two ranks go through, or why there are none."""
    reason = why_not()
    return reason or _described(dtype, RankedMumps())


@dataclass(frozen=True, kw_only=True)
class RankedMumps(_MumpsSolver):
    """The parallel MUMPS of the system (Debian: libmumps-dev, openmpi-bin) on ``ranks`` processes under mpirun.

    On one machine threads are faster and take less memory in all; on several, mpirun starts the processes where its
    own settings or the queue say, and this process has to run where rank 0 does.
    """

    name: ClassVar[str] = "mumps-ranks"
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(_library)
    ranks: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ranks < 1:
            raise InputError(f"ranks = {self.ranks} was given; expected 1 or more")

    def opened(self, dtype: str) -> Library | str:
        return why_not() or _described(dtype, self)

    def megabytes(self, instance: Instance, number: int) -> int:
        # The next one is the sum over all ranks, of which some may be elsewhere.
        return min(instance.info(number + 1), self.local(instance) * instance.info(number))

    def local(self, instance: Instance) -> int:
        library = instance.library
        return library.local if isinstance(library, RanksLibrary) else self.ranks


def _described(dtype: str, solver: RankedMumps) -> Library | str:
    files = rank_files(dtype)
    if isinstance(files, str):
        return files
    path, header = files
    version, layout = parse_header(header.read_text(encoding="latin-1"), ARITHMETIC[dtype])
    return RanksLibrary(path, version, layout, _elsewhere, count=solver.ranks, scratch=solver.scratch, dtype=dtype)


def _elsewhere(_: object) -> None:
    raise NotImplementedError("MUMPS runs in the ranks only")
