"""Studies with large deflections: the figures of docs/background/gmp_figures.md, and more in test_pipelines."""

import numpy as np
import pytest

from morembs.exporters.exudyn_system import exudyn_missing
from studies import flexible_pendulum as pendulum
from studies import flexible_slider_crank as crank

# The rod bends most at 0.7 s, where the torque ends.
MESH, STEP, END = (6, 12), 2e-3, 0.7


@pytest.mark.parametrize(
    ("E", "members", "modes", "limit", "step"), [(3e6, 1, 3, 0.0075, 2e-3), (1e6, 2, 2, 0.003, 1e-3)]
)
def test_reduced_pendulums_are_as_near_as_stated(E, members, modes, limit, step):
    reference = pendulum.full(E, step=step, elements=8)
    errors = {}
    for formulation in ("foreshortened", "membrane"):
        case = pendulum.Case(E=E, members=members, modes=modes, formulation=formulation)
        run = pendulum.reduced(case, step=step, elements=8)
        assert run.motion.warnings == () and run.drift < 3e-4
        errors[formulation] = pendulum.rms(run.error(reference))
    assert errors["membrane"] < limit
    # The tables are worth something over shapes with foreshortening, which need no nonlinear solves.
    assert errors["membrane"] < 0.6 * errors["foreshortened"]


@pytest.fixture(scope="module")
def bent():
    return crank.full(elements=MESH, step=STEP, end=END)


def test_the_parameterised_slider_crank_follows_and_linear_modes_do_not(bent):
    assert np.abs(bent.deflection).max() > 0.1 * crank.ROD
    errors = {name: crank.reduced(name, elements=MESH, step=STEP, end=END).errors(bent)[0] for name in crank.MODELS}
    assert errors["GMP"] < 0.02
    assert errors["linear, 10 modes"] > 10 * errors["GMP"] and errors["foreshortened"] > 1.5 * errors["GMP"]


@pytest.mark.skipif(bool(exudyn_missing()), reason="Exudyn is not installed")
def test_the_full_model_is_that_of_exudyn():
    ours, theirs = (run(elements=MESH, end=0.4) for run in (crank.full, crank.exudyn))
    deflection, slider = theirs.errors(ours)
    assert deflection < 5e-3 and slider < 1e-3
