"""Pipelines and studies with large deflections: figures that docs/gmp.md states."""

import functools

import numpy as np
import pytest

from morembs.exporters.exudyn_system import exudyn_missing
from studies import flexible_pendulum as pendulum
from studies import flexible_slider_crank as crank
from studies import two_link_manipulator as arm

MESH, STEP = (6, 12), 2e-3


@functools.cache
def whole_pendulum(E):
    return pendulum.full(E, step=1e-3, elements=8)


@pytest.mark.parametrize(
    ("E", "members", "modes", "limit"), [(3e6, 1, 3, 0.0075), (3e6, 2, 2, 0.0009), (1e6, 2, 2, 0.003)]
)
def test_reduced_pendulums_are_as_near_as_stated(E, members, modes, limit):
    reference = whole_pendulum(E)
    errors = {}
    for formulation in ("foreshortened", "membrane"):
        case = pendulum.Case(E=E, members=members, modes=modes, formulation=formulation)
        run = pendulum.reduced(case, step=1e-3, elements=8)
        assert run.motion.warnings == () and run.drift < 3e-4
        errors[formulation] = pendulum.rms(run.error(reference))
    assert errors["membrane"] < limit
    # The tables are worth something over shapes with foreshortening, which need no nonlinear solves.
    assert errors["membrane"] < 0.6 * errors["foreshortened"]


@pytest.fixture(scope="module")
def bent():
    return crank.full(elements=MESH, step=STEP)


def test_the_parameterised_slider_crank_follows_and_linear_modes_do_not(bent):
    assert np.abs(bent.deflection).max() > 0.1 * crank.ROD
    errors = {name: crank.reduced(name, elements=MESH, step=STEP).errors(bent)[0] for name in crank.MODELS}
    assert errors["GMP"] < 0.02
    assert errors["linear, 10 modes"] > 10 * errors["GMP"] and errors["foreshortened"] > 1.5 * errors["GMP"]


def test_at_a_hundred_times_the_stiffness_all_agree():
    reference = crank.full(100.0, elements=MESH, end=0.25)
    for name in crank.MODELS:
        deflection, slider = crank.reduced(name, 100.0, elements=MESH, end=0.25).errors(reference)
        assert deflection < 5e-3 and slider < 5e-3


@pytest.mark.skipif(bool(exudyn_missing()), reason="Exudyn is not installed")
def test_the_full_model_is_that_of_exudyn():
    ours, theirs = (run(elements=MESH, end=0.4) for run in (crank.full, crank.exudyn))
    deflection, slider = theirs.errors(ours)
    assert deflection < 5e-3 and slider < 1e-3


def test_two_modes_along_the_motion_are_enough_for_the_manipulator():
    reference = arm.full(end=1.0, step=2.5e-3, elements=4)
    paths = {modes: arm.prepare(modes, end=1.0, step=2.5e-3, elements=4) for modes in (1, 2)}
    errors = {modes: arm.reduced(path).error(reference) for modes, path in paths.items()}
    locked = np.sqrt(paths[2].squares[-1, 0]) / (2 * np.pi)
    assert locked == pytest.approx(3.06, rel=5e-3)
    assert arm.residual_frequency(reference) == pytest.approx(locked, rel=1e-2)
    assert arm.residual_frequency(arm.reduced(paths[2])) == pytest.approx(locked, rel=1e-2)
    assert errors[2] < 0.02 and np.abs(reference.deflection).max() > 0.05
