"""References made with inexact solutions, and those of modal damping, against solutions of the full equations."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.certificate.certify import certify
from morembs.interface import make_interface
from morembs.model import DofMap, FEModel, Nodes
from morembs.problem import Damping, Problem
from morembs.reducers import FreeInterface
from morembs.responses.certified import certified_reference
from tests.support.exact_responses import Truth, envelope, norms, pencil
from tests.support.meshes import beam, ends
from tests.support.solvers import InexactSolver

BAND = [50.0, 2500.0]


@pytest.mark.parametrize("error", [1e-8, 1e-4, 1e-2])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-9])
def test_a_reference_of_an_inexact_solver_is_known_to_its_uncertainty(error, tolerance):
    model = beam((16, 2, 2))
    damping = Damping(alpha=8.0, beta=3e-7)
    with Problem(model, ends(model), damping=damping, solver=InexactSolver(error=error)) as problem:
        reference = certified_reference(problem, BAND, tolerance=tolerance)
    with Problem(model, ends(model), damping=damping) as exact:
        omega = 2 * np.pi * np.append(np.linspace(*BAND, 9), np.sqrt(reference.values[:3]) / (2 * np.pi))
        wrong = norms(reference.H(omega) - Truth(exact)(omega))
    assert (wrong <= reference.uncertainty(omega)).all() and reference.proven
    assert reference.off.max() <= tolerance


def test_a_solver_that_is_of_no_use_proves_nothing():
    """Half of every solution is wrong: refinement gains nothing."""
    model = beam((16, 2, 2))
    with Problem(model, ends(model), damping=Damping(beta=3e-7), solver=InexactSolver(error=2.5)) as problem:
        reference = certified_reference(problem, BAND)
        assert not reference.proven and "solver is too inexact" in reference.doubts[0]


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-9])
@pytest.mark.parametrize("ratio", [1e-4, 0.05, 0.7])
def test_modal_damping_is_that_of_the_modes_of_the_model(ratio, tolerance):
    model = beam((8, 2, 2))
    with Problem(model, ends(model), damping=Damping(modal=ratio)) as problem:
        reference = certified_reference(problem, BAND, tolerance=tolerance)
        values, phi = pencil(problem)
        omega = 2 * np.pi * np.append(np.linspace(*BAND, 60), np.sqrt(reference.values[:3]) / (2 * np.pi))
        b = (problem.B.T @ phi).T * problem.motion_scale
        a = values + 2j * ratio * omega[:, None] * np.sqrt(values) - omega[:, None] ** 2
        H = np.einsum("pi,wp,pj->wij", b, 1 / a, b)
        assert (norms(reference.H(omega) - H) <= reference.uncertainty(omega)).all()
        assert reference.proven and reference.off.max() <= tolerance


def twins(turn=0.0):
    """Two equal chains of masses without stiffness between them but at the ends, and a damper on one of them.

    The modes of both are double; ``turn`` changes what an eigensolver takes for a basis of them.
    """
    n = 12
    K = 2e4 * np.eye(n) - 1e4 * (np.eye(n, k=1) + np.eye(n, k=-1))
    K, M = sl.block_diag(K, K), np.eye(2 * n)
    c, s = np.cos(turn), np.sin(turn)
    Q = np.block([[c * np.eye(n), -s * np.eye(n)], [s * np.eye(n), c * np.eye(n)]])
    D = np.zeros((2 * n, 2 * n))
    D[3, 3], D[3 + n, 3 + n], D[5, 5] = 4.0, 1.0, 2.0
    K[0, 0], K[n, n] = 2e4, 2e4
    b = np.zeros((2 * n, 2))
    b[n - 1, 0], b[2 * n - 1, 1] = 1.0, 1.0
    return K, M, Q.T @ D @ Q, Q.T @ b


def chain_model(K, M, D):
    n = len(K)
    nodes = Nodes(ids=np.arange(1, n + 1), xyz=np.outer(np.arange(float(n)), [0.0, 0.0, 1.0]))
    dofs = DofMap(node=np.arange(n), component=np.full(n, 2))
    return FEModel(K=sp.csr_array(K), M=sp.csr_array(M), D=sp.csr_array(D), nodes=nodes, dofs=dofs)
