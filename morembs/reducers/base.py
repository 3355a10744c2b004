"""What every reducer is: options that turn a problem into a basis and a reduced model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, ClassVar, Self, final

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.arguments import check_options, check_value
from morembs.base.errors import InputError, SolverError
from morembs.base.summary import hertz, kinds_words, summarised
from morembs.base.types import Floats
from morembs.base.units import eigenvalue_in_hz
from morembs.fem.fe_model import STRUCTURAL, WITHOUT_MASS
from morembs.linalg.columns import fix_signs, without_rigid_motion
from morembs.linalg.complex_modes import small_complex_modes
from morembs.linalg.dense import symmetric
from morembs.linalg.eigen import accurate_eigh, modes_without_mass_last
from morembs.linalg.massless import split_massless
from morembs.problem import Problem
from morembs.reducers.checks import (
    refuse_negative_mass,
    refuse_singular_mass,
    refuse_wrong_stiffness,
    without_roundoff_mass,
)
from morembs.reducers.problem_summary import ProblemSummary, ShiftedFactorisations
from morembs.reducers.tolerances import TOL
from morembs.reducers.transfer_function import TransferFunction
from morembs.responses.massless import massless_motions, massless_words

if TYPE_CHECKING:
    import scipy.sparse as sp

    from morembs.fem.stress_operator import StressOperator
    from morembs.linalg.space import Space
    from morembs.parametric.model import ParametricModel
    from morembs.responses.static_mode_tables import StaticModeTables


# What a reduced coordinate is; the body file stores the index in this table.
MODE_KINDS = (
    "rigid",
    "elastic",
    "constraint",
    "fixed-interface",
    "attachment",
    "krylov",
    "gramian",
    "balanced",
    "characteristic",
    "foreign",
)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Columns ``V`` (Nc, n) in coupled dofs, the kind of each, their stiffness ``K`` (n, n), and the
    coordinates ``rigid`` (n, r) of the M-orthonormal rigid-body modes that they span.

    "constraint" columns are unit interface displacements, and "fixed-interface" columns (with the attachment modes
    that follow them) leave the interfaces at rest: ``holds_interfaces`` says that B is therefore [I; 0].

    Equations are tested with ``W`` (Nc, n) where that is not V; accelerations and velocities are expanded with
    ``V_velocity`` (Nc, n) where that is not V. K is W' K V then. Rigid-body modes come first in all of them.
    ``notes`` say what was chosen on the way and join the recipe of the body.
    """

    V: Floats
    kinds: tuple[str, ...]
    K: Floats
    rigid: Floats
    holds_interfaces: bool = False
    W: Floats | None = None
    V_velocity: Floats | None = None
    notes: Mapping[str, object] = field(default_factory=dict)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedModel(TransferFunction):
    """M q'' + D q' + K q = B f, interface displacements C q: the projection on ``V`` (Nc, n).

    Of a model with gyroscopic or circulatory matrices ``D`` is V'(D + G)V and ``K`` V'(K + N)V, with ``W`` the same
    array as V: their symmetric and skew parts are those of the model.
    ``M``, ``K``, ``D`` (n, n), ``B`` (n, m) one column per interface dof, ``C`` (m, n); ``mode_kind`` the
    kind of each coordinate; ``rigid_count`` the number of rigid-body motions the coordinates span. A Galerkin
    projection has symmetric matrices and C = B'; in others (``W`` (Nc, n) is what the equations were tested
    with, ``is_projection`` says whether one V expands all of M, D and K) the rigid-body modes come first.
    ``structural`` is a loss factor: in the frequency domain the stiffness is (1 + i structural) K; D has none of it.

    >>> reduced
    ReducedModel: name craig-bampton; order 18; coordinates 12 constraint + 6 fixed-interface; elastic ...
    >>> reduced.K.shape, reduced.B.shape
    ((18, 18), (18, 12))
    """

    name: str
    M: Floats
    K: Floats
    D: Floats
    B: Floats
    V: Floats
    mode_kind: tuple[str, ...]
    rigid_count: int
    recipe: Mapping[str, object] = field(default_factory=dict)
    C: Floats
    W: Floats | None = None
    is_projection: bool = True
    structural: float = 0.0

    @property
    def order(self) -> int:
        """Number of reduced coordinates n."""
        return len(self.K)

    @property
    def symmetric(self) -> bool:
        """True if this is a Galerkin projection of a symmetric model, whose matrices are symmetric."""
        return self.W is None

    @property
    def congruent(self) -> bool:
        """True if the equations are tested with V itself, whatever the model: symmetric and skew parts stay apart."""
        return self.W is None or self.W is self.V

    def _facts(self) -> dict[str, object]:
        values = self.modes()[0][self.rigid_count :] if self.order <= TOL.shown_order else None
        return {
            "name": self.name,
            "order": self.order,
            "coordinates": kinds_words(self.mode_kind),
            "elastic frequencies": None if values is None else hertz(eigenvalue_in_hz(values)),
            "inputs": self.B.shape[1],
        }

    def modes(self) -> tuple[Floats, Floats]:
        """Eigenvalues (n,) of (K, M) in (rad/s)2, rigid-body modes first, and vectors (n, n) of unit modal mass.

        Motions without mass come last, with the eigenvalue infinity and unit stiffness. Of two-sided reductions the
        real parts; of gyroscopic and circulatory models those of the symmetric part of K.
        """
        r = self.rigid_count
        if self.symmetric:
            return modes_without_mass_last(self.K, self.M)
        if self.congruent:
            values, Y = accurate_eigh(symmetric(self.K), self.M)
            # Flow may make elastic modes softer than rigid motion.
            rigid = np.sort(np.argsort(np.abs(values))[:r])
            order = np.concatenate([rigid, np.delete(np.arange(self.order), rigid)])
            return values[order], Y[:, order]
        values, vectors = sl.eig(self.K[r:, r:], self.M[r:, r:])
        order = np.argsort(values.real, kind="stable")
        Y = np.eye(self.order)
        Y[r:, r:] = vectors[:, order].real
        return np.concatenate([np.zeros(r), values.real[order]]), Y

    def complex_modes(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Eigenvalues s (m,) in 1/s of s^2 M + s D + K on or above the real axis, by size, and vectors (n, m).

        Structural damping, which has no place in the time domain, is not in them.

        >>> values, vectors = reduced.complex_modes()
        >>> vectors.shape == (reduced.order, len(values))
        True
        """
        return small_complex_modes(self.K, self.M, self.D)


@dataclass(frozen=True, kw_only=True)
class Reducer(ABC):
    """Options of a reduction method; its fields are the keys of ``[[reduce]]`` in a job file.

    Limits of options stand with their types (``morembs.base.limits``) and are checked here. A method states its own
    limits (``why_not``), its cost, and the properties below.
    """

    method: ClassVar[str]

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def takes_unsymmetric(self) -> bool:
        """True if models with gyroscopic and circulatory matrices are taken."""
        return False

    @property
    def two_sided(self) -> bool:
        """True if the equations are tested with another space than that of the coordinates."""
        return False

    @property
    def needs_interfaces(self) -> bool:
        """True if there have to be interfaces."""
        return True

    @property
    def mode_count(self) -> int:
        """Number of modes that were asked for, 0 for none or for all up to a frequency."""
        return 0

    @property
    def computes_modes(self) -> bool:
        """True if modes of the full model are computed, and so counted."""
        return False

    @property
    def follows_responses(self) -> bool:
        """True if the responses to all interface dofs are followed at once, which takes long where there are many."""
        return False

    @property
    def certified_band(self) -> Sequence[float] | None:
        """[low, high] in Hz over which an error is promised, None where none is."""
        return None

    def why_not(self, facts: ProblemSummary) -> str:
        """Why such a problem cannot be reduced, as far as is known before a factorisation; "" where it can."""
        if not facts.symmetric and not self.takes_unsymmetric:
            return (
                f'method "{self.method}" takes symmetric models, and this one has a gyroscopic or circulatory matrix; '
                'take "krylov" with one side, "craig-bampton" or "modal"'
            )
        if self.needs_interfaces and not facts.inputs:
            return f'method "{self.method}" needs interfaces; add at least one [[interface]], or take method = "modal"'
        return ""

    def plan_factorisations(self, facts: ProblemSummary) -> Sequence[ShiftedFactorisations]:
        """What is factorised beside K."""
        return ()

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        """Time in addition to the factorisation, within a factor of about three; None where it cannot be predicted."""
        return None

    def in_units(self, length: float) -> Self:
        """This reducer where numbers in its selections of nodes are in units of ``length`` m."""
        return self

    def tabulate_static_modes(
        self, problem: Problem, reduced: ReducedModel, *, operator: StressOperator | None = None
    ) -> StaticModeTables | None:
        """Tables of static modes that complement ``reduced`` of this reducer; None for all but one method."""
        return None

    def variation(self, problem: Problem, reduced: ReducedModel) -> ParametricModel | None:
        """The reduced model of all values of parameters, of which ``reduced`` of this reducer is that of nominal ones;
        None for all but one method."""
        return None

    @abstractmethod
    def _basis(self, problem: Problem) -> Basis:
        """Columns of the reduction and their exact stiffness; ``why_not`` has nothing against ``problem``."""

    @final
    def reduce(self, problem: Problem, name: str | None = None) -> ReducedModel:
        """Reduced model of ``problem``.

        Raises:
            InputError: options that do not fit the problem, or interfaces that deform it without mass where an error
                is promised.
            SingularMatrixError: the model has a mechanism.
            SolverError: the stiffness of the basis is not that of the model.
        """
        check_value("reduce: problem", problem, Problem)
        reason = self.why_not(ProblemSummary.of(problem))
        if reason:
            raise InputError(reason, kind="unsupported")
        massless = massless_motions(problem)
        if massless and self.certified_band is not None:
            raise InputError(
                f'method "{self.method}" promises an error, and {massless_words(massless)}', kind="unsupported"
            )
        basis = self._basis(problem)
        self._refuse_unfit(basis)
        V, space = basis.V, problem.space
        outputs = _interface_motions(basis, problem)
        if basis.W is None:
            M = space.project(V, problem.M)
            K = without_rigid_motion(symmetric(basis.K), M, basis.rigid)
            M = without_roundoff_mass(problem, M, K)
            refuse_negative_mass(self.method, M, basis.kinds)
            if not problem.symmetric:
                refuse_singular_mass(self.method, M, basis.kinds)
            B = outputs.T
        else:
            V_velocity = V if basis.V_velocity is None else basis.V_velocity
            M, K = space.project(V_velocity, problem.M, basis.W), basis.K
            B = np.asarray((problem.B.T @ basis.W).T)
        refuse_wrong_stiffness(self.method, problem, basis.rigid, V=V, W=basis.W, K=K, M=M)
        # Velocities see the stiffness through their own basis.
        slow = K if basis.V_velocity is None else space.project(basis.V_velocity, problem.K, basis.W)
        D = problem.damping.matrix(M, slow, basis.rigid, basis.W is None)
        if problem.D is not None:
            D = D + space.project(V if basis.V_velocity is None else basis.V_velocity, problem.D, basis.W)
        W = basis.W if problem.symmetric else V
        if problem.G is not None:
            D = D + _skew_projected(space, V, problem.G)
        if problem.N is not None:
            K = K + _skew_projected(space, V, problem.N)
        options = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}
        structural = problem.damping.structural
        recipe = {"method": self.method, **options, **basis.notes, **({STRUCTURAL: structural} if structural else {})}
        if massless and split_massless(K, M) is None:
            recipe[WITHOUT_MASS] = massless_words(massless)
        return ReducedModel(
            name=name or self.method,
            M=M,
            K=K,
            D=D,
            B=B,
            C=outputs,
            V=V,
            mode_kind=basis.kinds,
            rigid_count=basis.rigid.shape[1],
            recipe=recipe,
            W=W,
            is_projection=basis.V_velocity is None,
            structural=structural,
        )

    def _refuse_unfit(self, basis: Basis) -> None:
        """Refuse a basis without elastic coordinates, or whose arrays do not fit each other."""
        if set(basis.kinds) <= {"rigid"}:
            raise InputError(
                f'method "{self.method}" with these options leaves no elastic coordinate, only {len(basis.kinds)} '
                "rigid-body modes; ask for at least one mode (or a higher up_to_hz), or take a rigid body of the "
                "simulation program",
                keyword="modes",
            )
        if basis.K.shape != (basis.V.shape[1],) * 2 or (basis.W is not None and basis.W.shape != basis.V.shape):
            raise SolverError(
                f'method "{self.method}" gave a basis of {basis.V.shape[1]} columns and a stiffness {basis.K.shape}'
            )


def _skew_projected(space: Space, V: Floats, A: sp.csr_array) -> Floats:
    """V' A V (n, n) of a skew-symmetric ``A``, skew to the last bit."""
    P = space.project(V, A, V)
    return np.asarray(0.5 * (P - P.T))


def _interface_motions(basis: Basis, problem: Problem) -> Floats:
    """C (m, n): motions of the interfaces for each coordinate."""
    if not basis.holds_interfaces:
        return np.asarray(problem.B.T @ basis.V)
    C = np.zeros((problem.B.shape[1], basis.V.shape[1]))
    constraint = basis.kinds.count("constraint")
    C[:constraint, :constraint] = np.eye(constraint)
    return C


def elastic_basis(problem: Problem, X: Floats, kind: str, notes: Mapping[str, object] | None = None) -> Basis:
    """Rigid-body modes and span(X), which becomes free of them, M-orthonormal and K-orthogonal.

    ``X`` (Nc, j) is overwritten; dependent columns are dropped. ``notes`` join the recipe of the body.

    Args:
        problem: gives M, K and the rigid motions.
        X: (Nc, j) columns in coupled dofs, overwritten.
        kind: kind of the coordinates, for the body file.
        notes: facts for the recipe of the body.
    """
    V = problem.space.complement(problem.rigid, X)

    def stiffness(Y: Floats) -> Floats:
        return problem.space.project(problem.space.multiply(V, Y), problem.K)

    values, Y = accurate_eigh(problem.space.project(V, problem.K), projected=stiffness)
    problem.space.multiply_into(V, Y, V)
    V = problem.space.fix_signs(V)
    r, m = problem.rigid.shape[1], V.shape[1]
    return Basis(
        V=problem.space.hstack(problem.rigid, V),
        kinds=("rigid",) * r + (kind,) * m,
        K=np.diag(np.concatenate([np.zeros(r), values])),
        rigid=np.eye(r + m, r),
        notes=notes or {},
    )


def add_residual_modes(problem: Problem, basis: Basis, W: Floats, orthogonal_to: Floats) -> Basis:
    """``basis`` with the "attachment" modes of span(W) behind it.

    They are M-orthonormal, free of span(orthogonal_to) (M-orthonormal too), and ordered by their own
    stiffness. In exact arithmetic they are K-orthogonal to the basis; columns that are nearly dependent
    are not, so their coupling is projected, not assumed to be zero. There are no more than the basis leaves room for.
    """
    W = problem.space.complement(orthogonal_to, W)
    W = W[:, : max(len(W) - basis.V.shape[1], 0)]
    if not W.shape[1]:
        return basis
    if basis.holds_interfaces:
        # Scaling up nearly dependent columns scaled up the round-off of their interface displacements too.
        constraint = basis.V[:, : basis.kinds.count("constraint")]
        W -= constraint @ (problem.B.T @ W)
    stiffness = W.T @ (problem.K @ W)
    W = fix_signs(W @ sl.eigh(symmetric(stiffness))[1])
    KW = problem.K @ W
    cross = basis.V.T @ KW
    return Basis(
        V=problem.space.hstack(basis.V, W),
        kinds=basis.kinds + ("attachment",) * W.shape[1],
        K=np.block([[basis.K, cross], [cross.T, W.T @ KW]]),
        rigid=np.vstack([basis.rigid, np.zeros((W.shape[1], basis.rigid.shape[1]))]),
        holds_interfaces=basis.holds_interfaces,
    )
