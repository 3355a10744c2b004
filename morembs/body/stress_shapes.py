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
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.model import frozen
from morembs.model.stress_operator import StressOperator, stress_operator, von_mises
from morembs.problem import Problem
from morembs.progress import SILENT, Progress
from morembs.reducers.base import ReducedModel
from morembs.responses.krylov_space import static_response

Floats = NDArray[np.float64]
Reals = NDArray[np.float64] | NDArray[np.float32]
Ints = NDArray[np.int64]
# Columns of length N that one block of shapes costs, beside the gradients at the points.
_COPIES = 6
CHUNK_ROWS = 2**28


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
        for one in fields(self):
            if isinstance(value := getattr(self, one.name), np.ndarray):
                object.__setattr__(self, one.name, frozen(value))

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
        found = shapes @ q.T.astype(shapes.dtype)
        if loads is not None and correction is not None:
            found += correction @ np.asarray(loads).T.astype(correction.dtype)
        return np.asarray(np.moveaxis(found.reshape(len(shapes) // 6, 6, -1), -1, 0), dtype=np.float64)


def stress_recovery(
    problem: Problem, reduced: ReducedModel, *, nodes: str | Ints = "skin", single: bool = True,
    correction: bool = True, jump: bool = True, operator: StressOperator | None = None, progress: Progress = SILENT,
) -> Recovery:  # fmt: skip
    """Stress recovery of ``reduced`` at ``nodes`` ("skin", "all" or rows), in ``single`` or double precision.

    ``operator`` saves making that of ``nodes`` again for the next reduction; its ``elements``, or ``jump`` without it,
    say whether to keep how far single elements miss the average. Peak memory: the operator, the result (6 np, nr + m),
    with jumps (6 ne, nr + m) for ne pairs of an element and a point, and (Nc, m) where the budget wants them, and some
    columns; the correction takes m static solves, shared.

    Raises:
        InputError: as ``stress_operator``.
    """
    model, budget = problem.model, problem.budget
    if operator is None:
        operator = stress_operator(model, nodes, elements=jump, budget=budget, progress=progress)
    dtype = np.float32 if single else np.float64
    rigid = np.array([kind == "rigid" for kind in reduced.mode_kind], dtype=bool)

    def shapes_of(width: int, its: StressOperator = operator) -> Reals:
        return budget.empty((6 * len(its.nodes), width), dtype, order="F")

    stress, jumps, jump_correction, elements = shapes_of(reduced.order), None, None, operator.elements
    stress_shapes(problem, reduced.V, operator, out=stress)
    stress[:, rigid] = 0.0
    if elements is not None:
        jumps = shapes_of(reduced.order, elements.operator)
        stress_shapes(problem, reduced.V, elements.operator, out=jumps)
        jumps[:, rigid] = 0.0
        _subtract(jumps, stress, elements.point)
    progress.update(f"{reduced.name}: stress of {reduced.order} coordinates at {len(operator.nodes)} points")
    corrected, missing, markers = None, None, {}
    loads = problem.B.shape[1]
    if correction and loads:
        static, q = static_response(problem), static_coordinates(reduced)
        corrected, missing = shapes_of(loads), budget.empty((len(static), loads), dtype, order="F")
        if elements is not None:
            jump_correction = shapes_of(loads, elements.operator)
        frames = problem.coupling.frames
        motions = np.empty((frames.shape[1], loads))
        width = budget.columns(len(static), copies=_COPIES)
        for at in range(0, loads, width):
            some = slice(at, at + width)
            block = static[:, some] - reduced.V @ q[:, some]
            stress_shapes(problem, block, operator, out=corrected[:, some])
            if elements is not None and jump_correction is not None:
                stress_shapes(problem, block, elements.operator, out=jump_correction[:, some])
                _subtract(jump_correction[:, some], corrected[:, some], elements.point)
            missing[:, some], motions[:, some] = block, frames.T @ block
            budget.relax()
        markers = {name: motions[rows] for name, rows in problem.coupling.frame_columns.items()}
    return Recovery(
        points=model.nodes.ids[operator.nodes], coordinates=model.nodes.xyz[operator.nodes],
        material=operator.material, deformation=_deformation(problem, reduced), stress=stress, correction=corrected,
        missing=missing, markers=markers, jump=jumps, jump_correction=jump_correction,
        jump_point=None if elements is None else elements.point,
        jump_element=None if elements is None else elements.element,
    )  # fmt: skip


def _subtract(single: Reals, mean: Reals, point: Ints) -> None:
    """Take the averages ``mean`` (6 np, k) at ``point`` (ne,) off stresses (6 ne, k) of single elements, in place."""
    for column in range(single.shape[1]):
        single[:, column] -= mean[:, column].reshape(-1, 6)[point].ravel()


def static_coordinates(reduced: ReducedModel) -> Floats:
    """K_r^+ B (nr, m): elastic coordinates under unit interface loads, free of rigid motion (inertia relief)."""
    r = reduced.rigid_count
    if not reduced.symmetric:
        found = np.zeros_like(reduced.B)
        found[r:] = np.linalg.solve(reduced.K[r:, r:], reduced.B[r:])
        return found
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


_PARTS = {
    "points": ("labels of the nodes; a node where materials meet comes once for each", ""),
    "coordinates": ("positions of the points", "m"),
    "material": ("index of the material of each point", ""),
    "deformation": ("takes the rigid motion out of reduced coordinates, before stress is applied", ""),
    "stress": ("row 6 i + c: component c (xx, yy, zz, xy, yz, zx) of point i per unit of each coordinate", "Pa"),
    "correction": ("mode acceleration: what stress lacks, per unit of each interface load; rows as stress", "Pa"),
    "displacement": ("mode acceleration: what basis lacks, per unit of each interface load; rows as basis", "m"),
    "jump_point": ("where among the points a stress of a single element is, ascending", ""),
    "jump_element": ("and the number of that element, through all blocks of the mesh", ""),
    "jump": ("as stress, of a single element less the average at the point; row 6 i + c of jump_point[i]", "Pa"),
    "jump_correction": ("what jump lacks, per unit of each interface load; rows as jump", "Pa"),
}
_JUMPS = ("jump_point", "jump_element", "jump", "jump_correction")
_AT_POINTS = ("points", "coordinates", "material", "stress", "correction")
_OPTIONAL = ("correction", "displacement", *_JUMPS)


def write_recovery(
    group: Any, its: Recovery, check: Callable[[], None] = lambda: None, at_nodes: sp.csr_array | None = None,
) -> None:  # fmt: skip
    """Datasets of ``its`` in the HDF5 ``group``; ``check`` is called after each and raises what went wrong.

    ``at_nodes`` (3 N, Nc) gives the displacements of the nodes of the file; without it these are left out.
    """

    def marked(name: str, data: Any, about: str, units: str) -> None:
        for key, words in (("description", about), ("units", units)):
            if words:
                data.attrs[key] = np.bytes_(words)
        check()

    for name, (about, units) in _PARTS.items():
        value, taken = getattr(its, name), None
        if name == "displacement" and at_nodes is not None:
            value, taken = its.missing, at_nodes
        if value is None:
            continue
        rows = len(value) if taken is None else taken.shape[0]
        if value.ndim == 2 and name not in ("coordinates", "deformation") and value.size and rows:
            shape, chunks = (rows, value.shape[1]), (min(rows, CHUNK_ROWS), 1)
            data = group.create_dataset(name, shape, value.dtype, chunks=chunks)
            for column in range(value.shape[1]):
                data[:, column] = value[:, column] if taken is None else taken @ value[:, column]
                check()
        else:
            data = group.create_dataset(name, data=value)
        marked(name, data, about, units)
    for name, value in its.markers.items():
        data = group.create_dataset(f"markers/{name}", data=value)
        marked(name, data, "displacement and small rotation of the interface in displacement", "")


def read_recovery(group: Any, *, stress: bool = True) -> Recovery:
    """What ``write_recovery`` wrote, whole in memory; without ``stress`` it has no points.

    Raises:
        InputError: a dataset is missing.
    """
    missing = [name for name in _PARTS if name not in _OPTIONAL and not hasattr(group.get(name), "shape")]
    if missing:
        raise InputError(f"the stress recovery lacks {', '.join(missing)}; write the body file again")
    markers = {name: item[()] for name, item in group.get("markers", {}).items()}
    left_out = () if stress else (*_AT_POINTS, *_JUMPS)
    found = {name: _columns(group[name]) for name in _PARTS if name in group and name not in left_out}
    for name in () if stress else _AT_POINTS:
        if name in group:
            found[name] = np.empty((0, *group[name].shape[1:]), group[name].dtype)
    return Recovery(**found, markers=markers)


def _columns(data: Any) -> Any:
    """The whole dataset; a matrix in pieces of columns comes column by column, as it lies on the disk."""
    if data.chunks is None or data.ndim != 2:
        return data[()]
    found = np.empty(data.shape, data.dtype, order="F")
    for column in range(data.shape[1]):
        found[:, column] = data[:, column]
    return found


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
        budget.relax()
    return values
