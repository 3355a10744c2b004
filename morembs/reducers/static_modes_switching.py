"""Static modes switching (Heirman, Tamarozzi and Desmet 2011): a constant basis, and static modes for many loads.

The reduced model is that of the constant basis, which any other reducer makes. The static modes of the candidates,
psi_i = (G - V K_r^-1 V') b_i, go to tables (``static_mode_tables``). G is the flexibility of the free body (mean axes),
or of the body held at its interfaces where the basis has constraint modes. psi_i is K-orthogonal to V. It is
M-orthogonal to V where eigenmodes span V; else V' M psi_i is stored and its size noted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.limits import Domain, Positive, PositiveCount, one_of
from morembs.base.types import Bools, Floats
from morembs.fem import FEModel
from morembs.fem.interface import Interface
from morembs.fem.stress_operator import StressOperator
from morembs.problem import Problem
from morembs.reducers.base import Basis, ReducedModel, Reducer
from morembs.reducers.candidates import NORMALS, Candidates
from morembs.reducers.craig_bampton import CraigBampton
from morembs.reducers.free_interface import FreeInterface
from morembs.reducers.gramian import Gramian
from morembs.reducers.krylov import Krylov
from morembs.reducers.modal import Modal
from morembs.reducers.problem_summary import ProblemSummary
from morembs.reducers.tolerances import TOL
from morembs.responses.static_mode_tables import KINDS, StaticModeTables

_BASES: tuple[type[Reducer], ...] = (Modal, CraigBampton, FreeInterface, Krylov, Gramian)
BASES = {reducer.method: reducer for reducer in _BASES}
Directions = Annotated[
    list[int] | str,
    Domain(
        'some of 0..5 such as [2], or "normals"',
        lambda chosen: chosen == NORMALS if isinstance(chosen, str) else len(chosen) > 0 and {*chosen} <= {*range(6)},
    ),
]


@dataclass(frozen=True, kw_only=True)
class StaticModesSwitching(Reducer):
    """A constant basis, and static modes of candidates for loads that slide or move.

    Args:
        base: method of the constant basis: "modal", "craig-bampton", "free-interface", "krylov" or "gramian".
        base_options: its keys.
        candidates: selection of the nodes that may be loaded.
        directions: components 0..5 of loads at each node, or "normals" of the surface.
        kind: "path" sorts the nodes along the chain on which loads slide, "surface" keeps their order.
        band: number of neighbours along the path that may be loaded together; all by default.
        stress: keep the stress at the candidate nodes.
        length: length unit of the numbers in ``candidates``, in m; a job uses its own unit of length.

    >>> row = "box:0.05,-1,-1,0.35,0.01,0.01"                       # a line of nodes along the bar
    >>> switched = StaticModesSwitching(base="modal", base_options={"modes": 4}, candidates=row).reduce(held)
    >>> switched.order
    4
    """

    method: ClassVar[str] = "static-modes-switching"
    base: Annotated[str, one_of(*BASES)] = "modal"
    base_options: dict[str, Any] = field(default_factory=dict)
    candidates: str
    directions: Directions = field(default_factory=lambda: [0, 1, 2])
    kind: Annotated[str, one_of(*KINDS)] = "path"
    band: PositiveCount | None = None
    stress: bool = False
    length: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.base_reducer()

    def base_reducer(self) -> Reducer:
        """The reducer of the constant basis.

        Raises:
            InputError: options that it does not have or lacks.
        """
        try:
            return BASES[self.base](**self.base_options)
        except TypeError as error:
            keys = {field.name: field for field in fields(BASES[self.base])}
            wrong = [f"{key!r} is no key of it" for key in self.base_options if key not in keys]
            lacking = [
                f"{key!r} is missing"
                for key, field in keys.items()
                if field.default is MISSING and field.default_factory is MISSING and key not in self.base_options
            ]
            raise InputError(
                f"base_options = {self.base_options} does not fit base = {self.base!r}: "
                f"{', '.join([*wrong, *lacking]) or error}; its keys are {', '.join(keys)}",
                keyword="base_options",
            ) from None

    def find_candidates(self, model: FEModel, interfaces: Sequence[Interface]) -> Candidates:
        """The candidate dofs.

        Raises:
            InputError: as ``tabulate_static_modes`` for its candidates.
        """
        return Candidates(
            model,
            interfaces,
            self.candidates,
            self.directions,
            kind=self.kind,
            band=self.band,
            length=self.length or 1.0,
        )

    @property
    def mode_count(self) -> int:
        return self.base_reducer().mode_count

    @property
    def computes_modes(self) -> bool:
        return self.base_reducer().computes_modes

    @property
    def follows_responses(self) -> bool:
        return self.base_reducer().follows_responses

    def why_not(self, facts: ProblemSummary) -> str:
        base = self.base_reducer()
        if base.two_sided:
            return "static modes switching needs a symmetric constant basis; leave two_sided out"
        try:
            self.find_candidates(facts.model, facts.interfaces)
        except InputError as error:
            return str(error)
        return base.why_not(facts)

    def seconds(self, facts: ProblemSummary, factor_entries: int = 0) -> float | None:
        return self.base_reducer().seconds(facts, factor_entries)

    def in_units(self, length: float) -> Self:
        return replace(self, length=length) if self.length is None else self

    def _basis(self, problem: Problem) -> Basis:
        return self.base_reducer()._basis(problem)

    def tabulate_static_modes(
        self, problem: Problem, reduced: ReducedModel, *, operator: StressOperator | None = None
    ) -> StaticModeTables:
        """Tables of all candidates that complement ``reduced``, the result of this reducer.

        One solve for each candidate, in blocks. Peak memory: the factor, and the columns of a block and of the band
        (all candidates without one), which the budget may put on disk. ``operator`` gives stress at nodes that include
        all candidates; by default it is computed where ``stress`` asks for it.

        Raises:
            InputError: no candidates, candidates on an interface, a path with gaps, stress without elements.
        """
        candidates = self.find_candidates(problem.model, problem.interfaces)
        modes = _constant_flexibility(problem, reduced)
        stress = candidates.stress_rows(problem, operator) if self.stress or operator is not None else None
        return _tables(problem, candidates, reduced, modes, stress)


def _constant_flexibility(problem: Problem, reduced: ReducedModel) -> Callable[[Floats], tuple[Floats, Floats]]:
    """psi = (G - W (W' K W)^-1 W') f, W the elastic columns of V (its fixed-interface modes, if it has any);
    and f' G f."""
    if "constraint" in reduced.mode_kind:
        count, pencil = reduced.mode_kind.count("constraint"), problem.fixed_interface
    elif "fixed-interface" in reduced.mode_kind:
        count, pencil = 0, problem.fixed_interface
    else:
        count, pencil = reduced.rigid_count, problem.free_free
    W, K = reduced.V[:, count:], reduced.K[count:, count:]
    factor = sl.cho_factor(K) if len(K) else None

    def static(F: Floats) -> tuple[Floats, Floats]:
        X = pencil.flexibility(F)
        compliance = np.einsum("ij,ij->j", F, X)
        for _ in range(2):
            # The second time takes round-off of the solve out.
            if factor is None:
                break
            problem.space.subtract(W, sl.cho_solve(factor, problem.space.dot(W, problem.K @ X)), X)
        return X, compliance

    return static


def _tables(
    problem: Problem,
    candidates: Candidates,
    reduced: ReducedModel,
    static: Callable[[Floats], tuple[Floats, Floats]],
    stress: Callable[[Floats], Floats] | None,
) -> StaticModeTables:
    """All tables, a block of candidates at a time; only the band's columns before the block stay."""
    space, budget = problem.space, problem.budget
    T, M, V, c, w = problem.coupling.T, problem.M, reduced.V, candidates.count, candidates.width()
    B = sp.csc_array(T.T @ candidates.loads)
    Bt = sp.csr_array(B.T)
    nodes, size = len(candidates.rows), len(V)
    R, Q = budget.empty((w + 1, c)), budget.empty((w + 1, c))
    coupling, gravity, compliance = np.zeros((reduced.order, c)), np.zeros((c, 3)), np.zeros(c)
    width = max(1, min(TOL.columns_at_once, budget.columns(size, copies=8), c))
    latest = _LatestColumns(budget.empty((size, w + width), order="F"), w)
    moving = M @ problem.coupling.R[:, :3]
    on_stress = _StressTable(candidates, w, problem) if stress is not None else None
    for first in range(0, c, width):
        last = min(first + width, c)
        Psi, compliance[first:last] = static(np.asarray(B[:, first:last].toarray()))
        columns = latest.push(Psi)
        MPsi, start = M @ Psi, last - columns.shape[1]
        coupling[:, first:last] = space.dot(V, MPsi)
        gravity[first:last] = Psi.T @ moving
        _into_band(R, np.asarray(Bt[start:last] @ Psi), start, first, w)
        _into_band(Q, space.dot(columns, MPsi), start, first, w)
        if on_stress is not None and stress is not None:
            on_stress.add(stress(Psi), first)
        progress.update(f"static modes: {last} of {c} candidates")
        budget.release_if_tight()
    model = problem.model
    alive = _alive(R[0], compliance, candidates)
    norms = np.sqrt(np.maximum(np.diag(reduced.M), np.finfo(float).tiny))
    cosine = np.abs(coupling[:, alive]) / norms[:, None] / np.sqrt(Q[0, alive])
    return StaticModeTables(
        kind=candidates.kind,
        node_ids=model.nodes.ids[candidates.rows],
        xyz=model.nodes.xyz[candidates.rows],
        node=candidates.node,
        direction=candidates.direction,
        turns=candidates.turns,
        modes=np.asarray(Bt @ V),
        stiffness=R,
        mass=Q,
        coupling=coupling,
        weight=V.T @ moving,
        static_weight=gravity,
        stress=None if stress is None else np.asarray(stress(V), dtype=np.float32),
        static_stress=None if on_stress is None else on_stress.values,
        stress_first=None if on_stress is None else on_stress.first,
        notes={
            "mass_coupling": float(cosine.max(initial=0.0)),
            "empty_candidates": int((~alive).sum()),
            "nodes": nodes,
            "candidates": c,
            "band": w,
        },
    )


def _alive(stiffness: Floats, compliance: Floats, candidates: Candidates) -> Bools:
    """(c,) which static modes have more than round-off of the ``compliance`` (c,) left, by their ``stiffness`` (c,).

    Raises:
        InputError: none.
    """
    largest = [compliance[candidates.turns == kind].max(initial=0.0) for kind in (False, True)]
    alive = np.asarray(stiffness > TOL.empty_mode * np.where(candidates.turns, largest[1], largest[0]))
    if not alive.any():
        raise InputError(
            "candidates: nothing is left of their static modes; the constant basis holds them all, or they do not move"
        )
    return alive


class _LatestColumns:
    """In an array that is given, the columns that came last, with ``count`` of those before them."""

    def __init__(self, space: Floats, count: int) -> None:
        self.space, self.count, self.filled = space, count, 0

    def push(self, block: Floats) -> Floats:
        """All that are there with a new ``block`` (N, k)."""
        old = min(self.filled, self.count)
        # A column at a time: they overlap.
        for k in range(old):
            self.space[:, k] = self.space[:, self.filled - old + k]
        self.filled = old + block.shape[1]
        self.space[:, old : self.filled] = block
        return self.space[:, : self.filled]


def _into_band(table: Floats, rows: Floats, row_first: int, first: int, w: int) -> None:
    """Entries i <= j of ``rows`` (i from row_first, j from first) into the band."""
    for column in range(rows.shape[1]):
        j = first + column
        top = max(j - w, row_first)
        table[: j - top + 1, j] = rows[top - row_first : j - row_first + 1, column][::-1]


class _StressTable:
    """Stress at each node of the candidates in its band, single precision."""

    def __init__(self, candidates: Candidates, w: int, problem: Problem) -> None:
        self.count, nodes = candidates.count, len(candidates.rows)
        self.width = min(candidates.count, 2 * w + 1)
        starts = np.searchsorted(candidates.node, np.arange(nodes))
        self.first = np.clip(starts - w, 0, candidates.count - self.width).astype(np.int64)
        self.values = problem.budget.empty((nodes, 6, self.width), np.float32)

    def add(self, stress: Floats, first: int) -> None:
        """Stresses (nodes, 6, k) of candidates from ``first`` on."""
        for k in range(stress.shape[2]):
            at = first + k - self.first
            here = np.flatnonzero((at >= 0) & (at < self.width))
            self.values[here, :, at[here]] = stress[here, :, k]
