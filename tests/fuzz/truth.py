"""Responses of a model with its interfaces in extended precision, at decisive points in ball arithmetic.

Modes are those of LAPACK, corrected in 64-bit mantissas until their own round-off is far below that of the program
(Ogita and Aishima 2018); responses are sums over them, or eliminations where a damping matrix couples them. The same
responses from 128-bit balls (python-flint) at the points that decide a verdict prove the sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sl
from numpy.typing import NDArray

from morembs.base.types import Floats, Ints
from tests.fuzz.models import Model

Long = np.longdouble
BITS = 128


@dataclass(frozen=True, kw_only=True)
class Port:
    """An interface: rows of the nodes, kind, point in m, components that are exposed; ``column`` of B of the model."""

    name: str
    nodes: Ints
    coupling: str
    point: Floats
    components: tuple[int, ...]
    vector: Floats | None = None


@dataclass(frozen=True, kw_only=True)
class Damping:
    """Factors as a job has them, and the ``floor`` that a certificate assumes."""

    alpha: float = 0.0
    beta: float = 0.0
    steps: tuple[tuple[float, float], ...] = ()
    structural: float = 0.0

    def ratio(self, hz: Floats) -> Floats:
        """Modal ratios at undamped frequencies."""
        if not self.steps:
            return np.zeros(len(hz))
        at = np.searchsorted([step[0] for step in self.steps], hz, side="right") - 1
        return np.array([step[1] for step in self.steps])[at]


def rigid_rows(arms: Floats, component: Ints) -> Floats:
    """Motion (k, 6) of dofs at ``arms`` (k, 3) from a point that moves and turns."""
    R = np.zeros((len(arms), 6), dtype=arms.dtype)
    for i, (arm, c) in enumerate(zip(arms, component, strict=True)):
        if c < 3:
            R[i, c] = 1
            j, k = (c + 1) % 3, (c + 2) % 3
            R[i, 3 + j], R[i, 3 + k] = arm[k], -arm[j]
        else:
            R[i, c] = 1
    return R


class Truth:
    """K, M, D and B of a model in the coordinates that its interfaces leave; ``free`` rigid motions nothing holds."""

    def __init__(self, model: Model, ports: tuple[Port, ...], damping: Damping) -> None:
        self.model, self.ports, self.damping = model, ports, damping
        T, B, R = _coupled(model, ports)
        self.T = T
        self.K, self.M = (T.T @ A.astype(Long) @ T for A in (model.K, model.M))
        self.D = None if model.D is None else T.T @ model.D.astype(Long) @ T
        self.B, self.R = B, R

    @cached_property
    def mass(self) -> tuple[float, Floats, Floats]:
        """Mass, its centre (3,), inertia (3, 3) about that, of the coordinates that move in space."""
        G = self.R.T @ self.M @ self.R
        mass = np.trace(G[:3, :3]) / 3
        arm = np.array([G[1, 5], G[2, 3], G[0, 4]]) / mass if mass else np.zeros(3)
        inertia = G[3:, 3:] - mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return float(mass), arm.astype(float), ((inertia + inertia.T) / 2).astype(float)

    @cached_property
    def scale(self) -> Floats:
        """Per column of B: one for displacements, the radius of gyration for rotations."""
        mass, _, inertia = self.mass
        turning = float(np.trace(inertia))
        return self._scale(float(np.sqrt(turning / (2 * mass)))) if turning > 0 < mass else self._middle_scale()

    def _middle_scale(self) -> Floats:
        """As ``scale``, with the inertia about the mean place of the nodes: rotations e_j x (x - p)."""
        mass = self.mass[0]
        R = self.R[:, 3:] - self.R[:, :3] @ np.cross(np.eye(3), self.model.xyz.mean(axis=0)).T
        turning = float((R * (self.M @ R)).sum())
        return self._scale(float(np.sqrt(turning / (2 * mass))) if turning > 0 and mass > 0 else 1.0)

    def measure(self, square: float) -> None:
        """Take the root of ``square`` in m2 for the radius of gyration; negative where masses have no centre."""
        self.__dict__["scale"] = self._scale(float(np.sqrt(square))) if square > 0 else self._middle_scale()
        self.__dict__.pop("b", None)

    def _scale(self, length: float) -> Floats:
        rotates = np.concatenate([np.array(p.components * self._times(p)) for p in self.ports])
        return np.where((rotates >= 3) & (rotates < 6), length, 1.0)

    def _times(self, port: Port) -> int:
        return len(port.nodes) if port.coupling == "direct" else 1

    @cached_property
    def rigid(self) -> NDArray[np.longdouble]:
        """(Nc, r) M-orthonormal motions that cost no energy, r = those of the model."""
        if not self.model.free:
            return np.zeros((len(self.K), 0), dtype=Long)
        R = self.R / np.maximum(np.linalg.norm(self.R.astype(float), axis=0), 1e-300)
        # Motions that held dofs leave nothing of cost no energy either, and are none.
        _, sizes, V = np.linalg.svd(R.astype(float), full_matrices=False)
        R = R @ V[sizes > 1e-9 * sizes[0]].T.astype(Long)
        _, U = np.linalg.eigh((R.T @ self.K @ R).astype(float) / np.abs(self.K).max().astype(float))
        Z = R @ U[:, : self.model.free].astype(Long)
        return _orthonormal(Z, self.M)

    @cached_property
    def modes(self) -> tuple[NDArray[np.longdouble], NDArray[np.longdouble]]:
        """Eigenvalues (k,) and vectors (Nc, k) of the elastic motion."""
        return refined(self.K, self.M, self.rigid)

    @cached_property
    def hz(self) -> Floats:
        """Elastic frequencies."""
        return np.sqrt(np.maximum(self.modes[0], 0)).astype(float) / (2 * np.pi)

    @cached_property
    def b(self) -> NDArray[np.longdouble]:
        """Loads (k, m) of the modes, scaled."""
        return (self.modes[1].T @ self.B) * self.scale

    @cached_property
    def rounding(self) -> Floats:
        """By what part rounding the entries of K moves each eigenvalue."""
        X = self.T @ self.modes[1]
        K = np.abs(self.model.K)
        return np.finfo(float).eps * np.einsum("ij,ij->j", np.abs(X), K @ np.abs(X)).astype(float)

    def moduli(self, omega: Floats, loss: float) -> NDArray[np.clongdouble]:
        """a_p (nf, k), of a model without a matrix D."""
        lam, w = self.modes[0], omega.astype(Long)[:, None]
        d, ratio = self.damping, self.damping.ratio(self.hz)
        viscous = d.alpha + d.beta * lam + 2 * ratio * np.sqrt(np.maximum(lam, 0))
        return lam * (1 + 1j * Long(d.structural + loss)) + 1j * w * viscous - w * w

    def H(self, omega: Floats, loss: float = 0.0) -> NDArray[np.clongdouble]:
        """Elastic part (nf, m, m), scaled."""
        if self.D is None:
            return np.einsum("pi,fp,pj->fij", self.b, 1 / self.moduli(omega, loss), self.b)
        own, a = self.modes[1].T @ self.D @ self.modes[1], self.moduli(omega, loss)
        A = 1j * omega.astype(Long)[:, None, None] * own
        A[:, np.arange(len(own)), np.arange(len(own))] += a
        return np.einsum("pi,fpj->fij", self.b, eliminated(A, self.b))

    def envelope(self, omega: Floats, loss: float = 0.0) -> Floats:
        """(nf,) the sum of the sizes of all modal contributions."""
        size = (self.b.astype(float) ** 2).sum(axis=1)
        return (size / np.abs(self.moduli(omega, loss))).sum(axis=1).astype(float)

    def exact(self, omega: float, loss: float = 0.0) -> NDArray[np.complex128]:
        """As ``H`` at one frequency, eliminated in balls of 128 bits, whose radii are checked."""
        import flint

        flint.ctx.prec = BITS
        X, w, d = _balls(self.modes[1]), flint.arb(omega), self.damping
        K, M = (_balls(self.T).transpose() * _balls(A) * _balls(self.T) for A in (self.model.K, self.model.M))
        K, M, B = X.transpose() * K * X, X.transpose() * M * X, X.transpose() * _balls(self.B * self.scale)
        velocity = flint.arb(d.alpha) * M + flint.arb(d.beta) * K
        if self.model.D is not None:
            XT = _balls(self.T) * X
            velocity = velocity + XT.transpose() * _balls(self.model.D) * XT
        n = len(self.modes[0])
        for k, (lam, ratio) in enumerate(zip(self.modes[0], self.damping.ratio(self.hz), strict=True)):
            high = float(lam)
            velocity[k, k] += (
                2 * flint.arb(float(ratio)) * (flint.arb(high) + flint.arb(float(lam - Long(high)))).sqrt()
            )
        real = K - w * w * M
        imaginary = flint.arb(d.structural + loss) * K + w * velocity
        A = flint.acb_mat([[flint.acb(real[i, j], imaginary[i, j]) for j in range(n)] for i in range(n)])
        H = flint.acb_mat(B.transpose()) * A.solve(flint.acb_mat(B))
        return np.array([[complex(H[i, j].mid()) for j in range(H.ncols())] for i in range(H.nrows())])


def refined(K, M, rigid):  # type: ignore[no-untyped-def]
    """Eigenpairs of (K, M) in 80-bit arithmetic, M-orthogonal to ``rigid`` (N, r), which are left out."""
    r = rigid.shape[1]
    _, X = sl.eigh(K.astype(float), M.astype(float))
    X = _orthonormal(np.hstack([rigid, X[:, r:].astype(Long)]), M)[:, r:]
    for _ in range(3):
        S, G = X.T @ K @ X, np.eye(X.shape[1], dtype=Long) - X.T @ M @ X
        lam = np.diag(S) / (1 - np.diag(G))
        gap = lam[None, :] - lam[:, None]
        off = S + lam[None, :] * G
        np.fill_diagonal(off, 0)
        limit = 4 * (np.abs(off).max() + np.abs(lam).max() * np.abs(G).max())
        far = np.abs(gap) > max(float(limit), 1e-17 * float(np.abs(lam).max()))
        with np.errstate(divide="ignore", invalid="ignore"):
            E = np.where(far, off / np.where(far, gap, 1), G / 2)
        X = X + X @ E
    order = np.argsort(lam)
    return lam[order], X[:, order]


def eliminated(A, B):  # type: ignore[no-untyped-def]
    """A^-1 B for many A (f, n, n) in extended precision, by elimination with partial pivoting."""
    A = np.array(A, dtype=np.clongdouble)
    X = np.broadcast_to(B, (len(A), *B.shape[-2:])).astype(np.clongdouble)
    f, n = np.arange(len(A)), A.shape[1]
    for k in range(n):
        p = k + np.abs(A[:, k:, k]).argmax(axis=1)
        for Y in (A, X):
            row = Y[f, p].copy()
            Y[f, p], Y[:, k] = Y[:, k].copy(), row
        factor = A[:, k + 1 :, k] / A[:, k, k, None]
        A[:, k + 1 :, k:] -= factor[..., None] * A[:, None, k, k:]
        X[:, k + 1 :] -= factor[..., None] * X[:, None, k]
    for k in range(n - 1, -1, -1):
        X[:, k] = (X[:, k] - np.einsum("fj,fjm->fm", A[:, k, k + 1 :], X[:, k + 1 :])) / A[:, k, k, None]
    return X


def _orthonormal(X, M):  # type: ignore[no-untyped-def]
    """Gram and Schmidt, twice, from the left."""
    X = X.astype(Long)
    for k in range(X.shape[1]):
        for _ in range(2):
            X[:, k] -= X[:, :k] @ (X[:, :k].T @ (M @ X[:, k]))
        X[:, k] /= np.sqrt(X[:, k] @ (M @ X[:, k]))
    return X


def _balls(A):  # type: ignore[no-untyped-def]
    """A matrix of 80-bit numbers as balls without radius."""
    import flint

    high = A.astype(float)
    low = (A.astype(Long) - high.astype(Long)).astype(float)
    return flint.arb_mat(high.tolist()) + flint.arb_mat(low.tolist())


def _coupled(model: Model, ports: tuple[Port, ...]):  # type: ignore[no-untyped-def]
    """T (N, Nc), B (Nc, m) and the six geometric motions R (Nc, 6), rotations about the origin."""
    xyz = model.xyz.astype(Long)
    own = rigid_rows(xyz[model.node], model.component)
    frames = [p for p in ports if p.coupling == "rigid" and len(p.nodes) > 1]
    slaves = np.isin(model.node, np.concatenate([np.zeros(0, int), *(p.nodes for p in frames)]))
    keep = np.flatnonzero(~slaves)
    T = np.zeros((len(model.node), len(keep) + 6 * len(frames)), dtype=Long)
    T[keep, np.arange(len(keep))] = 1
    R, B = [own[keep]], []
    for k, port in enumerate(frames):
        at = np.flatnonzero(np.isin(model.node, port.nodes))
        first = len(keep) + 6 * k
        T[at, first : first + 6] = rigid_rows(xyz[model.node[at]] - port.point, model.component[at])
        R.append(rigid_rows(np.tile(port.point.astype(Long), (6, 1)), np.arange(6)))
    for port in ports:
        if port in frames:
            first = len(keep) + 6 * frames.index(port)
            B.append(np.eye(T.shape[1], dtype=Long)[:, [first + c for c in port.components]])
        else:
            B.append(T.T @ _loads(model, port))
    return T, np.hstack(B), np.vstack(R)


def _loads(model: Model, port: Port):  # type: ignore[no-untyped-def]
    """(N, m) of an interface that takes no dofs away."""
    at = {(n, c): i for i, (n, c) in enumerate(zip(model.node.tolist(), model.component.tolist(), strict=True))}
    N, xyz = len(model.node), model.xyz.astype(Long)
    if port.vector is not None:
        return port.vector.astype(Long).reshape(N, -1)
    if port.coupling == "direct":
        rows = [at[n, c] for n in port.nodes.tolist() for c in port.components]
        return np.eye(N, dtype=Long)[:, rows]
    if port.coupling == "rigid":
        (n,) = port.nodes.tolist()
        motion = rigid_rows(np.tile(port.point - xyz[n], (6, 1)), np.arange(6))
        out = np.zeros((N, 6), dtype=Long)
        out[[at[n, c] for c in range(6)]] = motion.T
        return out[:, list(port.components)]
    w = model.weights(port.nodes)
    w = (w / w.sum()).astype(Long)
    rows = np.array([at[n, c] for n in port.nodes.tolist() for c in range(3)])
    R = rigid_rows(xyz[model.node[rows]] - port.point, model.component[rows])
    length = np.abs(R[:, 3:]).max()
    R[:, 3:] /= length
    WR = np.repeat(w, 3)[:, None] * R
    average = eliminated((R.T @ WR)[None], WR.T)[0].real
    average[3:] /= length
    out = np.zeros((N, 6), dtype=Long)
    out[rows] = average.T
    return out[:, list(port.components)]
