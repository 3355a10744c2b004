"""Interface reduction: characteristic constraint modes instead of one constraint mode for each interface dof.

They are the eigenvectors of the Craig-Bampton constraint part (Castanier, Tan and Pierre 2001): (K, M) on the span of
the constraint modes Psi. Rigid-body motion lies in that span and is always kept. With the elastic flexibility G_e of
the free body and that of the body held at its interfaces, G_i,

    Psi (Psi'K Psi)^+ Psi' = P (G_e - G_i) P',   P = I - Z Z'M for the rigid modes Z,

since a static solution is the constraint modes under its own interface displacements plus what the loads do to the held
body. So block Lanczos finds the modes from two sparse solves for each vector, and Psi (N, m) is never formed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.closing import Closing
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.base.units import eigenvalue_in_hz
from morembs.linalg.dense import symmetric
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.eigen import Modes, lowest_modes
from morembs.linalg.lanczos import BlockLanczos, largest
from morembs.linalg.statics import ConstrainedStatics, Statics
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Problem
from morembs.reducers.tolerances import TOL


@dataclass(frozen=True, kw_only=True, eq=False)
class InterfaceModes:
    """Elastic characteristic modes: ``eigenvalues`` (k,) in (rad/s)2 ascending, ``vectors`` (Nc, k) M-orthonormal and
    free of rigid-body motion; ``next_hz`` the frequency of the first that was left out, None where that is unknown or
    none was."""

    eigenvalues: Floats
    vectors: Floats
    next_hz: float | None


class FixedInterfaceBody(Closing):
    """The body held at its interfaces. Interface motions that are single dofs are rows left out of the matrices.

    A context manager, as it may own a factor. Peak memory: K and M without those rows, and the factor.

    Args:
        by_rows: leave them out (True) or solve for each (False); by default what their number is for.
    """

    def __init__(self, problem: Problem, *, by_rows: bool | None = None) -> None:
        self.problem = problem
        self.statics: Statics | None = None
        rows, mixed = _single(problem.B)
        if not (len(rows) > TOL.solved_rows if by_rows is None else by_rows) or not _holds(problem, rows):
            self.rows, self.constrained, self.M = None, problem.fixed_interface, problem.M
            return
        kept = np.setdiff1d(np.arange(problem.K.shape[0]), rows)
        self.rows = kept
        self.M = sp.csr_array(problem.M[kept][:, kept])
        with problem.budget.in_use():
            inner = DynamicStiffness(sp.csr_array(problem.K[kept][:, kept]), self.M, solver=problem.solver)
        self.statics = Statics(inner, np.zeros((len(kept), 0)))
        C = sp.csc_array(sp.csr_array(problem.B[:, mixed])[kept])
        self.constrained = ConstrainedStatics(self.statics, C, "the interfaces")

    def flexibility(self, F: Floats) -> Floats:
        """Displacements (Nc, k) under the loads ``F`` (Nc, k) with the interfaces at rest."""
        if self.rows is None:
            return self.constrained.flexibility(F)
        return self._with_interface_rows(self.constrained.flexibility(F[self.rows]))

    def modes(self, count: int | None, below: float | None) -> Modes:
        """Fixed-interface modes, proven complete by a Sturm count; (Nc, k) vectors."""
        if self.rows is None:
            return self.problem.fixed_modes(count=count, below=below)
        modes = lowest_modes(self.constrained, self.M, count=count, below=below, what="fixed-interface modes")
        if count is None and below is not None:
            count = int((modes.eigenvalues <= below * (1 + LINALG.eigenvalue_gap)).sum())
        modes = modes.first(len(modes.eigenvalues) if count is None else count)
        return replace(modes, vectors=self._with_interface_rows(modes.vectors))

    def close(self) -> None:
        """Release the factor, where there is one of its own."""
        if self.statics is not None:
            self.statics.close()
            self.statics.pencil.close()

    def _with_interface_rows(self, inner: Floats) -> Floats:
        columns = self.problem.budget.empty((self.problem.K.shape[0], inner.shape[1]), order="F")
        columns[self.rows] = inner
        return np.asarray(columns)


def interface_modes(
    problem: Problem,
    fixed_body: FixedInterfaceBody,
    *,
    count: int | None = None,
    below: float | None = None,
    from_all: bool | None = None,
) -> InterfaceModes:
    """The lowest ``count`` elastic characteristic modes, or all up to ``below`` in (rad/s)2.

    Args:
        from_all: from all constraint modes (True) or by block Lanczos (False); by default what their number is for.

    Peak memory: some three times as many columns of length Nc as modes, where the budget wants them; with up to
    ``TOL.dense_interface`` interface dofs, or where a large part of the modes is wanted, all constraint modes (Nc, m).

    Raises:
        InputError: more modes than there are.
    """
    limit = problem.B.shape[1] - problem.rigid.shape[1]
    if count is not None and count > limit:
        raise InputError(
            f"interface_modes = {count} was given, but {problem.B.shape[1]} interface dofs have {limit} elastic "
            "characteristic modes; ask for fewer",
            keyword="interface_modes",
        )
    if from_all is None:
        from_all = problem.B.shape[1] <= TOL.dense_interface or (count is not None and TOL.dense_part * count > limit)
    if from_all:
        return _all(problem, count, below)
    return _lowest(problem, fixed_body, limit, count, below)


def static_error(problem: Problem, fixed_body: FixedInterfaceBody, modes: InterfaceModes) -> float:
    """Largest part of the compliance of all constraint modes that ``modes`` miss, over six resultant loads on each
    interface in mean axes.

    Nodes of a direct interface share the load evenly.
    """
    F = np.hstack(
        [
            np.asarray(B @ (B.T @ (problem.coupling.R * np.array([1.0] * 3 + [1 / problem.length] * 3))))
            for B in (problem.B[:, columns] for columns in problem.coupling.columns.values())
        ]
    )
    energy = np.einsum("ij,ij->j", F, _flexibility(problem, fixed_body)(F))
    kept = problem.space.dot(modes.vectors, F)
    kept_energy = np.einsum("ij,ij->j", kept, kept / modes.eigenvalues[:, None]) if len(kept) else np.zeros(len(energy))
    # A load that inertia alone balances, or that is zero, has no compliance to speak of.
    real = energy > 1e-10 * energy.max(initial=0.0)
    return float(np.clip(1.0 - kept_energy[real] / energy[real], 0.0, 1.0).max(initial=0.0))


def _all(problem: Problem, count: int | None, below: float | None) -> InterfaceModes:
    Psi, K = problem.fixed_interface.solve_constraint_modes()
    M = np.zeros_like(K)
    width = problem.budget.columns(len(Psi))
    for at in range(0, Psi.shape[1], width):
        M[:, at : at + width] = problem.space.dot(Psi, problem.M @ Psi[:, at : at + width])
    r = problem.rigid.shape[1]
    # Rigid-body motion is known and goes out before the eigenvalues are computed, which it would blur.
    scale = 1.0 / np.sqrt(np.diag(M))
    H = (problem.B.T @ problem.rigid) / scale[:, None]
    Ms, Ks = (symmetric(A) * np.outer(scale, scale) for A in (M, K))
    Q = sl.qr(Ms @ H)[0][:, r:]
    values, Y = sl.eigh(Q.T @ Ks @ Q, Q.T @ Ms @ Q)
    kept = len(values) if count is None else count
    if below is not None:
        kept = int((values <= below * (1 + LINALG.eigenvalue_gap)).sum())
    out = problem.budget.empty((len(Psi), kept), order="F")
    V = problem.space.multiply_into(Psi, scale[:, None] * (Q @ Y[:, :kept]), out)
    problem.space.orthogonalize_in_place(problem.rigid, V)
    return InterfaceModes(
        eigenvalues=values[:kept],
        vectors=problem.space.fix_signs(V),
        next_hz=float(eigenvalue_in_hz(values[kept])) if kept < len(values) else None,
    )


def _lowest(
    problem: Problem, fixed_body: FixedInterfaceBody, limit: int, count: int | None, below: float | None
) -> InterfaceModes:
    flexibility = _flexibility(problem, fixed_body)
    rng = np.random.default_rng(3)
    start = flexibility(problem.M @ rng.standard_normal((problem.K.shape[0], TOL.block_columns)))
    wanted = 4 * TOL.block_columns if count is None else count + 1
    lanczos = BlockLanczos(flexibility, problem.space, start, capacity=_capacity(wanted, limit))
    while True:
        theta, V = largest(lanczos, wanted, what="characteristic modes")
        values = 1.0 / theta
        if below is None or values[-1] > below * (1 + LINALG.eigenvalue_gap):
            break
        wanted *= 2
        if TOL.dense_part * wanted > limit:
            return _all(problem, count, below)
        lanczos.enlarge(_capacity(wanted, limit))
    kept = wanted if count is None else count
    if count is None and below is not None:
        kept = int((values <= below * (1 + LINALG.eigenvalue_gap)).sum())
    V = V[:, :kept]
    problem.space.orthogonalize_in_place(problem.rigid, V)
    return InterfaceModes(
        eigenvalues=values[:kept], vectors=problem.space.fix_signs(V), next_hz=float(eigenvalue_in_hz(values[kept]))
    )


def _capacity(wanted: int, limit: int) -> int:
    return min(2 * wanted + 8 * TOL.block_columns, limit)


def _flexibility(problem: Problem, fixed_body: FixedInterfaceBody) -> Callable[[Floats], Floats]:
    """P (G_e - G_i) P' of loads (Nc, k)."""
    Z, M = problem.rigid, problem.M
    MZ = M @ Z

    def apply(F: Floats) -> Floats:
        F = F - MZ @ (Z.T @ F)
        U = problem.free_free.flexibility(F) - fixed_body.flexibility(F)
        return np.asarray(U - Z @ (MZ.T @ U))

    return apply


def _single(B: sp.csc_array) -> tuple[Ints, Ints]:
    """Rows of the columns of ``B`` that have one entry, and the other columns."""
    B = sp.csc_array(B)
    single = np.diff(B.indptr) == 1
    return np.unique(B.indices[B.indptr[:-1][single]]).astype(np.int64), np.flatnonzero(~single)


def _holds(problem: Problem, rows: Ints) -> bool:
    """True if holding ``rows`` holds the body."""
    Z = problem.rigid
    size = np.linalg.norm(Z, axis=0) / np.sqrt(len(Z))
    s = np.linalg.svd(Z[rows] / size, compute_uv=False)
    return bool(len(s) == Z.shape[1] and (not len(s) or s[-1] * TOL.loose_condition > s[0]))
