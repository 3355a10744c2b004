"""A model with its interfaces and a solver: owns the factorisation and the modes that reducers share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any, ClassVar, TypeVar

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import check_value
from morembs.base.budget import UNLIMITED, Budget, current_budget
from morembs.base.closing import Closing
from morembs.base.errors import InputError, MorembsError, SingularMatrixError
from morembs.base.progress import listener, listening
from morembs.base.summary import summarised
from morembs.base.types import Floats
from morembs.fem import FEModel
from morembs.fem.fe_model import has_places
from morembs.fem.interface import Coupling, Interface, couple
from morembs.fem.mass import mass_properties
from morembs.linalg.columns import dense
from morembs.linalg.congruence import congruence
from morembs.linalg.dynamic_stiffness import DynamicStiffness
from morembs.linalg.eigen import Modes, lowest_modes, start_loads
from morembs.linalg.space import Space
from morembs.linalg.sparse.select import select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.linalg.statics import ConstrainedStatics, Statics
from morembs.linalg.sturm import require_room_to_count
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem.damping import Damping as Damping
from morembs.problem.rigid_motions import acts_on_rigid_motion, need_factor, rigid_motions
from morembs.problem.soundness import refuse_lost_modes, refuse_lost_supports, refuse_other_geometry, why_singular
from morembs.problem.system import System
from morembs.problem.tolerances import TOL

Shared = TypeVar("Shared")
# Key of the constraint modes among the solutions that reducers share.
CONSTRAINT = "constraint modes"


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

    made_by: ClassVar[str] = "Problem(model, interfaces)"

    def __init__(
        self,
        model: FEModel,
        interfaces: Sequence[Interface] = (),
        *,
        solver: LinearSolver | None = None,
        damping: Damping | None = None,
        workers: int = 1,
    ) -> None:
        check_value("Problem: model", model, FEModel)
        check_value("Problem: interfaces", interfaces, Sequence[Interface])
        self.model = model
        self.interfaces = tuple(interfaces)
        self.solver = solver if solver is not None else select_solver()
        budget = current_budget()
        self.budget = Budget(self.solver.memory, self.solver.scratch) if budget is UNLIMITED else budget
        self.damping = damping if damping is not None else Damping()
        if self.damping.structural and any(A is not None for A in (model.D, model.G, model.N)):
            raise InputError(
                "structural damping in addition to a damping matrix of the model is not supported; leave one out, or "
                "replace the structural damping by rayleigh damping added to the matrix",
                kind="conflict",
                keyword="damping",
            )
        # Modes that are computed where nobody listens are heard by whoever listens now.
        self.listener, self.workers = listener(), workers
        self.coupling: Coupling = couple(model, self.interfaces)
        self.B = self.coupling.B
        with self.budget.in_use():
            self._couple()
        if not need_factor(model, self.K):
            self._refuse_free_flutter()
        self._elastic: Modes | None = None
        self._fixed: Modes | None = None
        self._shared: dict[object, Any] = {}

    def _couple(self) -> None:
        """Make the matrices of the coupled dofs."""
        model, T = self.model, self.coupling.T
        square = T.shape[0] == T.shape[1]
        self.K, self.M = (A if square else congruence(T, A) for A in (model.K, model.M))
        self.D = model.D if model.D is None or square else congruence(T, model.D)
        self.G, self.N = (A if A is None or square else congruence(T, A, skew=True) for A in (model.G, model.N))
        self.budget.release_pages()
        self.stiffness = DynamicStiffness(
            self.K, self.M, self.D, G=self.G, N=self.N, solver=self.solver, regular=has_places(model)
        )
        self.space = Space(self.M)
        self.budget.release_pages()

    @cached_property
    def _motions(self) -> tuple[Floats, Floats]:
        with self.budget.in_use():
            return rigid_motions(self.model, self.coupling, self.K, self.M, self.solver)

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
                "reduced held only: hold it in the model",
                kind="model",
                keyword="supports",
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

    def compute_once(self, key: object, make: Callable[[], Shared]) -> Shared:
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
        """True if there is neither a gyroscopic nor a circulatory matrix."""
        return self.G is None and self.N is None

    @cached_property
    def system(self) -> System:
        """The matrices with what solving at any s takes; goes to other processes."""
        one = self.G if self.D is None else self.D
        return System(
            K=self.K,
            M=self.M,
            velocity_matrix=sp.csr_array(self.D + self.G) if self.D is not None and self.G is not None else one,
            N=self.N,
            rigid=self.rigid,
            damping=self.damping,
            damps_rigid_motion=any(
                acts_on_rigid_motion(self.model, self.coupling, own, given, self.rigid)
                for own, given in ((self.D, self.model.D), (self.G, self.model.G))
            ),
            stiffness=self.stiffness,
            space=self.space,
        )

    @cached_property
    def statics(self) -> Statics:
        """The one factorisation: supported stiffness, shared by all reducers."""
        self._refuse_free_flutter()
        refuse_other_geometry(self.model, self.coupling, self.system, self._held)
        try:
            statics = Statics(self.stiffness, self.rigid, self._held)
        except SingularMatrixError as error:
            raise SingularMatrixError(why_singular(self.coupling, self.system)) from error
        try:
            refuse_lost_supports(statics, self.M)
        except MorembsError:
            statics.close()
            raise
        return statics

    @cached_property
    def free_free(self) -> ConstrainedStatics:
        """The free body without its rigid-body motion (mean axes): C = M rigid."""
        return ConstrainedStatics(
            self.statics,
            self.M @ self.rigid,
            "the rigid-body modes",
            mean_axes=True,
            loads=partial(start_loads, self.M),
        )

    @cached_property
    def fixed_interface(self) -> ConstrainedStatics:
        """The body held at all interface degrees of freedom: C = B."""
        return ConstrainedStatics(self.statics, self.B, "the interfaces", loads=partial(start_loads, self.M))

    def constraint_modes(self) -> tuple[Floats, Floats]:
        """Static displacements (Nc, m) under unit motions of the interfaces, and their stiffness (m, m): computed once.

        Not to be changed.
        """
        return self.compute_once(CONSTRAINT, self.fixed_interface.solve_constraint_modes)

    def keep_constraint_modes(self, modes: Floats, stiffness: Floats) -> None:
        """Take ``modes``, columns of an array that is kept anyway, in the place of the computed ones."""
        self._shared[CONSTRAINT] = modes, stiffness

    def static_response(self) -> Floats:
        """Elastic displacements (Nc, m) of the free body under unit loads at the interfaces.

        Without a solution of its own where the body has been held at its interfaces before.
        """
        if "fixed_interface" not in self.__dict__:
            return self.space.map_columns(self.free_free.flexibility, self.B, width=self.statics.columns(5))
        interface_response, width = self.fixed_interface.X, self.statics.columns(5)
        X = self.budget.empty(interface_response.shape, order="F")
        for at in range(0, X.shape[1], width):
            block = slice(at, at + width)
            X[:, block] = self.free_free.constrain(
                interface_response[:, block].copy(order="F"), dense(self.B[:, block])
            )[0]
        return X

    def require_room_for_modes(self) -> None:
        """Refuse a budget that the Sturm counts of modes will exceed, before anything is factorised.

        Raises:
            BudgetError: in these cases.
        """
        if self.budget.memory is not None:
            with self.budget.in_use():
                require_room_to_count(self.solver, self.stiffness.lower, self.budget.room_for_factor())

    def elastic_modes(self, *, count: int | None = None, below: float | None = None) -> Modes:
        """Free-free elastic modes: the lowest ``count`` or all up to ``below`` (rad/s)2; kept for later calls."""
        self._elastic = self._at_least(self._elastic, self.free_free, count, below, "free-free modes")
        return _cut(self._elastic, count, below)

    def fixed_modes(self, *, count: int | None = None, below: float | None = None) -> Modes:
        """Modes with all interface degrees of freedom fixed, as ``elastic_modes``."""
        self._fixed = self._at_least(self._fixed, self.fixed_interface, count, below, "fixed-interface modes")
        return _cut(self._fixed, count, below)

    def known_frequencies_hz(self) -> Floats | None:
        """Free-free frequencies of the coupled model computed so far, rigid ones as zero; None if none."""
        if self._elastic is None:
            return None
        return np.concatenate([np.zeros(self.rigid.shape[1]), self._elastic.frequencies_hz])

    def knows_modes(self, count: int) -> bool:
        """True if ``count`` elastic free-free modes have been computed."""
        return self._elastic is not None and len(self._elastic.eigenvalues) >= count

    def close(self) -> None:
        """Release the factorisations, and the solutions that reducers share."""
        self._shared.clear()
        if "statics" in self.__dict__:
            self.statics.close()
        self.stiffness.close()

    def release(self) -> None:
        """As ``close``, but the problem can be used again: factors and solutions are made again where they are needed.

        Of use between two reductions that share nothing, where memory is short. Modes stay.
        """
        self.close()
        for name in ("statics", "free_free", "fixed_interface"):
            self.__dict__.pop(name, None)

    def _at_least(
        self, latest: Modes | None, body: ConstrainedStatics, count: int | None, below: float | None, what: str
    ) -> Modes:
        enough = latest is not None and (
            (count is not None and len(latest.eigenvalues) >= count)
            # The limit of the last call comes back as it was given to the eigensolver, up to round-off.
            or (
                below is not None
                and latest.verified_below >= below * (1 + LINALG.eigenvalue_gap) * (1 - TOL.same_limit)
            )
        )
        if latest is not None and enough:
            return latest
        with listening(listener() or self.listener):
            modes = lowest_modes(body, self.M, count=count, below=below, what=what)
        refuse_lost_modes(modes, self.system.roundoff(modes.vectors), what)
        return modes


def _cut(modes: Modes, count: int | None, below: float | None) -> Modes:
    if count is None:
        highest = np.inf if below is None else below * (1 + LINALG.eigenvalue_gap)
        count = int((modes.eigenvalues <= highest).sum())
    return modes.first(count)
