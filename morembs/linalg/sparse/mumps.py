"""MUMPS: multifrontal factor, in memory or on disk, with the inertia of symmetric matrices.

Amestoy, Duff, L'Excellent and Koster 2001. Of symmetric matrices half is stored and factorised; METIS orders
the graph of the nodes; the analysis serves all matrices of one pattern.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.progress import SILENT, Progress
from morembs.base.scratch import ScratchFolder, free_bytes
from morembs.base.types import Values
from morembs.linalg.sparse.mumps_instance import ANALYSE, FACTORIZE, Instance
from morembs.linalg.sparse.mumps_library import Library, embedded_library, system_library
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.solver import (
    MECHANISM,
    STRUCTURES,
    Analysis,
    Factorization,
    FactorStats,
    Forecast,
    LinearSolver,
)
from morembs.linalg.sparse.symmetric import Lower

log = logging.getLogger(__name__)
PRECISIONS = ("double", "single")
_MEGABYTE = 1_000_000
# Room for pivots that are put off, in per cent; a positive definite matrix puts none off.
_RELAXATION, _RELAXATION_SPD = 20, 5
_ATTEMPTS = 4
# Workspace or buffers found too small in the numerical phase: more of them cures it.
_TOO_SMALL = {-8, -9, -14, -15, -17, -18, -20}
# Columns solved at once in memory; on disk each block reads every factor again, so all go at once.
_BLOCK = 64


@dataclass(frozen=True, kw_only=True)
class _MumpsSolver(LinearSolver):
    """What the libraries share.

    ``precision`` "single" and ``low_rank`` (relative size of what a low-rank block drops, 0 for none) make
    a rough factor: a preconditioner, which does not pass the check of ``factorize``.
    ``discard`` throws the factor away while it is computed: only the inertia is known then.
    """

    precision: str = "double"
    low_rank: float = 0.0
    out_of_core: bool | None = None
    discard: bool = False
    progress: Progress = field(default=SILENT, compare=False, repr=False)

    library: ClassVar[Callable[[str], Library | str]]

    def opened(self, dtype: str) -> Library | str:
        """The library for factors of ``dtype``, or why there is none."""
        return type(self).library(dtype)

    def megabytes(self, instance: Instance, number: int) -> int:
        """Memory on this machine of which INFOG(number) is the largest of one process."""
        return instance.info(number)

    def local(self, instance: Instance) -> int:
        """How many processes on this machine hold the factor of ``instance``."""
        return 1

    def __post_init__(self) -> None:
        if self.precision not in PRECISIONS:
            raise InputError(f"precision = {self.precision!r} was given; expected one of {', '.join(PRECISIONS)}")

    @classmethod
    def unavailable(cls) -> str:
        library = cls.library("float64")
        return library if isinstance(library, str) else ""

    def _inertia(self, A: Lower, what: str) -> int:
        if isinstance(type(self).library("float64"), str):
            return super()._inertia(A, what)
        # Backward stable by its choice of pivots, so the count holds for a matrix next to this one.
        with self._counting().analyse(A, "symmetric", what) as analysis, analysis.factorize_unchecked(A) as factor:
            return factor.negative_pivots()

    def _inertia_forecast(self, A: Lower) -> Forecast:
        with self._counting().analyse(A, "symmetric") as analysis:
            return replace(analysis.forecast, kept=0)

    def _counting(self) -> Self:
        """This solver with nothing kept but the signs of the pivots."""
        return replace(self, precision="double", low_rank=0.0, out_of_core=False, discard=True)

    @classmethod
    def lacks(cls, precision: str, structure: str) -> str:
        """Why there is no arithmetic of this ``precision`` for this ``structure``; empty: there is."""
        library = cls.library(_dtype(precision, structure))
        return library if isinstance(library, str) else ""

    def _analyse(self, A: Lower, structure: str) -> Analysis:
        library = self.opened(_dtype(self.precision, structure))
        if isinstance(library, str):
            raise InputError(f"solver = {self.name!r} cannot take {structure} matrices here: {library}")
        if self.low_rank and not library.low_rank:
            raise InputError(
                f"low_rank = {self.low_rank} was given, but this build of MUMPS crashes at random in low-rank mode; "
                "build one with METIS (make mumps)"
            )
        return MumpsAnalysis(self, library, A, structure)


def _dtype(precision: str, structure: str) -> str:
    if structure.startswith("complex"):
        return "complex64" if precision == "single" else "complex128"
    return "float32" if precision == "single" else "float64"


class MumpsAnalysis(Analysis):
    """An instance of MUMPS after JOB = 1."""

    def __init__(self, solver: _MumpsSolver, library: Library, A: Lower, structure: str) -> None:
        super().__init__(A, structure)
        self.solver, self.backend = solver, solver.name
        self._folder: ScratchFolder | None = None
        self._order = metis_ordering(A)
        self.relaxation = _RELAXATION_SPD if structure == "spd" else _RELAXATION
        try:
            self._set_up(library, A)
            self._forecast = self._within_budget()
        except BaseException:
            self.close()
            raise

    def _set_up(self, library: Library, A: Lower) -> None:
        solver, order = self.solver, self._order
        self.instance = instance = Instance(library, self.structure, _dtype(solver.precision, self.structure))
        instance.control(14, self.relaxation)
        # Neither of these may depend on the values: one analysis serves many shifts.
        instance.control(6, 0)
        instance.control(12, 1)
        # Processes that share the root of the tree (ScaLAPACK) would not count its negative pivots.
        instance.control(13, 1)
        if order is None:
            # Its own METIS; a build without one takes the next best.
            instance.control(7, 5)
        else:
            position = np.empty(A.n, dtype=np.int32)
            position[order] = np.arange(1, A.n + 1, dtype=np.int32)
            instance.give("perm_in", position)
            instance.control(7, 1)
        if solver.low_rank:
            instance.control(35, 2)
            instance.real_control(7, solver.low_rank)
        if solver.discard:
            instance.control(31, 1)
        instance.set_pattern(A)
        if solver.out_of_core or self._folder is not None:
            self._use_disk()

    def _within_budget(self) -> Forecast:
        """Analyse, on disk where the budget asks for it."""
        self._analyse()
        budget = self.solver.memory
        wanted = self._demand(16 if self._folder is None else 26)
        if budget is None or wanted.memory <= budget:
            return self._have_room(wanted)
        if self.relaxation > _RELAXATION_SPD:
            # Tight: less room to begin with, more if it turns out to be needed.
            self.relaxation = _RELAXATION_SPD
            self.instance.control(14, self.relaxation)
            self._analyse()
            wanted = self._demand(16 if self._folder is None else 26)
            if wanted.memory <= budget:
                return self._have_room(wanted)
        if self._folder is None and self.solver.out_of_core is None and self._demand(26).memory <= budget:
            self._use_disk()
            self._analyse()
            wanted = self._demand(26)
        if wanted.memory > budget:
            on_disk = self._demand(26)
            raise BudgetError(
                f"{budget / _MEGABYTE:.1f} MB are left of the memory budget for the factorisation; "
                f"{on_disk.memory / _MEGABYTE:.0f} MB are needed even with the factors on disk "
                f"({self._demand(16).memory / _MEGABYTE:.0f} MB without); give more memory or take a coarser mesh",
                needed=on_disk.memory,
            )
        return self._have_room(wanted)

    def _analyse(self) -> None:
        if self.instance.run(ANALYSE, self.solver.progress, "ordering") < 0:
            raise self.instance.error("analysis")

    def _demand(self, number: int) -> Forecast:
        """Forecast in core (INFOG(16)) or out of core (INFOG(26))."""
        instance = self.instance
        entries = instance.count(3)
        size = instance.dtype.itemsize
        # Coordinates of what is given, and its values where they are copied; the rest is what MUMPS will allocate.
        symmetric = not self.structure.endswith("unsymmetric")
        held = 0 if symmetric and instance.dtype == np.float64 else size
        matrix = (8 + held) * (self.lower_nnz if symmetric else self.nnz)
        disk = size * entries if number == 26 else 0
        needed = self.solver.megabytes(instance, number) * _MEGABYTE + matrix
        return Forecast(
            backend=self.backend,
            size=self.n,
            factor_entries=entries,
            flops=instance.real_info(1),
            memory=needed,
            kept=0 if disk else size * entries,
            disk=disk,
            precision=self.solver.precision,
            ranks=self.solver.local(instance),
        )

    def _have_room(self, wanted: Forecast) -> Forecast:
        if wanted.disk:
            free = free_bytes(self.solver.scratch)
            if free < wanted.disk:
                raise SolverError(
                    f"the scratch folder has {free / 1e9:.1f} GB left, the factor needs {wanted.disk / 1e9:.1f} GB; "
                    "make room, give another scratch folder, or give more memory"
                )
        return wanted

    def _use_disk(self) -> None:
        """Have the factors written to a private folder."""
        self._folder = self._folder or ScratchFolder(self.solver.scratch)
        path, room = str(self._folder.path).encode(), self.instance.longest_folder
        if len(path) > room:
            raise InputError(
                f"the scratch folder {self._folder.path} has a path of {len(path)} bytes; "
                f"MUMPS {self.instance.library.version} takes up to {room}: give a shorter one"
            )
        self.instance.set_disk(path)

    @property
    def forecast(self) -> Forecast:
        return self._forecast

    @property
    def on_disk(self) -> Forecast:
        """The forecast with the factor on disk."""
        return self._demand(26)

    def factorize_unchecked(self, A: Lower) -> Factorization:
        start = time.perf_counter()
        self._eliminate(A)
        instance = self.instance
        entries, on_disk = instance.count(29), self._folder is not None
        held = instance.dtype.itemsize * entries
        stats = self._stats(
            start,
            entries,
            memory_bytes=0 if on_disk else held,
            disk_bytes=held if on_disk else 0,
            out_of_core=on_disk,
            flops=instance.real_info(3),
        )
        return _MumpsFactor(self, stats)

    def _eliminate(self, A: Lower) -> None:
        """Numerical phase, with more workspace each time it was too small."""
        if self.instance.ended:
            # The factor before was closed, and this version of MUMPS let go of the analysis with it.
            self._set_up(self.instance.library, A)
            self._analyse()
        instance = self.instance
        instance.set_pattern(A)
        instance.set_values(A)
        relaxation = self.relaxation
        for attempt in range(_ATTEMPTS):
            news = f"factorising ({self._forecast.flops:.2g} operations)"
            code = instance.run(FACTORIZE, self.solver.progress, news)
            if code >= 0:
                break
            if code not in _TOO_SMALL or attempt == _ATTEMPTS - 1:
                raise instance.error("factorisation")
            relaxation = max(2 * relaxation, _RELAXATION)
            log.info("%s: INFOG(1) = %d, again with %d %% more workspace", self.backend, code, relaxation)
            instance.control(14, relaxation)
        instance.drop_matrix()
        if self.structure == "spd" and instance.info(12) > 0:
            raise SingularMatrixError(
                f"the matrix should be positive definite but has {instance.info(12)} negative pivots; {MECHANISM}"
            )

    def _release(self) -> None:
        # Not there where MUMPS could not be started.
        if hasattr(self, "instance"):
            self.instance.close()
        if self._folder is not None:
            self._folder.close()


class _MumpsFactor(Factorization):
    """The factor that an analysis holds."""

    def __init__(self, analysis: MumpsAnalysis, stats: FactorStats) -> None:
        super().__init__(stats, np.complex128 if analysis.structure.startswith("complex") else np.float64)
        self._instance = analysis.instance
        counts = analysis.structure in ("spd", "symmetric")
        self._negative = self._instance.info(12) if counts else None

    def _solve(self, B: Values) -> Values:
        instance = self._instance
        X = B if B.dtype == instance.dtype else B.astype(instance.dtype)
        # The entries of a right-hand side are counted in 32 bits in places.
        step = max(1, (2**31 - 1) // self.n)
        for first in range(0, X.shape[1], step):
            part = X[:, first : first + step]
            instance.control(27, part.shape[1] if self._stats.out_of_core else _BLOCK)
            instance.solve_dense(part)
        return X.astype(self.dtype, copy=False)

    def _solve_transposed(self, B: Values) -> Values:
        self._instance.control(9, 2)
        try:
            return self._solve(B)
        finally:
            self._instance.control(9, 1)

    def _negative_pivots(self) -> int | None:
        return self._negative

    def _release(self) -> None:
        self._instance.forget()

    def _give_way(self) -> None:
        """The next factorisation overwrites the factor."""


@dataclass(frozen=True, kw_only=True)
class Mumps(_MumpsSolver):
    """The sequential MUMPS of the system (Debian: libmumps-seq-dev), or one built with METIS."""

    name: ClassVar[str] = "mumps"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(system_library)


@dataclass(frozen=True, kw_only=True)
class EmbeddedMumps(_MumpsSolver):
    """The MUMPS that comes with the CasADi package: real double precision."""

    name: ClassVar[str] = "mumps-embedded"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(embedded_library)
