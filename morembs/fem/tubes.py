"""Tubes of Bernoulli beam elements, and the matrices of a fluid that flows through them.

With the unit tangent t, the fluid mass per length m, its velocity v and the mass flow q = m v, motions u follow from

    m u . w + q (w . u'_s - w'_s . u)_t - q v w'_s . u'_s     integrated along the tube (Paidoussis 1998, ch. 3),

the second term being gyroscopic where the ends do not move. At a free outlet the integration by parts leaves damping
q w . u and the follower force q v w . u'_s, which is circulatory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import Finite, PoissonRatio, Positive, one_of
from morembs.base.types import Floats, Ints
from morembs.fem.fe_model import DofMap, FEModel
from morembs.fem.mesh import Nodes

OUTLETS = ("held", "free")


def _unit_gauss(points: int) -> tuple[Floats, Floats]:
    """Gauss points and weights from 0 to 1, exact for polynomials of degree 2 ``points`` - 1."""
    x, w = np.polynomial.legendre.leggauss(points)
    return 0.5 * (x + 1), 0.5 * w


# Products of cubic shapes have degree six.
POINTS, WEIGHTS = _unit_gauss(4)


@checked
@dataclass(frozen=True, kw_only=True)
class Tube:
    """A round tube: ``outer`` and ``inner`` diameter in m, ``young`` in Pa, ``poisson``, ``density`` in kg/m3.

    Raises:
        InputError: numbers that make no tube.

    >>> Tube(outer=3e-3, inner=2.6e-3, young=195e9, density=8000.0).poisson
    0.3
    """

    outer: float
    inner: float
    young: Positive
    density: Positive
    poisson: PoissonRatio = 0.3

    def __post_init__(self) -> None:
        if not 0 <= self.inner < self.outer < math.inf:
            raise InputError(
                f"a tube of {self.outer} m around {self.inner} m was given; expected a wall between them",
                keyword="thickness",
            )


@checked
@dataclass(frozen=True, kw_only=True)
class Flow:
    """Steady flow: ``mass_flow`` in kg/s along the path, ``density`` in kg/m3, ``area`` of the bore in m2.

    ``outlet`` "held": both ends are at rest, or joined to what supplies them; "free": the last node is a nozzle.

    Raises:
        InputError: numbers or an outlet that are none.

    >>> round(Flow(mass_flow=1e-3, density=1000.0, area=5.31e-6).velocity, 6)
    0.188324
    """

    mass_flow: Finite
    density: Positive
    area: Positive
    outlet: Annotated[str, one_of(*OUTLETS)] = "held"

    def __post_init__(self) -> None:
        if self.outlet == "free" and self.mass_flow < 0:
            raise InputError(
                "flow: a free outlet is the end of the path; give the nodes in the order of the flow",
                kind="model",
                keyword="path",
            )

    @property
    def velocity(self) -> float:
        """Mean velocity in m/s."""
        return self.mass_flow / (self.density * self.area)


@checked
def tube_model(points: Floats, tube: Tube, held: tuple[int, ...] = ()) -> FEModel:
    """Tube of two-node Bernoulli elements through ``points`` (n, 3) in m, six dofs per node but for those ``held``.

    Args:
        points: (n, 3) in m.
        tube: cross-section and material.
        held: rows of ``points`` without motion.

    Raises:
        InputError: fewer than two points, two in a row at one place, or rows in ``held`` that are none of them.

    >>> line = np.linspace([0.0, 0, 0], [1.0, 0, 0], 9)
    >>> tube_model(line, Tube(outer=0.02, inner=0.016, young=2e11, density=7800.0), held=(0, 8)).size
    42
    """
    xyz = np.ascontiguousarray(points, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1:] != (3,) or len(xyz) < 2:
        raise InputError(f"the points of a tube have the shape {xyz.shape}; expected (n, 3) with two or more")
    path, ends = np.arange(len(xyz)), np.asarray(held, dtype=np.int64)
    if not np.isin(ends, path).all():
        raise InputError(
            f"held = {tuple(held)} was given; expected rows of the points, 0 to {len(xyz) - 1}", keyword="held"
        )
    elements = _Elements.on(xyz, path)
    area = np.pi / 4 * (tube.outer**2 - tube.inner**2)
    second = np.pi / 64 * (tube.outer**4 - tube.inner**4)
    shear = tube.young / (2 + 2 * tube.poisson)
    bending = np.array([0.0, tube.young * second, tube.young * second])[:, None] * elements.curvature
    stretch = np.array([tube.young * area, 0.0, 0.0])[:, None] * elements.slope
    K = elements.integral(elements.curvature, bending) + elements.integral(elements.slope, stretch)
    K += elements.integral(elements.twist_slope, 2 * shear * second * elements.twist_slope)
    M = elements.integral(elements.shape, tube.density * area * elements.shape)
    M += elements.integral(elements.twist, 2 * tube.density * second * elements.twist)
    dof = np.arange(6 * len(xyz))
    free = np.flatnonzero(~np.isin(dof // 6, ends))
    K, M = (sp.csr_array(elements.assemble(A, dof.reshape(-1, 6), len(dof))[free][:, free]) for A in (K, M))
    nodes = Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz, sets={"TUBE": path})
    return FEModel(K=K, M=M, nodes=nodes, dofs=DofMap(node=free // 6, component=free % 6), source="tube")


@checked
def add_flow(model: FEModel, path: Ints, flow: Flow) -> FEModel:
    """``model`` with ``flow`` through the tube along the nodes ``path`` (rows of ``model.nodes``, in order).

    Nodes have displacements and rotations, as those of beams; dofs that the model does not have are at rest. Fluid mass
    joins M, its centrifugal force K, its Coriolis force G; a free outlet adds to D, K and N.

    Args:
        model: the tube, in SI.
        path: rows (n,) of its nodes from inlet to outlet.
        flow: density, speed and ends of the fluid.

    Raises:
        InputError: nodes in no order, twice or without rotations.

    >>> line = np.linspace([0.0, 0, 0], [1.0, 0, 0], 9)
    >>> tube = tube_model(line, Tube(outer=0.02, inner=0.016, young=2e11, density=7800.0), held=(0, 8))
    >>> add_flow(tube, np.arange(9), Flow(mass_flow=2.0, density=1000.0, area=2.01e-4))
    FEModel: dofs 42; nodes 9; matrices K, M, G; source tube
    """
    path = np.asarray(path, dtype=np.int64)
    table = model.dofs.table(len(model.nodes))[:, :6]
    _check_path(model, path, table)
    elements, own = _Elements.on(model.nodes.xyz, path), table[path]
    shape, slope, q = elements.shape, elements.slope, flow.mass_flow
    half = q * elements.integral(shape, slope)
    added = {
        "M": elements.integral(shape, flow.density * flow.area * shape),
        "G": half - np.swapaxes(half, 1, 2),
        "K": -q * flow.velocity * elements.integral(slope, slope),
    }
    if flow.outlet == "free":
        end, tilt = (elements.at_end(derivative=k) for k in (0, 1))
        added["D"] = np.zeros_like(half)
        added["N"] = np.zeros_like(half)
        added["D"][-1] = q * end.T @ end
        added["N"][-1] = q * flow.velocity * end.T @ tilt
    changes: dict[str, Any] = {}
    for name, A in added.items():
        known, more = getattr(model, name), elements.assemble(A, own, model.size)
        changes[name] = more if known is None else sp.csr_array(known + more)
    return replace(model, **changes)


def _check_path(model: FEModel, path: Ints, table: Ints) -> None:
    labels = model.nodes.ids
    if len(path) < 2 or len(np.unique(path)) < len(path) or path.min() < 0 or path.max() >= len(labels):
        raise InputError(
            f"flow: {len(path)} nodes were given; expected two or more of the model, each once", keyword="path"
        )
    if (table[path, 3:] < 0).all():
        raise InputError("flow: the nodes of the path have no rotations; expected a tube of beam elements")
    for a, b in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
        rows, columns = (table[node][table[node] >= 0] for node in (a, b))
        if len(rows) and len(columns) and not np.abs(model.K[rows][:, columns]).sum() > 0:
            raise InputError(
                f"flow: nodes {labels[a]} and {labels[b]} follow each other in the path, but no element joins them; "
                "give the nodes in the order of the flow",
                kind="model",
                keyword="path",
            )


@dataclass(frozen=True, eq=False)
class _Elements:
    """Shapes (ne, 4 points, 3, 12) of displacements along local axes (tangent first), and the axes (ne, 3, 3)."""

    length: Floats
    axes: Floats

    @classmethod
    def on(cls, xyz: Floats, path: Ints) -> _Elements:
        along = np.diff(xyz[path], axis=0)
        length = np.linalg.norm(along, axis=1)
        if not (np.isfinite(length) & (length > 0)).all():
            raise InputError(
                "a tube has two nodes at one place in a row, or at none; expected finite, separate places", kind="model"
            )
        tangent = along / length[:, None]
        other = np.eye(3)[np.abs(tangent).argmin(axis=1)]
        normal = np.cross(tangent, other)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return cls(length, np.stack([tangent, normal, np.cross(tangent, normal)], axis=1))

    def _hermite(self, x: Floats, derivative: int) -> Floats:
        """(ne, points, 3, 12) displacements or their ``derivative`` along the tube at ``x`` (points,) from 0 to 1."""
        L, one = self.length[:, None], np.ones_like(x)
        none = np.zeros_like(x)
        rows = [[one, x, x**2, x**3], [none, one, 2 * x, 3 * x**2], [none, none, 2 * one, 6 * x]]
        powers = np.stack(rows[derivative]) / L[..., None] ** derivative
        bent = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]]) @ powers
        straight = np.array([[1, -1, 0, 0], [0, 1, 0, 0]]) @ powers
        N = np.zeros((len(self.length), len(x), 3, 12))
        for node in (0, 1):
            at = 6 * node
            N[:, :, 0, at] = straight[:, node]
            N[:, :, 1, at + 1] = N[:, :, 2, at + 2] = bent[:, 2 * node]
            N[:, :, 1, at + 5] = L * bent[:, 2 * node + 1]
            N[:, :, 2, at + 4] = -L * bent[:, 2 * node + 1]
        return N

    @property
    def shape(self) -> Floats:
        """Displacements."""
        return self._hermite(POINTS, 0)

    @property
    def slope(self) -> Floats:
        """Their derivatives along the tube."""
        return self._hermite(POINTS, 1)

    @property
    def curvature(self) -> Floats:
        """Second derivatives, along the tangent zero."""
        return self._hermite(POINTS, 2)

    @property
    def twist(self) -> Floats:
        """Rotation about the tangent (ne, points, 1, 12)."""
        N = np.zeros((len(self.length), len(POINTS), 1, 12))
        N[..., 0, 3], N[..., 0, 9] = 1 - POINTS, POINTS
        return N

    @property
    def twist_slope(self) -> Floats:
        """Its derivative along the tube."""
        N = np.zeros((len(self.length), len(POINTS), 1, 12))
        N[..., 0, 9] = 1 / self.length[:, None]
        N[..., 0, 3] = -N[..., 0, 9]
        return N

    def at_end(self, derivative: int) -> Floats:
        """Displacements (3, 12) of the last node along the axes of the last element, or their derivative."""
        return np.asarray(self._hermite(np.ones(1), derivative)[-1, 0])

    def integral(self, test: Floats, trial: Floats) -> Floats:
        """(ne, 12, 12) along the elements of test' trial."""
        return np.asarray(np.einsum("g,e,egai,egaj->eij", WEIGHTS, self.length, test, trial))

    def assemble(self, A: Floats, dofs: Ints, size: int) -> sp.csr_array:
        """``A`` (ne, 12, 12) in local axes as a matrix on the ``dofs`` (nodes, 6) of the path; those below zero are
        left out."""
        T = np.kron(np.eye(4), np.ones((3, 3))) * np.tile(self.axes, (1, 4, 4))
        whole = np.swapaxes(T, 1, 2) @ A @ T
        at = np.concatenate([dofs[:-1], dofs[1:]], axis=1)
        row, column = np.broadcast_arrays(at[:, :, None], at[:, None, :])
        there = (row >= 0) & (column >= 0)
        return sp.csr_array(sp.coo_array((whole[there], (row[there], column[there])), shape=(size, size)))
