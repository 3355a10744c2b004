"""Krylov blocks about one expansion point s, solved with one factor and kept with the problem.

Undamped and proportionally damped models have A(s) = (1 + beta s)(K + f(s) M), f = (s^2 + alpha s)/(1 + beta s): the
blocks of K - omega^2 M (or K + s^2 M) are real and match the damped transfer function where f(s) = -omega^2. A
model with its own D or G needs the second-order Krylov space of A(s); one that is not symmetric also that of its
transpose, for what the outputs see, from the same factor.

At s = 0 the elastic flexibility stands for the inverse of K, with the factor that the problem has anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from morembs.base import progress
from morembs.base.errors import BudgetError, InputError, SingularMatrixError, SolverError
from morembs.base.types import Floats, Values
from morembs.base.units import in_hz
from morembs.linalg.second_order_arnoldi import SecondOrderArnoldi
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Problem, System
from morembs.problem.system import Solve
from morembs.reducers.tolerances import TOL


@dataclass(eq=False)
class KrylovStart:
    """``count`` blocks started at the loads ``F`` (Nc, p), of A(s) or of its transpose."""

    F: Floats
    count: int
    transposed: bool = False


class KrylovChain:
    """M-orthonormal real blocks of one expansion point ``s``; ``deflated`` columns were lost in each."""

    def __init__(self, system: System, s: complex, F: Floats, transposed: bool = False) -> None:
        self.system, self.s, self.F, self.transposed = system, s, F, transposed
        self.blocks: list[Floats] = []
        self.deflated: list[int] = []
        self.space: SecondOrderArnoldi | None = None
        # Of blocks that another process made, which kept what further ones need: whether there are any.
        self.ended: bool | None = None

    @property
    def finished(self) -> bool:
        """True if a further block would be empty."""
        if self.space is not None:
            return self.space.finished
        if self.ended is not None:
            return self.ended
        return bool(self.blocks) and not self.blocks[-1].shape[1]

    def extend(self, solve: Solve, count: int) -> None:
        """Blocks up to ``count``, as far as there are any."""

        def columns(F: Values) -> Values:
            X = solve(F, transposed=self.transposed)
            # Elastic motions by rows, as products with M take them.
            return X if self.system.damps_rigid_motion else np.ascontiguousarray(X)

        while len(self.blocks) < count and not self.finished:
            if self.system.velocity_matrix is None:
                self._arnoldi(columns)
            else:
                self._second_order(columns)

    def _arnoldi(self, solve: Callable[[Values], Values]) -> None:
        """The orthonormal block is the next right-hand side: raw powers would lose directions after a few blocks."""
        M, space = self.system.M, self.system.space
        W = solve(M @ self.blocks[-1] if self.blocks else self.F)
        width = W.shape[1]
        W = space.complement(self.blocks, W, passes=LINALG.krylov_passes)
        self.deflated.append(width - W.shape[1])
        self.F = np.zeros((0, 0))
        self.blocks.append(space.budget.store(np.asfortranarray(W)))

    def _second_order(self, solve: Callable[[Values], Values]) -> None:
        system, D = self.system, self.system.velocity_matrix
        if self.space is None:
            if D is None:
                raise InputError(
                    "the second-order Krylov space needs a damping matrix; this model has none", kind="missing"
                )
            start, self.F = solve(self.F), np.zeros((0, 0))
            self.space = SecondOrderArnoldi(
                system.space, D.T if self.transposed else D, start, shift=self.s, scale=self._scale(start)
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
        return float(np.sqrt(np.vdot(start, self.system.K @ start) / np.vdot(start, self.system.M @ start)))


class ExpansionPoint:
    """An expansion point as asked for, and ``at``, where it was moved to; holds the chains made there.

    ``flexibility`` stands for the inverse of K, which is singular for a free body.
    """

    def __init__(self, system: System, asked: complex, flexibility: Callable[[Values], Values] | None = None) -> None:
        self.system, self.asked, self.at, self.moves = system, asked, asked, 0
        self.flexibility = flexibility
        self.chains: dict[object, KrylovChain] = {}

    @property
    def fresh(self) -> bool:
        """True if nothing was made here yet, and a factor is needed for it."""
        return bool(self.asked) and not self.chains and not self.moves

    def extend(self, wanted: Mapping[object, KrylovStart]) -> list[KrylovChain]:
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
                if self.moves == TOL.shift_moves:
                    raise SolverError(
                        f"shift {in_hz(abs(self.asked)):.6g} Hz and {TOL.shift_moves} places above it, up to "
                        f"{in_hz(abs(self.at)):.6g} Hz, lie on eigenvalues or on rigid-body motion; take a shift a few "
                        f"percent away, or 0 ({error})",
                        keyword="shifts_hz",
                    ) from error
                self.chains.clear()
                self.at, self.moves = self.at * TOL.shift_move, self.moves + 1
        return [self.chains[key] for key in wanted]

    def lacks(self, wanted: Mapping[object, KrylovStart]) -> bool:
        """True if blocks of ``wanted`` are still to be made."""
        return not all(self._long_enough(key, want.count) for key, want in wanted.items())

    def take(self, grown: KrylovBlocks, wanted: Mapping[object, KrylovStart]) -> None:
        """Chains that another process made of ``wanted``."""
        self.at, self.moves = grown.at, grown.moves
        for key, (blocks, deflated, ended) in zip(wanted, grown.chains, strict=True):
            chain = self.chains[key] = KrylovChain(self.system, self.at, np.zeros((0, 0)))
            chain.blocks, chain.deflated, chain.ended = blocks, deflated, ended

    def _long_enough(self, key: object, count: int) -> bool:
        chain = self.chains.get(key)
        return chain is not None and (len(chain.blocks) >= count or chain.finished)

    def _extend(self, wanted: Mapping[object, KrylovStart]) -> None:
        with self._inverse() as solve:
            for key, want in wanted.items():
                if self._long_enough(key, want.count):
                    continue
                chain = self.chains.get(key)
                if chain is not None and chain.ended is None:
                    chain.extend(solve, want.count)
                    continue
                fresh = KrylovChain(self.system, self.at, want.F, want.transposed)
                fresh.extend(solve, want.count)
                self._refuse_near_eigenvalue(fresh)
                self.chains[key] = fresh

    @contextmanager
    def _inverse(self) -> Iterator[Solve]:
        """The inverse of A(s) without proportional damping, and without rigid motion, whose round-off would grow."""
        system, flexibility = self.system, self.flexibility
        if self.at or system.N is not None:
            with system.inverse(self.at, damped=False) as solve:
                yield solve
            return
        if flexibility is None:
            raise SolverError("statics are solved with the factor of the problem, not by other processes")
        yield lambda F, *, transposed=False: system.elastic_part(system.space.map_columns(flexibility, F))

    def _refuse_near_eigenvalue(self, chain: KrylovChain) -> None:
        """A mode that drowns the others shows as a Rayleigh quotient next to the shift."""
        w2 = complex(self.at).imag ** 2
        own = self.system.velocity_matrix is not None or self.system.N is not None
        if not w2 or own or not chain.blocks[0].shape[1]:
            return
        Q = chain.blocks[0]
        distance = np.abs(sl.eigvalsh(Q.T @ (self.system.K @ Q)) - w2).min()
        if distance < TOL.on_eigenvalue * w2:
            raise SingularMatrixError(f"{in_hz(abs(self.at)):.6g} Hz is an eigenfrequency")


def expansion_point(problem: Problem, s: complex) -> ExpansionPoint:
    """The expansion point ``s`` (1/s) of a problem, which all reducers share."""

    def flexibility(F: Values) -> Values:
        return problem.free_free.flexibility(F)

    return problem.compute_once(
        ("krylov shift", complex(s)), lambda: ExpansionPoint(problem.system, complex(s), flexibility)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class KrylovBlocks:
    """What a process made of an expansion point: where it was moved to, and blocks, losses and end of each chain."""

    at: complex
    moves: int
    chains: list[tuple[list[Floats], list[int], bool]]


def extend_in_parallel(
    problem: Problem, points: Sequence[ExpansionPoint], wanted: Sequence[Mapping[object, KrylovStart]]
) -> None:
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
    asked = [point.asked for point, _ in open_]
    with problem.system.worker_pool(loads, asked, workers=problem.workers, columns=columns, damped=False) as pool:
        if pool.workers < 2:
            return
        for number, ((point, want), grown) in enumerate(zip(open_, pool.each(_extend_point, tasks), strict=True)):
            progress.update(f"shift {number + 1} of {len(tasks)}, on {pool.workers} workers")
            point.take(grown, want)


def _extend_point(
    shared: tuple[System, Mapping[object, Floats]], task: tuple[complex, Mapping[object, tuple[int, bool]]]
) -> KrylovBlocks:
    system, loads = shared
    s, counts = task
    point = ExpansionPoint(system, s)
    chains = point.extend({key: KrylovStart(loads[key], *asked) for key, asked in counts.items()})
    parts = [(chain.blocks, chain.deflated, chain.finished) for chain in chains]
    return KrylovBlocks(at=point.at, moves=point.moves, chains=parts)
