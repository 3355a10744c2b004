"""Open chains of slender links in deformation coordinates: two end angles of each element against its chord.

Elements keep their length and have no shear (Jonker 1989). With the directions of all chords, which are sums of the
coordinates, the motion between two nodes is linear in (r, l t, l a n, l b n): start, chord, and the end angles a, b
times the normal of the chord. In these amplitudes the mass matrix of the cubic deflection is constant and exact.
Small vibrations have constant shapes as seen from the links, so that the modes of one configuration may serve for all
(Aarts and Jonker 2002), with the equations as nonlinear as before: q = (joints, eta), end angles V eta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.limits import NotNegative, Positive, PositiveCount
from morembs.base.types import Floats
from morembs.dynamics.nonlinear.member import MemberState
from morembs.dynamics.nonlinear.planar_beam import Section


@checked
@dataclass(frozen=True, kw_only=True)
class Link:
    """A link of equal elements, ``length`` in m, with a point mass ``tip`` in kg at its end."""

    length: Positive
    section: Section
    elements: PositiveCount = 3
    tip: NotNegative = 0.0


@checked
class Chain:
    """Links in a row from the origin, joined by angles; a Member for ``Mechanism.chain``.

    Its configuration is (angle of each joint, rad; ``eta``): the first joint is seen from the x axis, others from the
    end of the link before. The end angles of all elements are ``V eta``; without V they are the coordinates.

    Args:
        links: one or more.
        V: (2 elements, m) modes of the end angles; all columns independent.

    Raises:
        InputError: no links, V of another shape or with columns that depend on each other.
    """

    def __init__(self, links: Sequence[Link], V: ArrayLike | None = None) -> None:
        if not links:
            raise InputError("a chain of no links was given; expected one or more", kind="missing", keyword="links")
        self.links, elements = tuple(links), sum(link.elements for link in links)
        self.V = np.eye(2 * elements) if V is None else np.array(V, dtype=float)
        if self.V.ndim != 2 or len(self.V) != 2 * elements or not np.isfinite(self.V).all():
            raise InputError(
                f"modes of shape {self.V.shape} were given; expected ({2 * elements}, m) finite numbers",
                keyword="modes",
            )
        rank, count = np.linalg.matrix_rank(self.V), self.V.shape[1]
        if rank < count:
            raise InputError(
                f"{count} modes were given of which {rank} are independent; expected all of them",
                kind="value",
                keyword="modes",
            )
        owner = np.repeat(np.arange(len(links)), [link.elements for link in links])
        each = [(link.length / link.elements, link.section.EI, link.section.mass) for link in links]
        lengths, EI, mass = np.array(each)[owner].T
        self.length = float(lengths.sum())
        # Directions of chords (e, joints + m): joints up to here, turns b - a of elements before, less a.
        ends = np.eye(2 * elements).reshape(elements, 2, -1)
        turns = np.cumsum(ends[:, 1] - ends[:, 0], axis=0) - ends[:, 1]
        self._ends = np.concatenate([np.zeros((elements, 2, len(links))), ends @ self.V], axis=2)
        self._directions = np.concatenate([owner[:, None] >= np.arange(len(links)), turns @ self.V], axis=1)
        self._before = np.tri(elements, k=-1)
        # Amplitudes of r, l t, l a n, l b n over an element: 1, s, s (1 - s)^2, -s^2 (1 - s); integrals of products.
        shapes = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, -2, 1], [0, 0, -1, 1]], dtype=float)
        block = shapes @ sl.hilbert(4) @ shapes.T
        blocks = [length * m * block for length, m in zip(lengths, mass, strict=True)]
        for last, link in zip(np.cumsum([link.elements for link in links]) - 1, links, strict=True):
            blocks[last][:2, :2] += link.tip
        self._lengths = lengths
        self.M = sp.csr_matrix(np.kron(sl.block_diag(*blocks), np.eye(2)))
        K = sl.block_diag(*(k / n * np.array([[4.0, 2], [2, 4]]) for k, n in zip(EI, lengths, strict=True)))
        self._K = np.zeros((self.size, self.size))
        self._K[len(links) :, len(links) :] = self.V.T @ K @ self.V
        self.rigid = np.zeros((8 * elements, 3))
        self.rigid[::8, 0] = self.rigid[1::8, 1] = 1

    @property
    def size(self) -> int:
        return len(self.links) + int(self.V.shape[1])

    def start(self, angles: ArrayLike) -> Floats:
        """Configuration without strain at the angles (links,) of the joints."""
        given = np.asarray(angles, dtype=float)
        if given.shape != (len(self.links),) or not np.isfinite(given).all():
            raise InputError(
                f"angles of joints of shape {given.shape} were given; expected a finite one for each of the "
                f"{len(self.links)} links",
                keyword="angles",
            )
        return np.concatenate((given, np.zeros(self.V.shape[1])))

    def at(self, q: Floats) -> MemberState:
        x, J = self._place_nodes(q)
        force = self._K @ q
        return MemberState(x=x, J=J, V=0.5 * float(q @ force), force=force, stiffness=self._give, strains=self._give)

    def _give(self) -> Floats:
        return self._K

    def _place_nodes(self, q: Floats) -> tuple[Floats, Floats]:
        """x (N,) and dx/dq (N, k)."""
        direction, ends = self._directions @ q, self._ends @ q
        t = np.column_stack((np.cos(direction), np.sin(direction))) * self._lengths[:, None]
        n = np.column_stack((-t[:, 1], t[:, 0]))
        turned = n[:, :, None] * self._directions[:, None, :]
        x = np.stack((self._before @ t, t, ends[:, :1] * n, ends[:, 1:] * n), axis=1)
        J = np.empty((*x.shape, self.size))
        J[:, 0] = np.tensordot(self._before, turned, 1)
        J[:, 1] = turned
        for k in range(2):
            J[:, 2 + k] = (
                n[:, :, None] * self._ends[:, k, None] - (ends[:, k, None] * t)[..., None] * (self._directions[:, None])
            )
        return x.ravel(), J.reshape(x.size, -1)

    def modes(self, angles: ArrayLike, count: int | None = None) -> tuple[Floats, Floats]:
        """Angular frequencies squared (m,) with the joints held, and their modes (2 elements, m) of end angles.

        Raises:
            InputError: another number of angles than of links.
        """
        J = self._place_nodes(self.start(angles))[1]
        free = slice(len(self.links), None)
        squares, shapes = sl.eigh(self._K[free, free], (J.T @ (self.M @ J))[free, free])
        return squares[:count], self.V @ shapes[:, :count]

    def nodes(self, x: Floats) -> Floats:
        """Positions (elements + 1, 2, ...) m of the nodes, from those (N, ...) of a motion."""
        parts = np.reshape(x, (len(self._lengths), 4, 2, *np.shape(x)[1:]))
        return np.concatenate((parts[:, 0], parts[-1:, 0] + parts[-1:, 1]))

    def outside(self, q: Floats) -> tuple[str, float, float] | None:
        return None

    def estimate_neglected(self, q: Floats, state: MemberState, load: Floats) -> float:
        return 0.0
