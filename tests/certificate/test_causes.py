"""Why a limit is infinite or far above what is reached: notes name the true cause."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.certificate.certify import certify
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import FreeInterface
from tests.support.meshes import box, steel, where

BAND = [0.0, 3000.0]


def beam(damping, components):
    model = steel(box("hex20", (6, 1, 1), (0.5, 0.05, 0.03)))
    end = make_interface(model, name="left", nodes=where(model, 0, 0.0), coupling="average", components=components)
    return Problem(model, [end], damping=damping)


def in_bad_coordinates(body, condition=1e5):
    """``body`` in elastic coordinates of which some are nearly parallel."""
    r, n = body.rigid_count, len(body.K)
    Q = np.linalg.qr(np.random.default_rng(1).standard_normal((n - r, n - r)))[0]
    T = np.eye(n)
    T[r:, r:] = Q @ np.diag(np.geomspace(1.0, condition, n - r)) @ Q.T
    M, D, K = (T.T @ A @ T for A in (body.M, body.D, body.K))
    return replace(body, M=M, D=D, K=K, B=T.T @ body.B, C=body.C @ T, V=body.V @ T)


def test_zeros_of_the_response_are_named():
    """By 1e9 of the envelope, where round-off of 1e-11 is large beside |H| and nothing beside the envelope."""
    with beam(Damping(alpha=1e-6), [1]) as problem:
        body = FreeInterface(modes=30).reduce(problem)
        (certificate,) = certify(problem, [replace(body, K=body.K * (1 + 1e-9))], [0.0, 9000.0])
    assert certificate.limits["pointwise"].upper > 1000 * certificate.limits["envelope"].upper
    assert certificate.limits["envelope"].upper < 1.05 * certificate.limits["envelope"].lower
    (note,) = certificate.notes
    assert note.startswith("pointwise: limited as H has a zero near 1,998") and 'measure = "envelope"' in note


def test_round_off_beyond_the_damping_is_named_with_its_frequency():
    with beam(Damping(structural=1e-11), [0]) as problem:
        first = float(problem.elastic_modes(count=1).frequencies_hz[0])
        (certificate,) = certify(problem, [FreeInterface(modes=20).reduce(problem)], BAND)
    assert certificate.limit.upper == np.inf
    (note,) = certificate.notes
    assert f"round-off of the full model exceeds the damping of a pole at {first:,.6g} Hz" in note
    assert "damping_floor" in note


def test_round_off_of_a_body_is_not_blamed_on_the_full_model():
    with beam(Damping(structural=1e-2), None) as problem:
        body = FreeInterface(modes=12).reduce(problem)
        sound, bad = certify(problem, [body, in_bad_coordinates(body)], BAND)
    assert not sound.notes and bad.limit.upper > 2 * bad.limit.lower
    assert all("round-off of the body" in note and "full model" not in note for note in bad.notes) and bad.notes


@pytest.mark.parametrize(("own", "whose"), [(0.0, "the full model and of the body"), (1e-3, "the body")])
def test_undamped_poles_are_named_by_their_model(own, whose):
    with beam(Damping(structural=own), None) as problem:
        body = replace(FreeInterface(modes=12).reduce(problem), structural=0.0)
        (certificate,) = certify(problem, [body], BAND, damping_floor=0.0)
    assert any(f"a pole of {whose}, where" in note for note in certificate.notes)
