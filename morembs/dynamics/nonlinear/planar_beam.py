"""Planar geometrically exact beams: extension, shear and bending of Reissner (1972) without limits on rotations.

An element has two nodes (x, y, rotation) and constant strain. Between its nodes the section moves along the one
screw of the plane that joins them (Sonneville, Cardona, Bruels 2014): with the relative rotation p, the rotation
b half way and the step d from node to node,

    Gamma = (p/2) / sin(p/2) R(b)' d / l - (1, 0),   kappa = p / l.

Constant strain is therefore exact for any rotation, strains do not feel rigid motions, and nothing locks. The
bending that varies along an element adds its flexibility to that of shear, 1/GA + l^2/(12 EI) (MacNeal 1978), which
makes the nodes of straight elements exact under end loads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, Positive, PositiveCount
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.tolerances import TOL

# From node coordinates (6,) to step d (2,), rotation half way and relative rotation.
_T = np.array([[-1, 0, 0, 1, 0, 0], [0, -1, 0, 0, 1, 0], [0, 0, 0.5, 0, 0, 0.5], [0, 0, -1, 0, 0, 1]], dtype=float)


@checked
@dataclass(frozen=True, kw_only=True)
class Section:
    """Stiffness EA (N), GA (N, of shear), EI (N m2) and mass per length (kg/m), rotary inertia per length (kg m)."""

    EA: Positive
    GA: Positive
    EI: Positive
    mass: Positive
    rotary: NotNegative = 0.0

    @classmethod
    @checked
    def of(cls, *, E: float, A: float, I: float, density: float, nu: float = 0.3, shear: float = 6 / 7) -> Section:  # noqa: E741
        """From Young's modulus E (Pa), area A (m2), second moment I (m4), density (kg/m3) and shear factor."""
        return cls(EA=E * A, GA=shear * E * A / (2 * (1 + nu)), EI=E * I, mass=density * A, rotary=density * I)


@checked
class PlanarBeam:
    """A chain of geometrically exact elements; a NonlinearComponent.

    Args:
        nodes: (n, 3) x, y (m) and direction of the axis (rad) of each node without load; straight or curved.
        section: one for all elements.
        corrected: add the flexibility of bending that varies along an element.
        directions: (n - 1, 2) rad, of the axis at the start and at the end of each element, less the third numbers of
            its nodes; see ``along``.

    The frames ``start`` and ``end`` are the first and the last node; coordinates are ordered node by node.

    Raises:
        InputError: fewer than two nodes, an element of no length or whose axis does not follow its nodes.
    """

    def __init__(
        self, nodes: ArrayLike, section: Section, *, corrected: bool = True, directions: ArrayLike | None = None
    ) -> None:
        table = np.asarray(nodes, dtype=float)
        if table.ndim != 2 or table.shape[1] != 3 or len(table) < 2 or not np.isfinite(table).all():
            raise InputError(
                f"nodes of a beam: shape {table.shape} was given; expected (n, 3) finite numbers, n >= 2",
                keyword="nodes",
            )
        ends = np.zeros((len(table) - 1, 2)) if directions is None else np.asarray(directions, dtype=float)
        if ends.shape != (len(table) - 1, 2) or not np.isfinite(ends).all():
            raise InputError(
                f"directions of elements: shape {ends.shape} was given; expected ({len(table) - 1}, 2)",
                keyword="directions",
            )
        self._nodes, self.section, self.corrected = table, section, corrected
        self._half0, self._turn0 = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
        step, (half, turn) = np.diff(table[:, :2], axis=0), self._turns(table)
        if np.abs(turn).max() >= np.pi:
            raise InputError(
                f"nodes of a beam: an element turns by {np.abs(turn).max():.3g} rad; expected less than pi, "
                "give the directions without jumps of 2 pi or more nodes"
            )
        along = _rotate_back(half, step) * _screw(turn)[0][:, None]
        self.lengths = np.linalg.norm(along, axis=1)
        if self.lengths.min() <= 0 or np.abs(along[:, 1]).max() > TOL.max_chord_across * self.lengths.max():
            raise InputError(
                "nodes of a beam: an element has no length or does not follow the direction of its nodes; "
                "expected nodes in order along the axis, with its direction as the third number",
                kind="model",
                keyword="nodes",
            )
        self._strain0 = np.column_stack((along / self.lengths[:, None], turn / self.lengths))
        bending = self.lengths**2 / (12 * section.EI) if corrected else 0.0
        shear = 1 / (1 / section.GA + bending) * np.ones_like(self.lengths)
        ones = np.ones_like(self.lengths)
        self._C = np.column_stack((section.EA * ones, shear, section.EI * ones)) * self.lengths[:, None]
        dofs = 3 * np.arange(len(table) - 1)[:, None] + np.arange(6)
        self._dofs = dofs
        self._rows, self._columns = np.repeat(dofs, 6, axis=1).ravel(), np.tile(dofs, (1, 6)).ravel()

    @classmethod
    @checked
    def straight(
        cls, length: Positive, elements: PositiveCount, section: Section, *, corrected: bool = True
    ) -> PlanarBeam:
        """A straight beam along x from the origin, ``length`` in m."""
        nodes = np.zeros((elements + 1, 3))
        nodes[:, 0] = np.linspace(0, length, elements + 1)
        return cls(nodes, section, corrected=corrected)

    @classmethod
    @checked
    def along(cls, line: ArrayLike, section: Section, *, corrected: bool = True) -> PlanarBeam:
        """A beam along a curved or bent line that can be a member: its chord on x from the origin, rotations zero.

        ``line`` (n, 3) as ``nodes``; a position that is given twice, with two directions, is a rigid corner.

        Raises:
            InputError: as for ``PlanarBeam``; ends that meet.
        """
        table = np.array(line, dtype=float)
        if table.ndim != 2 or table.shape[1] != 3 or len(table) < 2 or not np.isfinite(table).all():
            raise InputError(f"line of a beam: shape {table.shape} was given; expected (n, 3) finite numbers, n >= 2")
        chord = table[-1, :2] - table[0, :2]
        size = float(np.ptp(table[:, :2], axis=0).max())
        if not np.hypot(*chord) > TOL.meeting_ends * size:
            raise InputError(
                "the ends of the line of a beam meet; a member needs a chord, divide the line",
                kind="model",
                keyword="line",
            )
        direction = math.atan2(chord[1], chord[0])
        moved = _rotate_back(np.full(len(table), direction), table[:, :2] - table[0, :2])
        moved[-1, 1] = 0.0
        long = np.hypot(*np.diff(moved, axis=0).T) > TOL.same_point * size
        places = np.concatenate(([True], long))
        turns = np.column_stack((table[:-1, 2], table[1:, 2]))[long] - direction
        nodes = np.column_stack((moved[places], np.zeros(places.sum())))
        return cls(nodes, section, corrected=corrected, directions=turns)

    @property
    def directions(self) -> Floats:
        """(elements, 2) rad, of the axis at the start and at the end of each element without load."""
        half, turn = self._turns(self._nodes)
        return np.column_stack((half - turn / 2, half + turn / 2))

    @property
    def size(self) -> int:
        return self._nodes.size

    @property
    def frames(self) -> Mapping[str, Ints]:
        return {"start": np.arange(3), "end": np.arange(self.size - 3, self.size)}

    @property
    def translations(self) -> Ints:
        return np.arange(self.size).reshape(-1, 3)[:, :2]

    @property
    def reference(self) -> Floats:
        return np.array(self._nodes.ravel())

    @cached_property
    def M(self) -> sp.csr_matrix:
        shares = np.array([[2, 1], [1, 2]]) / 6
        block = np.kron(shares, np.diag([self.section.mass, self.section.mass, self.section.rotary]))
        return self._assemble(self.lengths[:, None, None] * block)

    def _assemble(self, blocks: Floats) -> sp.csr_matrix:
        return sp.coo_matrix((blocks.ravel(), (self._rows, self._columns)), shape=(self.size, self.size)).tocsr()

    def _turns(self, table: Floats) -> tuple[Floats, Floats]:
        """Per element: direction half way and relative rotation."""
        return (table[:-1, 2] + table[1:, 2]) / 2 + self._half0, np.diff(table[:, 2]) + self._turn0

    def _states(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Per element: rotation half way (e,), relative rotation (e,), step in the turned frame (e, 2), strain."""
        table = np.reshape(x, (-1, 3))
        half, turn = self._turns(table)
        p = _rotate_back(half, np.diff(table[:, :2], axis=0))
        strain = np.column_stack((_screw(turn)[0][:, None] * p, turn)) / self.lengths[:, None] - self._strain0
        return half, turn, p, strain

    def strain(self, x: Floats) -> Floats:
        """(elements, 3) extension, shear (both without unit) and change of curvature (1/m)."""
        return self._states(x)[3]

    def resultants(self, x: Floats) -> Floats:
        """(elements, 3) axial force (N), shear force (N), bending moment (N m)."""
        return np.asarray(self._C / self.lengths[:, None] * self.strain(x))

    def energy(self, x: Floats) -> float:
        return 0.5 * float(np.sum(self._C * self.strain(x) ** 2))

    def _gradient(self, half: Floats, turn: Floats, p: Floats) -> tuple[Floats, tuple[Floats, ...]]:
        """Derivative of strains (e, 3, 4) by step, rotation half way and relative rotation; pieces for the second."""
        s, s1, s2 = (f / self.lengths for f in _screw(turn))
        R = _rotations(half)
        G = np.zeros((len(half), 3, 4))
        side = np.column_stack((p[:, 1], -p[:, 0]))
        G[:, :2, :2] = s[:, None, None] * R
        G[:, :2, 2] = s[:, None] * side
        G[:, :2, 3] = s1[:, None] * p
        G[:, 2, 3] = 1 / self.lengths
        return G, (s, s1, s2, R, side)

    def force(self, x: Floats) -> Floats:
        half, turn, p, strain = self._states(x)
        G, _ = self._gradient(half, turn, p)
        local = np.einsum("eik,ei->ek", G, self._C * strain) @ _T
        result = np.zeros(self.size)
        np.add.at(result, self._dofs, local)
        return result

    def strain_stiffness(self, x: Floats) -> sp.csr_matrix:
        """The part of the tangent (size, size) by which strains resist; the other part turns their forces."""
        half, turn, p, _ = self._states(x)
        G = self._gradient(half, turn, p)[0] @ _T
        return self._assemble(np.einsum("eik,ei,eil->ekl", G, self._C, G))

    def tangent(self, x: Floats) -> sp.csr_matrix:
        half, turn, p, strain = self._states(x)
        G, (s, s1, s2, R, side) = self._gradient(half, turn, p)
        stress = self._C * strain
        K = np.einsum("eik,ei,eil->ekl", G, self._C, G)
        n = stress[:, :2]
        # d/d(half) of R' d is R(half + pi/2)' d: rows of R exchanged, the second with a minus sign.
        swapped = np.stack((R[:, 1], -R[:, 0]), axis=1)
        cross = s[:, None] * np.einsum("ei,eik->ek", n, swapped)
        mixed = s1[:, None] * np.einsum("ei,eik->ek", n, R)
        K[:, :2, 2] += cross
        K[:, 2, :2] += cross
        K[:, :2, 3] += mixed
        K[:, 3, :2] += mixed
        along, across = np.sum(n * p, axis=1), np.sum(n * side, axis=1)
        K[:, 2, 2] -= s * along
        K[:, 2, 3] += s1 * across
        K[:, 3, 2] += s1 * across
        K[:, 3, 3] += s2 * along
        return self._assemble(np.einsum("ka,ekl,lb->eab", _T, K, _T))


def _rotations(angle: Floats) -> Floats:
    """Transposed rotation matrices (e, 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((np.column_stack((c, s)), np.column_stack((-s, c))), axis=1)


def _rotate_back(angle: Floats, step: Floats) -> Floats:
    """R(angle)' step (e, 2)."""
    return np.asarray(np.einsum("eik,ek->ei", _rotations(angle), step))


def _screw(turn: Floats) -> tuple[Floats, Floats, Floats]:
    """f = (turn/2) / sin(turn/2), a chord on its arc, with its first and second derivative."""
    a = turn / 2
    small = np.abs(a) < TOL.screw_series_angle
    b = np.where(small, 1.0, a)
    q = a * a
    sine, cosine = np.sin(b), np.cos(b)
    # Series of x / sin x (Abramowitz and Stegun 4.3.68), and below of its derivatives.
    f = np.where(small, 1 + q / 6 * (1 + 7 * q / 60 * (1 + 31 * q / 294)), b / sine)
    # The first one.
    first = np.where(small, a / 3 * (1 + 7 * q / 30 * (1 + 31 * q / 196)), (sine - b * cosine) / sine**2)
    second = np.where(
        small,
        # The second one.
        (1 + 7 * q / 10 * (1 + 155 * q / 588)) / 3,
        (b * (1 + cosine**2) - 2 * sine * cosine) / sine**3,
    )
    return f, first / 2, second / 4
