"""The full model, solved without anything of the package but its matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from morembs.certificate.response import reduced_response
from morembs.responses.certified import floor_of
from morembs.responses.tolerances import TOL as RESPONSES

Long = np.longdouble
# Models of more dofs have a sparse factor.
DENSE = 700


class Truth:
    """Elastic part of H, scaled, by factorising A(i omega): the residual is refined in 80 bits."""

    def __init__(self, problem):
        self.problem, self.damping = problem, problem.damping
        self.loss = problem.damping.structural + 2 * floor_of(problem, [0.0, 1.0])
        self.K, self.M = sp.csc_array(problem.K).astype(Long), sp.csc_array(problem.M).astype(Long)
        if problem.D is not None:
            self.D = sp.csc_array(problem.D).astype(Long)
        Z = problem.rigid.astype(Long)
        for _ in range(2 if Z.shape[1] else 0):
            gram = (Z.T @ (self.M @ Z)).astype(float)
            Z = Z @ np.linalg.inv(np.linalg.cholesky(gram)).T.astype(Long)
        B = problem.B.toarray().astype(Long)
        self.Z, self.MZ = Z, self.M @ Z
        self.B = B - self.MZ @ (Z.T @ B)
        self.scale = np.outer(problem.motion_scale, problem.motion_scale)

    def __call__(self, omega):
        return np.array([(self.B.T @ self.states(w)).astype(complex) * self.scale for w in omega])

    def states(self, w):
        w, alpha, beta = Long(w), Long(self.damping.alpha), Long(self.damping.beta)
        A = self.K * (1 + 1j * Long(self.loss) + 1j * w * beta) + self.M * (1j * w * alpha - w**2)
        if self.problem.D is not None:
            A = A + 1j * w * self.D
        double = complex if A.dtype.kind == "c" else float
        if A.shape[0] <= DENSE:
            # Rigid motion, which the loads do not excite, gets a stiffness in the factor: at 0 Hz too it is regular.
            stiff = (self.MZ * (2 * w + 2000) ** 2).astype(float) @ self.MZ.T.astype(float)
            factor = sl.lu_factor(A.toarray().astype(double) + stiff)
            solve = lambda r: sl.lu_solve(factor, r.astype(double))  # noqa: E731
        else:
            solve = sla.splu(sp.csc_array(A.astype(double))).solve
        x = np.zeros(self.B.shape, A.dtype)
        for _ in range(12):
            dx = solve((self.B - A @ x).astype(double))
            dx = dx - self.Z @ (self.MZ.T @ dx)
            x = x + dx
            change, size = (np.abs(self.B.T @ u * self.scale).max() for u in (dx, x))
            if change < 1e-11 * size:
                return x
        raise AssertionError("the refinement of the reference does not converge")


def response_of(reduced, omega):
    """H of a body; one without damping gets that which certificates assume."""
    floor = RESPONSES.damping_floor if not reduced.D.any() and not reduced.structural else 0.0
    return reduced_response(replace(reduced, structural=reduced.structural + 2 * floor), omega)


def norms(H):
    return np.linalg.norm(H, axis=(1, 2))


def pencil(problem):
    """All elastic eigenvalues and vectors of the full model, by LAPACK."""
    values, vectors = sl.eigh(problem.K.toarray(), problem.M.toarray())
    r = problem.rigid.shape[1]
    return values[r:], vectors[:, r:]


def envelope(problem, omega):
    """(nf,) the sum of the sizes of all modal contributions."""
    values, vectors = pencil(problem)
    size = ((problem.B.T @ vectors) ** 2 * problem.motion_scale[:, None] ** 2).sum(axis=0)
    loss = problem.damping.structural + 2 * floor_of(problem, [0.0, 1.0])
    d = problem.damping.of_modes(values)
    return (size / np.abs(values * (1 + 1j * loss) + 1j * omega[:, None] * d - omega[:, None] ** 2)).sum(axis=1)
