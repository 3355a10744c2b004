"""Small models whose matrices are written down: beams, trusses, grids of springs, plates, modal coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.fem import DofMap, FEModel, Nodes


def beam_element(
    E: float, G: float, A: float, second: float, polar: float, rho: float, L: float
) -> tuple[np.ndarray, ...]:
    """K and M (12, 12) of an Euler-Bernoulli beam along x, six dofs at each end; M consistent (Przemieniecki 1968)."""
    K, M = np.zeros((12, 12)), np.zeros((12, 12))
    bar, mass = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([[2.0, 1.0], [1.0, 2.0]]) / 6
    for dofs, k, m in (((0, 6), E * A, rho * A), ((3, 9), G * polar, rho * polar)):
        K[np.ix_(dofs, dofs)] += k / L * bar
        M[np.ix_(dofs, dofs)] += m * L * mass
    bend = np.array(
        [
            [12, 6 * L, -12, 6 * L],
            [6 * L, 4 * L**2, -6 * L, 2 * L**2],
            [-12, -6 * L, 12, -6 * L],
            [6 * L, 2 * L**2, -6 * L, 4 * L**2],
        ]
    )
    heavy = np.array(
        [
            [156, 22 * L, 54, -13 * L],
            [22 * L, 4 * L**2, 13 * L, -3 * L**2],
            [54, 13 * L, 156, -22 * L],
            [-13 * L, -3 * L**2, -22 * L, 4 * L**2],
        ]
    )
    for dofs, sign in (((1, 5, 7, 11), 1.0), ((2, 4, 8, 10), -1.0)):
        s = np.array([1.0, sign, 1.0, sign])
        K[np.ix_(dofs, dofs)] += E * second / L**3 * bend * np.outer(s, s)
        M[np.ix_(dofs, dofs)] += rho * A * L / 420 * heavy * np.outer(s, s)
    return K, M


def beams(xyz: np.ndarray, pairs: Sequence[tuple[int, int]], radius: float = 0.01) -> tuple[sp.csr_array, sp.csr_array]:
    """K and M (6 n, 6 n) of round steel beams between nodes (n, 3)."""
    A, second = np.pi * radius**2, np.pi * radius**4 / 4
    places, elements = [], ([], [])
    for a, b in pairs:
        d = xyz[b] - xyz[a]
        L = float(np.linalg.norm(d))
        t = d / L
        up = np.eye(3)[int(np.argmin(np.abs(t)))]
        y = np.cross(up, t) / np.linalg.norm(np.cross(up, t))
        T = np.kron(np.eye(4), np.stack([t, y, np.cross(t, y)]))
        places.append(np.concatenate([6 * a + np.arange(6), 6 * b + np.arange(6)]))
        for made, own in zip(elements, beam_element(2.1e11, 8e10, A, second, 2 * second, 7850.0, L), strict=True):
            made.append(T.T @ own @ T)
    at = np.array(places)
    row, column = np.broadcast_arrays(at[:, :, None], at[:, None, :])
    K, M = (
        sp.csr_array((np.ravel(made), (row.ravel(), column.ravel())), shape=(6 * len(xyz),) * 2) for made in elements
    )
    return K, M


def line(count: int, length: float = 1.0, axis: Sequence[float] = (1.0, 0.0, 0.0)) -> np.ndarray:
    """``count`` nodes (n, 3) along an axis."""
    return np.outer(np.linspace(0.0, length, count), axis)


def chain(count: int) -> list[tuple[int, int]]:
    """Pairs of neighbours of ``count`` nodes."""
    return [(i, i + 1) for i in range(count - 1)]


def springs(
    xyz: np.ndarray, pairs: Sequence[tuple[int, int]], stiffness: float = 1e6, mass: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """K and M (3 n, 3 n) of bars, stiff along themselves alone, and of point masses."""
    K = np.zeros((3 * len(xyz),) * 2)
    for a, b in pairs:
        d = (xyz[b] - xyz[a]) / np.linalg.norm(xyz[b] - xyz[a])
        at = np.concatenate([3 * a + np.arange(3), 3 * b + np.arange(3)])
        K[np.ix_(at, at)] += stiffness * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.outer(d, d))
    return K, mass * np.eye(len(K))


def model_on(
    K: np.ndarray | sp.csr_array,
    M: np.ndarray | sp.csr_array,
    xyz: np.ndarray,
    components: Sequence[int],
    kept: np.ndarray | None = None,
) -> FEModel:
    """Model with ``components`` at each node, of which the rows ``kept`` (all by default) stay; all nodes stay."""
    node = np.repeat(np.arange(len(xyz)), len(components))
    component = np.tile(np.array(components), len(xyz))
    rows = np.arange(len(node)) if kept is None else np.asarray(kept)
    return FEModel(
        K=sp.csr_array(K)[rows][:, rows],
        M=sp.csr_array(M)[rows][:, rows],
        nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz),
        dofs=DofMap(node=node[rows], component=component[rows]),
        source="frame",
    )


def without(size: int, held: Sequence[int]) -> np.ndarray:
    """Rows of ``size`` that are not ``held``."""
    return np.setdiff1d(np.arange(size), np.asarray(held, dtype=int))


def clamped_beam(count: int, ends: Sequence[int] = (0,), axis: Sequence[float] = (1.0, 0.0, 0.0)) -> FEModel:
    """A straight beam of ``count`` nodes whose ``ends`` are held by taking their dofs out."""
    xyz = line(count, axis=axis)
    held = [6 * (node % count) + c for node in ends for c in range(6)]
    return model_on(*beams(xyz, chain(count)), xyz, range(6), without(6 * count, held))


def eigenvalues(model: FEModel) -> np.ndarray:
    """All eigenvalues of (K, M) by LAPACK."""
    return np.asarray(sl.eigh(model.K.toarray(), model.M.toarray(), eigvals_only=True))


def plate(nx: int, ny: int, held: bool, thickness: float = 0.01) -> FEModel:
    """A plate of nx x ny rectangles with 12 dofs (Adini and Clough 1961): deflection along z and two rotations a node;
    ``held`` takes out the dofs of an edge."""
    a, b, E, nu = 0.3, 0.2, 2.1e11, 0.3
    powers = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)]

    def row(x: float, y: float, dx: int, dy: int) -> np.ndarray:
        def term(p: int, d: int, at: float) -> float:
            return 0.0 if d > p else float(np.prod(np.arange(p - d + 1, p + 1))) * at ** (p - d)

        return np.array([term(p, dx, x) * term(q, dy, y) for p, q in powers])

    corners = [(0.0, 0.0), (a, 0.0), (a, b), (0.0, b)]
    dofs = ((0, 0, 1), (0, 1, 1), (1, 0, -1))
    values = np.array([sign * row(x, y, dx, dy) for x, y in corners for dx, dy, sign in dofs])
    C = np.linalg.inv(values)
    rigidity = E * thickness**3 / (12 * (1 - nu**2)) * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])
    points, weights = np.polynomial.legendre.leggauss(5)
    Ke, Me = np.zeros((12, 12)), np.zeros((12, 12))
    for s, ws in zip(points, weights, strict=True):
        for t, wt in zip(points, weights, strict=True):
            x, y, w = a * (1 + s) / 2, b * (1 + t) / 2, ws * wt * a * b / 4
            curved = np.array([row(x, y, 2, 0), row(x, y, 0, 2), 2 * row(x, y, 1, 1)]) @ C
            deflection = row(x, y, 0, 0) @ C
            Ke += w * curved.T @ rigidity @ curved
            Me += w * 7850.0 * thickness * np.outer(deflection, deflection)
    xyz = np.array([[a * i, b * j, 0.0] for j in range(ny + 1) for i in range(nx + 1)])
    K, M = np.zeros((3 * len(xyz),) * 2), np.zeros((3 * len(xyz),) * 2)
    for j in range(ny):
        for i in range(nx):
            first = j * (nx + 1) + i
            at = np.concatenate([3 * n + np.arange(3) for n in (first, first + 1, first + nx + 2, first + nx + 1)])
            K[np.ix_(at, at)] += Ke
            M[np.ix_(at, at)] += Me
    edge = [3 * n + c for n in np.flatnonzero(xyz[:, 0] == 0) for c in range(3)] if held else []
    return model_on(0.5 * (K + K.T), 0.5 * (M + M.T), xyz, (2, 3, 4), without(len(K), edge))


def lumped(model: FEModel) -> FEModel:
    """The same with point masses: each node has its share along x, y and z, and no rotary inertia."""
    d, rows = np.zeros(model.size), np.asarray(np.abs(model.M).sum(axis=1))
    for node in np.unique(model.dofs.node):
        own = np.flatnonzero((model.dofs.node == node) & (model.dofs.component < 3))
        d[own] = rows[own].mean()
    return replace(model, M=sp.csr_array(sp.diags_array(d)))
