"""Reduced models at values of parameters against full ones there, and derivatives against central differences."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.parametric.model import parametric_model
from morembs.parametric.parameter import Parameter
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.responses.direct import direct_response
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, some_basis

VALUES = {"E_arm": 1.9e11, "E_rest": 2.4e11, "rho": 8000.0, "alpha": 30.0, "beta": 2e-8, "t": 1.1}
F = np.array([500.0, 11000.0])


@pytest.fixture(scope="module")
def problem():
    mesh = bracket()
    beta = Parameter(name="beta", kind="beta", low=0.0, high=1e-7, nominal=1e-8)
    varied = varied_model(mesh, [STEEL], (*parameters(), beta, longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        yield problem


@pytest.fixture(scope="module")
def model(problem):
    return parametric_model(problem, some_basis(problem))


@pytest.fixture(scope="module")
def there(problem):
    with problem.at(problem.box.point(VALUES), assembled=True) as there:
        yield there


def test_frequencies_and_responses_are_those_of_the_full_model_at_the_values(model, there):
    at = model.at(model.box.point(VALUES))
    full = there.elastic_modes(count=4).frequencies_hz
    np.testing.assert_allclose(at.frequencies_hz[:4], full, rtol=1e-4)
    # Trial functions make the reduced body stiffer, the interpolation of volumes at most by its eps.
    assert (at.frequencies_hz[:4] > full * (1 - 1e-5)).all()
    H, exact = at.response(F), direct_response(there, 2 * np.pi * F)
    assert np.abs(H - exact).max() <= 1e-3 * np.abs(exact).max()


def test_a_body_at_any_value_has_six_free_motions(model):
    rng = np.random.default_rng(5)
    for p in rng.uniform(model.box.low, model.box.high, (20, len(model.box.low))):
        K, M = model.matrices(p)
        at = model.at(p)
        free = np.linalg.eigvalsh(np.linalg.solve(np.linalg.cholesky(M), np.linalg.solve(np.linalg.cholesky(M), K).T))
        assert np.sqrt(np.abs(free[:6]).max()) / (2 * np.pi) < 1e-5 * at.frequencies_hz[0]
        R = model.rigid_at(p)
        assert np.abs(K @ R).max() <= 1e-12 * np.abs(K).max() * np.abs(R).max()


def test_tables_of_frequencies_are_those_of_single_values(model):
    rng = np.random.default_rng(6)
    table = rng.uniform(model.box.low, model.box.high, (300, len(model.box.low)))
    F6 = model.frequencies_hz(table, 6)
    for k in (0, 255, 256, 299):
        np.testing.assert_allclose(F6[k], model.at(table[k]).frequencies_hz[:6], rtol=1e-8)


def steps(model):
    width = model.box.high - model.box.low
    for j, name in enumerate(model.box.names):
        yield name, 4e-4 * width[j] * np.eye(len(width))[j], 8e-4 * width[j]


def test_derivatives_are_those_of_the_reduced_model(model):
    p = model.box.point(VALUES)
    s = model.at(p).sensitivity()
    dH = s.response(F)
    assert not s.clustered[:6].any()
    for name, step, width in steps(model):
        more, less = model.at(p + step), model.at(p - step)
        for key in ("K", "M"):
            expected = (getattr(more, key) - getattr(less, key)) / width
            round_off = 1e-12 * np.abs(getattr(more, key)).max() / width
            np.testing.assert_allclose(
                getattr(s, key)[name], expected, atol=max(1e-6 * np.abs(expected).max(), round_off)
            )
        slope = (more.frequencies_hz[:6] - less.frequencies_hz[:6]) / width
        if name in ("alpha", "beta"):
            assert not s.frequencies_hz[name].any()
        else:
            np.testing.assert_allclose(s.frequencies_hz[name][:6], slope, rtol=1e-6)
        expected = (more.response(F) - less.response(F)) / width
        for k in range(len(F)):
            assert np.abs(dH[name][k] - expected[k]).max() <= 2e-6 * np.abs(expected[k]).max(), name


def test_derivatives_are_those_of_the_full_model(problem, model):
    p = problem.box.point(VALUES)
    s = model.at(p).sensitivity()
    dH = s.response(F)
    for name, step, width in steps(model):
        sides = []
        for side in (p + step, p - step):
            with problem.at(side, assembled=True) as there:
                sides.append((there.elastic_modes(count=3).frequencies_hz, direct_response(there, 2 * np.pi * F)))
        (f_more, H_more), (f_less, H_less) = sides
        if name not in ("alpha", "beta"):
            np.testing.assert_allclose(s.frequencies_hz[name][:3], (f_more - f_less) / width, rtol=1e-3)
        expected = (H_more - H_less) / width
        for k in range(len(F)):
            assert np.abs(dH[name][k] - expected[k]).max() <= 1e-3 * np.abs(expected[k]).max(), (name, F[k])


def test_frequencies_that_lie_together_are_marked_and_branch(model):
    # Two equal bodies side by side, of which one parameter changes one: every frequency is there twice.
    n = model.order
    K = np.zeros((len(model.K) + 1, 2 * n, 2 * n))
    M = np.zeros((len(model.M), 2 * n, 2 * n))
    law = replace(model.law_K, factors=np.vstack([model.law_K.factors, model.law_K.factors[:1]]))
    K[:-1, :n, :n] = K[:-1, n:, n:] = model.K
    M[:, :n, :n] = M[:, n:, n:] = model.M
    rigid = np.concatenate(
        [np.concatenate([model.rigid, 0 * model.rigid], axis=1), np.concatenate([0 * model.rigid, model.rigid], axis=1)]
    )
    double = replace(model, K=K, M=M, law_K=law, rigid=rigid, B=np.vstack([model.B, model.B]))
    single, s = model.at(model.box.nominal).sensitivity(), double.at(model.box.nominal).sensitivity()
    assert s.clustered[:8].all()
    for name in ("E_arm", "t"):
        np.testing.assert_allclose(s.frequencies_hz[name][:8:2], single.frequencies_hz[name][:4], rtol=1e-6)
        np.testing.assert_allclose(s.frequencies_hz[name][1:8:2], single.frequencies_hz[name][:4], rtol=1e-6)
