"""References made with inexact solutions, and those of modal damping, against solutions of the full equations."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.certificate.certify import certify
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import FreeInterface
from morembs.responses.certified import certified_reference
from tests.support.exact_responses import Truth, norms, pencil
from tests.support.meshes import beam, ends
from tests.support.solvers import InexactSolver

BAND = [50.0, 2500.0]


@pytest.mark.parametrize("error", [1e-8, 1e-4, 1e-2])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-9])
def test_a_reference_of_an_inexact_solver_is_known_to_its_uncertainty(error, tolerance):
    model = beam((8, 2, 2))
    damping = Damping(alpha=8.0, beta=3e-7)
    with Problem(model, ends(model), damping=damping, solver=InexactSolver(error=error)) as problem:
        reference = certified_reference(problem, BAND, tolerance=tolerance)
    with Problem(model, ends(model), damping=damping) as exact:
        omega = 2 * np.pi * np.append(np.linspace(*BAND, 9), np.sqrt(reference.values[:3]) / (2 * np.pi))
        wrong = norms(reference.H(omega) - Truth(exact)(omega))
    assert (wrong <= reference.uncertainty(omega)).all() and reference.proven
    assert reference.error_bounds.max() <= tolerance


def test_a_solver_that_is_of_no_use_proves_nothing():
    """Up to three tenths of every solution are wrong, which refinement cannot mend."""
    model = beam((16, 2, 2))
    with Problem(model, ends(model), damping=Damping(beta=3e-7), solver=InexactSolver(error=0.3)) as problem:
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
        assert reference.proven and reference.error_bounds.max() <= tolerance


def ring(place):
    """K, M and D of a ring of 13 equal masses on equal springs: but for the first, its modes are double."""
    n = 13
    K = 2.5e4 * np.eye(n) - 1e4 * (np.roll(np.eye(n), 1, axis=0) + np.roll(np.eye(n), -1, axis=0))
    D = np.zeros((n, n))
    D[place, place], D[place + 2, place + 2] = 4.0, 1.0
    return K, np.eye(n), D


def spring_model(K, M, D):
    n = len(K)
    nodes = Nodes(ids=np.arange(1, n + 1), xyz=np.outer(np.arange(float(n)), [0.0, 0.0, 1.0]))
    dofs = DofMap(node=np.arange(n), component=np.full(n, 2))
    return FEModel(K=sp.csr_array(K), M=sp.csr_array(M), D=sp.csr_array(D), nodes=nodes, dofs=dofs)


@pytest.mark.parametrize("place", [1, 4, 8])
def test_equal_modes_share_their_damping_in_the_envelope(place):
    """Round-off chooses the basis of double modes, and diagonals of D change with it; its traces do not."""
    K, M, D = ring(place)
    model, at = spring_model(K, M, D), [0, 5]
    faces = [make_interface(model, name=f"f{i}", nodes=[i], coupling="direct", components=[2]) for i in at]
    with Problem(model, faces) as problem:
        omega = np.linspace(0.0, 2 * np.pi * 20.0, 400)
        standard = certified_reference(problem, [0.0, 20.0]).standard()
        seen = standard.modes.moduli(omega)[0] @ standard.residue_norms
        values, phi = pencil(problem)
    # A zero beside the single mode makes it a pair too.
    pairs, theta = np.insert(phi, 1, 0.0, axis=1).reshape(len(K), -1, 2), values[::2]
    d = np.einsum("ipk,ij,jpk->p", pairs, D, pairs) / np.append(1, np.full(6, 2))
    inverse = 1 / np.abs(theta + 1j * omega[:, None] * d - omega[:, None] ** 2)
    left, right = (np.linalg.norm(pairs[i], axis=1) for i in at)
    # The whole, and the block of the motion of one interface under the load at the other.
    assert seen[:, 0] == pytest.approx(inverse @ (left**2 + right**2), rel=1e-6)
    assert seen[:, 2] == pytest.approx(inverse @ (left * right), rel=1e-6)


def test_a_mode_that_the_matrix_of_the_model_leaves_undamped_has_no_limit():
    """Two equal chains, joined at their ends: dampers on both see what moves the same way on both."""
    for h in range(2, 7):
        chain = np.diag(np.full(h, 2e4)) - 1e4 * (np.eye(h, k=1) + np.eye(h, k=-1))
        K, n, join = sl.block_diag(chain, chain), 2 * h, np.zeros(2 * h)
        join[h - 1], join[n - 1] = 1.0, -1.0
        K += 1e4 * np.outer(join, join)
        v = np.zeros(n)
        v[0] = v[h] = 1.0
        hz = np.sqrt(sl.eigvalsh(K)) / (2 * np.pi)
        for c in (1.0, 30.0, 1e3):
            model = spring_model(K, np.eye(n), c * np.outer(v, v))
            faces = [
                make_interface(model, name=f"f{i}", nodes=[i], coupling="direct", components=[2]) for i in (0, n - 1)
            ]
            with Problem(model, faces) as problem:
                band = [0.0, float(hz[min(5, n - 1)])]
                (certificate,) = certify(problem, [FreeInterface(modes=min(3, n - 2)).reduce(problem)], band)
            assert certificate.limit.upper == np.inf and "undamped resonance at" in certificate.notes[0]
            assert np.isfinite(certificate.full).all() and np.isfinite(certificate.block_error).all()
