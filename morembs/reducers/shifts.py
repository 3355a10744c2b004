"""Krylov blocks about one expansion point s, solved with one factor and kept with the problem.

Undamped and proportionally damped models have A(s) = (1 + beta s)(K + f(s) M), f = (s^2 + alpha s)/(1 + beta s): the
blocks of K - omega^2 M (or K + s^2 M) are real and match the damped transfer function where f(s) = -omega^2. A
model with its own D or G needs the second-order Krylov space of A(s); one that is not symmetric also that of its
transpose, for what the outputs see, from the same factor.

At s = 0 the elastic flexibility stands for the inverse of K, with the factor that the problem has anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg as sl

from morembs.base import progress
from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.types import Floats, Values
from morembs.linalg.columns import complement, map_columns
from morembs.linalg.second_order_arnoldi import PASSES, SecondOrderArnoldi
from morembs.linalg.sparse.solver import STRUCTURES
from morembs.problem import Dynamics, Problem, crew_of

Solve = Callable[[Values], Values]
# Backward error that a solution may have.
BACKWARD_ERROR = 1e-8
# An eigenvalue lambda of the body with |lambda - omega^2| below this part of omega^2 drowns all but its mode.
ON_EIGENVALUE = 1e-6
# A load that deforms the body by less than this part of itself is rigid.
RIGID_LOAD = 1e-10
MOVE, MOVES = 1.005, 3


@dataclass(eq=False)
class Wanted:
    """``count`` blocks started at the loads ``F`` (Nc, p), of A(s) or of its transpose."""

    F: Floats
    count: int
    transposed: bool = False


class KrylovChain:
    """M-orthonormal real blocks of one expansion point ``s``; ``deflated`` columns were lost in each."""

    def __init__(self, problem: Problem | Dynamics, s: complex, F: Floats, transposed: bool = False) -> None:
        self.problem, self.s, self.F, self.transposed = problem, s, F, transposed
        self.blocks: list[Floats] = []
        self.deflated: list[int] = []
        self.space: SecondOrderArnoldi | None = None
        # Of blocks that another process made, which kept what further ones need: whether there are any.
        self.ended: bool | None = None

    @property
    def finished(self) -> bool:
        """Whether a further block would be empty."""
        if self.space is not None:
            return self.space.finished
        if self.ended is not None:
            return self.ended
        return bool(self.blocks) and not self.blocks[-1].shape[1]

    def extend(self, solve: Solve, count: int) -> None:
        """Blocks up to ``count``, as far as there are any."""
        while len(self.blocks) < count and not self.finished:
            if self.problem.velocity_matrix is None:
                self._arnoldi(solve)
            else:
                self._second_order(solve)

    def _arnoldi(self, solve: Solve) -> None:
        """The orthonormal block is the next right-hand side: raw powers would lose directions after a few blocks."""
        budget = self.problem.budget
        W = solve(self.problem.M @ self.blocks[-1] if self.blocks else self.F)
        width = W.shape[1]
        W = complement(self.blocks, W, self.problem.M, budget, passes=PASSES)
        self.deflated.append(width - W.shape[1])
        self.F = np.zeros((0, 0))
        self.blocks.append(budget.store(np.asfortranarray(W)))

    def _second_order(self, solve: Solve) -> None:
        problem, D = self.problem, self.problem.velocity_matrix
        if self.space is None:
            if D is None:
                raise InputError("the second-order Krylov space needs a damping matrix; this model has none")
            start, self.F = solve(self.F), np.zeros((0, 0))
            self.space = SecondOrderArnoldi(
                problem.M,
                D.T if self.transposed else D,
                start,
                shift=self.s,
                scale=self._scale(start),
                budget=problem.budget,
            )
        else:
            self.space.expand(solve)
        Q = self.space.blocks[-1]
        self.deflated.append(self.space.deflated[-1])
        # Re and Im span what a block and its conjugate span: the basis serves s and its conjugate.
        self.blocks.append(np.hstack([Q.real, Q.imag]) if Q.dtype.kind == "c" else Q)

    def _scale(self, start: Values) -> float:
        """A frequency in rad/s: that of the expansion point, or at zero that of the deformation under the loads."""
        if self.s:
            return abs(self.s)
        return float(np.sqrt(np.vdot(start, self.problem.K @ start) / np.vdot(start, self.problem.M @ start)))


class ExpansionPoint:
    """An expansion point as asked for, and ``at``, where it was moved to; holds the chains made there."""

    def __init__(self, problem: Problem | Dynamics, asked: complex) -> None:
        self.problem, self.asked, self.at, self.moves = problem, asked, asked, 0
        self.chains: dict[object, KrylovChain] = {}
        self._weight = 1.0 / np.sqrt(np.maximum(problem.K.diagonal(), np.finfo(float).tiny))
        self._weight[problem.K.diagonal() <= 0] = 0.0

    @property
    def fresh(self) -> bool:
        """Whether nothing was made here yet, and a factor is needed for it."""
        return bool(self.asked) and not self.chains and not self.moves

    def grow(self, wanted: Mapping[object, Wanted]) -> list[KrylovChain]:
        """The wanted chains, as long as wanted or as the space is; at most one factorisation where nothing moves.

        A point on an eigenvalue is moved by half a percent, up to three times.

        Raises:
            SolverError: there is no regular A(s) near the expansion point.
        """
        missing = self.lacks(wanted)
        while missing:
            try:
                self._extend(wanted)
                break
            except BudgetError:
                raise
            except (SingularMatrixError, SolverError) as error:
                if not self.asked:
                    raise
                if not complex(self.asked).imag:
                    raise SolverError(
                        f"at the real shift {self.asked.real:.6g} 1/s nothing can be solved; take a larger one, or "
                        f"0.0 among shifts_hz ({error})"
                    ) from error
                if self.moves == MOVES:
                    raise SolverError(
                        f"shift {frequency(self.asked):.6g} Hz and {MOVES} places above it, up to "
                        f"{frequency(self.at):.6g} Hz, lie on eigenvalues or on rigid-body motion; take a shift a few "
                        f"percent away, or 0 ({error})"
                    ) from error
                self.chains.clear()
                self.at, self.moves = self.at * MOVE, self.moves + 1
        return [self.chains[key] for key in wanted]

    def lacks(self, wanted: Mapping[object, Wanted]) -> bool:
        """Whether blocks of ``wanted`` are still to be made."""
        return not all(self._long_enough(key, want.count) for key, want in wanted.items())

    def take(self, grown: Grown, wanted: Mapping[object, Wanted]) -> None:
        """Chains that another process made of ``wanted``."""
        self.at, self.moves = grown.at, grown.moves
        for key, (blocks, deflated, ended) in zip(wanted, grown.chains, strict=True):
            chain = self.chains[key] = KrylovChain(self.problem, self.at, np.zeros((0, 0)))
            chain.blocks, chain.deflated, chain.ended = blocks, deflated, ended

    def _long_enough(self, key: object, count: int) -> bool:
        chain = self.chains.get(key)
        return chain is not None and (len(chain.blocks) >= count or chain.finished)

    def _extend(self, wanted: Mapping[object, Wanted]) -> None:
        problem = self.problem
        if not self.at and problem.N is None:
            if isinstance(problem, Dynamics):
                raise SolverError("statics are solved with the factor of the problem, not by other processes")
            flexibility = problem.elastic.flexibility
            self._extend_with(lambda F, transposed: map_columns(flexibility, F, problem.budget), wanted)
            return
        s = self.at if complex(self.at).imag else complex(self.at).real
        problem.budget.release_pages()
        with problem.stiffness.factorize(s) as factor:
            kind = factor.dtype

            def solve(F: Values, transposed: bool) -> Values:
                X = map_columns(partial(factor.solve, transposed=transposed), F, problem.budget, kind)
                self._check(F, X, transposed)
                return X

            self._extend_with(solve, wanted)

    def _extend_with(self, solve: Callable[[Values, bool], Values], wanted: Mapping[object, Wanted]) -> None:
        elastic = not self.problem.damps_rigid_motion
        M, Z = self.problem.M, self.problem.rigid

        def deformation(F: Values, transposed: bool) -> Values:
            X = solve(F, transposed)
            # Round-off along rigid motion would grow from block to block.
            return X - Z @ (Z.T @ (M @ X)) if elastic else X

        for key, want in wanted.items():
            if self._long_enough(key, want.count):
                continue
            chain = self.chains.get(key)
            if chain is not None and chain.ended is not None:
                chain = None
            fresh = KrylovChain(self.problem, self.at, want.F, want.transposed) if chain is None else chain
            fresh.extend(partial(deformation, transposed=want.transposed), want.count)
            if chain is None:
                self._refuse_near_eigenvalue(fresh)
                self.chains[key] = fresh

    def _check(self, F: Values, X: Values, transposed: bool) -> None:
        """Backward error of a solution, with rows scaled so that forces and moments count alike."""
        A = apply(self.problem, self.at, X, transposed)
        d = self._weight[:, None]
        small = np.linalg.norm(d * (A - F), axis=0)
        size = np.linalg.norm(d * F, axis=0) + np.linalg.norm(X / np.where(d > 0, d, np.inf), axis=0)
        error = float((small / np.where(size > 0, size, 1.0)).max(initial=0.0))
        if not error <= BACKWARD_ERROR:
            raise SolverError(f"solved at {frequency(self.at):.6g} Hz to a backward error of {error:.1e} only")

    def _refuse_near_eigenvalue(self, chain: KrylovChain) -> None:
        """A mode that drowns the others shows as a Rayleigh quotient next to the shift."""
        w2 = complex(self.at).imag ** 2
        own = self.problem.velocity_matrix is not None or self.problem.N is not None
        if not w2 or own or not chain.blocks[0].shape[1]:
            return
        Q = chain.blocks[0]
        distance = np.abs(sl.eigvalsh(Q.T @ (self.problem.K @ Q)) - w2).min()
        if distance < ON_EIGENVALUE * w2:
            raise SingularMatrixError(f"{frequency(self.at):.6g} Hz is an eigenfrequency")


def expansion_point(problem: Problem, s: complex) -> ExpansionPoint:
    """The expansion point ``s`` (1/s) of a problem, which all reducers share."""
    return problem.shared(("krylov shift", complex(s)), lambda: ExpansionPoint(problem, complex(s)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Grown:
    """What a process made of an expansion point: where it was moved to, and blocks, losses and end of each chain."""

    at: complex
    moves: int
    chains: list[tuple[list[Floats], list[int], bool]]


def grow_at_once(problem: Problem, points: Sequence[ExpansionPoint], wanted: Sequence[Mapping[object, Wanted]]) -> None:
    """Grow several expansion points on the workers of ``problem``, one factorisation each; one worker grows none.

    Loads (Nc, p) of one key are the same at all points. Points at zero are left out, as the problem has their factor.

    Raises:
        SolverError: as ``ExpansionPoint.grow`` for the first point where that fails, or a worker was ended.
    """
    open_ = [(point, want) for point, want in zip(points, wanted, strict=True) if point.fresh and point.lacks(want)]
    if problem.workers < 2 or len(open_) < 2:
        return
    loads = {key: each.F for _, want in open_ for key, each in want.items()}
    tasks = [(point.asked, {k: (each.count, each.transposed) for k, each in want.items()}) for point, want in open_]
    columns = sum(F.shape[1] for F in loads.values())
    structure = max((problem.stiffness.structure_at(point.asked) for point, _ in open_), key=STRUCTURES.index)
    with crew_of(problem, loads, tasks=len(tasks), columns=columns, structure=structure) as crew:
        if crew.workers < 2:
            return
        for number, ((point, want), grown) in enumerate(zip(open_, crew.each(_grown, tasks), strict=True)):
            progress.update(f"shift {number + 1} of {len(tasks)}, on {crew.workers} workers")
            point.take(grown, want)


def _grown(
    shared: tuple[Dynamics, Mapping[object, Floats]], task: tuple[complex, Mapping[object, tuple[int, bool]]]
) -> Grown:
    dynamics, loads = shared
    s, counts = task
    point = ExpansionPoint(dynamics, s)
    chains = point.grow({key: Wanted(loads[key], *asked) for key, asked in counts.items()})
    parts = [(chain.blocks, chain.deflated, chain.finished) for chain in chains]
    return Grown(at=point.at, moves=point.moves, chains=parts)


def frequency(s: complex) -> float:
    """|s| in Hz."""
    return float(abs(s) / (2 * np.pi))


def apply(problem: Problem | Dynamics, s: complex, X: Values, transposed: bool = False) -> Values:
    """A(s) X (Nc, k), or A(s)' X, without the proportional damping of the problem."""
    square: complex = s * s
    s, square = (x.real if not complex(x).imag else x for x in (complex(s), complex(square)))
    out = problem.K @ X + square * (problem.M @ X)
    for factor, A in ((s, problem.velocity_matrix), (1.0, problem.N)):
        if A is not None:
            out = out + factor * ((A.T if transposed else A) @ X)
    return np.asarray(out)
