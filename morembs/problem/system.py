"""A(s) of a problem as an operator: what solving with it takes, here and in other processes."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.errors import SolverError
from morembs.base.memory import resident_bytes
from morembs.base.types import Floats, Values
from morembs.base.units import in_hz
from morembs.base.worker_pool import WorkerPool
from morembs.linalg.congruence import scaled_row_sums
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.space import Space
from morembs.linalg.sparse.solver import STRUCTURES
from morembs.problem.damping import Damping
from morembs.problem.tolerances import TOL

log = logging.getLogger(__name__)


class Solve(Protocol):
    """A(s)^-1 F (Nc, p), or A(s)'^-1 F, for loads ``F`` (Nc, p), dense or sparse."""

    def __call__(self, F: Values, *, transposed: bool = False) -> Values: ...


@dataclass(frozen=True, kw_only=True, eq=False)
class System:
    """A(s) = s^2 M + s (D + G) + K + N in coupled dofs, with proportional ``damping`` in addition.

    ``velocity_matrix`` (Nc, Nc) is D + G, ``rigid`` (Nc, r) the M-orthonormal rigid-body modes, and
    ``damps_rigid_motion`` says that D or G acts on these. ``stiffness`` holds the factors.
    """

    K: sp.csr_array
    M: sp.csr_array
    velocity_matrix: sp.csr_array | None
    N: sp.csr_array | None
    rigid: Floats
    damping: Damping
    damps_rigid_motion: bool
    stiffness: DynamicStiffness
    space: Space

    def apply(self, s: complex, X: Values, *, transposed: bool = False) -> Values:
        """A(s) X (Nc, k), or A(s)' X, without proportional damping."""
        square: complex = s * s
        s, square = (x.real if not complex(x).imag else x for x in (complex(s), complex(square)))
        out = self.K @ X + square * (self.M @ X)
        for factor, A in ((s, self.velocity_matrix), (1.0, self.N)):
            if A is not None:
                out = out + factor * ((A.T if transposed else A) @ X)
        return np.asarray(out)

    @cached_property
    def row_sums(self) -> Floats:
        """Row sums (Nc,) of abs(K), which stand for its products, so that no copy of K is made."""
        return scaled_row_sums(self.K)

    def roundoff(self, V: Floats) -> Floats:
        """What round-off in K makes of the energies of the columns of ``V`` (Nc, k) at most: eps abs(v)' abs(K) abs(v).

        Of modes of unit mass: how far it moves their eigenvalues, in (rad/s)2.
        """
        return np.asarray(np.finfo(float).eps * np.einsum("i,ij,ij->j", self.row_sums, V, V))

    @contextmanager
    def inverse(self, s: complex, *, damped: bool = True) -> Iterator[Solve]:
        """A(s)^-1 at ``s`` in 1/s, without rigid motion where that is a solution of its own; one factorisation.

        Proportional damping needs no matrix: A(s) = c K + g M = c (K + f M), see ``damping``. ``damped`` False leaves
        it out. Factor and solutions are real where K + f M is. Peak memory: 2 p columns and the factor.

        Raises:
            SingularMatrixError: ``s`` is an eigenvalue.
            SolverError: the backend failed, the budget is too small, or a solution has a backward error above
                ``TOL.backward_error``.
        """
        c, at = self._factor_out_damping(s, damped)
        self.space.budget.release_pages()
        with self.stiffness.factorize(at) as factor:

            def solve(F: Values, *, transposed: bool = False) -> Values:
                def block(F: Values) -> Values:
                    F = F if c == 1 else F / c
                    X = factor.solve(F, transposed=transposed)
                    self._refuse_inaccurate(at, F, X, transposed)
                    return X

                return self.elastic_part(self.space.map_columns(block, F, dtype=factor.dtype))

            yield solve

    def elastic_part(self, X: Values) -> Values:
        """Motions ``X`` (Nc, k), overwritten, without rigid motion, unless damping couples it to elastic motion."""
        if self.rigid.shape[1] and not self.damps_rigid_motion:
            X -= self.rigid @ (self.rigid.T @ (self.M @ X))
        return X

    @cached_property
    def _row_scale(self) -> Floats:
        """(Nc, 1) by which forces and moments count alike."""
        diagonal = self.K.diagonal()[:, None]
        return np.where(diagonal > 0, 1.0 / np.sqrt(np.maximum(diagonal, np.finfo(float).tiny)), 0.0)

    def _factor_out_damping(self, s: complex, damped: bool) -> tuple[Any, complex]:
        """c and sqrt(f) of A(s) = c (K + f M): what is solved at sqrt(f) instead, which is ``s`` for c = 1."""
        c, at = 1.0, s
        if damped and (self.damping.is_rayleigh or self.damping.structural):
            c, g = self.damping.proportional(s)
            at = np.sqrt(complex(g / c))
        return c, at if complex(at).imag else complex(at).real

    def _refuse_inaccurate(self, s: complex, F: Values, X: Values, transposed: bool) -> None:
        """Refuse a solution by its backward error in scaled rows."""
        d = self._row_scale
        small = np.linalg.norm(d * (self.apply(s, X, transposed=transposed) - F), axis=0)
        size = np.linalg.norm(d * F, axis=0) + np.linalg.norm(X / np.where(d > 0, d, np.inf), axis=0)
        error = float((small / np.where(size > 0, size, 1.0)).max(initial=0.0))
        if not error <= TOL.backward_error:
            raise SolverError(
                f"solved at {in_hz(abs(s)):.6g} Hz to a backward error of {error:.1e} only", keyword="accuracy"
            )

    def worker_pool(
        self, others: Any, points: Sequence[complex], *, workers: int, columns: int, damped: bool = True
    ) -> WorkerPool:
        """Processes for a factorisation of A(s) at each of ``points``, with ``columns`` solved for.

        They share (system, ``others``). As many run as have room within the budget, ``workers`` at most.
        """
        budget, workers = self.space.budget, max(1, min(workers, len(points)))
        share = None
        if budget.memory is not None and workers > 1:
            structures = [self.stiffness.structure_at(self._factor_out_damping(s, damped)[1]) for s in points]
            structure = max(structures, key=STRUCTURES.index)
            needed = worker_bytes(self.stiffness.room_for_factor(structure), len(self.rigid), columns, structure)
            budget.release_pages()
            left = max(0, budget.memory - resident_bytes())
            room = max(1, left // needed)
            if room < workers:
                log.warning(
                    "%d of %d workers run: each needs %.2f GB, and %.2f GB are left of the memory budget",
                    room,
                    workers,
                    needed / 1e9,
                    left / 1e9,
                )
            workers = min(workers, room)
            share = left // workers
        if workers == 1:
            return WorkerPool((self, others))
        own = Budget(share, budget.scratch, in_memory=budget.in_memory, widest=budget.widest)
        with own.in_use():
            there = replace(self, stiffness=self.stiffness.for_worker(), space=Space(self.M))
        return WorkerPool((there, others), workers, scratch=budget.scratch)


def worker_bytes(factor: int, size: int, columns: int, structure: str) -> int:
    """Memory of a process with a ``factor`` of so many bytes that solves for ``columns`` of length ``size``."""
    number = 16 if structure.startswith("complex") else 8
    return TOL.process_bytes + factor + TOL.load_blocks * number * size * columns
