"""A solid at large displacements with interface frames: nodes as positions, rigid frames as points that turn.

solid = NonlinearSolid(model, [make_interface(model, name="root", nodes=...), ...])
found = follow_equilibrium(solid, held=solid.frames["root"], load=solid.wrench("tip", force=(0, 0, 100.0)))

Coordinates: positions of the nodes that no rigid frame carries (m), then for every rigid frame the position of its
point and a rotation vector p along the fixed axes (rad). Nodes of a rigid frame are c + exp(p) a. An average frame
adds no coordinates: it is the motion that fits its nodes best, and spreads loads over them; it cannot be held.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from morembs.base.arguments import checked
from morembs.base.errors import InputError, nearest
from morembs.base.types import Floats, Ints
from morembs.dynamics.nonlinear.rotation_vectors import curvature, rotation_matrices, shorten_vectors, tangents
from morembs.dynamics.nonlinear.total_lagrangian import SaintVenantKirchhoff
from morembs.fem import FEModel, skew
from morembs.fem.interface import COUPLINGS, Interface
from morembs.linalg.dense import symmetric


@dataclass(frozen=True, eq=False)
class _Rigid:
    """``numbers`` (6,) of the coordinates, ``nodes`` (s,) carried and their ``arms`` (s, 3) without load; ``beside``
    (b,) rows of the kept node coordinates that share elements with them."""

    numbers: Ints
    nodes: Ints
    arms: Floats
    beside: Ints

    @property
    def dofs(self) -> Ints:
        """Numbers (3 s,) of the coordinates of the nodes among those of all nodes."""
        return np.asarray((3 * self.nodes[:, None] + np.arange(3)).ravel())


@checked
class NonlinearSolid:
    """A St. Venant-Kirchhoff solid of N coordinates; see morembs.dynamics.nonlinear.continuation for its equilibria.

    Linear elements (hex8, tet4, wedge6) are too stiff in bending here as in linear analyses; take quadratic ones.

    Args:
        model: from ``morembs.fem.assembly.assemble``.
        interfaces: from ``morembs.fem.interface.make_interface``, of a coupling that is known for large
            rotations (rigid, average, direct).

    Raises:
        InputError: a model without elements, interfaces of one name, rigid ones that share nodes, or a coupling for
            small rotations only.
    """

    def __init__(self, model: FEModel, interfaces: Sequence[Interface] = ()) -> None:
        self.elements = SaintVenantKirchhoff(model)
        self.model, self.interfaces = model, {interface.name: interface for interface in interfaces}
        if len(self.interfaces) < len(interfaces):
            raise InputError(
                "two interfaces have the same name; give each its own name", kind="conflict", keyword="interfaces"
            )
        for interface in interfaces:
            if not interface.kind.large_rotations:
                known = ", ".join(name for name, kind in COUPLINGS.items() if kind.large_rotations)
                raise InputError(
                    f"interface {interface.name!r}: coupling = {interface.coupling!r} is for small rotations only; "
                    f"take one of {known}",
                    kind="unsupported",
                    keyword="coupling",
                )
        rigid = [interface for interface in interfaces if interface.kind.carries]
        carried = np.concatenate([np.zeros(0, dtype=np.int64), *(interface.nodes for interface in rigid)])
        if len(np.unique(carried)) < len(carried):
            raise InputError(
                "rigid interfaces share nodes; leave these out of one, or take coupling = 'average'",
                kind="conflict",
                keyword="interfaces",
            )
        self.kept = np.setdiff1d(np.arange(len(model.nodes)), carried)
        self._row = np.full(len(model.nodes), -1, dtype=np.int64)
        self._row[self.kept] = np.arange(len(self.kept))
        self._rigid = {}
        for number, interface in enumerate(rigid):
            numbers = 3 * len(self.kept) + 6 * number + np.arange(6)
            arms = model.nodes.xyz[interface.nodes] - interface.point
            near = np.unique(self._row[np.unique(self.elements.neighbours(interface.nodes))])
            beside = (3 * near[near >= 0][:, None] + np.arange(3)).ravel()
            self._rigid[interface.name] = _Rigid(numbers, np.asarray(interface.nodes), arms, beside)

    @property
    def size(self) -> int:
        return 3 * len(self.kept) + 6 * len(self._rigid)

    @property
    def frames(self) -> Mapping[str, Ints]:
        """Interfaces: numbers of the coordinates, (6,) of a rigid frame, those of its components of a direct one."""
        frames = {name: frame.numbers for name, frame in self._rigid.items()}
        for name, interface in self.interfaces.items():
            if not interface.kind.framed:
                own = self._row[interface.nodes]
                if (own < 0).any():
                    raise InputError(f"interface {name!r}: some nodes belong to a rigid frame; take others")
                frames[name] = (3 * own[:, None] + np.array(interface.components)).ravel()
        return frames

    @property
    def translations(self) -> Ints:
        """Numbers (n, 3) of the coordinates that are positions."""
        nodes = np.arange(3 * len(self.kept)).reshape(-1, 3)
        return np.vstack([nodes, *(frame.numbers[None, :3] for frame in self._rigid.values())])

    @property
    def reference(self) -> Floats:
        points = [np.concatenate((self.interfaces[name].point, np.zeros(3))) for name in self._rigid]
        return np.concatenate([self.model.nodes.xyz[self.kept].ravel(), *points])

    def positions(self, x: Floats) -> Floats:
        """Positions (n, 3) of all nodes."""
        result = np.empty_like(self.model.nodes.xyz)
        result[self.kept] = x[: 3 * len(self.kept)].reshape(-1, 3)
        for frame in self._rigid.values():
            point, p = x[frame.numbers[:3]], x[frame.numbers[3:]]
            result[frame.nodes] = point + frame.arms @ rotation_matrices(p[None])[0].T
        return result

    def _arms(self, frame: _Rigid, x: Floats) -> tuple[Floats, Floats, Floats]:
        """p (3,), T(p)' (3, 3) and the arms (s, 3) now."""
        p = x[frame.numbers[3:]]
        return p, tangents(p[None])[0].T, frame.arms @ rotation_matrices(p[None])[0].T

    def _frame_jacobian(self, frame: _Rigid, x: Floats) -> Floats:
        """Motion (3 s, 6) of the nodes of a frame per coordinate."""
        _, spin, arms = self._arms(frame, x)
        G = np.zeros((len(arms), 3, 6))
        G[:, :, :3] = np.eye(3)
        G[:, :, 3:] = -skew(arms) @ spin
        return G.reshape(-1, 6)

    def step_of_nodes(self, x: Floats, step: Floats) -> Floats:
        """First-order motion (n, 3) of all nodes by a ``step`` (N,) of the coordinates."""
        result = np.empty_like(self.model.nodes.xyz)
        result[self.kept] = step[: 3 * len(self.kept)].reshape(-1, 3)
        for frame in self._rigid.values():
            result[frame.nodes] = (self._frame_jacobian(frame, x) @ step[frame.numbers]).reshape(-1, 3)
        return result

    def load(self, x: Floats, forces: Floats) -> Floats:
        """Loads (N,) on the coordinates at x of ``forces`` (n, 3) on the nodes, in N."""
        result = np.empty(self.size)
        result[: 3 * len(self.kept)] = forces[self.kept].ravel()
        for frame in self._rigid.values():
            result[frame.numbers] = self._frame_jacobian(frame, x).T @ forces[frame.nodes].ravel()
        return result

    def energy(self, x: Floats) -> float:
        """Strain energy in J."""
        return self.elements.energy(self.positions(x))

    def force(self, x: Floats) -> Floats:
        """Inner forces dW/dx (N,)."""
        return self.load(x, self.elements.force(self.positions(x)))

    def resultants_after(self, x: Floats, step: Floats) -> Floats:
        """Stress (points, 6) at x plus its change to first order by a ``step`` (N,)."""
        return self.elements.stress_after(self.positions(x), self.step_of_nodes(x, step))

    @cached_property
    def _layout(self) -> tuple[Ints, Ints, Ints]:
        """How the tangent (N, N) is put together: for each entry its place in [entries of the tangent of all nodes,
        those of the frames as ``tangent`` lists them], then indices and indptr."""
        indptr, indices = self.elements.pattern
        table = np.full((len(self._row), 3), -1, dtype=indices.dtype)
        table[self.kept] = np.arange(3 * len(self.kept)).reshape(-1, 3)
        number = table.ravel()
        row = np.repeat(number, np.diff(indptr))
        at = np.flatnonzero((row >= 0) & (number[indices] >= 0))
        rows, columns = [row[at]], [number[indices[at]]]
        for frame in self._rigid.values():
            beside, own = np.repeat(frame.beside, 6), np.tile(frame.numbers, len(frame.beside))
            rows += [beside, own]
            columns += [own, beside]
            for other in self._rigid.values():
                rows.append(np.repeat(other.numbers, 6))
                columns.append(np.tile(frame.numbers, 6))
        count = sum(len(part) for part in rows)
        source = np.concatenate((at, len(indices) + np.arange(count - len(at))))
        where = tuple(np.concatenate([part.astype(indices.dtype) for part in parts]) for parts in (rows, columns))
        places = sp.csr_array((np.arange(count), where), shape=(self.size, self.size))
        places.sort_indices()
        return source[places.data], places.indices, places.indptr

    def tangent(self, x: Floats, resultants: Floats | None = None) -> sp.csr_array:
        """Tangent stiffness d2W/dx2 (N, N) of one pattern; ``resultants`` (points, 6) may replace the stress at x in
        its geometric part."""
        nodes = self.positions(x)
        K = self.elements.tangent(nodes, resultants)
        if not self._rigid:
            return K
        forces = self.elements.force(nodes, resultants)
        values, frames = [K.data], list(self._rigid.values())
        moved = [self._frame_jacobian(frame, x) for frame in frames]
        place = (3 * self.kept[:, None] + np.arange(3)).ravel()
        for i, frame in enumerate(frames):
            # K is symmetric: its rows are its columns.
            KG = K[frame.dofs].T @ moved[i]
            side = KG[place[frame.beside]].ravel()
            values += [side, side]
            for j, other in enumerate(frames):
                block = moved[j].T @ KG[other.dofs]
                if i == j:
                    block = symmetric(block) + self._turning(frame, x, forces)
                values.append(block.ravel())
        source, indices, indptr = self._layout
        result = sp.csr_array((np.concatenate(values)[source], indices, indptr), shape=(self.size,) * 2)
        result.has_canonical_format = True
        return result

    def _turning(self, frame: _Rigid, x: Floats, forces: Floats) -> Floats:
        """(6, 6) second derivative of the nodes of a frame by its coordinates, times the forces (n, 3) on them."""
        p, spin, arms = self._arms(frame, x)
        f = forces[frame.nodes]
        product = f.T @ arms
        second = spin.T @ (symmetric(product) - np.trace(product) * np.eye(3)) @ spin
        result = np.zeros((6, 6))
        result[3:, 3:] = second + curvature(p[None], np.cross(arms, f).sum(axis=0)[None], fixed=True)[0]
        return result

    @cached_property
    def M(self) -> sp.csr_array:
        """Consistent mass (N, N) without load; that of turning frames changes with p, that of the nodes never."""
        G = self.motion(self.reference)
        return sp.csr_array(G.T @ (self.model.M @ G))

    def motion(self, x: Floats) -> sp.csr_array:
        """Motion (3 n, N) of all nodes per coordinate at x."""
        place = (3 * self.kept[:, None] + np.arange(3)).ravel()
        rows, columns, values = [place], [np.arange(len(place))], [np.ones(len(place))]
        for frame in self._rigid.values():
            rows.append(np.repeat(frame.dofs, 6))
            columns.append(np.tile(frame.numbers, len(frame.dofs)))
            values.append(self._frame_jacobian(frame, x).ravel())
        where = np.concatenate(rows), np.concatenate(columns)
        return sp.csr_array((np.concatenate(values), where), shape=(3 * len(self._row), self.size))

    def shorten_rotations(self, x: Floats, held: ArrayLike = ()) -> Floats:
        """The same configuration with rotation vectors of at most half a turn, but for those with ``held`` numbers."""
        result = np.array(x, dtype=float)
        for frame in self._rigid.values():
            if not np.isin(frame.numbers[3:], np.asarray(held)).any():
                result[frame.numbers[3:]] = shorten_vectors(result[frame.numbers[3:]])
        return result

    def examine(self, x: Floats) -> None:
        """Refuses elements that are inside out.

        Raises:
            SolverError: det F <= 0 at a point.
        """
        self.elements.refuse_inverted(self.positions(x))

    def _find_framed(self, name: str) -> Interface:
        framed = [key for key, interface in self.interfaces.items() if interface.kind.framed]
        if name not in framed:
            raise InputError(f"interface {name!r} has no frame; {nearest(name, framed)}", kind="unknown")
        return self.interfaces[name]

    def frame(self, x: Floats, name: str) -> tuple[Floats, Floats]:
        """Position (3,) in m and rotation matrix (3, 3) of a rigid or average interface.

        Raises:
            InputError: an unknown or direct interface.
        """
        interface = self._find_framed(name)
        if name in self._rigid:
            numbers = self._rigid[name].numbers
            return x[numbers[:3]], rotation_matrices(x[None, numbers[3:]])[0]
        center, R, _, arms = self._fit(interface, x)
        return center + R @ (interface.point - self.model.nodes.xyz[interface.nodes[0]] + arms[0]), R

    def _fit(self, interface: Interface, x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Centroid, best rotation, weights (s,) and undeformed arms (s, 3) of an average interface."""
        w = interface.weights / interface.weights.sum()
        X, now = self.model.nodes.xyz[interface.nodes], self.positions(x)[interface.nodes]
        arms, center = X - w @ X, w @ now
        # The rotation nearest to sum w y a' (Kabsch 1976); area weights of quadratic faces may be negative.
        U, _, Vt = np.linalg.svd((w[:, None] * (now - center)).T @ arms)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        return center, R, w, arms

    def wrench(
        self, name: str, *, force: ArrayLike = (0.0, 0.0, 0.0), moment: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Callable[[Floats], Floats]:
        """Load of a ``force`` (N) and a ``moment`` (N m) along the fixed axes on a frame: a function of x.

        Raises:
            InputError: an unknown or direct interface, or other than three numbers each.
        """
        interface, f, m = self._find_framed(name), np.asarray(force, dtype=float), np.asarray(moment, dtype=float)
        if f.shape != (3,) or m.shape != (3,) or not (np.isfinite(f).all() and np.isfinite(m).all()):
            raise InputError(
                f"force {force!r} and moment {moment!r} were given; expected three finite numbers each", keyword="force"
            )

        def rigid(x: Floats) -> Floats:
            result = np.zeros(self.size)
            numbers = self._rigid[name].numbers
            result[numbers[:3]], result[numbers[3:]] = f, tangents(x[None, numbers[3:]])[0] @ m
            return result

        def average(x: Floats) -> Floats:
            center, R, w, arms = self._fit(interface, x)
            about = m + np.cross(self.frame(x, name)[0] - center, f)
            now = self.positions(x)[interface.nodes] - center
            S = R.T @ ((w[:, None] * now).T @ arms)
            spin = R @ np.linalg.solve(np.trace(S) * np.eye(3) - symmetric(S), R.T @ about)
            forces = np.zeros_like(self.model.nodes.xyz)
            forces[interface.nodes] = w[:, None] * (f + np.cross(spin, arms @ R.T))
            return self.load(x, forces)

        return rigid if name in self._rigid else average
