"""Contact stiffness of a finite-element surface: the force that a rigid ball or roller takes by its penetration.

Pressures p >= 0 at the corner nodes of the faces, linear between them, meet gaps averaged with the same functions L:
int L g dA >= 0, p int L g dA = 0 with g = u + gap of the rigid body - penetration. The surface moves by u = C p with
the flexibility C of the held part, so that each penetration is a quadratic programme with p >= 0, solved as a
least-squares problem with bounds (Lawson and Hanson 1974). Linear pressures suit quadratic faces too, whose own
functions have corners of weight zero or less.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import pairwise

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import nnls

from morembs.base.arguments import checked
from morembs.base.errors import InputError, SolverError
from morembs.base.limits import Positive
from morembs.base.types import Floats, Ints
from morembs.dynamics.multibody.component import direction, vector
from morembs.dynamics.multibody.contact.surfaces import Sphere
from morembs.dynamics.multibody.contact.tolerances import TOL
from morembs.fem.elements import FACES
from morembs.fem.selection import select_nodes
from morembs.fem.surface import outer_faces
from morembs.linalg.dense import symmetric
from morembs.problem import Problem

log = logging.getLogger(__name__)
# Exact for the integrand 2 x F(x3) of each piece, a polynomial of degree ten in x.
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(6)


@checked
@dataclass(frozen=True)
class Cylinder:
    """A roller of ``radius`` m about an ``axis`` (3,) through ``center`` (3,) m, with profile radius ``crown`` m.

    Raises:
        InputError: a radius that is not positive, an axis that is no direction.
    """

    center: ArrayLike
    axis: ArrayLike
    radius: Positive
    _: KW_ONLY
    # Infinite by default: a straight profile.
    crown: Positive = np.inf
    name: str = "cylinder"

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector(f"center of {self.name!r}", self.center))
        object.__setattr__(self, "axis", direction(f"axis of {self.name!r}", self.axis))


@checked
@dataclass(frozen=True, eq=False)
class ContactTable:
    """Force by penetration, monotone and smooth: a cubic without overshoot in d^1.5 (Fritsch and Carlson 1980).

    ``penetration`` (k,) m and ``forces`` (k,) N, both growing from above zero; ``area`` (k,) m2 in contact.

    Raises:
        InputError: tables that do not grow.
    """

    penetration: ArrayLike
    forces: ArrayLike
    area: ArrayLike | None = None
    _force: PchipInterpolator = field(init=False, repr=False)
    _energy: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        depth, force = (np.asarray(value, dtype=float) for value in (self.penetration, self.forces))
        growing = depth.ndim == 1 and depth.shape == force.shape and len(depth) > 0
        if not (growing and all(np.isfinite(a).all() and (np.diff(a, prepend=0.0) > 0).all() for a in (depth, force))):
            raise InputError(
                f"penetration {depth.tolist()} and forces {force.tolist()} were given; expected as many of both, each "
                "above zero and growing",
                keyword="force",
            )
        area = None if self.area is None else np.asarray(self.area, dtype=float)
        if area is not None and not (area.shape == depth.shape and np.isfinite(area).all()):
            raise InputError(
                f"area {area.tolist()} was given; expected {len(depth)} finite numbers, as of the forces",
                keyword="area",
            )
        object.__setattr__(self, "penetration", depth)
        object.__setattr__(self, "forces", force)
        object.__setattr__(self, "area", area)
        object.__setattr__(
            self, "_force", PchipInterpolator(np.append(0.0, depth**TOL.hertz_exponent), np.append(0.0, force))
        )
        ends = np.sqrt(np.append(0.0, depth))
        pieces = [self._work(a, b) for a, b in pairwise(ends.tolist())]
        object.__setattr__(self, "_energy", np.append(0.0, np.cumsum(pieces)))

    @property
    def exponent(self) -> float:
        """Of the power law that fits best: the mean slope of log F over log d."""
        if len(self._depth) < 2:
            return TOL.hertz_exponent
        return float(np.polyfit(np.log(self._depth), np.log(np.asarray(self.forces)), 1)[0])

    def force(self, penetration: float) -> float:
        """N at a penetration in m; beyond the table along its last slope, so that iterations may step over its end."""
        s, end = max(penetration, 0.0) ** TOL.hertz_exponent, float(self._depth[-1]) ** TOL.hertz_exponent
        if s <= end:
            return float(self._force(s))
        return float(self._force(end) + (s - end) * self._force(end, 1))

    def energy(self, penetration: float) -> float:
        """J at a penetration in m."""
        x = float(np.sqrt(max(penetration, 0.0)))
        k = int(np.searchsorted(self._depth, penetration))
        start = float(np.sqrt(self._depth[k - 1])) if k else 0.0
        return float(self._energy[k] + self._work(start, x))

    def check(self, penetration: float) -> None:
        """Raises SolverError beyond the table."""
        if penetration > self._depth[-1]:
            raise SolverError(
                f"a penetration of {penetration:.3g} m lies beyond the contact table's {self._depth[-1]:.3g} m; "
                "make the table for deeper penetrations"
            )

    def without(self, compliance: float) -> ContactTable:
        """The table without a linear ``compliance`` in m/N: that of the part, where it is elastic in the simulator too.

        Raises:
            InputError: a compliance that leaves no growing penetration.
        """
        return replace(self, penetration=self._depth - compliance * np.asarray(self.forces))

    @property
    def _depth(self) -> Floats:
        return np.asarray(self.penetration)

    def _work(self, a: float, b: float) -> float:
        """Integral of the force over penetrations from a squared to b squared, within one piece."""
        x = 0.5 * (a + b) + 0.5 * (b - a) * _POINTS
        force = np.array([self.force(value * value) for value in x])
        return float(0.5 * (b - a) * _WEIGHTS @ (2 * x * force))


@checked
def contact_table(
    problem: Problem, body: Sphere | Cylinder, *, surface: str, penetration: Sequence[float], push: ArrayLike
) -> ContactTable:
    """Force of a rigid ball or roller on a surface of a held part, by its penetration.

    Args:
        problem: a part, held at its interfaces and by its supports; its own flexibility between there and the surface
            is part of the table.
        body: its place counts across ``push`` only: penetrations are measured from where it touches first.
        surface: the nodes that it may touch, as for ``select_nodes``.
        penetration: (k,) m, growing.
        push: (3,) the direction in which the body is pushed, into the part.

    Memory: one dense square matrix of the corner nodes that may touch.

    Raises:
        InputError: a part that is free, a surface without faces, penetrations that do not grow from above zero.
    """
    if problem.rigid.shape[1] and not problem.interfaces:
        raise InputError(
            f"the part is free: {problem.rigid.shape[1]} rigid motions are left, and a contact pushes it away; give it "
            "the interfaces at which it is mounted",
            kind="model",
        )
    deepest = _check_penetration(penetration)
    along = direction("push", push)
    faces = _Faces(problem, body, surface, along, TOL.reached_penetration * deepest)
    C = faces.flexibility(problem)
    L = sl.cholesky(C, lower=True)
    forces, areas = [], []
    for depth in penetration:
        # Least |L'p - L^-1 b| with p >= 0 has w = C p - b >= 0, p w = 0.
        pressure, _ = nnls(L.T, sl.solve_triangular(L, depth * faces.area - faces.gap, lower=True))
        forces.append(float(faces.area @ pressure))
        areas.append(float(faces.area[pressure > 0].sum()))
        reached = max(float(faces.aside[pressure > 0].max(initial=0.0)), float(np.sqrt(areas[-1] / np.pi)))
        if reached < TOL.elements_across * faces.size:
            log.warning(
                "at a penetration of %.3g m the contact reaches over %.1f elements to the side, where %g are needed: "
                "its force is uncertain; make elements of %.2g m there",
                depth,
                reached / faces.size,
                TOL.elements_across,
                reached / TOL.elements_across,
            )
    return ContactTable(list(penetration), forces, areas)


def _check_penetration(penetration: Sequence[float]) -> float:
    depth = np.asarray(penetration, dtype=float)
    if not (depth.ndim == 1 and len(depth) and np.isfinite(depth).all() and (np.diff(depth, prepend=0.0) > 0).all()):
        raise InputError(
            f"penetration = {depth.tolist()} m was given; expected lengths above zero that grow", keyword="penetration"
        )
    return float(depth[-1])


def _height(body: Sphere | Cylinder, points: Floats, push: Floats) -> tuple[Floats, Floats]:
    """(n,) m along ``push`` by which the rigid surface lies behind its lowest point at ``points``; (n,) m aside."""
    across = points - np.asarray(body.center)
    across = across - np.outer(across @ push, push)
    if isinstance(body, Sphere):
        aside = np.linalg.norm(across, axis=1)
        return _drop(aside, body.radius), aside
    axis = np.asarray(body.axis)
    if abs(axis @ push) > TOL.push_along_axis:
        raise InputError(
            f"push = {push.tolist()} was given; expected a direction across the axis of {body.name!r}", keyword="push"
        )
    aside = np.abs(across @ np.cross(push, axis))
    return _drop(aside, body.radius) + _drop(across @ axis, body.crown), aside


def _drop(distance: Floats, radius: float) -> Floats:
    if np.isinf(radius):
        return np.zeros(len(distance))
    inside = np.minimum(np.abs(distance), radius)
    # radius - sqrt(radius2 - distance2), without cancellation.
    return np.asarray(inside**2 / (radius + np.sqrt(radius**2 - inside**2)))


class _Faces:
    """Faces that may touch, with c corners: ``shape`` (nodes, c) = int N L dA, ``area`` (c,) = int L dA, ``gap`` (c,)
    = int L gap dA, ``aside`` (c,) m from the middle of the contact; ``size`` of the faces in m."""

    def __init__(self, problem: Problem, body: Sphere | Cylinder, surface: str, push: Floats, reach: float) -> None:
        mesh, self.push = problem.model.mesh, push
        if mesh is None:
            raise InputError("a model without a mesh was given; expected one whose surface has faces")
        xyz = mesh.nodes.xyz
        faces = outer_faces(mesh, within=select_nodes(problem.model, surface))
        # Faces that look away from the body, such as the other side of a thin part, do not touch.
        faces = {kind: nodes[_normals(xyz[nodes]) @ push < 0] for kind, nodes in faces.items()}
        if not any(len(nodes) for nodes in faces.values()):
            raise InputError(
                f"surface = {surface!r} has no whole face that looks against the push; select more nodes",
                keyword="surface",
            )
        begins = {k: _height(body, x := xyz[n].reshape(-1, 3), push)[0] + x @ push for k, n in faces.items()}
        first = min(float(values.min()) for values in begins.values() if len(values))
        near = {
            kind: nodes[(begins[kind].reshape(nodes.shape) - first).min(axis=1, initial=np.inf) <= reach]
            for kind, nodes in faces.items()
        }
        self._integrate(body, xyz, near, first)

    def _integrate(self, body: Sphere | Cylinder, xyz: Floats, faces: dict[str, Ints], first: float) -> None:
        rows, columns, values, gaps, areas, sizes = [], [], [], [], [], []
        for kind, nodes in faces.items():
            if not len(nodes):
                continue
            linear = FACES["tri3" if kind.startswith("tri") else "quad4"]
            rule = FACES[kind].rule(FACES[kind].mass_order)
            L, _ = linear.shape(rule.points)
            corners = nodes[:, : L.shape[1]]
            tangents = np.einsum("fka,qkr->fqra", xyz[nodes], rule.dN, optimize=True)
            dA = np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=2) * rule.weights
            points = np.einsum("qk,fka->fqa", rule.N, xyz[nodes])
            height, _ = _height(body, points.reshape(-1, 3), self.push)
            gap = height + points.reshape(-1, 3) @ self.push - first
            values.append(np.einsum("fq,qk,qc->fkc", dA, rule.N, L).ravel())
            rows.append(np.repeat(nodes, L.shape[1], axis=1).ravel())
            columns.append(np.tile(corners, (1, nodes.shape[1])).ravel())
            gaps.append((corners.ravel(), np.einsum("fq,qc->fc", dA * gap.reshape(dA.shape), L).ravel()))
            areas.append((corners.ravel(), np.einsum("fq,qc->fc", dA, L).ravel()))
            sizes.append(dA.sum(axis=1))
        row, column, value = (np.concatenate(parts) for parts in (rows, columns, values))
        self.corners, number = np.unique(column, return_inverse=True)
        self.shape = sp.csc_array((value, (row, number)), shape=(len(xyz), len(self.corners)))
        self.gap, self.area = (self._sum_by_node(parts) for parts in (gaps, areas))
        _, self.aside = _height(body, xyz[self.corners], self.push)
        self.size = float(np.sqrt(np.median(np.concatenate(sizes))))

    def _sum_by_node(self, parts: list[tuple[Ints, Floats]]) -> Floats:
        nodes, values = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        at = np.searchsorted(self.corners, nodes)
        return np.asarray(np.bincount(at, weights=values, minlength=len(self.corners)), dtype=float)

    def flexibility(self, problem: Problem) -> Floats:
        """(c, c) weighted displacement along the push at each corner per pressure at each."""
        model = problem.model
        table = model.dofs.table(len(model.nodes))[:, :3]
        shape = self.shape.tocoo()
        dofs = table[shape.row]
        there = dofs >= 0
        column, value = np.repeat(shape.col, 3).reshape(-1, 3), np.outer(shape.data, self.push)
        loads = sp.csc_array((value[there], (dofs[there], column[there])), shape=(model.size, shape.shape[1]))
        F = sp.csc_array(problem.coupling.T.T @ loads)
        C = np.empty((F.shape[1], F.shape[1]))
        for first in range(0, F.shape[1], TOL.table_columns):
            some = slice(first, first + TOL.table_columns)
            C[:, some] = F.T @ problem.fixed_interface.flexibility(F[:, some].toarray())
        return symmetric(C)


def _normals(corners: Floats) -> Floats:
    """(f, 3) normals of faces with ``corners`` (f, k, 3)."""
    last = 3 if corners.shape[1] in (4, 8, 9) else 2
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, last] - corners[:, 0])
