"""A model with its interfaces and a solver: owns the factorisation and the modes that reducers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from morembs.budget import Budget
from morembs.closing import Closing
from morembs.errors import InputError, MorembsError, SingularMatrixError, SolverError
from morembs.interface import Coupling, Interface, couple
from morembs.linalg.columns import dense, map_columns
from morembs.linalg.congruence import cancelling, congruence, scaled_row_sums
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.eigen import GAP, Modes, lowest_modes
from morembs.linalg.rigid import resists, strain_free, written
from morembs.linalg.sparse.ordering import node_graph
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.statics import ConstrainedStatics, Statics, require_room_to_count, room_for_factor
from morembs.model import FEModel
from morembs.model.fe_model import SCALAR
from morembs.model.mass import mass_properties
from morembs.model.rigid_residual import refuse_other_geometry
from morembs.problem.damping import Damping as Damping
from morembs.progress import SILENT, Progress
from morembs.summary import summarised

Floats = NDArray[np.float64]
Shared = TypeVar("Shared")
# Round-off adds up at random: part of its bound that is seen as a rule.
AS_A_RULE = 0.1
# Number of terms up to which round-off of their sum is that of a row of an assembled matrix.
FEW_TERMS = 100
# Key of the constraint modes among the solutions that reducers share.
CONSTRAINT = "constraint modes"
# Limits of modes that differ by less than this part are one limit.
SAME = 1e-14
# Part of a static motion or of the stiffness of a mode that round-off may take.
LOST = 1e-3
# Shift in the Sturm count of motions without energy, as a multiple of the round-off in that of rigid motion.
MECHANISM = 1e3
SOFTER = (
    "make stiff links and penalty springs softer (a thousand times the stiffness of what they join is rigid enough) or "
    "replace them by rigid couplings, or leave a soft support to the simulation"
)


@summarised
class Problem(Closing):
    """M u'' + (D + G) u' + (K + N) u = B f of a model coupled to its interfaces. A context manager.

    ``budget`` bounds the resident memory of the process; by default it is that of ``solver``. Up to ``workers``
    processes factorise A(s) at different s at once, as far as the budget has room for all of their factors.
    ``K``, ``M`` (Nc, Nc) in coupled dofs, ``B`` (Nc, m); ``rigid`` (Nc, r) M-orthonormal rigid-body modes,
    analytic, never from an eigensolver.

    Raises:
        InputError: interfaces that do not fit together, unconnected parts, coordinates or dofs that are not those of
            K, structural damping of a model that has D, G or N, or N of a free body.

    >>> with Problem(model, interfaces, damping=Damping(modal=0.02)) as problem:
    ...     problem.K.shape, problem.rigid.shape
    ((48, 48), (48, 6))
    """

    def __init__(
        self, model: FEModel, interfaces: Sequence[Interface] = (), *, solver: LinearSolver | None = None,
        damping: Damping | None = None, budget: Budget | None = None, progress: Progress = SILENT,
        workers: int = 1,
    ) -> None:  # fmt: skip
        self.model = model
        self.interfaces = tuple(interfaces)
        self.solver = solver if solver is not None else select_solver()
        self.budget = budget if budget is not None else Budget(self.solver.memory, self.solver.scratch)
        self.damping = damping if damping is not None else Damping()
        if self.damping.structural and any(A is not None for A in (model.D, model.G, model.N)):
            raise InputError(
                "structural damping in addition to a damping matrix of the model is not supported; leave one out, or "
                "replace the structural damping by rayleigh damping added to the matrix"
            )
        self.progress, self.workers = progress, workers
        self.coupling: Coupling = couple(model, self.interfaces)
        T = self.coupling.T
        square = T.shape[0] == T.shape[1]
        self.K, self.M = (A if square else congruence(T, A, self.budget) for A in (model.K, model.M))
        self.D = model.D if model.D is None or square else congruence(T, model.D, self.budget)
        self.G, self.N = (
            A if A is None or square else congruence(T, A, self.budget, skew=True) for A in (model.G, model.N)
        )
        self.B = self.coupling.B
        self.budget.release_pages()
        self.stiffness = DynamicStiffness(
            self.K, self.M, self.D, G=self.G, N=self.N, solver=self.solver, budget=self.budget
        )
        self.budget.release_pages()
        self._refuse_unconnected()
        self.rigid, self._held = self._rigid_motions()
        if self.N is not None and self.rigid.shape[1]:
            raise InputError(
                f"the model has a circulatory matrix and {self.rigid.shape[1]} rigid-body motions; models with one are "
                "reduced held only: hold it in the model"
            )
        self._elastic: Modes | None = None
        self._fixed: Modes | None = None
        self._shared: dict[object, Any] = {}

    def _facts(self) -> dict[str, object]:
        return {
            "model": f"{self.model.size:,} dofs", "interfaces": [each.name for each in self.interfaces],
            "coupled dofs": self.K.shape[0], "inputs": self.B.shape[1], "rigid-body modes": self.rigid.shape[1],
            "solver": self.solver_name,
        }  # fmt: skip

    def shared(self, key: object, make: Callable[[], Shared]) -> Shared:
        """What ``make`` gives, computed once: solutions that several reducers need."""
        if key not in self._shared:
            self._shared[key] = make()
        value: Shared = self._shared[key]
        return value

    @cached_property
    def mass_properties(self) -> tuple[float, Floats, Floats]:
        """Mass in kg, centre of mass (3,) in m and inertia (3, 3) in kg m2 about it."""
        return mass_properties(self.M, self.coupling.R, self.coupling.pole)

    @cached_property
    def length(self) -> float:
        """Radius of gyration in m: it turns rotations and moments into the units of motions and forces."""
        mass, _, inertia = self.mass_properties
        turning = float(np.trace(inertia))
        if not turning > 0:
            # Masses that differ along x, y and z have no centre; about the middle of the nodes there is an inertia.
            R = self.coupling.R[:, 3:]
            turning = float(np.einsum("ij,ij->", R, self.M @ R))
        return float(np.sqrt(turning / (2 * mass))) if turning > 0 and mass > 0 else 1.0

    @cached_property
    def motion_scale(self) -> Floats:
        """One for displacements and ``length`` for rotations, for each column of B."""
        scales = (interface.kind.scale(interface, self.length) for interface in self.interfaces)
        return np.concatenate([np.ones(0), *scales])

    @property
    def solver_name(self) -> str:
        """Name of the linear solver in use: the one that was chosen, once there is a factor."""
        return self.statics.factor.stats.backend if "statics" in self.__dict__ else self.solver.name

    @property
    def symmetric(self) -> bool:
        """Whether there is neither a gyroscopic nor a circulatory matrix."""
        return self.G is None and self.N is None

    @cached_property
    def velocity_matrix(self) -> sp.csr_array | None:
        """D + G of the model (Nc, Nc), None without either."""
        if self.D is None or self.G is None:
            return self.G if self.D is None else self.D
        return sp.csr_array(self.D + self.G)

    @cached_property
    def damps_rigid_motion(self) -> bool:
        """Whether D or G of the model acts on rigid-body motion, which then couples to the elastic part."""
        return self._acts_on_rigid_motion("D") or self._acts_on_rigid_motion("G")

    def _acts_on_rigid_motion(self, name: str) -> bool:
        own, given = getattr(self, name), getattr(self.model, name)
        if own is None or given is None or not own.nnz or not self.rigid.shape[1]:
            return False
        return resists(
            own, self.rigid, self._magnitudes(given, self.rigid), self._nodes_of_rows(), written(given.data)
        )

    @cached_property
    def statics(self) -> Statics:
        """The one factorisation: supported stiffness, shared by all reducers."""
        try:
            statics = Statics(self.stiffness, self.rigid, self._held)
        except SingularMatrixError as error:
            raise SingularMatrixError(self._mechanism()) from error
        try:
            self._refuse_lost_supports(statics)
        except MorembsError:
            statics.close()
            raise
        return statics

    @cached_property
    def elastic(self) -> ConstrainedStatics:
        """The free body without its rigid-body motion (mean axes): C = M rigid."""
        return ConstrainedStatics(self.statics, self.M @ self.rigid, "the rigid-body modes", mean_axes=True)

    @cached_property
    def internal(self) -> ConstrainedStatics:
        """The body held at all interface degrees of freedom: C = B."""
        return ConstrainedStatics(self.statics, self.B, "the interfaces")

    def constraint_modes(self) -> tuple[Floats, Floats]:
        """Static displacements (Nc, m) under unit motions of the interfaces, and their stiffness (m, m): computed once.

        Not to be changed.
        """
        return self.shared(CONSTRAINT, self.internal.impose)

    def keep_constraint_modes(self, modes: Floats, stiffness: Floats) -> None:
        """Take ``modes``, columns of an array that is kept anyway, in the place of those that were computed."""
        self._shared[CONSTRAINT] = modes, stiffness

    def static_response(self) -> Floats:
        """Elastic displacements (Nc, m) of the free body under unit loads at the interfaces.

        Without a solution of its own where the body has been held at its interfaces before.
        """
        if "internal" not in self.__dict__:
            return map_columns(self.elastic.flexibility, self.B, self.budget, width=self.statics.columns(5))
        known, width = self.internal.X, self.statics.columns(5)
        X = self.budget.empty(known.shape, order="F")
        for at in range(0, X.shape[1], width):
            some = slice(at, at + width)
            X[:, some] = self.elastic.constrain(known[:, some].copy(order="F"), dense(self.B[:, some]))[0]
        return X

    def require_room_for_modes(self) -> None:
        """Refuse a budget that the Sturm counts of modes will exceed, before anything is factorised.

        Raises:
            BudgetError: as said.
        """
        if self.budget.memory is not None:
            require_room_to_count(self.solver, self.stiffness.lower, room_for_factor(self.budget), self.budget)

    def elastic_modes(self, *, count: int | None = None, below: float | None = None) -> Modes:
        """Free-free elastic modes: the lowest ``count`` or all up to ``below`` (rad/s)2; kept for later calls."""
        self._elastic = self._at_least(self._elastic, self.elastic, count, below, "free-free modes")
        return _cut(self._elastic, count, below)

    def fixed_modes(self, *, count: int | None = None, below: float | None = None) -> Modes:
        """Modes with all interface degrees of freedom fixed, as ``elastic_modes``."""
        self._fixed = self._at_least(self._fixed, self.internal, count, below, "fixed-interface modes")
        return _cut(self._fixed, count, below)

    def known_frequencies_hz(self) -> Floats | None:
        """Free-free frequencies of the coupled model computed so far, rigid ones as zero; None if none."""
        if self._elastic is None:
            return None
        return np.concatenate([np.zeros(self.rigid.shape[1]), self._elastic.frequencies_hz])

    def knows_modes(self, count: int) -> bool:
        """Whether ``count`` elastic free-free modes have been computed."""
        return self._elastic is not None and len(self._elastic.eigenvalues) >= count

    def close(self) -> None:
        """Release the factorisations, and the solutions that reducers share."""
        self._shared.clear()
        if "statics" in self.__dict__:
            self.statics.close()
        self.stiffness.close()

    def release(self) -> None:
        """As ``close``, but the problem can be used again: factors and solutions are made anew where they are needed.

        Of use between two reductions that share nothing, where memory is short. Modes stay.
        """
        self.close()
        for name in ("statics", "elastic", "internal"):
            self.__dict__.pop(name, None)

    def _rigid_motions(self) -> tuple[Floats, Floats]:
        """M-orthonormal bases of the geometric motions (Nc, r) that K leaves free of strain and (Nc, h) that it holds.

        Raises:
            InputError: a support so soft that it cannot be told from round-off, or coordinates that are not those of K.
        """
        M, R = self.M, self.coupling.R
        moves = R[:, :3].any(axis=1)
        # Rotations per radius, so that all motions move nodes as far.
        radius = float(np.sqrt((R[moves, 3:] ** 2).sum(axis=1).mean())) if moves.any() else 0.0
        R = R / np.repeat([1.0, radius or 1.0], 3)
        G = R.T @ (M @ R)
        self.budget.release_pages()
        # Eigenvectors of the inertia are independent motions also where some vanish (all nodes on a line).
        scale = np.sqrt(np.abs(np.diag(G)).clip(np.finfo(float).tiny))
        values, U = sl.eigh(G / np.outer(scale, scale))
        good = values > 1e-12
        Phi = R if good.all() else (R / scale) @ U[:, good]
        Phi = Phi / np.linalg.norm(Phi * np.where(moves, 1.0, radius or 1.0)[:, None], axis=0)
        # One matrix at a time has its pages in memory.
        size, last = self._magnitudes(self.model.K, Phi), max(written(self.model.K.data), self.model.strained)
        self.budget.release_pages()
        free, held = strain_free(self.K, Phi, size, self._nodes_of_rows(), last)
        self.budget.release_pages()
        if held.shape[1] and self.model.dependent is None:
            refuse_other_geometry(self.model.K, self.model.nodes, self.model.dofs)
        return _orthonormal(free, M), _orthonormal(held, M)

    def _magnitudes(self, A: sp.csr_array, Phi: Floats) -> Floats:
        """Sums (Nc, k) of all terms that cancel in A Phi for a matrix ``A`` of the model.

        Frames sum up the forces of their nodes, most of which cancel there: their round-off grows with the root of the
        number of terms, and so do these sums.
        """
        T = sp.csc_array(abs(self.coupling.T))
        size = T.T @ cancelling(A, T @ np.abs(Phi), self.model.dofs.component == SCALAR)
        terms = T.astype(bool).T @ np.diff(A.indptr).astype(float)
        growth = np.where(np.diff(T.indptr) > 1, np.sqrt(np.maximum(terms / FEW_TERMS, 1.0)), 1.0)
        return np.asarray(size * growth[:, None])

    def _nodes_of_rows(self) -> NDArray[np.int64]:
        """Node (Nc,) that each coupled dof moves, the first of those that a frame moves."""
        T = sp.csc_array(self.coupling.T)
        of_entry = np.asarray(self.model.dofs.node, dtype=np.int64)[T.indices]
        return np.minimum.reduceat(of_entry, T.indptr[:-1])

    def _at_least(
        self, known: Modes | None, body: ConstrainedStatics, count: int | None, below: float | None, what: str
    ) -> Modes:
        enough = known is not None and (
            (count is not None and len(known.eigenvalues) >= count)
            # The limit of the last call comes back as it was given to the eigensolver, up to round-off.
            or (below is not None and known.verified_below >= below * (1 + GAP) * (1 - SAME))
        )
        if known is not None and enough:
            return known
        modes = lowest_modes(body, self.M, count=count, below=below, progress=self.progress, what=what)
        off = AS_A_RULE * self.uncertainty(modes)
        lost = np.flatnonzero(off > LOST * modes.eigenvalues)
        if len(lost):
            k = int(lost[np.argmax(off[lost] / np.maximum(modes.eigenvalues[lost], np.finfo(float).tiny))])
            raise SolverError(
                f"round-off in the stiffness matrix hides {len(lost)} of the {what}: that at "
                f"{modes.frequencies_hz[k]:.6g} Hz has a stiffness of {modes.eigenvalues[k]:.3g} (rad/s)2, known to "
                f"{off[k]:.1e} only (needed {LOST:.0e} of it); {SOFTER}"
            )
        return modes

    def uncertainty(self, modes: Modes) -> Floats:
        """How far round-off in K moves the eigenvalues (k,) of ``modes`` at most, in (rad/s)2."""
        return self.rounding(modes.vectors)

    def rounding(self, V: Floats) -> Floats:
        """What round-off in K makes of the energies of the columns of ``V`` (Nc, k) at most: eps abs(v)' abs(K) abs(v).

        Row sums of abs(K) stand for its products, so that no copy of K is made.
        """
        weights = self.shared("row sums of |K|", lambda: scaled_row_sums(self.K))
        return np.asarray(np.finfo(float).eps * np.einsum("i,ij,ij->j", weights, V, V))

    def _refuse_lost_supports(self, statics: Statics) -> None:
        """Refuse a factor that does not give back the rigid motions that K holds from their own forces.

        Raises:
            SolverError: as said.
        """
        held = statics.held
        if not held.shape[1]:
            return
        change = statics.apply(statics.supported(held)) - held
        # The motions are M-orthonormal.
        lost = float(np.sqrt(np.linalg.norm(change.T @ (self.M @ change), 2)))
        if not lost <= LOST:
            raise SolverError(
                f"the body is held so softly that its static motion on the supports comes out wrong by {lost:.1e} "
                f"(needed {LOST:.0e}): round-off of the stiff parts hides its digits; {SOFTER}"
            )

    def _refuse_unconnected(self) -> None:
        graph, starts = node_graph(self.stiffness.lower)
        parts, label = connected_components(graph, directed=False)
        if parts > 1:
            # Dofs of one node belong together, whether K couples them or not (a straight beam along an axis).
            nodes = self._nodes_of_groups(starts)
            parts, label = connected_components(sp.block_array([[graph, nodes], [nodes.T, None]]), directed=False)
            label = label[: len(starts)]
        if parts > 1:
            rows = np.diff(np.append(starts, self.K.shape[0]))
            sizes = np.sort(np.bincount(label, weights=rows).astype(int))[::-1]
            raise InputError(
                f"the model has {parts} unconnected parts (of {', '.join(map(str, sizes[:5]))} dofs), so it has "
                f"{6 * parts} rigid-body modes where one free body has 6; "
                "join the parts (merge coincident nodes), or reduce them one by one"
            )

    def _nodes_of_groups(self, starts: NDArray[np.int64]) -> sp.csr_array:
        """Pattern (groups, nodes): which nodes of the model the groups of coupled dofs move."""
        dofs, size = self.model.dofs, self.K.shape[0]
        shape = len(dofs), len(self.model.nodes)
        of_node = sp.csr_array((np.ones(len(dofs)), (np.arange(len(dofs)), dofs.node)), shape=shape)
        group = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, size)))
        gather = sp.csr_array((np.ones(size), (group, np.arange(size))), shape=(len(starts), size))
        return sp.csr_array(gather @ (abs(self.coupling.T).T @ of_node))

    def _mechanism(self) -> str:
        """Message for a stiffness with more zero-energy motions than the rigid ones."""
        # A shift far above the round-off of rigid motion, and so far below every elastic mode of a sound part.
        Z, weights = self.rigid, scaled_row_sums(self.K)
        if Z.shape[1]:
            lost = float(np.einsum("i,ij,ij->j", weights, Z, Z).max())
        else:
            lost = float(weights.sum() / self.mass_properties[0])
        sigma = MECHANISM * float(np.finfo(float).eps) * lost
        try:
            solver = self.solver.with_memory(self.budget.left())
            negative = solver.negative_eigenvalues(self.stiffness.shifted(-sigma), "K + sigma M")
            count = solver.negative_eigenvalues(self.stiffness.shifted(sigma), "K - sigma M")
        except MorembsError:
            return (
                "the stiffness matrix is singular beyond its rigid-body modes: a mechanism, or a body so slender or so "
                "far from its interface points that double precision does not resolve it; check the mesh and the units"
            )
        if negative:
            return (
                f"the stiffness matrix has {negative} negative eigenvalues: the body buckles or diverges under its "
                "load, speed or flow; lower that below the critical one (complex modes of the full model are computed "
                "above it too)"
            )
        if count <= self.rigid.shape[1]:
            return "the stiffness matrix is singular to working precision; check the units and the material"
        return (
            f"the model has a mechanism: {count} rigid-body modes were found where {self.rigid.shape[1]} are expected; "
            "look for parts that touch in a node or an edge only, or nodes that should be merged"
        )


def _cut(modes: Modes, count: int | None, below: float | None) -> Modes:
    if count is None:
        count = int((modes.eigenvalues <= below * (1 + GAP)).sum()) if below is not None else len(modes.eigenvalues)
    return modes.first(count)


def _orthonormal(Z: Floats, M: sp.csr_array) -> Floats:
    return np.asarray(Z @ np.linalg.inv(np.linalg.cholesky(Z.T @ (M @ Z))).T) if Z.shape[1] else Z
