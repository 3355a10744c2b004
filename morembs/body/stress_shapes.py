"""The part of a body that recovers stress, and what displacements lack, from reduced coordinates and interface loads.

A reduced model leaves out the part of the static response that its basis misses. Mode acceleration (Williams 1945;
Craig 1981, ch. 15) adds it for each interface load: U_res = (G_e - V K_r^+ V') B and its stress, where G_e is the
flexibility of the free body under inertia relief (or of the held one) and K_r^+ that of the reduced model. U_res has no
momentum, so the mean axes of the body do not move with it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from morembs.base import progress
from morembs.base.types import Floats, Ints, Reals
from morembs.body.recovery_shapes import Recovery
from morembs.body.tolerances import TOL
from morembs.fem.stress_operator import StressOperator, stress_operator
from morembs.linalg.massless import split_massless
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.loads import static_response


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

    Args:
        problem: the full model.
        reduced: its reduced model.
        nodes: "skin", "all" or rows of nodes.
        single: whether single precision is stored.
        correction: whether loads correct displacements and stress.
        jump: whether differences between elements are kept.
        operator: of ``stress_operator``, made here by default.

    Raises:
        InputError: as ``stress_operator``.

    >>> stress_recovery(problem, reduced).stress.shape               # six components at 20 points
    (120, 18)
    """
    model, budget = problem.model, problem.budget
    if operator is None:
        with budget.in_use():
            operator = stress_operator(model, nodes, elements=jump)
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
    missed = _find_missing_stress(problem, reduced, operator, shapes_of) if correction and problem.B.shape[1] else {}
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


def _find_missing_stress(
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
    width = budget.columns(len(static), copies=TOL.gradient_copies)
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
    # Motions without mass have unit stiffness.
    values = np.where(np.isfinite(values), values, 1.0)
    return np.asarray((Y[:, r:] / values[r:]) @ (Y[:, r:].T @ reduced.B))


def _deformation(problem: Problem, reduced: ReducedModel) -> Floats:
    """I - Z (Z'M Z)^-1 Z'M (nr, nr) with the rigid coordinates Z."""
    r = reduced.rigid_count
    if not r:
        return np.eye(reduced.order)
    if reduced.mode_kind[:r] == ("rigid",) * r:
        return np.diag(np.concatenate([np.zeros(r), np.ones(reduced.order - r)]))
    # Coordinates of the known rigid motions: eigenvectors of the zeros would carry the round-off of K.
    inertia, split = reduced.V.T @ (problem.M @ problem.rigid), split_massless(reduced.K, reduced.M)
    if split is None:
        Z = np.linalg.solve(reduced.M, inertia)
    else:
        P = split.P
        Z = P @ np.linalg.solve(P.T @ reduced.M @ P, P.T @ inertia)
    ZM = Z.T @ reduced.M
    return np.asarray(np.eye(reduced.order) - Z @ np.linalg.solve(ZM @ Z, ZM))


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
    width = budget.columns(T.shape[0] + 8 * len(operator.nodes), copies=TOL.gradient_copies)
    for at in range(0, X.shape[1], width):
        u = np.asarray(T @ X[:, at : at + width])
        values[:, at : at + width] = operator.strain(u) if strain else operator.stress(u)
        budget.release_if_tight()
    return values
