"""MUMPS: multifrontal factor, in memory or on disk, with the inertia of symmetric matrices.

Amestoy, Duff, L'Excellent and Koster 2001. Of symmetric matrices half is stored and factorised; METIS orders
the graph of the nodes; the analysis serves all matrices of one pattern.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from morembs.base.arguments import check_options
from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.limits import one_of
from morembs.base.scratch import ScratchFolder, free_bytes
from morembs.base.types import Values
from morembs.linalg.sparse.mumps_codes import (
    SINGULAR,
    TOO_SMALL,
    WORDS,
    Control,
    Info,
    Job,
    Ordering,
    RealControl,
    RealInfo,
    Setting,
    Unit,
)
from morembs.linalg.sparse.mumps_instance import Instance
from morembs.linalg.sparse.mumps_library import Library, embedded_library, system_library
from morembs.linalg.sparse.ordering import metis_ordering
from morembs.linalg.sparse.session import FactorSize, Session, SessionSolver
from morembs.linalg.sparse.solver import MECHANISM, STRUCTURES, Forecast
from morembs.linalg.sparse.symmetric import Lower
from morembs.linalg.sparse.tolerances import TOL

log = logging.getLogger(__name__)
PRECISIONS = ("double", "single")


class MumpsSession(Session):
    """An instance of MUMPS. Versions before 5.6 lose the analysis with the factor: a new instance is then made."""

    title = "MUMPS"
    words = WORDS
    overwrites = True
    solver: MumpsSolver
    library: Library

    def __init__(self, solver: MumpsSolver, A: Lower, structure: str) -> None:
        super().__init__(solver, A, structure)
        # The entries of a right-hand side are counted in 32 bits in places.
        self.columns = max(1, np.iinfo(np.int32).max // self.n)
        self.arithmetic = np.dtype(_dtype(solver.precision, structure))
        self._order = metis_ordering(A)
        self._delayed = TOL.delayed_pivots_percent_spd if structure == "spd" else TOL.delayed_pivots_percent
        self._folder: ScratchFolder | None = None
        self._instance: Instance | None = None
        self._negative: int | None = None

    @property
    def instance(self) -> Instance:
        """What MUMPS holds."""
        if self._instance is None:
            raise SolverError("MUMPS holds nothing of this matrix any more; analyse it again")
        return self._instance

    def _begin(self, A: Lower) -> None:
        """Make an instance and analyse the pattern of ``A`` with it."""
        solver, order = self.solver, self._order
        self._instance = instance = Instance(self.library, self.structure, self.arithmetic)
        controls = {
            Control.DELAYED_PIVOTS_PERCENT: self._delayed,
            # Neither of these may depend on the values: one analysis serves many shifts.
            Control.PERMUTE_LARGE_TO_DIAGONAL: Setting.NO,
            Control.SYMMETRIC_ORDERING: Setting.USUAL_SYMMETRIC_ORDERING,
            # Processes that share the root of the tree (ScaLAPACK) would not count its negative pivots.
            Control.WHOLE_ROOT: Setting.YES,
            # Its own METIS where there is none here; a build without one takes the next best.
            Control.ORDERING: Ordering.METIS if order is None else Ordering.GIVEN,
        }
        if solver.low_rank:
            controls[Control.LOW_RANK] = Setting.LOW_RANK_FACTOR_AND_SOLUTION
            instance.set_real(RealControl.DROPPED_BY_LOW_RANK, solver.low_rank)
        if solver.discard:
            controls[Control.DISCARD_FACTOR] = Setting.YES
        for control, value in controls.items():
            instance.set(control, value)
        if order is not None:
            position = np.empty(A.n, dtype=np.int32)
            position[order] = np.arange(1, A.n + 1, dtype=np.int32)
            instance.give("perm_in", position)
        instance.give_pattern(A)
        if solver.out_of_core or self._folder is not None:
            self._use_disk()
        self._analyse_again()

    def _analyse_again(self) -> None:
        if self.run(self.instance.run, Job.ANALYSE) < 0:
            raise self._failure("the analysis")

    def _analyse(self, A: Lower) -> Forecast:
        """In memory where the budget has room: first usual, then tight for delayed pivots; else on disk."""
        self._begin(A)
        budget = self.solver.memory
        wanted = self._demand()
        if budget is not None and wanted.memory > budget and self._delayed > TOL.delayed_pivots_percent_spd:
            # Less room to begin with, more if it turns out to be needed.
            self._delayed = TOL.delayed_pivots_percent_spd
            self.instance.set(Control.DELAYED_PIVOTS_PERCENT, self._delayed)
            self._analyse_again()
            wanted = self._demand()
        if budget is not None and wanted.memory > budget:
            on_disk = self._demand_of(Info.MEMORY_ON_DISK)
            if self._folder is None and self.solver.out_of_core is None and on_disk.memory <= budget:
                self._use_disk()
                self._analyse_again()
                wanted = self._demand()
        if budget is not None and wanted.memory > budget:
            on_disk = self._demand_of(Info.MEMORY_ON_DISK)
            raise BudgetError(
                f"{budget / Unit.MILLION:.1f} MB are left of the memory budget for the factorisation; "
                f"{on_disk.memory / Unit.MILLION:.0f} MB are needed even with the factors on disk "
                f"({self._demand_of(Info.MEMORY).memory / Unit.MILLION:.0f} MB without); give more memory "
                "or take a coarser mesh",
                needed=on_disk.memory,
            )
        if wanted.disk and (free := free_bytes(self.solver.scratch)) < wanted.disk:
            raise SolverError(
                f"the scratch folder has {free / 1e9:.1f} GB left, the factor needs {wanted.disk / 1e9:.1f} GB; "
                "make room, give another scratch folder, or give more memory"
            )
        return wanted

    def _demand(self) -> Forecast:
        """The forecast for the place where the factor is to lie."""
        return self._demand_of(Info.MEMORY if self._folder is None else Info.MEMORY_ON_DISK)

    def _demand_of(self, memory: Info) -> Forecast:
        instance, size = self.instance, self.arithmetic.itemsize
        entries = instance.count(Info.ENTRIES_ESTIMATE)
        # Coordinates of what is given, and its values where they are copied; the rest is what MUMPS will allocate.
        symmetric = not self.structure.endswith("unsymmetric")
        copied = 0 if symmetric and self.arithmetic == np.float64 else size
        matrix = (8 + copied) * (self.lower_nnz if symmetric else self.nnz)
        disk = size * entries if memory == Info.MEMORY_ON_DISK else 0
        return self.forecast(
            entries=entries,
            flops=instance.real_info(RealInfo.FLOPS_ESTIMATE),
            memory=self._megabytes(memory) * Unit.MILLION + matrix,
            kept=0 if disk else size * entries,
            disk=disk,
            precision=self.solver.precision,
            ranks=self._ranks(),
        )

    def _megabytes(self, memory: Info) -> int:
        """Memory on this machine of which INFOG(memory) is the largest of one process."""
        return self.instance.info(memory)

    def _ranks(self) -> int:
        """How many processes on this machine hold the factor."""
        return 1

    def _on_disk(self) -> Forecast | None:
        return self._demand_of(Info.MEMORY_ON_DISK)

    def _use_disk(self) -> None:
        """Have the factors written to a private folder."""
        self._folder = self._folder or ScratchFolder(self.solver.scratch)
        path, room = str(self._folder.path).encode(), self.instance.longest_folder
        if len(path) > room:
            raise InputError(
                f"the scratch folder {self._folder.path} has a path of {len(path)} bytes; "
                f"MUMPS {self.library.version} takes up to {room}: give a shorter one",
                keyword="scratch",
            )
        self.instance.use_folder(path)

    def _factorize(self, A: Lower) -> FactorSize:
        """Numerical phase, with more workspace each time it was too small."""
        if self._instance is None:
            self._begin(A)
        instance = self.instance
        instance.give_pattern(A)
        instance.give_values(A)
        delayed = self._delayed
        for attempt in range(1, TOL.factorisation_attempts + 1):
            code = self.run(instance.run, Job.FACTORIZE)
            if code >= 0:
                break
            if code not in TOO_SMALL or attempt == TOL.factorisation_attempts:
                raise self._failure("the factorisation")
            delayed = max(2 * delayed, TOL.delayed_pivots_percent)
            log.info("%s: INFOG(1) = %d, again with %d %% more workspace", self.solver.name, code, delayed)
            instance.set(Control.DELAYED_PIVOTS_PERCENT, delayed)
        instance.take_matrix()
        negative = instance.info(Info.NEGATIVE_PIVOTS)
        if self.structure == "spd" and negative > 0:
            raise SingularMatrixError(
                f"the matrix should be positive definite but has {negative} negative pivots; {MECHANISM}"
            )
        self._negative = negative if self.structure in ("spd", "symmetric") else None
        entries = instance.count(Info.ENTRIES)
        size, on_disk = self.arithmetic.itemsize * entries, self._folder is not None
        flops = instance.real_info(RealInfo.FLOPS)
        return FactorSize(entries=entries, memory=0 if on_disk else size, disk=size if on_disk else 0, flops=flops)

    def _solve(self, B: Values) -> Values:
        X = B.astype(self.arithmetic, copy=False)
        # On disk each block reads every factor again, so all go at once.
        self.instance.set(Control.COLUMNS_AT_ONCE, TOL.block_columns if self._folder is None else B.shape[1])
        if self.run(self.instance.solve, X) < 0:
            raise self._failure("the solution")
        return X

    def _solve_transposed(self, B: Values) -> Values:
        self.instance.set(Control.NOT_TRANSPOSED, Setting.TRANSPOSED)
        try:
            return self._solve(B)
        finally:
            self.instance.set(Control.NOT_TRANSPOSED, Setting.YES)

    def _negative_pivots(self) -> int | None:
        return self._negative

    def _failure(self, phase: str) -> SolverError | SingularMatrixError:
        """The exception for a job that failed."""
        code, detail = self.instance.info(Info.CODE), self.instance.info(Info.DETAIL)
        if code in SINGULAR:
            return SingularMatrixError(f"the matrix is singular (MUMPS INFOG(1) = {code}); {MECHANISM}")
        return self.failure(phase, code, f"INFOG(1) = {code}, INFOG(2) = {detail}")

    def _forget(self) -> None:
        if self._instance is not None and self.library.keeps_analysis:
            self._instance.run(Job.FREE_FACTOR)
        else:
            self._free()

    def _free(self) -> None:
        instance, self._instance = self._instance, None
        if instance is not None:
            instance.end()

    def close(self) -> None:
        super().close()
        # At once, also where an interrupted job goes on.
        if self._folder is not None:
            self._folder.close()


@dataclass(frozen=True, kw_only=True)
class MumpsSolver(SessionSolver):
    """What the libraries share.

    ``precision`` "single" and ``low_rank`` (relative size of dropped terms of a low-rank block, 0 for none) make
    a rough factor: a preconditioner, which does not pass the check of ``factorize``.
    ``discard`` throws the factor away while it is computed: only the inertia is known then.
    """

    precision: Annotated[str, one_of(*PRECISIONS)] = "double"
    low_rank: float = 0.0
    out_of_core: bool | None = None
    discard: bool = False

    session: ClassVar[type[Session]] = MumpsSession
    library: ClassVar[Callable[[str], Library | str]]

    def __post_init__(self) -> None:
        check_options(self)

    @classmethod
    def unavailable(cls) -> str:
        return cls.lacks("double", "spd")

    @classmethod
    def lacks(cls, precision: str, structure: str) -> str:
        """Why there is no arithmetic of this ``precision`` for this ``structure``; empty: there is."""
        library = cls.library(_dtype(precision, structure))
        return library if isinstance(library, str) else ""

    def open_library(self, structure: str) -> Library:
        library = self._find_library(_dtype(self.precision, structure))
        if isinstance(library, str):
            raise InputError(
                f"solver = {self.name!r} cannot take {structure} matrices here: {library}", keyword="solver"
            )
        if self.low_rank and not library.low_rank:
            raise InputError(
                f"low_rank = {self.low_rank} was given, but this build of MUMPS crashes at random in low-rank mode; "
                "build one with METIS (make mumps)",
                kind="program",
                keyword="low_rank",
            )
        return library

    def _find_library(self, dtype: str) -> Library | str:
        """The library for factors of ``dtype``, or why there is none."""
        return type(self).library(dtype)

    def _inertia(self, A: Lower, what: str) -> int:
        if self.unavailable():
            return super()._inertia(A, what)
        # Backward stable by its choice of pivots, so the count holds for a matrix next to this one.
        with (
            self._counting_solver().analyse(A, "symmetric", what) as analysis,
            analysis.factorize_unchecked(A) as factor,
        ):
            return factor.negative_pivots()

    def _inertia_forecast(self, A: Lower) -> Forecast:
        with self._counting_solver().analyse(A, "symmetric") as analysis:
            return replace(analysis.forecast, kept=0)

    def _counting_solver(self) -> Self:
        """This solver with nothing kept but the signs of the pivots."""
        return replace(self, precision="double", low_rank=0.0, out_of_core=False, discard=True)


def _dtype(precision: str, structure: str) -> str:
    if structure.startswith("complex"):
        return "complex64" if precision == "single" else "complex128"
    return "float32" if precision == "single" else "float64"


@dataclass(frozen=True, kw_only=True)
class Mumps(MumpsSolver):
    """The sequential MUMPS of the system (Debian: libmumps-seq-dev), or one built with METIS."""

    name: ClassVar[str] = "mumps"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(system_library)


@dataclass(frozen=True, kw_only=True)
class EmbeddedMumps(MumpsSolver):
    """The MUMPS that comes with the CasADi package: real double precision."""

    name: ClassVar[str] = "mumps-embedded"
    structures: ClassVar[tuple[str, ...]] = STRUCTURES
    library: ClassVar[Callable[[str], Library | str]] = staticmethod(embedded_library)
