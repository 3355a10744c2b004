"""Residuals of spaces for models with a damping matrix of their own, against dense solutions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.certificate.certify import certify
from morembs.problem import Problem
from morembs.reducers import FreeInterface
from morembs.responses.band import beyond
from morembs.responses.certified import certified_reference
from morembs.responses.clusters import clusters, damping_of_clusters
from morembs.responses.damped_residual import damped_residual
from morembs.responses.rational import PoleResidueForm
from morembs.responses.reference import ModalReference
from tests.responses.test_direct import dense_response
from tests.support.meshes import beam, ends, where

HIGH = 2 * np.pi * 2500.0
# N s/m of a damper, whether it is at the ground, and s of stiffness damping.
DAMPERS = [
    (30.0, False, 1e-6),
    (300.0, True, 1e-6),
    (3e3, True, 0.0),
    (1e6, False, 1e-7),
    (1e8, False, 1e-6),
    (-30.0, False, 1e-6),
]


def damped(model, viscosity, grounded, beta):
    """The ``model`` with a damper between two corners, or from one to the ground, beside stiffness damping."""
    rows = [model.dofs.of_nodes(where(model, 0, x)[:1])[0][2] for x in (0.0, 0.5)]
    v = sp.csr_array((np.array([1.0, 0.0 if grounded else -1.0]), (rows, [0, 0])), shape=(model.size, 1))
    return replace(model, D=sp.csr_array(viscosity * (v @ v.T) + beta * model.K)), v


def small_space(problem, force):
    """The modes below the cut, and the statics of loads and of the ``force`` of the damper."""
    modes, solve = problem.elastic_modes(below=beyond(2500.0)), problem.free_free.flexibility
    B = problem.B.toarray()
    statics = solve(np.hstack([B, force]))
    V = problem.space.complement([problem.rigid], np.hstack([modes.vectors, statics]))
    values, Y = sl.eigh(V.T @ (problem.K @ V), V.T @ (problem.M @ V))
    U = V @ Y
    model = ModalReference(
        values=values,
        D=U.T @ (problem.D @ U),
        damping=problem.damping,
        F=U.T @ B,
        inputs=B.shape[1],
        V=V,
        Y=Y,
        error=0.0,
        problem=problem,
    )
    return model, len(modes.eigenvalues)


@pytest.mark.parametrize(("viscosity", "grounded", "beta"), DAMPERS)
def test_no_error_of_a_space_lies_above_its_bound(viscosity, grounded, beta):
    model, v = damped(beam((16, 2, 2)), viscosity, grounded, beta)
    with Problem(model, ends(model)) as problem:
        space, k = small_space(problem, problem.coupling.T.T @ v.toarray())
        residual, proven = damped_residual(problem, space, (problem.D, space.D), k, beyond(2500.0), 0.0)
        assert proven
        edges, bounds = residual.bounds((0.0, HIGH), 1e-12)
        resonances = np.sqrt(space.values[:k])
        omega = np.concatenate([np.linspace(60.0, 0.999 * HIGH, 40), resonances, 1.001 * resonances])
        omega = omega[omega < HIGH]
        wrong = dense_response(problem, omega, problem.D.toarray()) - space.response(omega)
        error = np.linalg.norm(wrong * np.outer(problem.motion_scale, problem.motion_scale), axis=(1, 2))
        size = (residual.b**2).sum(axis=1)
        for cluster in clusters(space.values):
            size[cluster] = size[cluster].mean()
        d = damping_of_clusters(space.values, space.D)[0]
        e = PoleResidueForm.second_order(space.values, d, size[:, None]).moduli(omega)[0] @ size
    limit = bounds[np.clip(np.searchsorted(edges, omega, side="right") - 1, 0, len(bounds) - 1)]
    # The dense solutions have round-off.
    known = error / e > 1e-7
    assert known.sum() > 20
    assert (limit[known] >= error[known] / e[known]).all()
    assert np.median(limit[known] / (error[known] / e[known])) < 3


def test_a_reference_of_dampers_is_proven_and_one_that_is_driven_an_estimate():
    for viscosity, kind in ((30.0, "proven"), (-3e3, "estimate")):
        model, _ = damped(beam((16, 2, 2)), viscosity, False, 1e-6)
        with Problem(model, ends(model)) as problem:
            reference = certified_reference(problem, [0.0, 2500.0])
            assert problem.K.shape[0] > 400 and reference.error_bounds.max() < 1e-6
            (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], [0.0, 2500.0])
        assert certificate.kind == kind
