"""Floating frames at values of parameters against those of the models assembled there."""

from dataclasses import fields

import numpy as np
import pytest

from morembs.floating.frame import floating_frame
from morembs.floating.integrals import ShapeIntegrals
from morembs.floating.parametric import frame_terms
from morembs.parametric.model import parametric_model
from morembs.parametric.terms import AffineProblem, varied_model
from morembs.reducers.base import ReducedModel
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, some_basis


@pytest.fixture(scope="module")
def problem():
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        yield problem


def close(given, expected, tolerance):
    given, expected = np.asarray(given), np.asarray(expected)
    return np.abs(given - expected).max(initial=0.0) <= tolerance * np.abs(expected).max(initial=0.0)


@pytest.mark.parametrize(("kind", "followed"), [("mean-axes", ()), ("chord", ("FOOT", "TIP"))])
def test_frames_are_those_of_the_model_assembled_at_the_values(problem, kind, followed):
    V = some_basis(problem, modes=4)
    model, terms = parametric_model(problem, V), frame_terms(problem, V)
    rng, origin = np.random.default_rng(2), (0.01, 0.0, 0.002)
    for p in rng.uniform(model.box.low, model.box.high, (5, len(model.box.low))):
        at = model.at(p)
        frame = terms.frame(at, kind=kind, interfaces=followed, origin=origin)
        with problem.at(p, assembled=True) as there:
            reduced = ReducedModel(
                name="here", M=at.M, K=at.K, D=at.D, B=at.B, C=at.B.T, V=V, mode_kind=("krylov",) * len(at.K),
                rigid_count=6,
            )  # fmt: skip
            expected = floating_frame(there, reduced, kind=kind, interfaces=followed, origin=origin)
        for name in ("origin", "Ke", "De", "rigid"):
            assert close(getattr(frame, name), getattr(expected, name), 1e-8), name
        for entry in fields(ShapeIntegrals):
            given, exact = (getattr(each.integrals, entry.name) for each in (frame, expected))
            scale = 1e-8 if entry.name not in ("Ct", "Cr") else 1e-8 * expected.integrals.mass**0.5
            assert np.abs(np.asarray(given) - exact).max() <= max(scale * np.abs(exact).max(), 1e-9 * scale), entry.name
        for name, marker in expected.markers.items():
            assert close(frame.markers[name].point, marker.point, 1e-12)
            assert close(frame.markers[name].motion, marker.motion, 1e-8)
