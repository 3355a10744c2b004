"""Solid elements: shape functions from scikit-fem in VTK node order, quadrature, faces.

Reference domains are those of scikit-fem: the unit simplex, the unit cube [0, 1]^3, and the unit
triangle times [0, 1]. The order of scikit-fem's functions differs from VTK's; it is found from
where each function is one, so no table of permutations can be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from itertools import combinations
from typing import Any

import numpy as np

from morembs.base.types import Floats, Ints

Order = int | tuple[int, int] | str
# Rules by name, exact to degree 5: 14 points in a hexahedron (Irons 1971), 15 in a tetrahedron (Stroud 1971, T3 5-1);
# of a bar along the first axis 2 points by 5 times 5 in a section (Kronrod 1965).
IRONS, STROUD, BAR = "irons", "stroud", "bar"


def _with_edges(corners: Sequence[Sequence[float]], edges: Sequence[tuple[int, int]]) -> Floats:
    corner = np.array(corners, dtype=float)
    return np.vstack([corner, *[(corner[[a]] + corner[[b]]) / 2 for a, b in edges]])


_TRI = [[0, 0], [1, 0], [0, 1]]
_QUAD = [[0, 0], [1, 0], [1, 1], [0, 1]]
_TET = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
_HEX = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
_WEDGE = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]]
# Corners of the edges by shape, in the order of VTK.
_EDGES = {
    "tri": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tet": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hex": ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
}
_HEX_CENTERS = [[0, 0.5, 0.5], [1, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 1, 0.5], [0.5, 0.5, 0], [0.5, 0.5, 1]]
_HEX20 = _with_edges(_HEX, _EDGES["hex"])
_TET_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
_HEX_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
WEDGE_EDGES = ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
WEDGE15 = _with_edges(_WEDGE, WEDGE_EDGES)
_WEDGE_FACES = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))


@dataclass(frozen=True)
class Rule:
    """Quadrature points (nq, dim) and weights (nq,) with the shape functions there.

    ``N`` (nq, k) values and ``dN`` (nq, k, dim) gradients in reference coordinates.
    """

    points: Floats
    weights: Floats
    N: Floats
    dN: Floats


@dataclass(frozen=True, kw_only=True)
class ElementType:
    """One element type.

    ``formula`` says where its shape functions are, ``reference`` (k, dim) node positions in VTK order, ``faces`` the
    corner nodes of each face seen from outside, ``stiffness_order`` and ``mass_order`` the polynomial degrees
    integrated exactly; of a wedge they may be two, in the triangle and along the axis.
    """

    name: str
    formula: str
    reference: Floats
    vtk: int
    stiffness_order: Order
    mass_order: Order
    faces: tuple[tuple[int, ...], ...] = ()
    face_types: tuple[str, ...] = ()

    @property
    def n_nodes(self) -> int:
        """Nodes per element."""
        return len(self.reference)

    @cached_property
    def function(self) -> Any:
        """Shape functions of scikit-fem, which is imported where they are asked for: the table needs none."""
        module, _, name = self.formula.rpartition(".")
        return getattr(import_module(module), name)()

    @cached_property
    def _order(self) -> Ints:
        distance = np.linalg.norm(self.reference[:, None] - self.function.doflocs[None], axis=2)
        return np.asarray(np.argmin(distance, axis=1))

    def shape(self, points: Floats) -> tuple[Floats, Floats]:
        """Values (nq, k) and reference gradients (nq, k, dim) at ``points`` (nq, dim)."""
        pairs = [self.function.lbasis(points.T, int(i)) for i in self._order]
        ones = np.ones(len(points))
        N = np.stack([value * ones for value, _ in pairs], axis=1)
        dN = np.stack([(np.asarray(grad) * ones).T for _, grad in pairs], axis=1)
        return N, dN

    def rule(self, order: Order) -> Rule:
        """Quadrature exact to the degree ``order``, or of that name, with the shape functions at its points."""
        points, weights = _quadrature(self.function.refdom, order)
        N, dN = self.shape(points)
        return Rule(points, weights, N, dN)

    @cached_property
    def face_nodes(self) -> tuple[tuple[str, Ints], ...]:
        """For each face its type and its nodes in VTK order, the normal pointing outwards."""
        result = []
        for corners, kind in zip(self.faces, self.face_types, strict=True):
            face = FACES[kind]
            linear = FACES["tri3" if len(corners) == 3 else "quad4"]
            N, _ = linear.shape(face.reference)
            points = N @ self.reference[list(corners)]
            distance = np.linalg.norm(points[:, None] - self.reference[None], axis=2)
            result.append((kind, np.argmin(distance, axis=1)))
        return tuple(result)


def _quadrature(domain: type, order: Order) -> tuple[Floats, Floats]:
    """Points (nq, dim) and weights of a rule exact to degree ``order``."""
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefLine, RefTet, RefTri, RefWedge

    if isinstance(order, str):
        return {IRONS: _irons, STROUD: _stroud, BAR: _bar}[order]()
    across, along = order if isinstance(order, tuple) else (order, order)
    if domain is not RefWedge:
        # Rules of order 1 have more than one point there, but for tetrahedra; here it is the centre.
        if across == 1 and domain is not RefTet:
            return np.full((1, 3), 0.5), np.ones(1)
        # scikit-fem's tetrahedron rules from order 5 on miss their last degree by some percent, and its
        # rule of order 4 has negative weights: ask for one more.
        X, W = get_quadrature(domain, across + 1 if domain is RefTet and across >= 4 else across)
        return np.ascontiguousarray(X.T), W
    # scikit-fem's own wedge rule integrates the volume 0.25 instead of 0.5, so the product is made here.
    tri, w_tri = (np.full((2, 1), 1 / 3), [0.5]) if across == 1 else get_quadrature(RefTri, across)
    line, w_line = get_quadrature(RefLine, along)
    points = [[x, y, z] for z in line[0] for x, y in tri.T]
    return np.array(points), np.array([a * b for b in w_line for a in w_tri])


def _irons() -> tuple[Floats, Floats]:
    inner, outer = np.sqrt(19 / 30), np.sqrt(19 / 33)
    points = np.vstack([inner * np.eye(3), -inner * np.eye(3), outer * (2 * np.array(_HEX, dtype=float) - 1)])
    # Irons 1971: 320 / 361 for the six points on the axes, 121 / 361 for the eight on the diagonals, of a volume of 8.
    return (points + 1) / 2, np.repeat([320 / 361, 121 / 361], [6, 8]) / 8


def _bar() -> tuple[Floats, Floats]:
    # Kronrod 1965: three points between those of Gauss' rule with two; the weights follow from degrees 0 to 4.
    outer, inner = np.sqrt(6 / 7), np.sqrt(1 / 3)
    across, degree = np.array([-outer, -inner, 0.0, inner, outer]), np.arange(5)
    weight = np.linalg.solve(across ** degree[:, None], (1 - (-1.0) ** (degree + 1)) / (degree + 1))
    points = [[x, y, z] for x in (-inner, inner) for y in across for z in across]
    return (np.array(points) + 1) / 2, np.tile(np.outer(weight, weight).ravel(), 2) / 8


def _stroud() -> tuple[Floats, Floats]:
    root = np.sqrt(15)
    corners = np.vstack([np.zeros(3), np.eye(3)])
    # Weights of the middle, 16 / 135, of two sets of four and of the six points below (Stroud 1971).
    points, weights = [np.full((1, 3), 0.25)], [16 / 135]
    for sign in (1, -1):
        a = (7 - sign * root) / 34
        points.append(a + (1 - 4 * a) * corners)
        # Rational numbers and sqrt(15) make the rule exact for all polynomials of degree five.
        weights += [(2665 + sign * 14 * root) / 37800] * 4
    c = (5 - root) / 20
    points.append(np.array([c + (0.5 - 2 * c) * (corners[i] + corners[j]) for i, j in combinations(range(4), 2)]))
    # 20 / 378 for each of the six; all weights are parts of the volume, 1 / 6.
    return np.vstack(points), np.array(weights + [20 / 378] * 6) / 6


def _face(name: str, formula: str, reference: Floats, vtk: int, order: int) -> ElementType:
    return ElementType(
        name=name, formula=formula, reference=reference, vtk=vtk, stiffness_order=order, mass_order=order
    )


FACES: dict[str, ElementType] = {
    face.name: face
    for face in (
        _face("tri3", "skfem.ElementTriP1", np.array(_TRI, dtype=float), 5, 2),
        _face("tri6", "skfem.ElementTriP2", _with_edges(_TRI, _EDGES["tri"]), 22, 6),
        _face("quad4", "skfem.ElementQuad1", np.array(_QUAD, dtype=float), 9, 3),
        _face("quad8", "skfem.ElementQuadS2", _with_edges(_QUAD, _EDGES["quad"]), 23, 7),
        _face("quad9", "skfem.ElementQuad2", np.vstack([_with_edges(_QUAD, _EDGES["quad"]), [[0.5, 0.5]]]), 28, 7),
    )
}


def _solid(
    name: str,
    formula: str,
    reference: Floats,
    vtk: int,
    orders: tuple[Order, Order],
    faces: tuple[tuple[int, ...], ...],
    kinds: tuple[str, ...],
) -> ElementType:
    return ElementType(
        name=name,
        formula=formula,
        reference=reference,
        vtk=vtk,
        stiffness_order=orders[0],
        mass_order=orders[1],
        faces=faces,
        face_types=kinds,
    )


# Stiffness rules are those of the field (4 points in tet10, 3x3x3 in hex20, 3x3 in wedge15); mass is integrated
# exactly on straight-sided elements.
TYPES: dict[str, ElementType] = {
    kind.name: kind
    for kind in (
        _solid("tet4", "skfem.ElementTetP1", np.array(_TET, dtype=float), 10, (1, 2), _TET_FACES, ("tri3",) * 4),
        _solid("tet10", "skfem.ElementTetP2", _with_edges(_TET, _EDGES["tet"]), 24, (2, 4), _TET_FACES, ("tri6",) * 4),
        _solid("hex8", "skfem.ElementHex1", np.array(_HEX, dtype=float), 12, (3, 5), _HEX_FACES, ("quad4",) * 6),
        _solid("hex20", "skfem.ElementHexS2", _HEX20, 25, (5, 5), _HEX_FACES, ("quad8",) * 6),
        _solid(
            "hex27",
            "skfem.ElementHex2",
            np.vstack([_HEX20, _HEX_CENTERS, [[0.5] * 3]]),
            29,
            (5, 5),
            _HEX_FACES,
            ("quad9",) * 6,
        ),
        _solid(
            "wedge6",
            "skfem.ElementWedge1",
            np.array(_WEDGE, dtype=float),
            13,
            (2, 4),
            _WEDGE_FACES,
            ("tri3",) * 2 + ("quad4",) * 3,
        ),
        _solid(
            "wedge15",
            "morembs.fem.wedge15.ElementWedgeS2",
            WEDGE15,
            26,
            ((2, 5), 5),
            _WEDGE_FACES,
            ("tri6",) * 2 + ("quad8",) * 3,
        ),
    )
}

__all__ = ["FACES", "IRONS", "STROUD", "TYPES", "ElementType", "Order", "Rule"]
