"""A(s) as an operator, against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.base.errors import SolverError
from morembs.problem import Damping, Problem
from tests.support.meshes import beam, ends
from tests.support.refusals import refusal
from tests.support.solvers import InexactSolver

S = 2j * np.pi * 900.0


def skew(M):
    """A gyroscopic matrix with the mass ``M`` of solids that turn about z."""
    T = sp.kron(sp.eye_array(M.shape[0] // 3), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    return sp.csr_array(100.0 * (M @ T - (M @ T).T))


@pytest.mark.parametrize("transposed", [False, True])
def test_solutions_have_no_rigid_motion_and_the_damping_of_the_problem(transposed):
    damping = Damping(alpha=30.0, beta=2e-5, structural=0.01)
    with Problem(beam(), ends(beam()), damping=damping) as problem:
        system = problem.system
        K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
        F = problem.B.toarray() - M @ (Z @ (Z.T @ problem.B.toarray()))
        with system.inverse(S) as solve, system.inverse(S, damped=False) as undamped:
            X, Y = solve(F, transposed=transposed), undamped(F, transposed=transposed)
    c, g = damping.proportional(S)
    assert np.abs(M @ (c * K @ X)).max() > 0 and np.abs(Z.T @ M @ X).max() < 1e-12 * np.abs(M @ X).max()
    assert np.abs(c * K @ X + g * M @ X - F).max() < 1e-7
    assert np.isrealobj(Y) and np.abs(K @ Y + (S * S).real * M @ Y - F).max() < 1e-7


@pytest.mark.parametrize("transposed", [False, True])
def test_skew_parts_are_transposed(transposed):
    model = beam()
    model = replace(
        model, G=skew(model.M), N=10.0 * skew(model.M), K=sp.csr_array(model.K + 1e6 * sp.eye_array(model.size))
    )
    with Problem(model, ends(model)) as problem:
        K, M, G, N = (A.toarray() for A in (problem.K, problem.M, problem.G, problem.N))
        A = S * S * M + S * G + K + N
        A, F = A.T if transposed else A, problem.B.toarray()
        with problem.system.inverse(S) as solve:
            X = solve(problem.B, transposed=transposed)
        assert problem.system.apply(S, X, transposed=transposed) == pytest.approx(A @ X, abs=1e-7)
    assert np.abs(A @ X - F).max() < 1e-7


@pytest.mark.parametrize("s", [S, 3000.0, 0.0])
def test_solutions_that_are_wrong_are_refused(s):
    model = replace(beam(), K=sp.csr_array(beam().K + 1e6 * sp.eye_array(beam().size)))
    with (
        Problem(model, ends(model), solver=InexactSolver()) as problem,
        problem.system.inverse(s) as solve,
        refusal("result", "accuracy", by=SolverError),
    ):
        solve(problem.B)
