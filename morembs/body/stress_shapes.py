"""The part of a body that recovers stress, and what displacements lack, from reduced coordinates and interface loads.

A reduced model leaves out the part of the static response that its basis misses. Mode acceleration (Williams 1945;
Craig 1981, ch. 15) adds it for each interface load: U_res = (G_e - V K_r^+ V') B and its stress, where G_e is the
flexibility of the free body under inertia relief (or of the held one) and K_r^+ that of the reduced model. U_res has no
momentum, so the mean axes of the body do not move with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base import progress
from morembs.base.former_names import with_progress_argument
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints, Reals
from morembs.body.tables import RECOVERY
from morembs.fem import frozen
from morembs.fem.stress_operator import StressOperator, stress_operator, von_mises
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.loads import static_response
from morembs.storage.table import Table, read_rows
from morembs.storage.writer import Columns

# Columns of length N that one block of shapes costs, in addition to the gradients at the points.
_COPIES = 6


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Recovery:
    """Stress at points of a body from its reduced coordinates.

    ``points`` (np,) labels of the nodes, ascending rows of the model; ``coordinates`` (np, 3) m; ``material`` (np,)
    index of the material (a node where materials meet is one point for each). ``stress`` (6 np, nr) Pa per unit of
    each reduced coordinate, ``correction`` (6 np, m) Pa per unit of each interface load, or None; single or double
    precision. ``deformation`` (nr, nr) takes the rigid motion out of reduced coordinates, so that none of it is left
    to cancel in single precision.

    ``missing`` (Nc, m) are displacements in coupled dofs, per unit of each interface load, that the basis lacks; in a
    body file they are ``displacement`` (3 N, m) m of its nodes. ``markers`` (6, m) are the displacements and small
    rotations of the interfaces with a frame in them.

    ``jump`` (6 ne, nr) and ``jump_correction`` (6 ne, m) are as ``stress`` and ``correction``, of single elements
    less the average: at ``jump_point`` (ne,), places in the points, ascending, in the elements ``jump_element`` (ne,).
    """

    points: Ints
    coordinates: Floats
    material: Ints
    deformation: Floats
    stress: Reals
    correction: Reals | None = None
    missing: Reals | None = None
    displacement: Reals | None = None
    markers: Mapping[str, Floats] = field(default_factory=dict)
    jump: Reals | None = None
    jump_correction: Reals | None = None
    jump_point: Ints | None = None
    jump_element: Ints | None = None

    def __post_init__(self) -> None:
        for attribute in fields(self):
            if isinstance(value := getattr(self, attribute.name), np.ndarray):
                object.__setattr__(self, attribute.name, frozen(value))

    @cached_property
    def seams(self) -> bool:
        """Whether some node is more than one point."""
        return len(np.unique(self.points)) < len(self.points)

    def at(self, coordinates: Floats, loads: Floats | None = None) -> Floats:
        """Stresses (nt, np, 6) in Pa of reduced coordinates (nt, nr) and interface loads (nt, m) in N and Nm."""
        return self._applied(self.stress, self.correction, coordinates, loads)

    def jumps_at(self, coordinates: Floats, loads: Floats | None = None) -> Floats | None:
        """How far elements miss the averaged stress around each point (nt, np) in Pa; None where that was not kept.

        The largest von Mises stress of element less average, at any of its points, over the elements at the point
        (Zienkiewicz and Zhu 1987 measure the error of stresses by that difference). An element's other points count as
        elements on both sides of a peak agree in it. Von Mises stress being a norm of deviators, no element's von Mises
        stress is further from that of the average.
        """
        if self.jump is None or self.jump_point is None or self.jump_element is None:
            return None
        size = von_mises(self._applied(self.jump, self.jump_correction, coordinates, loads))
        elements, which = np.unique(self.jump_element, return_inverse=True)
        order = np.argsort(which, kind="stable")
        first = np.searchsorted(which[order], np.arange(len(elements)))
        of_element = np.maximum.reduceat(size[:, order], first, axis=1)
        starts = np.searchsorted(self.jump_point, np.arange(len(self.points)))
        return np.asarray(np.maximum.reduceat(of_element[:, which], starts, axis=1))

    def _applied(self, shapes: Reals, correction: Reals | None, coordinates: Floats, loads: Floats | None) -> Floats:
        """Tensors (nt, rows / 6, 6) of shapes (rows, nr) and their correction (rows, m)."""
        q = np.asarray(coordinates, dtype=np.float64) @ self.deformation.T
        tensors = shapes @ q.T.astype(shapes.dtype)
        if loads is not None and correction is not None:
            tensors += correction @ np.asarray(loads).T.astype(correction.dtype)
        return np.asarray(np.moveaxis(tensors.reshape(len(shapes) // 6, 6, -1), -1, 0), dtype=np.float64)


@with_progress_argument
def stress_recovery(
    problem: Problem,
    reduced: ReducedModel,
    *,
    nodes: str | Ints = "skin",
    single: bool = True,
    correction: bool = True,
    jump: bool = True,
    operator: StressOperator | None = None,
) -> Recovery:
    """Stress recovery of ``reduced`` at ``nodes`` ("skin", "all" or rows), in ``single`` or double precision.

    ``operator`` saves making that of ``nodes`` again for the next reduction; its ``elements``, or ``jump`` without it,
    say whether to keep how far single elements miss the average. Peak memory: the operator, the result (6 np, nr + m),
    with jumps (6 ne, nr + m) for ne pairs of an element and a point, and (Nc, m) where the budget wants them, and some
    columns; the correction takes m static solves, shared.

    Raises:
        InputError: as ``stress_operator``.

    >>> stress_recovery(problem, reduced).stress.shape               # six components at 20 points
    (120, 18)
    """
    model, budget = problem.model, problem.budget
    if operator is None:
        operator = stress_operator(model, nodes, elements=jump, budget=budget)
    dtype = np.float32 if single else np.float64
    rigid = np.array([kind == "rigid" for kind in reduced.mode_kind], dtype=bool)

    def shapes_of(width: int, chosen: StressOperator = operator) -> Reals:
        return budget.empty((6 * len(chosen.nodes), width), dtype, order="F")

    stress, jumps, elements = shapes_of(reduced.order), None, operator.elements
    stress_shapes(problem, reduced.V, operator, out=stress)
    stress[:, rigid] = 0.0
    if elements is not None:
        jumps = shapes_of(reduced.order, elements.operator)
        stress_shapes(problem, reduced.V, elements.operator, out=jumps)
        jumps[:, rigid] = 0.0
        _subtract(jumps, stress, elements.point)
    progress.update(f"{reduced.name}: stress of {reduced.order} coordinates at {len(operator.nodes)} points")
    missed = _missed(problem, reduced, operator, shapes_of) if correction and problem.B.shape[1] else {}
    return Recovery(
        points=model.nodes.ids[operator.nodes],
        coordinates=model.nodes.xyz[operator.nodes],
        material=operator.material,
        deformation=_deformation(problem, reduced),
        stress=stress,
        jump=jumps,
        jump_point=None if elements is None else elements.point,
        jump_element=None if elements is None else elements.element,
        **missed,
    )


def _missed(
    problem: Problem, reduced: ReducedModel, operator: StressOperator, shapes_of: Callable[..., Reals]
) -> dict[str, Any]:
    """What the basis lacks under unit interface loads, by the names of the fields of ``Recovery``."""
    loads, elements, budget = problem.B.shape[1], operator.elements, problem.budget
    static, q = static_response(problem), static_coordinates(reduced)
    stress = shapes_of(loads)
    missing = budget.empty((len(static), loads), stress.dtype, order="F")
    jump = None if elements is None else shapes_of(loads, elements.operator)
    frames = problem.coupling.frames
    motions = np.empty((frames.shape[1], loads))
    width = budget.columns(len(static), copies=_COPIES)
    for at in range(0, loads, width):
        some = slice(at, at + width)
        block = static[:, some] - reduced.V @ q[:, some]
        stress_shapes(problem, block, operator, out=stress[:, some])
        if elements is not None and jump is not None:
            stress_shapes(problem, block, elements.operator, out=jump[:, some])
            _subtract(jump[:, some], stress[:, some], elements.point)
        missing[:, some], motions[:, some] = block, frames.T @ block
        budget.release_if_tight()
    markers = {name: motions[rows] for name, rows in problem.coupling.frame_columns.items()}
    return {"correction": stress, "missing": missing, "jump_correction": jump, "markers": markers}


def _subtract(single: Reals, mean: Reals, point: Ints) -> None:
    """Take the averages ``mean`` (6 np, k) at ``point`` (ne,) off stresses (6 ne, k) of single elements, in place."""
    for column in range(single.shape[1]):
        single[:, column] -= mean[:, column].reshape(-1, 6)[point].ravel()


def static_coordinates(reduced: ReducedModel) -> Floats:
    """K_r^+ B (nr, m): elastic coordinates under unit interface loads, free of rigid motion (inertia relief)."""
    r = reduced.rigid_count
    if not reduced.congruent:
        coordinates = np.zeros_like(reduced.B)
        coordinates[r:] = np.linalg.solve(reduced.K[r:, r:], reduced.B[r:])
        return coordinates
    values, Y = reduced.modes()
    return np.asarray((Y[:, r:] / values[r:]) @ (Y[:, r:].T @ reduced.B))


def _deformation(problem: Problem, reduced: ReducedModel) -> Floats:
    """I - Z (Z'M Z)^-1 Z'M (nr, nr) with the rigid coordinates Z."""
    r = reduced.rigid_count
    if not r:
        return np.eye(reduced.order)
    if reduced.mode_kind[:r] == ("rigid",) * r:
        return np.diag(np.concatenate([np.zeros(r), np.ones(reduced.order - r)]))
    # Coordinates of the known rigid motions: eigenvectors of the zeros would carry the round-off of K.
    Z = np.linalg.solve(reduced.M, reduced.V.T @ (problem.M @ problem.rigid))
    ZM = Z.T @ reduced.M
    return np.asarray(np.eye(reduced.order) - Z @ np.linalg.solve(ZM @ Z, ZM))


_AT_POINTS = ("points", "coordinates", "material", "stress", "correction")
_JUMPS = ("jump_point", "jump_element", "jump", "jump_correction")


def recovery_parts(recovery: Recovery, at_nodes: sp.csr_array | None = None) -> dict[str, Any]:
    """Values for the rows of ``tables.RECOVERY``.

    ``at_nodes`` (3 N, Nc) gives the displacements of the nodes of the file; without it these are as they are.
    """
    values, missing = dict(vars(recovery)), recovery.missing
    if at_nodes is not None:
        values["displacement"] = (
            missing
            if missing is None
            else Columns(
                (at_nodes.shape[0], missing.shape[1]),
                missing.dtype,
                (at_nodes @ column[:, None] for column in missing.T),
            )
        )
    return values


def read_recovery(group: Any, *, stress: bool = True) -> Recovery:
    """The recovery in an open HDF5 ``group``, whole in memory; without ``stress`` it has no points.

    Raises:
        InputError: a dataset is missing.
    """
    if stress:
        return Recovery(**read_rows(group, RECOVERY, "the stress recovery lacks"))
    present = {name: group[name] for name in _AT_POINTS if name in group}
    empty: dict[str, Any] = {name: np.empty((0, *item.shape[1:]), item.dtype) for name, item in present.items()}
    rows = tuple(row for row in RECOVERY if row.name not in (*_AT_POINTS, *_JUMPS))
    return Recovery(**read_rows(group, Table(rows), "the stress recovery lacks"), **empty)


def stress_shapes(
    problem: Problem, X: Floats, operator: StressOperator, *, strain: bool = False, out: Reals | None = None
) -> Reals:
    """Stresses in Pa (6 np, k) of displacements ``X`` (Nc, k) in coupled dofs; strains if ``strain``.

    ``out`` (6 np, k) takes the result and may be of single precision. Works in blocks of columns.
    """
    budget = problem.budget
    values: Reals = budget.empty((6 * len(operator.nodes), X.shape[1]), order="F") if out is None else out
    T, rows = problem.coupling.T, 3 * operator.gradient.shape[1]
    if T.shape[0] > rows:
        # Other dofs come behind those of the nodes; a part of a sparse matrix is a copy.
        T = T[:rows]
    width = budget.columns(T.shape[0] + 8 * len(operator.nodes), copies=_COPIES)
    for at in range(0, X.shape[1], width):
        u = np.asarray(T @ X[:, at : at + width])
        values[:, at : at + width] = operator.strain(u) if strain else operator.stress(u)
        budget.release_if_tight()
    return values
