"""Inertia forces of a floating-frame body from its integrals, with all terms of second order (Wallrapp 1994).

With s = x + phi q the body point in the frame, everything follows from two contractions:
P(q)[a, b, l] = int s_a phi_b,l dm and the change of the moments G(q)[a, b] = int s_a s_b dm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from morembs.base.types import Floats
from morembs.dynamics.multibody.rotations import cross, hat

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Foreshortening:
    """Second-order displacement by its integrals, from geometric stiffness matrices of unit inertia loads.

    ``linear`` (3, n, n): W_a = int w_a dm = q' linear[a] q / 2; ``angular`` (3, n, n): int x cross w dm in the
    same way; ``centrifugal`` (6, n, n) per product of angular velocities in the order xx, yy, zz, xy, yz, zx.
    """

    linear: Floats
    angular: Floats
    centrifugal: Floats


class Inertia:
    """Mass matrix and velocity forces of one body; axes of the frame throughout.

    Velocity coordinates: velocity of the origin (3), angular velocity (3), elastic rates (n).
    """

    def __init__(
        self,
        *,
        mass: float,
        first: Floats,
        inertia: Floats,
        Ct: Floats,
        Cr: Floats,
        Me: Floats,
        x_phi: Floats,
        phi_phi: Floats,
        foreshortening: Foreshortening | None = None,
    ) -> None:
        n = len(Me)
        self.n, self.mass, self.first, self.inertia = n, mass, first, inertia
        self.C1, self.Cr = np.ascontiguousarray(Ct.T), np.ascontiguousarray(Cr.T)
        self.Me = Me
        self._x_phi = np.ascontiguousarray(x_phi.reshape(9, n))
        self._phi_phi = np.ascontiguousarray(phi_phi.transpose(0, 1, 3, 2).reshape(9 * n, n))
        self._short = foreshortening
        if foreshortening is not None:
            rigid = np.block([[mass * np.eye(3), -hat(first)], [hat(first), inertia]])
            self._coupling = np.vstack((self.C1, self.Cr))
            self._by_rigid = np.linalg.pinv(rigid, hermitian=True)
            self._relative = Me - self._coupling.T @ self._by_rigid @ self._coupling

    def first_moment(self, q: Floats) -> Floats:
        """int s dm (3,), with the second-order displacement where there is stiffening."""
        moment = self.first + self.C1 @ q
        if self._short is not None:
            moment = moment + 0.5 * (self._short.linear @ q) @ q
        return np.asarray(moment)

    def evaluate(self, w: Floats, q: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Mass matrix (6 + n, 6 + n) and velocity forces (6 + n,) for angular velocity w, elastic q and dq/dt.

        Forces: those of the translation row, the rotation row and the elastic rows, in axes of the frame.
        """
        n, eye = self.n, np.eye(3)
        both = self._phi_phi @ np.stack((q, rate), axis=1)
        at_q, at_rate = both[:, 0].reshape(9, n), both[:, 1].reshape(9, n)
        P = self._x_phi + at_q
        mixed = (self._x_phi @ q).reshape(3, 3)
        G = mixed + mixed.T + (at_q @ q).reshape(3, 3)
        J = self.inertia + np.trace(G) * eye - G
        Cr = self.Cr + _cross_integrals(at_q)
        moment = self.first + self.C1 @ q
        flow = self.C1 @ rate
        N = (P @ rate).reshape(3, 3)
        spin = np.outer(w, w) - (w @ w) * eye
        M = np.empty((6 + n, 6 + n))
        force = np.empty(6 + n)
        force[:3] = 2 * cross(w, flow) + spin @ moment
        force[3:6] = 2 * (np.trace(N) * w - w @ N) + cross(w, J @ w)
        force[6:] = 2 * (w @ _cross_integrals(at_rate)) + spin.ravel() @ P
        C1, Me = self.C1, self.Me
        if self._short is not None:
            moment, C1, Cr, J, Me = self._second_order(self._short, w, q, rate, force, moment, Cr, J)
        M[:3, :3] = self.mass * eye
        M[:3, 3:6] = -hat(moment)
        M[3:6, :3] = -M[:3, 3:6]
        M[:3, 6:], M[6:, :3] = C1, C1.T
        M[3:6, 3:6] = J
        M[3:6, 6:], M[6:, 3:6] = Cr, Cr.T
        M[6:, 6:] = Me
        return M, force

    def tangents(
        self, A: Floats, w: Floats, alpha: Floats, q: Floats, rate: Floats, second: Floats
    ) -> tuple[Floats, Floats] | None:
        """Derivatives (6 + n, 6 + n) of the inertia forces by configuration and by velocity; None with stiffening.

        The frame has the acceleration ``A`` less gravity, angular velocity ``w`` and acceleration ``alpha``, all along
        its axes; ``second`` (n,) is that of q. A point has the acceleration a = A + S s + 2 w x phi q' + phi q'', where
        S s = alpha x s + w x (w x s); forces are its integrals with 1, s x and phi.
        """
        if self._short is not None:
            return None
        n, W, C1, eye = self.n, hat(w), self.C1, np.eye(3)
        S = hat(alpha) + W @ W
        turns = np.array([hat(e) for e in eye])
        dS = turns @ W + W @ turns
        by = [part.reshape(3, 3, n) for part in (self._phi_phi @ np.stack((q, rate, second), axis=1)).T]
        P = self._x_phi.reshape(3, 3, n) + by[0]
        moment, mixed = self.first + C1 @ q, (self._x_phi @ q).reshape(3, 3)
        squares = 0.5 * np.trace(self.inertia) * eye - self.inertia + mixed + mixed.T + by[0] @ q
        flow, N = C1 @ rate, P @ rate
        SP, WP = np.tensordot(S, P, axes=(1, 1)), 2 * np.tensordot(W, P, axes=(1, 1))
        # int a_b phi_a, and the force that turns with the frame.
        Q = A[:, None, None] * C1 + np.tensordot(S, P, axes=(1, 0)) + 2 * np.tensordot(W, by[1], axes=(1, 0)) + by[2]
        F = self.mass * A + S @ moment + 2 * W @ flow + C1 @ second
        K, C = np.zeros((6 + n, 6 + n)), np.zeros((6 + n, 6 + n))
        turned = hat(A)
        K[:3, 3:6], K[3:6, 3:6], K[6:, 3:6] = self.mass * turned - hat(F), hat(moment) @ turned, C1.T @ turned
        K[:3, 6:], C[:3, 6:] = S @ C1, 2 * W @ C1
        # SP[b, a, l] is int s_a (S phi_l)_b.
        K[3:6, 6:], C[3:6, 6:] = (
            _cross_integrals((Q + SP).transpose(1, 0, 2).reshape(9, n)),
            _cross_integrals(WP.transpose(1, 0, 2).reshape(9, n)),
        )
        both = (np.stack((S.ravel(), 2 * W.ravel())) @ self._phi_phi.reshape(9, n * n)).reshape(2, n, n)
        K[6:, 6:], C[6:, 6:] = both[0].T, both[1].T
        C[:3, 3:6] = (dS @ moment + 2 * turns @ flow).T
        H = squares @ dS.transpose(0, 2, 1) + 2 * N @ turns.transpose(0, 2, 1)
        C[3:6, 3:6] = np.stack((H[:, 1, 2] - H[:, 2, 1], H[:, 2, 0] - H[:, 0, 2], H[:, 0, 1] - H[:, 1, 0]))
        C[6:, 3:6] = (
            dS.reshape(3, 9) @ P.transpose(1, 0, 2).reshape(9, n)
            + 2 * turns.reshape(3, 9) @ by[1].transpose(1, 0, 2).reshape(9, n)
        ).T
        return K, C

    @staticmethod
    def _inner(matrices: Floats, q: Floats, rate: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """q'Gq/2, its first derivative in time, q'' free second derivative, and Gq per matrix."""
        gq = matrices @ q
        return 0.5 * gq @ q, gq @ rate, (matrices @ rate) @ rate, gq

    def _second_order(
        self,
        short: Foreshortening,
        w: Floats,
        q: Floats,
        rate: Floats,
        force: Floats,
        moment: Floats,
        Cr: Floats,
        J: Floats,
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Adds the forces of the second-order displacement; returns the corrected moment, C1, Cr, J and Me.

        All follow from the kinetic energy v.(w x W + dW/dt) + w.H + w'Jw/2, so that energy is kept. Of the energy of
        dw/dt itself the integrals know the part whose momentum they hold: with y = (C1, Cr) q + (W, H) and the rigid
        mass matrix R it is y' R^-1 y'/2 without its terms of first order. Without it the mass matrix
        would be indefinite in a frame in which elastic shapes have momentum (tangent), at deflections that are small.
        """
        W, W1, W2, linear = self._inner(short.linear, q, rate)
        _, H, H1, angular = self._inner(short.angular, q, rate)
        _, _, _, centrifugal = self._inner(short.centrifugal, q, rate)
        extra, change = _symmetric(centrifugal @ q), _symmetric(2 * centrifugal @ rate)
        force[:3] += W2 + 2 * cross(w, W1) + cross(w, cross(w, W))
        force[3:6] += H1 + cross(w, H) - change @ w - cross(w, extra @ w)
        products = np.array([w[a] * w[b] for a, b in _PAIRS])
        force[6:] += products @ centrifugal
        momentum = self._coupling + np.vstack((linear, angular))
        share = self._by_rigid @ momentum
        force[6:] += np.concatenate((W2, H1)) @ share
        return moment + W, self.C1 + linear, Cr + angular, J - extra, self._relative + momentum.T @ share


def _cross_integrals(P: Floats) -> Floats:
    """(3, n): int s x phi_l dm from P (9, n)."""
    return np.stack((P[5] - P[7], P[6] - P[2], P[1] - P[3]))


def _symmetric(six: Floats) -> Floats:
    """(3, 3) S with w'Sw = sum of six times the products of w."""
    xx, yy, zz, xy, yz, zx = six.tolist()
    return np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]])
