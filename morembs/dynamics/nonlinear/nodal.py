"""Generalised-alpha (Chung and Hulbert 1993) on the nodes x(q) of a mechanism, with the coordinates q as unknowns.

J(q)' (M d2x/dt2 - f) + dV/dq = 0 holds at every step, J = dx/dq. The mass of reduced members is therefore exact and
neither a derivative of J nor a Christoffel symbol is needed; x takes the place of q in the update formulas. Reduced
members give few amplitudes of fields for x, which is the same to round-off and does not grow with the mesh.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy.linalg.lapack import dgetrf as getrf
from scipy.linalg.lapack import dgetrs as getrs

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import SpectralRadius, one_of
from morembs.base.types import Floats
from morembs.dynamics.multibody.integrate import Scheme
from morembs.dynamics.nonlinear.mechanism import Mechanism
from morembs.dynamics.nonlinear.member import MemberState
from morembs.dynamics.nonlinear.tolerances import TOL


class LeftTablesError(SolverError):
    """A coordinate left the range of its table; ``share`` is its value over the range."""

    def __init__(self, message: str, *, share: float) -> None:
        super().__init__(message)
        self.share = share


@dataclass(frozen=True, kw_only=True, eq=False)
class MechanismMotion:
    """A simulated motion of T times.

    ``times`` (T,) s; ``q`` (T, size); ``x``: per member (N, T) coordinates of its motion, of which ``member.nodes``
    makes those of its component; ``kinetic``, ``potential`` (T,) J, gravity included; ``iterations``: mean number per
    step; ``dissipated`` (T,) J by damping; ``warnings``: losses, with time and coordinate.
    """

    times: Floats
    q: Floats
    x: tuple[Floats, ...]
    kinetic: Floats
    potential: Floats
    dissipated: Floats
    iterations: float
    warnings: tuple[str, ...]


class _Run:
    """The mechanism at one configuration: nodes of all members in one vector, point masses last."""

    def __init__(self, mechanism: Mechanism, outside: str, dense_entries: int) -> None:
        self.mechanism, self.outside = mechanism, outside
        blocks = [m.M for m in mechanism.members] + [mass * sp.eye(2) for _, mass in mechanism.masses]
        self.M = sp.block_diag(blocks, format="csr")
        cuts = np.cumsum([0, *(b.shape[0] for b in blocks)])
        self.slices = [slice(int(a), int(b)) for a, b in pairwise(cuts)]
        fall = np.concatenate([np.zeros(0), *(m.rigid[:, :2] @ mechanism.gravity for m in mechanism.members)])
        fall = np.concatenate((fall, np.tile(mechanism.gravity, len(mechanism.masses))))
        self.weight = self.M @ fall
        self.dense = self.M.shape[0] * mechanism.size <= dense_entries
        # Amplitudes of reduced members have diagonal masses.
        diagonal = self.M.diagonal()
        self.masses = diagonal if self.dense and self.M.nnz == np.count_nonzero(diagonal) else None
        if self.dense:
            self.M = self.M.toarray()
        # Coordinates of members and masses that can move, and their numbers in the mechanism.
        every = [*mechanism.numbers, *(point.numbers for point, _ in mechanism.masses)]
        self.free = [(free, numbers[free]) for numbers in every for free in [np.flatnonzero(numbers >= 0)]]
        self.warnings: dict[str, str] = {}
        self.shares: dict[int, tuple[float, float]] = {}

    def at(self, q: Floats, t: float) -> tuple[Floats, list[MemberState], Any]:
        """Nodes x, the members, and J = dx/dq."""
        mechanism = self.mechanism
        states = [member.at(mechanism.configuration(k, q, t)) for k, member in enumerate(mechanism.members)]
        points = [np.where(point.numbers >= 0, q[point.numbers], point.at(t)) for point, _ in mechanism.masses]
        x = np.concatenate([*(m.x for m in states), *points])
        shape = self.M.shape[0], mechanism.size
        matrices = [*(m.J for m in states), *(None for _ in mechanism.masses)]
        if self.dense:
            J = np.zeros(shape)
            for part, (free, columns), matrix in zip(self.slices, self.free, matrices, strict=True):
                if matrix is None:
                    J[part.start + free, columns] = 1
                else:
                    J[part, columns] = matrix[:, free]
            return x, states, J
        rows, places, values = [], [], []
        for part, (free, columns), matrix in zip(self.slices, self.free, matrices, strict=True):
            count = part.stop - part.start
            rows.append(part.start + (free if matrix is None else np.repeat(np.arange(count), len(free))))
            places.append(columns if matrix is None else np.tile(columns, count))
            values.append(np.ones(len(free)) if matrix is None else matrix[:, free].ravel())
        where = np.concatenate(rows), np.concatenate(places)
        return x, states, sp.csr_matrix((np.concatenate(values), where), shape=shape)

    def inertia(self, x: Floats) -> Floats:
        """M x."""
        return np.asarray(self.M @ x if self.masses is None else self.masses * x)

    def forces(self, t: float, states: list[MemberState]) -> Floats:
        """dV/dq less torques (size,)."""
        total = np.zeros(self.mechanism.size)
        for (free, columns), state in zip(self.free, states, strict=False):
            total[columns] += state.force[free]
        for number, torque in self.mechanism.torques:
            total[number] -= torque(t)
        return total

    def damping(self, t: float, states: list[MemberState], rate: Floats) -> Floats:
        """Forces (size,) of damping at the ``rate`` (size,) dq/dt, on the side of ``forces``."""
        total, ahead = np.zeros(self.mechanism.size), TOL.motion_rate_step
        for k, (state, (free, columns)) in enumerate(zip(states, self.free, strict=False)):
            if state.strains is None:
                raise InputError(
                    f"damping was given, and member {k} does not say which of its stiffness resists strains; expected "
                    "beams and reduced members",
                    kind="unsupported",
                    keyword="damping",
                )
            local = np.zeros(self.mechanism.members[k].size)
            local[free] = rate[columns]
            for place, motion in self.mechanism.drives[k]:
                local[place] += (motion(t + ahead) - motion(t - ahead)) / (2 * ahead)
            total[columns] += self.mechanism.damping * (state.strains() @ local)[free]
        return total

    def factor(
        self, states: list[MemberState], J: Any, scale: float, stiffer: float = 1.0
    ) -> Callable[[Floats], Floats]:
        """Solver of scale J'MJ + d2V/dq2, the latter ``stiffer`` times."""
        A = scale * (J.T @ (self.M @ J if self.masses is None else self.masses[:, None] * J))
        if self.dense:
            for (free, columns), state in zip(self.free, states, strict=False):
                K = state.stiffness()
                S = K if isinstance(K, np.ndarray) else K.toarray()
                A[columns[:, None], columns] += stiffer * S[free[:, None], free]
            lu, pivots, _ = getrf(A)
            return lambda right: np.asarray(getrs(lu, pivots, right)[0])
        for numbers, state in zip(self.mechanism.numbers, states, strict=True):
            K = sp.coo_matrix(state.stiffness())
            i, j = numbers[K.row], numbers[K.col]
            free = (i >= 0) & (j >= 0)
            A = A + sp.csr_matrix((stiffer * K.data[free], (i[free], j[free])), shape=A.shape)
        factor = spl.splu(sp.csc_matrix(A))
        return lambda right: np.asarray(factor.solve(right))

    def watch(self, t: float, q: Floats, states: list[MemberState], load: Floats) -> None:
        """Range of the tables and modes left out, at the end of a step.

        Raises:
            LeftTablesError: a coordinate left its table and the motion shall stop there.
        """
        for k, member in enumerate(self.mechanism.members):
            local = self.mechanism.configuration(k, q, t)
            left = member.outside(local)
            if left is not None:
                name, value, limit = left
                text = f"member {k}: {name} = {value:.4g} left its tabulated range of +-{limit:.4g} at t = {t:.6g} s"
                if self.outside == "stop":
                    raise LeftTablesError(
                        f"{text}. Tabulate a larger range, divide the member into "
                        f"{math.ceil(abs(value) / limit / TOL.wanted_table_part)} or more, or continue with "
                        "outside='continue' (tables go on as straight lines, results lose accuracy)",
                        share=abs(value) / limit,
                    )
                self.warnings.setdefault(f"{k}{name}", f"{text}; from there on the tables are extended")
            share = member.estimate_neglected(local, states[k], load[self.slices[k]])
            if share > max(TOL.neglected_answer, self.shares.get(k, (0.0, 0.0))[0]):
                self.shares[k] = share, t

    def sentences(self) -> tuple[str, ...]:
        """All warnings."""
        modes = (
            f"member {k}: modes left out would answer with {share:.2g} of its length (the most, at t = {t:.6g} s); "
            "take more modes, or divide it into more members"
            for k, (share, t) in sorted(self.shares.items())
        )
        return (*self.warnings.values(), *modes)


@checked
def simulate(
    mechanism: Mechanism,
    *,
    end: float,
    step: float,
    rho: SpectralRadius = TOL.default_rho,
    tolerance: float = TOL.node_change,
    outside: Annotated[str, one_of("stop", "continue")] = "stop",
    dense_entries: int = TOL.dense_entries,
) -> MechanismMotion:
    """Motion from rest to ``end`` (s) in steps of ``step`` (s).

    Args:
        rho: spectral radius at infinite frequency, 0 to 1.
        tolerance: largest last change of a node in a step, in m and rad per unit of size.
        outside: "stop" where a coordinate leaves its table, or "continue" with a warning in the result.
        dense_entries: entries of the Jacobian of the nodes up to which matrices are dense; larger ones are sparse.

    Raises:
        InputError: wrong numbers, an empty mechanism.
        SolverError: no convergence; LeftTablesError, which is one, where a coordinate leaves its table.
    """
    scheme = Scheme(rho=rho)
    if not mechanism.members or mechanism.size == 0:
        raise InputError(
            "the mechanism has no member that can move; add members between points", kind="missing", keyword="members"
        )
    loose = np.setdiff1d(np.arange(mechanism.size), np.concatenate(mechanism.numbers))
    if len(loose):
        raise InputError(
            f"{len(loose)} coordinates of points or angles (numbers {', '.join(map(str, loose[:5]))}) belong to no "
            "member; attach members there, or leave the points out",
            kind="model",
            keyword="points",
        )
    if not (0 < step <= end and np.isfinite(end)):
        raise InputError(f"step = {step} s and end = {end} s were given; expected 0 < step <= end", keyword="step")
    return _Integration(_Run(mechanism, outside, dense_entries), scheme, step, tolerance).run(round(end / step))


class _Integration:
    def __init__(self, run: _Run, scheme: Scheme, h: float, tolerance: float) -> None:
        self.run_, self.h, self.scheme = run, h, scheme
        self.tolerance = tolerance * max(TOL.least_size, min(m.length for m in run.mechanism.members))
        self.q = run.mechanism.start()
        self.past = [self.q] * 3
        self.x, states, J = run.at(self.q, 0.0)
        self.iterations = 0
        # At rest: the acceleration of the nodes is J d2q/dt2 and that of prescribed motions, and its rate is zero
        # unless one of them or a torque jumps. A little of the stiffness stands in where a coordinate has no mass.
        scale, prescribed = (1e4 / h) ** 2, self._prescribed_accelerations()
        load = J.T @ (run.weight - run.inertia(prescribed)) - run.forces(0.0, states)
        self.rate = prescribed + J @ (scale * run.factor(states, J, scale)(load))
        self.v, self.auxiliary = np.zeros_like(self.x), self.rate.copy()
        self.states = states
        self.drag, self.loss = np.zeros_like(self.q), 0.0

    def _prescribed_accelerations(self) -> Floats:
        """Accelerations of the nodes by prescribed motions alone, from after the start: none is known before it."""
        mechanism, d = self.run_.mechanism, TOL.start_part * self.h
        if not any(mechanism.drives) and all(point.motion is None for point, _ in mechanism.masses):
            return np.zeros_like(self.x)
        x = [self.run_.at(self.q, k * d)[0] for k in range(4)]
        return np.asarray((2 * x[0] - 5 * x[1] + 4 * x[2] - x[3]) / d**2)

    def run(self, steps: int) -> MechanismMotion:
        size, run = self.run_.mechanism.size, self.run_
        q, x = np.empty((steps + 1, size)), np.empty((steps + 1, len(self.x)))
        kinetic, potential, dissipated = np.zeros((3, steps + 1))
        for k in range(steps + 1):
            if k:
                self._advance(k * self.h)
            run.watch(k * self.h, self.q, self.states, run.weight - run.inertia(self.rate))
            q[k], x[k] = self.q, self.x
            dissipated[k] = self.loss
            kinetic[k] = 0.5 * float(self.v @ run.inertia(self.v))
            potential[k] = sum(m.V for m in self.states) - float(run.weight @ self.x)
        count = len(run.mechanism.members)
        return MechanismMotion(
            times=np.asarray(self.h * np.arange(steps + 1), dtype=np.float64),
            q=q,
            x=tuple(x[:, s].T for s in run.slices[:count]),
            kinetic=kinetic,
            potential=potential,
            dissipated=np.cumsum(dissipated),
            iterations=self.iterations / max(1, steps),
            warnings=run.sentences(),
        )

    def _advance(self, t: float) -> None:
        a, h, run = self.scheme, self.h, self.run_
        c = (1 - a.alpha_m) / ((1 - a.alpha_f) * a.beta * h * h)
        # The first guess goes on as in the last two steps.
        old, factor, last, damping = self.x, None, np.inf, run.mechanism.damping
        q = 3 * self.q - 3 * self.past[1] + self.past[0]
        x, states, J = run.at(q, t)
        first = True
        for _ in range(TOL.step_iterations):
            self.iterations += 1
            auxiliary = ((x - old) / h - self.v) / (a.beta * h) - (0.5 - a.beta) / a.beta * self.auxiliary
            rate = ((1 - a.alpha_m) * auxiliary + a.alpha_m * self.auxiliary - a.alpha_f * self.rate) / (1 - a.alpha_f)
            if factor is None:
                # The rate of second order takes 3/2 of the last change (BDF2).
                factor = run.factor(states, J, c, 1 + 1.5 * damping / h)
            residual = J.T @ (run.inertia(rate) - run.weight) + run.forces(t, states)
            if damping:
                residual += self._drag(q, t, states)
            dq = -factor(residual)
            size = float(np.abs(J @ dq).max())
            if not np.isfinite(size):
                break
            q += dq
            x, states, J = run.at(q, t)
            if size <= self.tolerance:
                auxiliary = ((x - old) / h - self.v) / (a.beta * h) - (0.5 - a.beta) / a.beta * self.auxiliary
                rate = (1 - a.alpha_m) * auxiliary + a.alpha_m * self.auxiliary - a.alpha_f * self.rate
                self.rate = rate / (1 - a.alpha_f)
                self.v = self.v + h * ((1 - a.gamma) * self.auxiliary + a.gamma * auxiliary)
                if damping:
                    drag = self._drag(q, t, states)
                    self.loss, self.drag = 0.5 * float((drag + self.drag) @ (q - self.q)), drag
                self.x, self.q, self.auxiliary, self.states = x, q, auxiliary, states
                self.past = [*self.past[1:], q]
                return
            if first or size > TOL.slow_ratio * last:
                factor, first = None, False
            last = size
        raise SolverError(
            f"the step to t = {t:.6g} s with h = {h:.3g} s does not converge in {TOL.step_iterations} iterations (last "
            f"change {last:.2g}, limit {self.tolerance:.2g}, in m and rad). Take a smaller step"
        )

    def _drag(self, q: Floats, t: float, states: list[MemberState]) -> Floats:
        """Damping at the end of a step, with the rate of second order from two steps (BDF2)."""
        return self.run_.damping(t, states, (3 * q - 4 * self.past[2] + self.past[1]) / (2 * self.h))
