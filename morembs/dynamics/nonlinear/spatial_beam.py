"""Geometrically exact beams in space (Simo 1985; Reissner 1981): stretch, two shears, torsion, two bendings, finite.

Every element has constant strain: from its first to its second frame runs a helix, so that r_B - r_A =
R_A J(phi) g l with exp(phi) = R_A' R_B, J = T(phi)' (elements on the group of rigid motions: Sonneville, Cardona and
Bruels 2014). Strains g and phi / l depend on nothing but the motion of B relative to A: they are the same after any
rigid motion, and a constant moment bends into an exact circle. Bending that varies along an element adds its
flexibility to that of shear, 1/GA + l^2/(12 EI) (MacNeal 1978), so that nothing locks.

Coordinates of a node: position (m) and rotation vector p (rad) along the fixed axes; its frame is exp(p) times that
without load. Forces on p and the tangent are derivatives of the energy by p itself, for |p| < 2 pi.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, PoissonRatio, Positive, PositiveCount
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.helix import Helix
from morembs.dynamics.nonlinear.rotation_vectors import curvature, shorten_vectors, tangents
from morembs.dynamics.nonlinear.tolerances import TOL


@checked
@dataclass(frozen=True, kw_only=True)
class SpatialSection:
    """Stiffness EA, shears GA2, GA3 (N), torsion GJ, bendings EI2, EI3 (N m2) about the axes 2 and 3 of the section.

    ``mass`` per length (kg/m); ``rotary`` per length (kg m) about the axes 1 (along the beam), 2 and 3.
    """

    EA: Positive
    GA2: Positive
    GA3: Positive
    GJ: Positive
    EI2: Positive
    EI3: Positive
    mass: Positive
    rotary: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)

    @classmethod
    @checked
    def rectangle(
        cls,
        width: Positive,
        height: Positive,
        *,
        E: Positive,
        nu: PoissonRatio,
        density: Positive,
        shear: Positive = 5 / 6,
    ) -> SpatialSection:
        """Solid rectangle, ``width`` along axis 2 and ``height`` along axis 3 in m; torsion after Saint-Venant."""
        A, I2, I3, G = width * height, width * height**3 / 12, height * width**3 / 12, E / (2 * (1 + nu))
        long, short = max(width, height), min(width, height)
        odd = np.arange(1, 40, 2)
        series = float(np.sum(np.tanh(odd * np.pi * long / (2 * short)) / odd**5))
        # Timoshenko and Goodier: Theory of Elasticity, torsion of rectangular bars.
        torsion = long * short**3 / 3 * (1 - 192 * short / (np.pi**5 * long) * series)
        return cls(
            EA=E * A,
            GA2=shear * G * A,
            GA3=shear * G * A,
            GJ=G * torsion,
            EI2=E * I2,
            EI3=E * I3,
            mass=density * A,
            rotary=(density * (I2 + I3), density * I2, density * I3),
        )


@checked
class SpatialBeam:
    """A chain of geometrically exact elements in space.

    Args:
        nodes: (n, 3) positions in m without load.
        frames: (n, 3, 3) axes of the sections as columns: along the beam, then the axes 2 and 3.
        section: one for all elements.
        corrected: add the flexibility of bending that varies along an element.

    The interfaces ``start`` and ``end`` are the first and the last node.

    Raises:
        InputError: fewer than two nodes, axes that are no rotations, elements without length, or that turn by half
            a turn or more, or whose axis does not follow its nodes.
    """

    def __init__(self, nodes: ArrayLike, frames: ArrayLike, section: SpatialSection, *, corrected: bool = True) -> None:
        xyz, axes = np.asarray(nodes, dtype=float), np.asarray(frames, dtype=float)
        if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) < 2 or axes.shape != (len(xyz), 3, 3):
            raise InputError(
                f"nodes {xyz.shape} and frames {axes.shape} of a beam were given; expected (n >= 2, 3) and (n, 3, 3)",
                keyword="frames",
            )
        square = np.einsum("nij,nik->njk", axes, axes)
        if not (
            np.isfinite(xyz).all()
            and np.abs(square - np.eye(3)).max() < TOL.frame_error
            and np.linalg.det(axes).min() > 0
        ):
            raise InputError(
                "nodes and frames of a beam: expected finite positions and right-handed orthonormal axes",
                keyword="frames",
            )
        self.nodes, self.section, self.corrected = xyz, section, corrected
        self._rotation = Rotation.from_matrix(axes)
        self._frames = self._rotation.as_matrix()
        helix = Helix.between(*self._ends(self.reference)[:3])
        self.lengths = np.linalg.norm(helix.chord, axis=1)
        along = helix.chord[:, 0]
        if np.linalg.norm(helix.phi, axis=1).max() > 3.0 or not (along > TOL.least_chord_along * self.lengths).all():
            raise InputError(
                "nodes of a beam: an element has no length, turns by 3 rad or more, or does not follow the first axis "
                "of its frames; expected nodes in order along the beam, or more of them",
                kind="model",
                keyword="nodes",
            )
        self._strain0 = np.hstack((helix.chord, helix.phi)) / self.lengths[:, None]
        s, length = section, self.lengths
        extra = length**2 / 12 if corrected else 0 * length
        ones = np.ones_like(length)
        self._C = np.column_stack(
            (
                s.EA * ones,
                1 / (1 / s.GA2 + extra / s.EI3),
                1 / (1 / s.GA3 + extra / s.EI2),
                s.GJ * ones,
                s.EI2 * ones,
                s.EI3 * ones,
            )
        )
        dofs = 6 * np.arange(len(xyz) - 1)[:, None] + np.arange(12)
        self._dofs = dofs
        self._rows, self._columns = np.repeat(dofs, 12, axis=1).ravel(), np.tile(dofs, (1, 12)).ravel()

    @classmethod
    @checked
    def straight(
        cls, length: Positive, elements: PositiveCount, section: SpatialSection, *, corrected: bool = True
    ) -> SpatialBeam:
        """A straight beam along x from the origin, its axes 2 and 3 along y and z; ``length`` in m."""
        nodes = np.zeros((elements + 1, 3))
        nodes[:, 0] = np.linspace(0, length, elements + 1)
        return cls(nodes, np.tile(np.eye(3), (elements + 1, 1, 1)), section, corrected=corrected)

    @classmethod
    @checked
    def arc(
        cls,
        radius: Positive,
        angle: Positive,
        elements: PositiveCount,
        section: SpatialSection,
        *,
        corrected: bool = True,
    ) -> SpatialBeam:
        """A circular arc in the plane of x and y that leaves the origin along x and bends to y; ``angle`` in rad."""
        t = np.linspace(0, angle, elements + 1)
        nodes = radius * np.column_stack((np.sin(t), 1 - np.cos(t), 0 * t))
        frames = Rotation.from_rotvec(np.column_stack((0 * t, 0 * t, t))).as_matrix()
        return cls(nodes, frames, section, corrected=corrected)

    @property
    def size(self) -> int:
        return 2 * self.nodes.size

    @property
    def frames(self) -> Mapping[str, Ints]:
        """Interfaces: numbers (6,) of position and rotation vector."""
        return {"start": np.arange(6), "end": np.arange(self.size - 6, self.size)}

    @property
    def translations(self) -> Ints:
        """Numbers (n, 3) of the positions."""
        return np.arange(self.size).reshape(-1, 6)[:, :3]

    @property
    def reference(self) -> Floats:
        return np.hstack((self.nodes, np.zeros_like(self.nodes))).ravel()

    @cached_property
    def M(self) -> sp.csr_matrix:
        """Mass matrix without load; rotary inertia turns with the frames, other terms are constant."""
        shares = np.array([[2, 1], [1, 2]]) / 6
        J = np.einsum("nij,j,nkj->nik", self._frames, np.array(self.section.rotary), self._frames)
        blocks = np.zeros((len(self.lengths), 2, 6, 2, 6))
        for a in range(2):
            for b in range(2):
                blocks[:, a, :3, b, :3] = shares[a, b] * self.section.mass * np.eye(3)
            # Rotary inertia is lumped, so that it stays with the frame of its node.
            blocks[:, a, 3:, a, 3:] = 0.5 * (J[:-1] if a == 0 else J[1:])
        return self._assemble(self.lengths[:, None, None] * blocks.reshape(-1, 12, 12))

    def _assemble(self, blocks: Floats) -> sp.csr_matrix:
        return sp.coo_matrix((blocks.ravel(), (self._rows, self._columns)), shape=(self.size, self.size)).tocsr()

    def _ends(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Per element R_A, d = R_A' (r_B - r_A), phi; and all rotation vectors (n, 3)."""
        table = np.reshape(x, (-1, 6))
        p = table[:, 3:]
        turned = Rotation.from_rotvec(p) * self._rotation
        R = turned[:-1].as_matrix()
        phi = (turned[:-1].inv() * turned[1:]).as_rotvec()
        return R, np.einsum("eji,ej->ei", R, np.diff(table[:, :3], axis=0)), phi, p

    def strain(self, x: Floats) -> Floats:
        """(elements, 6) extension, two shears (no unit), twist and two changes of curvature (1/m), in body axes."""
        helix = Helix.between(*self._ends(x)[:3])
        return np.asarray(np.hstack((helix.chord, helix.phi)) / self.lengths[:, None] - self._strain0)

    def resultants(self, x: Floats) -> Floats:
        """(elements, 6) axial and two shear forces (N), torque and two bending moments (N m), in body axes."""
        return np.asarray(self._C * self.strain(x))

    def energy(self, x: Floats) -> float:
        """Strain energy W in J."""
        return 0.5 * float(np.sum(self._C * self.lengths[:, None] * self.strain(x) ** 2))

    def _charts(self, p: Floats) -> Floats:
        """Rates (n, 3, 3) of the spin of a section, in its axes, per rate of the rotation vector."""
        return np.asarray(np.swapaxes(self._frames, 1, 2) @ tangents(p))

    def _helix(self, x: Floats) -> tuple[Helix, Floats, Floats]:
        """Helices, resultants (e, 6) and rotation vectors (n, 3)."""
        R, d, phi, p = self._ends(x)
        helix = Helix.between(R, d, phi)
        strain = np.hstack((helix.chord, helix.phi)) / self.lengths[:, None] - self._strain0
        return helix, self._C * strain, p

    def force(self, x: Floats) -> Floats:
        """Inner forces dW/dx (N,)."""
        helix, stress, p = self._helix(x)
        spun = np.zeros(self.size)
        np.add.at(spun, self._dofs, helix.gradient(stress))
        result = spun.reshape(-1, 6)
        result[:, 3:] = np.einsum("nij,ni->nj", self._charts(p), result[:, 3:])
        return spun

    def resultants_after(self, x: Floats, step: Floats) -> Floats:
        """Resultants at x and their first-order change by a ``step`` (N,) of the coordinates, see ``tangent``."""
        helix, stress, p = self._helix(x)
        spun = np.array(step, dtype=float).reshape(-1, 6)
        spun[:, 3:] = np.einsum("nij,nj->ni", self._charts(p), spun[:, 3:])
        return np.asarray(stress + self._C * helix.rates(spun.ravel()[self._dofs]) / self.lengths[:, None])

    def tangent(self, x: Floats, resultants: Floats | None = None) -> sp.csr_matrix:
        """Tangent stiffness d2W/dx2 (N, N); ``resultants`` (e, 6) may replace those at x in its geometric part.

        Newton's method needs far fewer steps with ``resultants_after`` the last one (Magisano, Leonetti, Garcea 2017).
        """
        helix, stress, p = self._helix(x)
        stress = stress if resultants is None else resultants
        gradient = helix.gradient(stress)
        H = helix.hessian(stress, self._C / self.lengths[:, None])
        charts = self._charts(p)
        for a, nodes in ((3, slice(None, -1)), (9, slice(1, None))):
            part = slice(a, a + 3)
            H[:, :, part] = H[:, :, part] @ charts[nodes]
            H[:, part, :] = np.swapaxes(charts[nodes], 1, 2) @ H[:, part, :]
            moment = np.einsum("nij,nj->ni", self._frames[nodes], gradient[:, part])
            H[:, part, part] += curvature(p[nodes], moment)
        return self._assemble(H)

    def moment(self, x: Floats, node: int, moment: ArrayLike) -> Floats:
        """Forces (N,) on the coordinates of a moment (3,) N m along the fixed axes on a node, at x.

        It is no dead load of the coordinates unless the node turns about the axis of the moment.
        """
        load = np.zeros(self.size).reshape(-1, 6)
        load[node, 3:] = tangents(np.reshape(x, (-1, 6))[node, 3:]) @ np.asarray(moment, dtype=float)
        return load.ravel()

    def shorten_rotations(self, x: Floats, held: ArrayLike = ()) -> Floats:
        """The same configuration with rotation vectors of at most half a turn, but for those with ``held`` numbers."""
        table = np.array(x, dtype=float).reshape(-1, 6)
        free = ~np.isin(np.arange(self.size), np.asarray(held)).reshape(-1, 6)[:, 3:].any(axis=1)
        table[free, 3:] = shorten_vectors(table[free, 3:])
        return table.ravel()

    def of_frames(
        self, r: Floats, R: Floats, rates: Floats | None = None, damping: float = 0.0
    ) -> tuple[float, Floats, float]:
        """Strain energy (J), forces (n, 6) and power (W) of damping for positions r (n, 3) and sections R (n, 3, 3).

        Forces are derivatives of the energy by steps along the fixed axes and by spins along those of the sections.
        ``rates`` (n, 6) of both are damped by ``damping`` (s) times the stiffness of strains.
        """
        d = np.einsum("eji,ej->ei", R[:-1], np.diff(r, axis=0))
        phi = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec()
        helix = Helix.between(R[:-1], d, phi)
        strain = np.hstack((helix.chord, helix.phi)) / self.lengths[:, None] - self._strain0
        stress, power = self._C * strain, 0.0
        energy = 0.5 * float(np.sum(self.lengths[:, None] * stress * strain))
        if damping and rates is not None:
            rate = helix.rates(rates.ravel()[self._dofs]) / self.lengths[:, None]
            stress = stress + damping * self._C * rate
            power = -damping * float(np.sum(self.lengths[:, None] * self._C * rate**2))
        force = np.zeros(self.size)
        np.add.at(force, self._dofs, helix.gradient(stress))
        return energy, force.reshape(-1, 6), power

    @property
    def sections(self) -> Floats:
        """Axes (n, 3, 3) of the sections without load, as columns."""
        return np.array(self._frames)

    def move_rigidly(self, x: Floats, turn: Floats, step: Floats) -> Floats:
        """The configuration x after a rigid rotation ``turn`` (3, 3) about the origin and a ``step`` (3,) in m."""
        table = np.array(x, dtype=float).reshape(-1, 6)
        Q = Rotation.from_matrix(turn)
        table[:, :3] = Q.apply(table[:, :3]) + step
        table[:, 3:] = (Q * Rotation.from_rotvec(table[:, 3:])).as_rotvec()
        return table.ravel()
