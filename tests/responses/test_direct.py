"""Responses by direct factorisation, and of models with a damping matrix of their own, against dense solutions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.base.errors import SingularMatrixError
from morembs.certificate.certify import certify
from morembs.certificate.response import full_response, reduced_response
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, FreeInterface
from morembs.responses.band import band_frequencies
from morembs.responses.direct import direct_response, elastic_states
from morembs.responses.reference import reference_model
from tests.support.meshes import beam, ends, where
from tests.support.refusals import refusal

OMEGA = 2 * np.pi * np.array([40.0, 500.0, 1090.0, 2500.0])


def dampers(model, grounded):
    """A damper of 300 Ns/m between two corners of the beam, or from one of them to the ground, across it."""
    rows = [model.dofs.of_nodes(where(model, 0, x)[:1])[0][2] for x in (0.0, 0.5)]
    v = sp.csr_array((np.array([1.0, 0.0 if grounded else -1.0]), (rows, [0, 0])), shape=(model.size, 1))
    return sp.csr_array(300.0 * (v @ v.T))


def dense_response(problem, omega, D):
    """H (nf, m, m) of the body held to motions u with Z'M u = 0 by forces M Z."""
    K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
    MZ = M @ problem.rigid
    r, responses = MZ.shape[1], []
    for w in omega:
        A = np.block([[K + 1j * w * D - w**2 * M, MZ], [MZ.T, np.zeros((r, r))]])
        # One unit for displacements and for the forces that hold the mean axes.
        s = np.concatenate([1 / np.sqrt(np.diag(K)), np.full(r, np.sqrt(np.diag(K).max()))])
        U = s[:, None] * np.linalg.solve(s[:, None] * A * s, s[:, None] * np.vstack([B, np.zeros((r, B.shape[1]))]))
        responses.append(B.T @ U[: len(K)])
    return np.array(responses)


def off(H, true):
    return (np.linalg.norm(H - true, axis=(1, 2)) / np.linalg.norm(true, axis=(1, 2))).max()


@pytest.mark.parametrize("damping", [Damping(), Damping(alpha=8.0, beta=3e-6)])
@pytest.mark.parametrize("coupling", ["average", "rigid"])
def test_direct_response_is_that_of_the_dense_matrices(damping, coupling):
    model = beam()
    with Problem(model, ends(model, coupling), damping=damping) as problem:
        D = damping.alpha * problem.M.toarray() + damping.beta * problem.K.toarray()
        true = dense_response(problem, OMEGA, D)
        assert off(direct_response(problem, OMEGA), true) < 1e-9
        assert off(full_response(problem, OMEGA), true) < 1e-7
        # At zero it is the flexibility, without a factorisation of the singular K.
        assert off(direct_response(problem, np.zeros(1)), dense_response(problem, np.array([1e-3]), D)) < 1e-6


@pytest.mark.parametrize("grounded", [False, True])
@pytest.mark.parametrize("n", [(8, 2, 2), (20, 2, 2)])
def test_dampers_are_followed_by_the_direct_and_the_reference_response(grounded, n):
    """A grounded damper couples rigid motion to the rest, which mean axes then have to be held against."""
    model = beam(n)
    with Problem(replace(model, D=dampers(model, grounded)), ends(model)) as problem:
        assert n[0] == 8 or problem.K.shape[0] > 400  # larger models take another way to their reference
        true = dense_response(problem, OMEGA, problem.D.toarray())
        assert off(direct_response(problem, OMEGA), true) < 1e-8
        assert off(full_response(problem, OMEGA), true) < 1e-7


def test_limits_of_a_model_with_dampers_are_proven():
    model = beam((16, 2, 2))
    with Problem(replace(model, D=sp.csr_array(dampers(model, False) + 2e-6 * model.K)), ends(model)) as problem:
        reducers = FreeInterface(modes=8), AutoReducer(band_hz=[0, 2500], tolerance=1e-3)
        bodies = [reducer.reduce(problem) for reducer in reducers]
        hz = band_frequencies(problem, [0, 2500], 30)
        true = dense_response(problem, 2 * np.pi * hz, problem.D.toarray())
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        for body, certificate in zip(bodies, certify(problem, bodies, [0, 2500], points=30), strict=True):
            assert certificate.bound_kind == "bound"
            size = np.linalg.norm(true * scale, axis=(1, 2))
            assert certificate.full == pytest.approx(size, rel=1e-6)
            assert certificate.kind == "proven" and (certificate.error <= certificate.bound).all(), body.name
            reached = np.linalg.norm((reduced_response(body, 2 * np.pi * hz) - true) * scale, axis=(1, 2)) / size
            assert np.abs(certificate.error - reached).max() < 1e-6
            assert reached.max() <= certificate.limits["pointwise"].upper
        assert certificate.limit.upper <= 1e-3


def membrane(n, seed):
    """Masses (n^2) that move along z between springs of two decades, one side to the ground, and four dampers."""
    rng, point = np.random.default_rng(seed), np.arange(n * n).reshape(n, n)
    pairs = np.vstack(
        [
            np.stack([point[:-1].ravel(), point[1:].ravel()], 1),
            np.stack([point[:, :-1].ravel(), point[:, 1:].ravel()], 1),
        ]
    )
    each = np.arange(len(pairs))
    A = sp.csr_array((np.repeat([1.0, -1.0], len(pairs)), (np.tile(each, 2), pairs.T.ravel())))
    K = A.T @ sp.diags_array(1e4 * 10 ** rng.uniform(-1, 1, len(pairs))) @ A
    K = sp.csr_array(K + sp.diags_array(np.where(np.arange(n * n) < n, 1e4, 0.0)))
    M = sp.csr_array(sp.diags_array(10 ** rng.uniform(-0.5, 0.5, n * n)))
    D = np.zeros(K.shape)
    for i, j in rng.integers(0, n * n, (4, 2)):
        v = np.zeros(n * n)
        v[i], v[j] = 1.0, -1.0
        D += 10 ** rng.uniform(0, 4) * np.outer(v, v)
    nodes = Nodes(ids=np.arange(1, n * n + 1), xyz=np.outer(np.arange(float(n * n)), [0.0, 0.0, 1.0]))
    dofs = DofMap(node=np.arange(n * n), component=np.full(n * n, 2))
    return FEModel(K=K, M=M, D=sp.csr_array(D), nodes=nodes, dofs=dofs)


@pytest.mark.parametrize(("seed", "at"), [(1, (30, 400)), (5, (150, 151)), (13, (30, 400))])
def test_references_are_known_where_nothing_was_solved(seed, at):
    model = membrane(22, seed)
    faces = [make_interface(model, name=f"f{i}", nodes=[i], coupling="direct", components=[2]) for i in at]
    with Problem(model, faces) as problem:
        (last,) = sl.eigh(model.K.toarray(), model.M.toarray(), subset_by_index=[60, 60], eigvals_only=True)
        omega = np.linspace(0.0, np.sqrt(last), 100)
        reference = reference_model(problem, omega, tolerance=1e-6)
        H, true = reference.response(omega[1::6]), dense_response(problem, omega[1::6], model.D.toarray())
        error = np.abs(H - true).max(axis=(1, 2)) / np.abs(true).max(axis=(1, 2))
    assert reference.error <= 1e-6 and error.max() <= 1e-6


def test_an_undamped_resonance_is_named():
    model = beam()
    with Problem(model, ends(model)) as problem:
        omega = np.sqrt(problem.elastic_modes(count=1).eigenvalues)
        with refusal("model", "", f"{omega[0] / (2 * np.pi):.6g}", by=SingularMatrixError):
            direct_response(problem, omega)


def test_what_has_no_matrix_is_not_solved_directly():
    model = beam()
    modal = Damping(modal=0.01)
    with Problem(model, ends(model), damping=modal) as problem, refusal("unsupported", "damping"):
        elastic_states(problem.system, 100j, problem.B)
    with Problem(model) as problem, refusal("missing", "interfaces"):
        direct_response(problem, OMEGA)
    damped = replace(model, D=dampers(model, False))
    both = Damping(beta=1e-6)
    with Problem(damped, ends(model), damping=both) as problem, refusal("unsupported", "damping", "alpha", "beta"):
        direct_response(problem, OMEGA)
