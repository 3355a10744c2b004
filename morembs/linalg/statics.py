"""Static solves with a stiffness matrix that has rigid-body modes, which is never factorised as it is.

As many dofs as there are rigid modes are held by springs (statically determinate, so the springs carry
nothing under loads in equilibrium); K_c = K + springs is positive definite and has the pattern of K. With
rigid modes Z and constraints C' u = g, u = K_c^-1 (f - C lam) + Z a follows from

    [ C'K_c^-1 C  -C'Z ] [lam]   [ C'K_c^-1 f - g ]
    [ -Z'C          0  ] [ a ] = [ -Z'f           ]

so one factorisation serves the free body (C = M Z: mean axes, inertia relief) and the body held at any
interface (C = B), for any kind of coupling.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.closing import Closing
from morembs.base.errors import InputError, SolverError
from morembs.base.types import Floats, Ints
from morembs.linalg.columns import dense, m_norms
from morembs.linalg.dense import symmetric
from morembs.linalg.dynamic_stiffness import DynamicStiffness, spring_stiffness
from morembs.linalg.space import Columns
from morembs.linalg.tolerances import TOL


def support_dofs(Z: Floats) -> Ints:
    """Rows (r,) of ``Z`` (N, r) that hold its motions: pivoted QR picks far and independent ones."""
    if not Z.shape[1]:
        return np.empty(0, dtype=np.int64)
    _, pivots = sl.qr(Z.T, mode="r", pivoting=True)
    return np.sort(pivots[: Z.shape[1]]).astype(np.int64)


class Statics(Closing):
    """K_c^-1 of the stiffness of ``pencil`` (N, N), positive semidefinite with null space ``Z`` (N, r).

    ``System.inverse`` of a problem does not serve here: K is singular, and what makes it regular is supports, which
    belong to statics alone.
    ``held_motions`` (N, h) are rigid motions that the stiffness holds, perhaps softly.

    Raises:
        SingularMatrixError: K has more zero-energy motions than Z.
        SolverError: no method fits into the memory budget.
    """

    def __init__(self, pencil: DynamicStiffness, Z: Floats, held_motions: Floats | None = None) -> None:
        self.pencil, self.Z, self.held_motions = pencil, Z, Z[:, :0] if held_motions is None else held_motions
        self.supports = support_dofs(Z)
        supported = pencil.with_springs(self.supports) if Z.shape[1] else pencil.lower
        solver = pencil.solver.with_near_null_space(Z).with_memory(pencil.budget.room_for_factor())
        self.factor = solver.factorize(supported, "spd", what="the supported stiffness matrix")

    @property
    def budget(self) -> Budget:
        """The memory budget of the process."""
        return self.pencil.budget

    @property
    def space(self) -> Columns:
        """Columns under that budget."""
        return Columns(budget=self.budget)

    def columns(self, copies: int = 4, widest: int | None = None) -> int:
        """Columns to solve for at once where ``copies`` of them exist: each block reads a factor on disk as a whole."""
        return self.budget.columns(len(self.Z), copies, widest, wide=self.factor.stats.out_of_core)

    def block_columns(self, widest: int) -> int:
        """Columns of a Krylov block with the factor on disk, which is read as a whole for each: wide ones."""
        return int(np.clip(self.columns(TOL.block_copies, TOL.widest_block), TOL.least_wide_block, widest))

    def apply(self, F: Floats) -> Floats:
        """K_c^-1 F (N, k): displacements with the supports on springs."""
        return np.asarray(self.factor.solve(F))

    def multiply_supported(self, U: Floats) -> Floats:
        """K_c U (N, k): forces with the supports on springs."""
        lower = self.pencil.lower
        F = np.asarray(lower @ U)
        F[self.supports] += spring_stiffness(lower, self.supports)[:, None] * U[self.supports]
        return F

    def close(self) -> None:
        """Give the factor's memory back."""
        self.factor.close()


class ConstrainedStatics:
    """The body on the subspace C' u = 0, with C (N, c) dense or sparse.

    ``mean_axes`` says that C = M Z with the rigid modes Z, which the modes are orthogonal to anyway. ``loads`` (k)
    gives k columns of loads that are solved for in the pass of C over a factor on disk, until ``take_ahead``.
    Peak memory: one dense (N, c) array besides the factor.

    Raises:
        InputError: the constraints depend on each other or leave rigid motions free.
    """

    def __init__(
        self,
        statics: Statics,
        C: Floats | sp.csc_array,
        what: str,
        *,
        mean_axes: bool = False,
        loads: Callable[[int], Floats] | None = None,
    ) -> None:
        self.statics, self.C, self.mean_axes = statics, C, mean_axes
        Z = statics.Z
        self.X, self._ahead = _solve_with(statics, C, loads)
        E = C.T @ self.X
        H = C.T @ Z
        # Motions that the constraints do not see at all, but for the round-off of others.
        H[:, np.abs(H).max(axis=0, initial=0.0) <= TOL.unseen_motion * np.abs(Z).max(axis=0, initial=0.0)] = 0.0
        c, r = H.shape
        self.count = c
        # What the constraints are where each holds a single dof.
        self.rows = None if mean_axes else single_dof_rows(C)
        border = np.block([[symmetric(E), -H], [-H.T, np.zeros((r, r))]])
        self.scale = _scales(np.diag(E), H)
        scaled = self.scale[:, None] * border * self.scale
        if c + r:
            values = np.abs(sl.eigvalsh(scaled))
            if values.min() <= TOL.dependent_constraint * values.max():
                free = r - int(np.linalg.matrix_rank(H)) if c else r
                raise InputError(
                    f"{what} leave {free} rigid-body motions of the body free; add or enlarge interfaces until they "
                    'hold it, or take method = "free-interface"'
                    if free
                    else f"{what} depend on each other; do not expose one motion twice",
                    kind="model",
                    keyword="interfaces",
                )
        self.border = sl.lu_factor(scaled) if c + r else None

    def solve(self, F: Floats, G: Floats | None = None) -> tuple[Floats, Floats]:
        """u (N, k) with K u = f - C lam and C' u = g, and lam (c, k)."""
        return self.constrain(self.statics.apply(F), F, G)

    def constrain(self, U: Floats, F: Floats, G: Floats | None = None) -> tuple[Floats, Floats]:
        """As ``solve``, with ``U`` (N, k) = K_c^-1 F, which is overwritten: without a solution of its own."""
        if self.border is None:
            return U, np.zeros((0, F.shape[1]))
        top = self.C.T @ U - (0.0 if G is None else G)
        rhs = np.vstack([top, -(self.statics.Z.T @ F)])
        both = self.scale[:, None] * sl.lu_solve(self.border, self.scale[:, None] * rhs)
        lam = both[: self.count]
        # By columns, as the solver leaves them.
        U -= (lam.T @ self.X.T).T
        U += (both[self.count :].T @ self.statics.Z.T).T
        return U, lam

    def take_ahead(self) -> Floats | None:
        """K_c^-1 of the loads (N, k) that were solved for ahead, once; None without any."""
        solved, self._ahead = self._ahead, None
        return solved

    def flexibility(self, F: Floats) -> Floats:
        """Displacements (N, k) under the loads F with C' u = 0."""
        return self.solve(F)[0]

    def deformation(self, F: Floats, M: sp.csr_array) -> Floats:
        """As ``flexibility``; columns of which constraints leave round-off alone, in the norm of ``M``, are zero."""
        U = self.statics.apply(F)
        loose = m_norms(U, M @ U)
        U = self.constrain(U, F)[0]
        U[:, m_norms(U, M @ U) <= TOL.dependent_column * loose] = 0.0
        return U

    def solve_constraint_modes(self) -> tuple[Floats, Floats]:
        """U (N, c) with C' U = I and no other load, and the condensed stiffness U' K U (c, c).

        Where stiff parts take digits of it, loads and displacements are refined with solves of their own.

        Raises:
            SolverError: round-off takes more digits than refinement gives back.
        """
        if self.border is None:
            return np.zeros((len(self.statics.Z), 0)), np.zeros((0, 0))
        U, lam = np.zeros((len(self.statics.Z), self.count)), np.zeros((self.count, self.count))
        self._meet_motions(U, lam)
        for step in range(TOL.refinement_steps):
            imposed_error, lost_energy = (
                self._measure_constraint_error(U),
                self._measure_energy_error(self._energy(U, lam), lam),
            )
            # Equilibrium, of which rigid motion needs more digits than elastic motion does, takes a step of its own.
            allowed = TOL.lost_energy if step else TOL.sure_energy
            if (imposed_error <= TOL.imposed_error and lost_energy <= allowed) or step == TOL.refinement_steps - 1:
                break
            self._refine(U, lam)
        if not imposed_error <= TOL.imposed_error:
            raise SolverError(
                f"unit interface displacements could be imposed to {imposed_error:.1e} only (needed "
                f"{TOL.imposed_error:.0e}); points far from the body, or interfaces that nearly depend on each other, "
                "cost these digits"
            )
        self._refuse_lost_energy(lost_energy)
        # Loads have no part in rigid motion, of which the energy has round-off of all rows.
        return U, -symmetric(lam)

    def _meet_motions(self, U: Floats, lam: Floats) -> None:
        """Make C' U = I with loads on the interfaces alone, in place: X has their displacements."""
        rhs = np.zeros((len(self.scale), self.count))
        for _ in range(TOL.refinement_steps):
            # Stiff links between interfaces cost the bordered system digits, which refinement regains.
            rhs[: self.count] = self.C.T @ U - np.eye(self.count)
            both = self.scale[:, None] * sl.lu_solve(self.border, self.scale[:, None] * rhs)
            lam += both[: self.count]
            U += self.statics.Z @ both[self.count :] - self.X @ both[: self.count]
            if not TOL.exact_imposed_error < self._measure_constraint_error(U) <= TOL.first_imposed_error:
                break

    def _measure_constraint_error(self, U: Floats) -> float:
        """Largest error of C' U = I, motions of different units scaled."""
        top = self.scale[: self.count, None]
        return float(np.abs(top * (self.C.T @ U - np.eye(self.count)) / top.T).max(initial=0.0))

    def _refine(self, U: Floats, lam: Floats) -> None:
        """One step of iterative refinement of K U + C lam = 0, C' U = I, in place."""
        eye = np.eye(self.count)
        for block in self._blocks():
            F = -(self.statics.pencil.lower @ U[:, block]) - np.asarray(self.C @ lam[:, block])
            dU, dlam = self.solve(F, eye[:, block] - self.C.T @ U[:, block])
            U[:, block] += dU
            lam[:, block] += dlam

    def _energy(self, U: Floats, lam: Floats) -> Floats:
        """Condensed stiffness (c, c) in which all errors of ``U`` and ``lam`` are of second order.

        U' K U - lam' G - G' lam with G = I - C' U: what ``lam`` is checked against.
        """
        parts = [U.T @ np.asarray(self.statics.pencil.lower @ U[:, block]) for block in self._blocks()]
        cross = lam.T @ (np.eye(self.count) - self.C.T @ U)
        return np.asarray(np.hstack(parts) - cross - cross.T)

    def _measure_energy_error(self, condensed: Floats, lam: Floats) -> float:
        """Largest relative difference of the energies of unit interface displacements, by fields and by loads."""
        s = _scales_of(condensed, self.scale[: self.count])
        H = s[:, None] * (self.C.T @ self.statics.Z)
        Q = sl.qr(H)[0][:, H.shape[1] :] if H.shape[1] else np.eye(self.count)
        A, B = (Q.T @ (symmetric(E) / np.outer(s, s)) @ Q for E in (condensed, -lam))
        if not A.size:
            return 0.0
        try:
            return float(np.abs(sl.eigvalsh(A - B, A)).max())
        except np.linalg.LinAlgError:
            return np.inf

    def _refuse_lost_energy(self, lost: float) -> None:
        """Raise where ``lost`` says that the condensed stiffness is not known."""
        if not lost <= TOL.lost_energy:
            raise SolverError(
                f"the stiffness between the interfaces has the energy of soft motions wrong by {lost:.1e} "
                f"(needed {TOL.lost_energy:.0e}): round-off of stiff parts hides its digits; make stiff links softer, "
                'replace them by rigid couplings, or take method = "free-interface"'
            )

    def _blocks(self) -> list[slice]:
        """Columns of as many interface degrees of freedom as the budget allows at once."""
        width = self.statics.columns()
        return [slice(at, at + width) for at in range(0, self.count, width)]


def single_dof_rows(C: Floats | sp.csc_array) -> Ints | None:
    """Rows (c,) that C' u picks, where every column has a single entry; None otherwise."""
    if isinstance(C, np.ndarray):
        return None if C.shape[1] else np.empty(0, dtype=np.int64)
    C = sp.csc_array(C)
    return np.asarray(C.indices, dtype=np.int64) if (np.diff(C.indptr) == 1).all() else None


def _solve_with(
    statics: Statics, C: Floats | sp.csc_array, loads: Callable[[int], Floats] | None
) -> tuple[Floats, Floats | None]:
    """K_c^-1 of ``C`` (N, c) and, with a factor on disk, of as many ``loads`` as its pass has room for."""
    spare = min(statics.columns(TOL.single_copies) - C.shape[1], statics.block_columns(TOL.wide_block))
    if loads is None or not statics.factor.stats.out_of_core or spare < TOL.least_wide_block:
        return statics.space.map_columns(statics.apply, C, width=statics.columns()), None
    U = statics.apply(np.hstack([dense(C), loads(spare)]))
    # Apart, as what was solved for ahead goes first.
    c = C.shape[1]
    return statics.budget.store(U[:, :c].copy(order="F")), statics.budget.store(U[:, c:].copy(order="F"))


def _scales(flexibility: Floats, H: Floats) -> Floats:
    """Row scales (c + r,) that bring the bordered system to unit size: forces and moments mix units.

    ``flexibility`` (c,) is the diagonal of C'K_c^+C; it vanishes for motions that are supports.
    """
    rigid = np.linalg.norm(H, axis=1)
    # Motions at a hinge have nothing but round-off there.
    translating = (flexibility > 0) & (rigid > 1e-9 * rigid.max(initial=0.0))
    ratio = float(np.median(rigid[translating] / np.sqrt(flexibility[translating]))) if translating.any() else 1.0
    size = np.sqrt(np.maximum(flexibility, 0.0))
    least = rigid / ratio
    top = 1.0 / np.where(size > TOL.support_flexibility * least, size, np.where(least > 0, least, 1.0))
    coupled = np.abs(top[:, None] * H).max(axis=0, initial=0.0)
    return np.concatenate([top, 1.0 / np.where(coupled > 0, coupled, 1.0)])


def _scales_of(A: Floats, usual: Floats) -> Floats:
    """Roots (c,) of the diagonal of ``A`` (c, c), those ``usual`` for their flexibility where it is round-off."""
    diagonal = np.diag(A)
    return np.asarray(np.sqrt(np.where(diagonal > TOL.rigid_energy * usual**2, diagonal, usual**2)))
