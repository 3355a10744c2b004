"""Krylov bases: transfer functions matched at expansion points (Grimme 1997, Lehner and Eberhard 2006).

V = span of A(s_k)^-1 F and further blocks. One block makes H and, for loads and motions of the same interfaces,
dH/df exact at the point; J blocks match J moments for any outputs and 2J for those of the loads themselves.
With Rayleigh, modal or structural damping the undamped matrices are factorised and the basis is real (Beattie and
Gugercin 2005): moments are those without damping, and H with it is near them, far off at points among resonances; a
model with its own D takes the second-order Krylov space, [Re, Im] of it at imaginary points. One with G or N takes the
space of the transpose, A(s_k)^-T C', beside it, and projects by congruence on both: moments from inputs to outputs are
matched as often as by two sides, damping stays damping and gyroscopic terms do no work.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base import progress
from morembs.base.errors import InputError, nearest
from morembs.base.limits import Hertz, PositiveCount, number
from morembs.base.tolerances import TOL as BASE
from morembs.base.types import Floats
from morembs.base.units import in_hz
from morembs.linalg.tolerances import TOL as LINALG
from morembs.problem import Problem
from morembs.reducers.base import Basis, Reducer, elastic_basis
from morembs.reducers.petrov_galerkin import two_sided_basis
from morembs.reducers.problem_summary import ProblemSummary, ShiftedFactorisations
from morembs.reducers.shifts import KrylovStart, expansion_point, extend_in_parallel
from morembs.reducers.tolerances import TOL
from morembs.responses.loads import elastic_part, inertia_loads, load_scale

Rate = Annotated[float, number("a positive number in 1/s", gt=0, lt=BASE.largest_hz)]


@dataclass(frozen=True, kw_only=True)
class Krylov(Reducer):
    """Moments of the transfer matrix at expansion points.

    ``two_sided`` matches J + J moments from inputs to outputs at half the order that both would take. It gives up
    symmetry; for equal inputs and outputs it would be the one-sided method, and is refused. An unstable result is
    refused too: the rule between far ends, where residues of both signs have complex poles (Feldmann and Freund 1995).
    One side with the columns of both has the same moments at twice the order, and is stable.

    Args:
        shifts_hz: expansion points i 2 pi f.
        real_shifts: real expansion points in 1/s.
        moments: number of blocks at each point: one number, or a list with one number for each of ``shifts_hz``, then
            of ``real_shifts``. With ``order``, 1 means as many blocks as ``order`` needs.
        order: number of elastic coordinates. The directions with the largest energy in the responses from zero to the
            highest shift are kept, with equal weight of all frequencies. Moments are then matched approximately.
        tangential: number of load directions at each point, chosen by the largest residual; all by default.
        two_sided: test the equations with columns from the interfaces ``outputs``.
        inputs: names of the interfaces whose loads are followed; all by default.
        outputs: names of interfaces, with ``two_sided``.
        inertia_loads: also follow the inertia loads of a moving frame.

    Peak memory: the columns twice beside the factor of one shift, which goes with the shift. Two things stay with the
    problem, for other reducers and for the body: the columns (8 bytes by Nc each) for the same shifts, and where 0 is
    among the shifts the factor of the statics. ``problem.release()`` gives both back.

    >>> Krylov(shifts_hz=[0.0, 2000.0]).reduce(problem).symmetric
    True
    """

    method: ClassVar[str] = "krylov"
    shifts_hz: list[Hertz] = field(default_factory=lambda: [0.0])
    real_shifts: list[Rate] = field(default_factory=list)
    moments: PositiveCount | list[PositiveCount] = 1
    order: PositiveCount | None = None
    tangential: PositiveCount | None = None
    two_sided: bool = False
    inputs: list[str] | None = None
    outputs: list[str] | None = None
    inertia_loads: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        count = len(self.shifts_hz) + len(self.real_shifts)
        if not count:
            raise InputError(
                "no shift was given; give at least one in shifts_hz (0.0 for statics) or real_shifts",
                kind="missing",
                keyword="shifts_hz",
            )
        if len({*self.shifts_hz}) + len({*self.real_shifts}) < count:
            raise InputError(
                "a shift was given twice; give it once and raise its moments", kind="conflict", keyword="shifts_hz"
            )
        moments = [self.moments] * count if isinstance(self.moments, int) else self.moments
        if len(moments) != count:
            raise InputError(
                f"moments = {self.moments} was given for {count} shifts; expected one positive number, or one for each "
                "of shifts_hz and then of real_shifts",
                keyword="moments",
            )
        if self.outputs is not None and not self.two_sided:
            raise InputError(
                "outputs were given, which only two_sided = true uses; set it, or leave outputs out",
                kind="conflict",
                keyword="outputs",
            )
        if (
            self.two_sided
            and (self.inputs is None) == (self.outputs is None)
            and (self.inputs is None or set(self.inputs) == set(self.outputs or []))
        ):
            raise InputError(
                "two_sided = true needs inputs and outputs that differ; for equal ones it is the one-sided method: "
                "leave two_sided out",
                kind="conflict",
                keyword="outputs",
            )

    @property
    def takes_unsymmetric(self) -> bool:
        return not self.two_sided

    @property
    def needs_interfaces(self) -> bool:
        return not self.inertia_loads

    def why_not(self, facts: ProblemSummary) -> str:
        columns = facts.coupling.columns
        for key, given in (("inputs", self.inputs), ("outputs", self.outputs)):
            for name in given or []:
                if name not in columns:
                    return f"{key} name the interface {name!r}, which does not exist; {nearest(name, columns)}"
        return super().why_not(facts)

    def plan_factorisations(self, facts: ProblemSummary) -> Sequence[ShiftedFactorisations]:
        return facts.at_shifts((s for s, _ in self._points()), facts.inputs, at_once=self.tangential is None)

    def _basis(self, problem: Problem) -> Basis:
        self._check(problem)
        notes: dict[str, object] = {}
        # Only where some directions are kept and others not does it matter how much a load counts.
        counts = self.order is not None or self.tangential is not None
        spaces = [_LoadSpace(problem, self.inputs, "inputs", self.inertia_loads, counts)]
        if self.two_sided:
            spaces.append(_LoadSpace(problem, self.outputs, "outputs", self.inertia_loads, counts))
            if spaces[0].names == spaces[1].names:
                raise InputError(
                    "inputs and outputs name the same interfaces; leave two_sided out",
                    kind="conflict",
                    keyword="outputs",
                )
        columns = min(self._columns(problem, space.F.shape[1]) for space in spaces)
        if self.order is not None and self.moments == 1 and self.order > columns:
            return self._with_enough_moments(problem, columns)
        for space in spaces:
            space.reserve(self._columns(problem, space.F.shape[1]))
        lost, moved = self._fill(problem, spaces)
        lost = [text for space in spaces for text in space.lost] + lost
        if lost:
            notes["deflated"] = lost
        if moved:
            notes["moved_shifts"] = moved
        if problem.D is not None and problem.damping.is_viscous:
            notes["damping"] = (
                "the expansion is that of the model's own damping matrix, without the damping added to it"
            )
        if self.order is not None:
            top = max([*self.shifts_hz, *(in_hz(s) for s in self.real_shifts)])
            for space in spaces:
                notes[f"columns_of_{space.name}_before_the_cut"] = space.size
                space.cut(self.order, 2 * np.pi * top)
        if self.two_sided:
            return _two_sided(problem, spaces[0].V, spaces[1].V, notes)
        return elastic_basis(problem, spaces[0].V, "krylov", notes)

    def _with_enough_moments(self, problem: Problem, columns: int) -> Basis:
        """The basis for ``order`` where one block at each point has too few ``columns``; some depend on others."""
        points = len(self.shifts_hz) + len(self.real_shifts)
        max_moments = min(TOL.max_columns, problem.K.shape[0] - problem.rigid.shape[1]) // columns
        moments = min(1 - (-(self.order or 0) // columns), max_moments)
        while True:
            try:
                basis = replace(self, moments=[moments] * points)._basis(problem)
            except InputError:
                if moments >= max_moments:
                    raise
                moments = min(2 * moments, max_moments)
            else:
                return replace(basis, notes={**basis.notes, "moments": moments})

    def _check(self, problem: Problem) -> None:
        if 0.0 in self.shifts_hz and problem.system.damps_rigid_motion:
            raise InputError(
                "the model's damping or gyroscopic matrix acts on its rigid-body motion, so there is no expansion at "
                "0 Hz; take real_shifts, or shifts_hz above zero",
                kind="unsupported",
                keyword="shifts_hz",
            )

    def _points(self) -> Iterator[tuple[complex, int]]:
        """Expansion points s in 1/s and the blocks of each."""
        points = [2j * np.pi * f for f in self.shifts_hz] + [complex(s) for s in self.real_shifts]
        counts = [self.moments] * len(points) if isinstance(self.moments, int) else self.moments
        yield from zip(points, counts, strict=True)

    def _columns(self, problem: Problem, loads: int) -> int:
        """Columns of the basis before rank decisions."""
        width = min(loads, self.tangential or loads)
        own = problem.system.velocity_matrix is not None
        total = sum(
            count * width * (2 if own and s.imag else 1) * len(_sides(problem, s)) for s, count in self._points()
        )
        room = problem.K.shape[0] - problem.rigid.shape[1]
        if total > min(TOL.max_columns, room):
            raise InputError(
                f"{loads} loads with these shifts and moments make {total} columns; at most "
                f"{min(TOL.max_columns, room)} make sense here: take fewer shifts or moments, "
                "or set tangential = COUNT (loads per shift)",
                keyword="moments",
            )
        return total

    def _fill(self, problem: Problem, spaces: list[_LoadSpace]) -> tuple[list[str], list[str]]:
        """All blocks into the spaces of the loads; words on columns lost and shifts moved."""
        lost: list[str] = []
        moved: list[str] = []
        if all(space.takes_all_loads(self.tangential) for space in spaces):
            # The loads do not depend on the points before: all points at once.
            points = [(expansion_point(problem, s), count) for s, count in self._points()]
            wanted_at: list[dict[object, KrylovStart]] = [
                {
                    (space.names, *side): KrylovStart(space.F, count, bool(side))
                    for space in spaces
                    for side in _sides(problem, point.asked)
                }
                for point, count in points
            ]
            extend_in_parallel(problem, [point for point, _ in points], wanted_at)
        for s, count in self._points():
            shift = expansion_point(problem, s)
            what = f"shift {in_hz(abs(s)):.6g} Hz" if s.imag or not s else f"real shift {s.real:.6g} 1/s"
            wanted: dict[object, KrylovStart] = {}
            growing = []
            for space in spaces:
                key, F = space.loads(shift.at, self.tangential)
                if F.shape[1]:
                    for side in _sides(problem, s):
                        wanted[space.names, *key, *side] = KrylovStart(F, count, bool(side))
                        growing.append(space)
                else:
                    lost.append(f"{what}: the space carries all {space.name} already, nothing was solved")
            progress.update(f"{self.method}: {what}, {sum(space.size for space in spaces)} columns so far")
            for space, chain in zip(growing, shift.extend(wanted), strict=True):
                for j, block in enumerate(chain.blocks[:count]):
                    deflated = chain.deflated[j] + space.add(block)
                    if deflated:
                        lost.append(f"{what}, block {j + 1}: {deflated} columns of the {space.name}")
            if shift.moves:
                moved.append(f"{what} lies on an eigenvalue; moved to {in_hz(abs(shift.at)):.8g} Hz")
        return lost, moved


def _sides(problem: Problem, s: complex) -> list[tuple[str, ...]]:
    """Names of the spaces at ``s``: one where A(s) is symmetric or Hermitian, so that its transpose has the same."""
    same = problem.symmetric or (problem.N is None and problem.D is None and (bool(s.imag) or not s))
    return [()] if same else [(), ("transposed",)]


class _LoadSpace:
    """Loads ``F`` (Nc, p) of some interfaces on the elastic body, and the space ``V`` that grows from them.

    ``counts`` says that inertia loads are to count as ``load_scale`` has it, which takes a static solution.
    """

    def __init__(self, problem: Problem, interfaces: list[str] | None, name: str, inertia: bool, counts: bool) -> None:
        self.problem, self.name, self.size = problem, name, 0
        columns = problem.coupling.columns
        chosen = [columns[interface] for interface in columns if interfaces is None or interface in interfaces]
        rows = np.concatenate([np.arange(problem.B.shape[1])[part] for part in chosen] or [np.zeros(0, int)])
        if interfaces is None:
            rows = np.arange(problem.B.shape[1])
        F = problem.B[:, rows].toarray() * problem.motion_scale[rows]
        self.names: tuple[object, ...] = (*rows.tolist(), "inertia" if inertia else "")
        norms = np.linalg.norm(F, axis=0)
        if not problem.system.damps_rigid_motion:
            F = elastic_part(problem, F)
        bends = np.linalg.norm(F, axis=0) > TOL.rigid_load * norms
        self.lost = [] if bends.all() else [f"{(~bends).sum()} of the {name} do not deform the body"]
        F = F[:, bends]
        if inertia:
            F = problem.space.hstack(F, inertia_loads(problem))
            if counts:
                G = problem.space.map_columns(problem.free_free.flexibility, F)
                F *= load_scale(np.ones(int(bends.sum())), F, G)
        if not F.shape[1]:
            raise InputError(f"none of the {name} deforms the body; choose other interfaces")
        self.F = F

    def reserve(self, columns: int) -> None:
        """Make room for the space."""
        self._room: Floats = self.problem.budget.empty((len(self.F), columns), order="F")

    @property
    def V(self) -> Floats:
        """M-orthonormal elastic columns so far (Nc, size)."""
        return self._room[:, : self.size]

    def add(self, block: Floats) -> int:
        """Join the columns of ``block`` to the space; returns how many were in it already."""
        new = self.problem.space.complement(
            [self.problem.rigid, self.V], np.array(block, order="F"), passes=LINALG.krylov_passes
        )
        self._room[:, self.size : self.size + new.shape[1]] = new
        self.size += new.shape[1]
        return int(block.shape[1] - new.shape[1])

    def takes_all_loads(self, tangential: int | None) -> bool:
        """True if all loads are taken at each point."""
        return tangential is None or tangential >= self.F.shape[1]

    def loads(self, s: complex, tangential: int | None) -> tuple[tuple[object, ...], Floats]:
        """All loads, or the combinations that the space so far carries worst at ``s``; and a name for them."""
        if self.takes_all_loads(tangential) or tangential is None:
            return (), self.F
        weight = np.maximum(self.problem.K.diagonal(), np.finfo(float).tiny)[:, None]
        residual = self._residual(s)
        values, U = sl.eigh((residual.conj().T @ (residual / weight)).real)
        largest = np.sqrt(np.einsum("ij,ij->j", self.F, self.F / weight).max())
        good = np.sqrt(np.maximum(values, 0.0)) > TOL.carried_load * largest
        directions = U[:, good][:, ::-1][:, :tangential]
        return (directions.tobytes(),), self.F @ directions

    def _residual(self, s: complex) -> NDArray[Any]:
        """F - A(s) V y of the Galerkin solution y: loads (Nc, p) that the space does not carry."""
        problem, V, F = self.problem, self.V, self.F
        if not self.size:
            return np.asarray(F)
        width = problem.budget.columns(len(V))
        blocks = [slice(at, min(at + width, self.size)) for at in range(0, self.size, width)]
        A = np.hstack([problem.space.dot(V, problem.system.apply(s, V[:, block])) for block in blocks])
        y = np.linalg.solve(A, V.T @ F)
        residual: NDArray[Any] = np.array(F, dtype=y.dtype)
        for block in blocks:
            residual -= problem.system.apply(s, V[:, block]) @ y[block]
        return np.asarray(residual)

    def cut(self, order: int, top: float) -> None:
        """Keep the ``order`` directions with most energy in the responses up to ``top`` in rad/s.

        Responses of the space itself with one percent of damping, in the norm of K + mu M, each frequency scaled
        to equal size: principal directions of frequency responses (Lehner 2007), without a further solve.
        """
        if order > self.size:
            raise InputError(
                f"order = {order} was given, but shifts and moments give {self.size} columns; lower it, or add shifts",
                keyword="order",
            )
        values, Y = sl.eigh(self.problem.space.project(self.V, self.problem.K))
        load = Y.T @ (self.V.T @ self.F)
        top = top or float(np.sqrt(values[0]))
        mu = (0.5 * top) ** 2
        samples = []
        for w in np.linspace(0.0, top, 60):
            x = np.sqrt(values + mu)[:, None] * load / (values - w**2 + 0.02j * w * np.sqrt(values))[:, None]
            samples += [x.real / np.linalg.norm(x), x.imag / np.linalg.norm(x)]
        R = sl.qr(np.hstack(samples).T, mode="r")[0]
        directions = np.linalg.svd(R[: self.size])[2][:order].T
        self.problem.space.multiply_into(
            self.V, sl.qr(Y @ (directions / np.sqrt(values + mu)[:, None]), mode="economic")[0], self._room[:, :order]
        )
        self.size = order


def _two_sided(problem: Problem, V: Floats, W: Floats, notes: dict[str, object]) -> Basis:
    """[rigid, V] tested with [rigid, W], paired so that W' M V = I.

    Raises:
        InputError: the two spaces cannot be paired.
        SolverError: the result is unstable.
    """
    if V.shape[1] != W.shape[1]:
        # The smaller space takes directions of the other one, which loses no moment.
        small, large = (V, W) if V.shape[1] < W.shape[1] else (W, V)
        missing = large.shape[1] - small.shape[1]
        added = problem.space.complement(small, np.array(large, order="F"), passes=LINALG.krylov_passes)[:, :missing]
        notes["filled"] = f"{missing} columns of the {'outputs' if small is V else 'inputs'} serve both sides"
        joined = problem.space.hstack(small, added)
        V, W = (joined, W) if small is V else (V, joined)
    U, cosines, T = np.linalg.svd(W.T @ (problem.M @ V))
    if cosines[-1] < TOL.paired_cosine:
        raise InputError(
            "the spaces of inputs and outputs are nearly orthogonal and cannot be paired; leave two_sided out, or take "
            "other shifts"
        )
    V, W = V @ (T.T / np.sqrt(cosines)), W @ (U / np.sqrt(cosines))
    return two_sided_basis(
        problem,
        V,
        W,
        "krylov",
        notes,
        what="two_sided = true",
        instead="leave two_sided, inputs and outputs out (the moments of both sides at twice the order, stable "
        "always), or take other shifts, moments or damping",
    )
