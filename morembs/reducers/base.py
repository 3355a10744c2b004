"""What every reducer is: options that turn a problem into a basis and a reduced model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, final

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.budget import Budget
from morembs.errors import InputError
from morembs.linalg.eigen import signed
from morembs.linalg.orthogonal import dot, m_norms, m_orthonormal, remove
from morembs.problem import Problem
from morembs.progress import SILENT, Progress

Floats = NDArray[np.float64]

MOST_HZ = 1e12
# What a reduced coordinate is; the body file stores the index in this table.
MODE_KINDS = ("rigid", "elastic", "constraint", "fixed-interface", "attachment")


@dataclass(frozen=True, kw_only=True, eq=False)
class Basis:
    """Columns ``V`` (Nc, n) in coupled dofs, the kind of each, their stiffness ``K`` (n, n), and the
    coordinates ``rigid`` (n, r) of the M-orthonormal rigid-body modes that they span.

    "constraint" columns are unit interface motions, and "fixed-interface" columns (with the attachment modes
    beside them) leave the interfaces at rest: ``holds_interfaces`` says that B is therefore [I; 0].
    """

    V: Floats
    kinds: tuple[str, ...]
    K: Floats
    rigid: Floats
    holds_interfaces: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedModel:
    """M q'' + D q' + K q = B f, outputs B' q: the Galerkin projection on ``V`` (Nc, n).

    ``M``, ``K``, ``D`` (n, n) symmetric, ``B`` (n, m) one column per interface motion; ``mode_kind`` the
    kind of each coordinate; ``rigid_count`` the number of rigid-body motions the coordinates span.
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

    @property
    def order(self) -> int:
        """Number of reduced coordinates n."""
        return len(self.K)


@dataclass(frozen=True, kw_only=True)
class Reducer(ABC):
    """Options of a reduction method; its fields are the keys of ``[[reduce]]`` in a job file."""

    method: ClassVar[str]

    @abstractmethod
    def _basis(self, problem: Problem, progress: Progress) -> Basis:
        """Columns of the reduction and their exact stiffness."""

    @final
    def reduce(self, problem: Problem, name: str | None = None, progress: Progress = SILENT) -> ReducedModel:
        """Reduced model of ``problem``.

        Raises:
            InputError: options that do not fit the problem.
            SingularMatrixError: the model has a mechanism.
        """
        basis = self._basis(problem, progress)
        V = basis.V
        M = projected(V, problem.M, problem.budget)
        K = 0.5 * (basis.K + basis.K.T)
        if basis.holds_interfaces:
            B = np.zeros((V.shape[1], problem.B.shape[1]))
            constraint = basis.kinds.count("constraint")
            B[:constraint, :constraint] = np.eye(constraint)
        else:
            B = np.asarray((problem.B.T @ V).T)
        D = problem.damping.matrix(M, K, basis.rigid)
        if problem.D is not None:
            D = D + projected(V, problem.D, problem.budget)
        options = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) is not None}
        return ReducedModel(
            name=name or self.method, M=M, K=K, D=D, B=B, V=V, mode_kind=basis.kinds, rigid_count=basis.rigid.shape[1],
            recipe={"method": self.method, **options},
        )  # fmt: skip


def projected(V: Floats, A: sp.csr_array, budget: Budget) -> Floats:
    """V' A V (n, n) of a symmetric ``A``, a block of columns of ``V`` (Nc, n) at a time."""
    width = budget.columns(len(V))
    parts = [dot(V, A @ V[:, at : at + width], budget) for at in range(0, V.shape[1], width)]
    whole = np.hstack(parts) if parts else np.zeros((0, 0))
    return 0.5 * (whole + whole.T)


def beside(*parts: Floats, budget: Budget) -> Floats:
    """Columns of the ``parts`` (Nc, .) beside each other, where the budget wants them."""
    V = budget.empty((len(parts[0]), sum(part.shape[1] for part in parts)), order="F")
    at = 0
    for part in parts:
        V[:, at : at + part.shape[1]] = part
        at += part.shape[1]
        budget.relax()
    return V


def chosen_modes(modes: int | None, up_to_hz: float | None, method: str) -> None:
    """Check that exactly one of ``modes`` and ``up_to_hz`` selects the modes."""
    if (modes is None) == (up_to_hz is None):
        raise InputError(f'method "{method}" needs either modes = COUNT or up_to_hz = LIMIT (one of the two)')
    if modes is not None and modes < 0:
        raise InputError(f"modes = {modes} was given; expected a count, zero or more")
    if up_to_hz is not None and not 0 < up_to_hz < MOST_HZ:
        raise InputError(f"up_to_hz = {up_to_hz} was given; expected a positive frequency in Hz below {MOST_HZ:g}")


def add_residual_modes(problem: Problem, basis: Basis, W: Floats, orthogonal_to: Floats) -> Basis:
    """``basis`` with the "attachment" modes of span(W) behind it.

    They are M-orthonormal, free of span(orthogonal_to) (M-orthonormal too), and ordered by their own
    stiffness. In exact arithmetic they are K-orthogonal to the basis; columns that are nearly dependent
    are not, so their coupling is projected, not assumed to be zero.
    """
    MW = problem.M @ W
    before = m_norms(W, MW)
    remove(orthogonal_to, W, problem.M, MW)
    W = m_orthonormal(W, problem.M, before)
    if basis.holds_interfaces:
        # Scaling up nearly dependent columns scaled up the round-off of their interface motion too.
        constraint = basis.V[:, : basis.kinds.count("constraint")]
        W -= constraint @ (problem.B.T @ W)
    stiffness = W.T @ (problem.K @ W)
    W = signed(W @ sl.eigh(0.5 * (stiffness + stiffness.T))[1])
    KW = problem.K @ W
    cross = basis.V.T @ KW
    return Basis(
        V=beside(basis.V, W, budget=problem.budget),
        kinds=basis.kinds + ("attachment",) * W.shape[1],
        K=np.block([[basis.K, cross], [cross.T, W.T @ KW]]),
        rigid=np.vstack([basis.rigid, np.zeros((W.shape[1], basis.rigid.shape[1]))]),
        holds_interfaces=basis.holds_interfaces,
    )
