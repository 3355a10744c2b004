"""A model with its interfaces and a solver: owns the factorisation and the modes that reducers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from morembs.base.budget import Budget
from morembs.base.closing import Closing
from morembs.base.errors import InputError, MorembsError, SingularMatrixError, SolverError
from morembs.base.former_names import with_progress_argument
from morembs.base.progress import listener, listening
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.fem import FEModel
from morembs.fem.fe_model import has_places
from morembs.fem.interface import Coupling, Interface, couple
from morembs.fem.mass import mass_properties
from morembs.fem.rigid_residual import share_of_other_geometry
from morembs.linalg.columns import dense, map_columns
from morembs.linalg.congruence import congruence, scaled_row_sums
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.eigen import GAP, Modes, lowest_modes
from morembs.linalg.rigid import decimal_precision, has_stiffness
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.statics import ConstrainedStatics, Statics, require_room_to_count, room_for_factor
from morembs.problem.damping import Damping as Damping
from morembs.problem.rigid_motions import need_factor, nodes_of_rows, rigid_motions, terms_in_rows
from morembs.problem.system import System
from morembs.problem.tolerances import TOL

Shared = TypeVar("Shared")
# Round-off adds up at random: part of its bound that is seen as a rule.
AS_A_RULE = 0.1
# Key of the constraint modes among the solutions that reducers share.
CONSTRAINT = "constraint modes"
# Part of a static motion or of the stiffness of a mode that round-off may take.
LOST = 1e-3
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
    analytic; those of coordinates without places are the null space of K.

    Raises:
        InputError: interfaces that do not fit together, unconnected parts, coordinates or dofs that are not those of
            K, structural damping of a model that has D, G or N, or N of a free body.

    >>> with Problem(model, interfaces, damping=Damping(modal=0.02)) as problem:
    ...     problem.K.shape, problem.rigid.shape
    ((48, 48), (48, 6))
    """

    @with_progress_argument
    def __init__(
        self,
        model: FEModel,
        interfaces: Sequence[Interface] = (),
        *,
        solver: LinearSolver | None = None,
        damping: Damping | None = None,
        budget: Budget | None = None,
        workers: int = 1,
    ) -> None:
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
        # Modes that are computed where nobody listens are heard by whoever listens now.
        self.listener, self.workers = listener(), workers
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
            self.K,
            self.M,
            self.D,
            G=self.G,
            N=self.N,
            solver=self.solver,
            budget=self.budget,
            regular=has_places(model),
        )
        self.budget.release_pages()
        if not need_factor(model, self.K):
            self._refuse_free_flutter()
        self._elastic: Modes | None = None
        self._fixed: Modes | None = None
        self._shared: dict[object, Any] = {}

    @cached_property
    def _motions(self) -> tuple[Floats, Floats]:
        return rigid_motions(self.model, self.coupling, self.K, self.M, self.solver, self.budget)

    @property
    def rigid(self) -> Floats:
        """M-orthonormal rigid-body modes (Nc, r), which K leaves free of strain."""
        return self._motions[0]

    @property
    def _held(self) -> Floats:
        """M-orthonormal rigid motions (Nc, h) that K holds, perhaps softly."""
        return self._motions[1]

    def _refuse_free_flutter(self) -> None:
        count = self.rigid.shape[1]
        if self.N is not None and count:
            raise InputError(
                f"the model has a circulatory matrix and {count} rigid-body motions; models with one are "
                "reduced held only: hold it in the model"
            )

    def _facts(self) -> dict[str, object]:
        return {
            "model": f"{self.model.size:,} dofs",
            "interfaces": [each.name for each in self.interfaces],
            "coupled dofs": self.K.shape[0],
            "inputs": self.B.shape[1],
            "rigid-body modes": self.rigid.shape[1] if "_motions" in self.__dict__ else "not known yet",
            "solver": self.solver_name,
        }

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
        # A row that moves by the round-off of these vectors alone has no terms that its force could cancel among.
        moves = np.abs(self.rigid) > TOL.still_row * np.abs(self.rigid).max(axis=0)
        rigid = np.where(moves, self.rigid, 0.0)
        return has_stiffness(
            own,
            rigid,
            terms_in_rows(self.model, self.coupling, given, rigid),
            nodes_of_rows(self.model, self.coupling),
            decimal_precision(given.data),
        )

    @cached_property
    def system(self) -> System:
        """The matrices with what solving at any s takes; goes to other processes."""
        return System(
            K=self.K,
            M=self.M,
            velocity_matrix=self.velocity_matrix,
            N=self.N,
            rigid=self.rigid,
            damping=self.damping,
            damps_rigid_motion=self.damps_rigid_motion,
            stiffness=self.stiffness,
            budget=self.budget,
        )

    @cached_property
    def statics(self) -> Statics:
        """The one factorisation: supported stiffness, shared by all reducers."""
        self._refuse_free_flutter()
        self._refuse_other_geometry()
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
        return self.shared(CONSTRAINT, self.internal.solve_constraint_modes)

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

    def _at_least(
        self, known: Modes | None, body: ConstrainedStatics, count: int | None, below: float | None, what: str
    ) -> Modes:
        enough = known is not None and (
            (count is not None and len(known.eigenvalues) >= count)
            # The limit of the last call comes back as it was given to the eigensolver, up to round-off.
            or (below is not None and known.verified_below >= below * (1 + GAP) * (1 - TOL.same_limit))
        )
        if known is not None and enough:
            return known
        with listening(listener() or self.listener):
            modes = lowest_modes(body, self.M, count=count, below=below, what=what)
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

    def _refuse_other_geometry(self) -> None:
        """Refuse coordinates or dofs that are not those of K: they strain it, and it has other motions without energy.

        Raises:
            InputError: as said.
        """
        model = self.model
        if not self._held.shape[1] or model.dependent is not None or not has_places(model):
            return
        share = share_of_other_geometry(model.K, model.nodes, model.dofs)
        if not share:
            return
        # Frames of interfaces may hold what they do not fit.
        lower = sp.csr_array(model.K - self._round_off_shift(model.K, self.rigid[:, :0]) * model.M)
        try:
            count = self.solver.with_memory(self.budget.left()).negative_eigenvalues(lower, "K - sigma M")
        except SingularMatrixError:
            return
        if count > self.rigid.shape[1]:
            raise InputError(
                f"the stiffness matrix K does not fit the geometry: rigid motion strains it at {share:.0%} of the dofs "
                f"and {count} other motions have no energy; check that coordinates and dof map belong to these "
                "matrices, in this order; morembs.body.diagnostics.examine_model(model) says more"
            )

    def _round_off_shift(self, K: sp.csr_array, Z: Floats) -> float:
        """A shift far above the round-off of ``K`` in motions ``Z``, so far below every elastic mode of a sound part.

        Without any such motion: the round-off in a translation of all rows.
        """
        weights = scaled_row_sums(K)
        if Z.shape[1]:
            lost = float(np.einsum("i,ij,ij->j", weights, Z, Z).max())
        else:
            mass = self.mass_properties[0]
            lost = float(weights.sum() / (mass if mass > 0 else self.M.diagonal().max(initial=0.0) or 1.0))
        return TOL.mechanism_shift * float(np.finfo(float).eps) * lost

    def _mechanism(self) -> str:
        """Message for a stiffness with more zero-energy motions than the rigid ones."""
        sigma = self._round_off_shift(self.K, self.rigid)
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
            "look for parts that touch in a node or an edge only, nodes that should be merged, or coordinates that are "
            "not those of the matrices"
        )


def _cut(modes: Modes, count: int | None, below: float | None) -> Modes:
    if count is None:
        count = int((modes.eigenvalues <= below * (1 + GAP)).sum()) if below is not None else len(modes.eigenvalues)
    return modes.first(count)
