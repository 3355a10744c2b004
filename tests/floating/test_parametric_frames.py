"""Floating frames at values of parameters against those of the models assembled there."""

from dataclasses import fields

import numpy as np
import pytest

from morembs.body.floating.frame import floating_frame
from morembs.body.floating.integrals import ShapeIntegrals, shape_integrals
from morembs.body.floating.parametric import frame_terms
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


@pytest.fixture(scope="module")
def V(problem):
    return some_basis(problem, modes=4)


@pytest.mark.parametrize(("kind", "followed"), [("mean-axes", ()), ("chord", ("FOOT", "TIP"))])
def test_frames_are_those_of_the_model_assembled_at_the_values(problem, V, kind, followed):
    model, terms = parametric_model(problem, V), frame_terms(problem, V)
    rng, origin = np.random.default_rng(2), (0.01, 0.0, 0.002)
    for p in rng.uniform(model.box.low, model.box.high, (2, len(model.box.low))):
        at = model.at(p)
        frame = terms.frame(at, kind=kind, interfaces=followed, origin=origin)
        with problem.at(p, assembled=True) as there:
            reduced = ReducedModel(
                name="here",
                M=at.M,
                K=at.K,
                D=at.D,
                B=at.B,
                C=at.B.T,
                V=V,
                mode_kind=("krylov",) * len(at.K),
                rigid_count=6,
            )
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


def test_derivatives_of_frames_are_those_of_the_models_assembled_nearby(problem):
    """The shapes of the body stay: their integrals over the assembled mass, and what moves with the interfaces."""
    V = some_basis(problem, modes=2, corners=0)
    model, terms = parametric_model(problem, V), frame_terms(problem, V)
    options = {"kind": "chord", "interfaces": ("FOOT", "TIP"), "origin": (0.01, 0.0, 0.002)}
    p = model.box.point({"E_arm": 1.9e11, "rho": 8000.0, "alpha": 30.0, "t": 1.1})
    here, names = model.at(p), [entry.name for entry in fields(ShapeIntegrals)]
    slopes = terms.derivatives(here, **options)
    for j, name in enumerate(model.box.names):
        step, found = 1e-3 * (model.box.high[j] - model.box.low[j]), []
        for k in (-2, -1, 1, 2):
            value = p + k * step * np.eye(len(p))[j]
            frame = terms.frame(model.at(value), shapes=here.Y[:, 6:], **options)
            with problem.at(value, assembled=True) as there:
                shapes = there.coupling.T @ (V @ frame.elastic)
                parts, _ = shape_integrals(there.model, shapes, np.array(options["origin"]))
                K = V.T @ (there.K @ V)
            mine = [getattr(parts, each) for each in names] + [frame.elastic.T @ K @ frame.elastic]
            found.append([*mine, frame.markers["TIP"].motion, frame.rigid, frame.De])
        known = [getattr(slopes[name].integrals, each) for each in names] + [slopes[name].Ke]
        known += [slopes[name].markers["TIP"].motion, slopes[name].rigid, slopes[name].De]
        for what, given, *values in zip([*names, "Ke", "TIP", "rigid", "De"], known, *found, strict=True):
            a, b, c, d = (np.asarray(value) for value in values)
            exact = (8 * (c - b) - (d - a)) / (12 * step)
            noise = 1e-10 * np.abs(a).max() / step
            # Volumes of a morph are interpolated in the stiffness.
            tolerance = problem.eps if what == "Ke" else 1e-6
            assert np.abs(given - exact).max() <= tolerance * np.abs(exact).max() + noise, (name, what)
