"""Parameters from measured frequencies: hidden values, scatter, directions that frequencies do not tell, crossings."""

from __future__ import annotations

import numpy as np
import pytest

from morembs.parametric.model import parametric_model
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.parametric.update import Measured, update
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, some_basis
from tests.support.refusals import refusal

HIDDEN = {"E_arm": 1.8e11, "E_rest": 2.35e11}


@pytest.fixture(scope="module")
def problem():
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters()[:3], longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        yield problem


@pytest.fixture(scope="module")
def model(problem):
    return parametric_model(problem, some_basis(problem, modes=6))


def measured(frequencies, sigma=0.01, modes=None, **shapes):
    frequencies = np.asarray(frequencies, dtype=float)
    modes = np.arange(1, len(frequencies) + 1) if modes is None else np.asarray(modes)
    return Measured(modes=modes, frequencies_hz=frequencies, sigma_hz=sigma * frequencies, **shapes)


def test_hidden_moduli_come_out_of_frequencies_of_the_full_model(problem, model):
    with problem.at(problem.box.point(HIDDEN), assembled=True) as there:
        exact = there.elastic_modes(count=6).frequencies_hz
    result = update(model, measured(exact), fixed=["rho", "t"])
    for name, value in HIDDEN.items():
        assert result.values[name] == pytest.approx(value, rel=5e-3)
    assert result.values["rho"] == 7850.0 and result.values["t"] == 0.0
    assert result.misfit < 0.02 and not result.untold and not result.at_end


def test_estimates_scatter_as_their_covariance_says(model):
    truth = model.box.point({**HIDDEN, "t": 1.0})
    exact, random = model.at(truth).frequencies_hz[:6], np.random.default_rng(17)
    within = np.zeros(len(truth))
    for _ in range(40):
        noisy = exact * (1 + 0.005 * random.standard_normal(len(exact)))
        result = update(model, measured(noisy, 0.005), fixed=["rho"])
        within += np.abs(result.p - truth) <= 2 * result.sigma
    free = [model.box.names.index(name) for name in ("E_arm", "E_rest", "t")]
    # 38 of 40 on average; 33 and less have a probability of one in five hundred, and of 0.99 with half of sigma.
    assert ((within[free] >= 34) & (within[free] <= 40)).all(), within


def test_a_common_factor_of_stiffness_and_mass_is_named(model):
    exact = model.at(model.box.point(HIDDEN)).frequencies_hz[:6]
    result = update(model, measured(exact), fixed=["t"])
    ((names, factors),) = [(set(each), list(each.values())) for each in result.untold]
    assert names == {"E_arm", "E_rest", "rho"}
    truth = model.box.point(HIDDEN)
    # The same part of each of the values, not of the nominal ones.
    parts = np.array([result.untold[0][name] for name in model.box.names[:3]]) * model.box.nominal[:3] / result.p[:3]
    assert parts == pytest.approx(parts[0] * np.ones(3), rel=1e-3) and len(factors) == 3
    assert np.isinf(result.sigma[:3]).all() and result.singular_values[-1] < 1e-6 * result.singular_values[0]
    # Ratios are told: frequencies at the estimate are the measured ones.
    assert result.frequencies_hz == pytest.approx(exact, rel=1e-6)
    assert result.p[0] / result.p[1] == pytest.approx(truth[0] / truth[1], rel=1e-5)
    # What is known of one parameter tells the others.
    known = update(model, measured(exact), fixed=["t"], prior={"rho": 10.0})
    assert not known.untold and np.isfinite(known.sigma).all()
    assert known.values["E_arm"] == pytest.approx(HIDDEN["E_arm"], rel=0.01)


def test_shapes_pair_the_modes_whatever_their_numbers(model):
    truth = model.at(model.box.point(HIDDEN))
    # Motions of the interfaces; signs and sizes of measured shapes mean nothing.
    basis, order = model.B.T, np.array([3, 0, 2, 1])
    shapes = -7.0 * (basis @ truth.Y[:, 6 + order]).T
    wrong = measured(truth.frequencies_hz[order], modes=[1, 2, 3, 4])
    paired = measured(truth.frequencies_hz[order], modes=[1, 2, 3, 4], shapes=shapes, basis=basis)
    result = update(model, paired, fixed=["rho", "t"])
    assert result.p == pytest.approx(truth.p, rel=1e-6)
    assert update(model, wrong, fixed=["rho", "t"]).misfit > 10


def test_an_estimate_at_the_end_of_its_range_is_named(model):
    outside = 0.7 * model.at(model.box.nominal).frequencies_hz[:4]
    assert update(model, measured(outside), fixed=["rho", "t"]).at_end == ("E_arm", "E_rest")


def test_what_cannot_be_used_is_refused(model):
    f = [7000.0, 14000.0]
    with refusal("unknown", "E_rst", "E_rest"):
        update(model, measured(f), fixed=["E_rst"])
    with refusal("value", "fixed"):
        update(model, measured(f), fixed=model.box.names)
    with refusal("value", "prior"):
        update(model, measured(f), prior={"rho": 0.0})
    with refusal("value", "modes", "9000"):
        update(model, measured(f, modes=[1, 9000]))
    for wrong, message in (
        ({"frequencies": [7000.0, -1.0]}, ("value", "frequencies_hz")),
        ({"frequencies": f, "modes": [2, 2]}, ("value", "modes")),
        ({"frequencies": [], "modes": []}, ("value", "modes")),
        ({"frequencies": f, "sigma": 0.0}, ("value", "frequencies_hz")),
        ({"frequencies": f, "shapes": np.ones((2, 3)), "basis": np.ones((4, 5))}, ("value", "shapes")),
    ):
        with refusal(*message):
            measured(**wrong)
