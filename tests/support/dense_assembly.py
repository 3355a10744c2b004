"""Assemblies of unreduced parts with dense matrices, made of nothing but meshes in their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sl

import morembs

Joint = tuple[tuple[int, str], tuple[int, str], Sequence[int], Sequence[float] | None, Sequence[float] | None]


def rigid(xyz: np.ndarray) -> np.ndarray:
    """Displacements (3 n, 6) of points (n, 3) that move with a frame at the origin."""
    R = np.zeros((len(xyz), 3, 6))
    R[:, range(3), range(3)] = 1.0
    for axis in range(3):
        R[:, :, 3 + axis] = np.cross(np.eye(3)[axis], xyz)
    return R.reshape(-1, 6)


@dataclass
class Part:
    """K, M, D of a free part whose interfaces (name -> rows) are rigid frames, or the means of their nodes."""

    mesh: morembs.Mesh
    turn: np.ndarray
    place: np.ndarray
    interfaces: dict[str, np.ndarray]
    alpha: float = 0.0
    beta: float = 0.0
    modal: float = 0.0
    average: bool = False
    young: float = 2.1e11

    def matrices(self) -> tuple[np.ndarray, ...]:
        """K, M, D (n, n) and the motions (n, 6 k) of the interfaces."""
        xyz = self.mesh.nodes.xyz @ self.turn.T + self.place
        mesh = replace(self.mesh, nodes=replace(self.mesh.nodes, xyz=xyz))
        model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=self.young, poisson=0.3, density=7850.0)])
        K, M = model.K.toarray(), model.M.toarray()
        Z = rigid(xyz - xyz.mean(axis=0))
        if self.average:
            B = []
            for name, rows in self.interfaces.items():
                own = [morembs.make_interface(model, name=name, nodes=rows, coupling="average")]
                with morembs.Problem(model, own) as problem:
                    B.append(problem.B.toarray())
            T, B = np.eye(len(K)), np.hstack(B)
        else:
            slaves = np.concatenate(list(self.interfaces.values()))
            free = np.setdiff1d(np.arange(len(xyz)), slaves)
            T = np.zeros((len(K), 3 * len(free) + 6 * len(self.interfaces)))
            T[(3 * free[:, None] + np.arange(3)).ravel(), np.arange(3 * len(free))] = 1.0
            for k, rows in enumerate(self.interfaces.values()):
                at = 3 * len(free) + 6 * k + np.arange(6)
                T[np.ix_((3 * rows[:, None] + np.arange(3)).ravel(), at)] = rigid(xyz[rows] - xyz[rows].mean(axis=0))
            B = np.eye(T.shape[1])[:, 3 * len(free) :]
        Z = np.linalg.lstsq(T, Z, rcond=None)[0]
        K, M = T.T @ K @ T, T.T @ M @ T
        MZ = M @ Z @ np.linalg.inv(np.linalg.cholesky(Z.T @ M @ Z)).T
        D = self.alpha * (M - MZ @ MZ.T) + self.beta * K
        if self.modal:
            values, X = sl.eigh(K, M)
            D = (M @ X[:, 6:] * (2 * self.modal * np.sqrt(values[6:]))) @ (M @ X[:, 6:]).T
        return K, M, D, B


class Whole:
    """The coupled parts: ``K``, ``M``, ``D``, and ``B`` of the interfaces ``outer`` (part, name)."""

    def __init__(self, parts: Sequence[Part], joints: Sequence[Joint], outer: Sequence[tuple[int, str]]) -> None:
        given = [part.matrices() for part in parts]
        K, M, D, B = (sl.block_diag(*(each[k] for each in given)) for k in range(4))
        first = np.cumsum([0, *(each[3].shape[1] for each in given)])

        def motions(end: tuple[int, str]) -> np.ndarray:
            at = first[end[0]] + 6 * list(parts[end[0]].interfaces).index(end[1])
            return B[:, at : at + 6]

        held = [np.zeros((0, len(K)))]
        for one, other, components, stiffness, damping in joints:
            G = (motions(one) - motions(other)).T[list(components)]
            if stiffness is None:
                held.append(G)
                continue
            K = K + G.T @ (np.array(stiffness)[list(components)][:, None] * G)
            if damping is not None:
                D = D + G.T @ (np.array(damping)[list(components)][:, None] * G)
        N = sl.null_space(np.vstack(held)) if len(held) > 1 else np.eye(len(K))
        self.K, self.M, self.D = (N.T @ A @ N for A in (K, M, D))
        self.B = N.T @ np.hstack([motions(end) for end in outer])

    def response(self, omega: float, structural: float) -> np.ndarray:
        """Elastic part of H (m, m)."""
        return elastic(self.K, self.M, self.D, self.B, omega, structural)

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Those of all modes, the six rigid ones first."""
        return np.sqrt(np.maximum(sl.eigvalsh(self.K, self.M), 0.0)) / (2 * np.pi)


def elastic(K: np.ndarray, M: np.ndarray, D: np.ndarray, B: np.ndarray, omega: float, structural: float) -> np.ndarray:
    """Elastic part of H (m, m), whose rigid motions nothing damps."""
    values, X = sl.eigh(K, M)
    Z, E = X[:, :6], X[:, 6:]
    b = E.T @ B
    A = np.diag(values[6:] * (1 + 1j * structural) - omega**2) + 1j * omega * (E.T @ D @ E)
    assert np.abs(D @ Z).max() <= 1e-6 * max(np.abs(D).max(), 1e-300) * np.abs(Z).max()
    return b.T @ np.linalg.solve(A, b.astype(complex))
