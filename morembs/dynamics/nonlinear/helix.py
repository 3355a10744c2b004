"""Elements of constant strain between two frames, and derivatives of their energy (spatial_beam has the theory).

chord = J(phi)^-1 d with d = R_A' (r_B - r_A), exp(phi) = R_A' R_B and J = T(phi)'. Derivatives are by the steps of
both nodes and by spins a, b of both frames: R_A -> R_A exp(a), R_B -> R_B exp(b). All arrays have one row per element.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats
from morembs.dynamics.nonlinear.rotation_vectors import inverse_coefficient, rotation_matrices
from morembs.fem import skew

_EYE = np.eye(3)


def _outer(a: Floats, b: Floats) -> Floats:
    return a[:, :, None] * b[:, None, :]


def _even(A: Floats) -> Floats:
    """Symmetric part."""
    return np.asarray(0.5 * (A + A.transpose(0, 2, 1)))


def _times(A: Floats, x: Floats) -> Floats:
    return np.asarray(np.einsum("eij,ej->ei", A, x))


def _scale(x: Floats, *arrays: Floats) -> Floats:
    """Product of numbers per element with an array per element."""
    shape = (-1, *([1] * (arrays[0].ndim - 1)))
    return np.asarray(x.reshape(shape) * arrays[0])


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("ei,ei->e", a, b))


@dataclass(frozen=True, eq=False)
class Helix:
    """``R`` (e, 3, 3) of A; ``d``, ``phi``, ``chord`` (e, 3); ``P`` = hat(phi); ``G`` = T(phi)^-1, so that J^-1 = G';
    ``e``, ``e1``, ``e2`` (e,) as rotation_vectors gives them; ``U`` (e, 3, 3) = d chord / d phi."""

    R: Floats
    d: Floats
    phi: Floats
    P: Floats
    G: Floats
    e: Floats
    e1: Floats
    e2: Floats
    chord: Floats

    @classmethod
    def between(cls, R: Floats, d: Floats, phi: Floats) -> Helix:
        """From R_A (e, 3, 3), d and phi (e, 3)."""
        e, e1, e2 = inverse_coefficient(_dot(phi, phi))
        P = skew(phi)
        G = _EYE + 0.5 * P + _scale(e, P @ P)
        return cls(R, d, phi, P, G, e, e1, e2, np.einsum("eji,ej->ei", G, d))

    def _slope(self, y: Floats, sign: float) -> Floats:
        """Matrix of v -> D(1 + sign P/2 + e P^2)[v] y."""
        Py = np.cross(self.phi, y)
        first = -0.5 * sign * skew(y) + _scale(2 * self.e1, _outer(np.cross(self.phi, Py), self.phi))
        return np.asarray(first - _scale(self.e, skew(Py) + self.P @ skew(y)))

    def gradient(self, stress: Floats) -> Floats:
        """Derivative (e, 12) of the energy for ``stress`` (e, 6), the force and moment of the section."""
        n, m = stress[:, :3], stress[:, 3:]
        g = _times(self.G, n)
        mu = np.einsum("eji,ej->ei", self.G, m + np.einsum("eji,ej->ei", self._slope(self.d, -1.0), n))
        force = _times(self.R, g)
        return np.hstack((-force, np.cross(g, self.d) - _times(rotation_matrices(self.phi), mu), force, mu))

    def rates(self, steps: Floats) -> Floats:
        """Rates (e, 6) of chord and phi for ``steps`` (e, 12) of the nodes and spins."""
        a, b = steps[:, 3:6], steps[:, 9:]
        d = np.einsum("eji,ej->ei", self.R, steps[:, 6:9] - steps[:, :3]) + np.cross(self.d, a)
        phi = _times(self.G, b - np.einsum("eji,ej->ei", rotation_matrices(self.phi), a))
        return np.hstack((np.einsum("eji,ej->ei", self.G, d) + _times(self._slope(self.d, -1.0), phi), phi))

    def _local(self, stress: Floats, C: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """By d and phi: gradient by phi (e, 3), and blocks dd, d phi, phi phi (e, 3, 3) of the second derivative."""
        n, m, d, phi, e, e1, e2 = stress[:, :3], stress[:, 3:], self.d, self.phi, self.e, self.e1, self.e2
        U = self._slope(d, -1.0)
        CU, Gn = C[:, :3, None] * U, self.G * C[:, None, :3]
        Pd = np.cross(phi, d)
        alpha = _dot(n, np.cross(phi, Pd))
        v = np.cross(Pd, n) + np.cross(d, np.cross(n, phi))
        # n . D2(e P^2)[v, v] d
        second = _scale(4 * e2 * alpha, _outer(phi, phi)) + _scale(2 * e1 * alpha - 2 * e * _dot(n, d), _EYE[None])
        second = second + _even(_scale(4 * e1, _outer(phi, v)) + _scale(2 * e, _outer(n, d)))
        pp = C[:, 3:, None] * _EYE + U.transpose(0, 2, 1) @ CU + second
        return m + np.einsum("eji,ej->ei", U, n), Gn @ self.G.transpose(0, 2, 1), Gn @ U + self._slope(n, 1.0), pp

    def hessian(self, stress: Floats, C: Floats) -> Floats:
        """Second derivative (e, 12, 12) for section stiffness per length ``C`` (e, 6), exponentials as above."""
        moment, dd, dp, pp = self._local(stress, C)
        g, d, G, P, e, phi = _times(self.G, stress[:, :3]), self.d, self.G, self.P, self.e, self.phi
        E = rotation_matrices(phi)
        # y = (d, phi) by (step along body axes, a, b): d' = step + d x a, phi' = G (b - E' a).
        Y = np.zeros((len(d), 6, 9))
        Y[:, :3, :3] = _EYE
        Y[:, :3, 3:6] = skew(d)
        Y[:, 3:, 6:] = G
        Y[:, 3:, 3:6] = -G @ E.transpose(0, 2, 1)
        inner = np.block([[dd, dp], [dp.transpose(0, 2, 1), pp]])
        H = Y.transpose(0, 2, 1) @ inner @ Y
        # Second derivatives of y: of d,
        H[:, 3:6, 3:6] += _even(_outer(g, d)) - _scale(_dot(g, d), _EYE[None])
        H[:, 3:6, :3] += skew(g)
        H[:, :3, 3:6] -= skew(g)
        # of phi: D G[G w] w with w = b - E' a,
        PPm = np.cross(phi, np.cross(phi, moment))
        mG = skew(moment) @ G
        Q = 0.5 * mG + _scale(2 * self.e1, _outer(PPm, phi))
        Q = Q + _scale(e, mG.transpose(0, 2, 1) @ P + skew(np.cross(moment, phi)) @ G)
        w = np.concatenate((-E.transpose(0, 2, 1), np.broadcast_to(_EYE, E.shape)), axis=2)
        H[:, 3:, 3:] += w.transpose(0, 2, 1) @ _even(Q) @ w
        # and G w' with w' = b x E' a.
        cross = -0.5 * skew(np.einsum("eji,ej->ei", G, moment)) @ E.transpose(0, 2, 1)
        H[:, 6:, 3:6] += cross
        H[:, 3:6, 6:] += cross.transpose(0, 2, 1)
        # From (step along body axes, a, b) to (r_A, a, r_B, b).
        full = np.zeros((len(d), 9, 12))
        full[:, :3, :3], full[:, :3, 6:9] = -self.R.transpose(0, 2, 1), self.R.transpose(0, 2, 1)
        full[:, 3:6, 3:6] = full[:, 6:, 9:] = _EYE
        return np.asarray(full.transpose(0, 2, 1) @ H @ full)
