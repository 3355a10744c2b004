"""The heavy top on R^3 x SO(3), index 3, against an ODE on SO(3) of high accuracy."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from morembs.base.errors import SolverError
from morembs.dynamics.multibody import RigidBody, SphericalJoint, System, ground, simulate
from tests.support.refusals import refusal

MASS, INERTIA = 15.0, np.array([0.234375, 0.46875, 0.234375])
CENTER, SPIN, GRAVITY = np.array([0.0, 1.0, 0.0]), np.array([0.0, 150.0, -4.61538]), np.array([0.0, 0.0, -9.81])
# step: error of the position, of multipliers from the plain start, of multipliers from the corrected start.
TABLE = {2e-3: (2.20e-2, 252.0, 27.7), 1e-3: (5.43e-3, 115.0, 6.85)}


@lru_cache
def reference():
    """Functions of time: position of the centre and force of the joint; R by rows and angular velocity as states."""
    about_tip = np.diag(INERTIA) + MASS * np.diag([1.0, 0.0, 1.0])

    def turning(y):
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.linalg.solve(about_tip, MASS * np.cross(CENTER, GRAVITY @ R) - np.cross(w, about_tip @ w))

    def rate(t, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.concatenate((np.cross(R, w).ravel(), turning(y)))

    start = np.concatenate((np.eye(3).ravel(), SPIN))
    path = solve_ivp(rate, (0, 1), start, method="DOP853", rtol=1e-13, atol=1e-12, dense_output=True).sol

    def position(t):
        return path(t)[:9].reshape(3, 3) @ CENTER

    def force(t):
        y = path(t)
        R, w = y[:9].reshape(3, 3), y[9:]
        return MASS * (R @ (np.cross(turning(y), CENTER) + np.cross(w, np.cross(w, CENTER))) - GRAVITY)

    return position, force


@lru_cache
def errors(step, corrected):
    """Largest errors of position and joint force over all times, and over times after 0.1 s."""
    system = System(gravity=GRAVITY)
    top = system.add(
        RigidBody(
            MASS,
            INERTIA,
            position=CENTER,
            velocity=np.cross(SPIN, CENTER),
            angular_velocity=SPIN,
            markers={"center": (0, 0, 0), "tip": -CENTER},
        )
    )
    joint = system.add(SphericalJoint(ground.marker_at(), top.marker("tip")))
    result = simulate(system, end=1.0, step=step, rho=0.9, corrected_start=corrected)
    position, force = reference()
    far = np.abs(result.position(top.marker("center")) - [position(t) for t in result.time]).max()
    off = np.abs(result.reaction(joint)[:, :3] - [force(t) for t in result.time]).max(axis=1)
    return far, off.max(), off[result.time > 0.1].max()


def test_reference():
    position, _ = reference()
    assert position(1.0) == pytest.approx([0.17334396, 0.64008859, -0.74849079], abs=1e-8)


@pytest.mark.parametrize("step", TABLE)
def test_errors_are_those_of_the_published_scheme(step):
    of_position, plain, corrected = TABLE[step]
    assert errors(step, True)[0] == pytest.approx(of_position, rel=0.02)
    assert errors(step, True)[1] == pytest.approx(corrected, rel=0.02)
    assert errors(step, False)[0] == pytest.approx(of_position, rel=0.02)
    assert errors(step, False)[1] == pytest.approx(plain, rel=0.02)


def test_second_order_from_the_corrected_start():
    (x1, f1, late1), (x2, f2, late2) = (errors(step, True) for step in (2e-3, 1e-3))
    assert np.log2(x1 / x2) == pytest.approx(2.0, abs=0.1)
    assert np.log2(f1 / f2) == pytest.approx(2.0, abs=0.1)
    assert np.log2(late1 / late2) == pytest.approx(2.0, abs=0.1)


def test_the_plain_start_costs_one_order_of_multipliers():
    (x1, f1, late1), (x2, f2, late2) = (errors(step, False) for step in (1e-3, 5e-4))
    assert np.log2(x1 / x2) == pytest.approx(2.0, abs=0.1)
    assert np.log2(f1 / f2) == pytest.approx(1.0, abs=0.15)
    assert np.log2(late1 / late2) == pytest.approx(2.0, abs=0.1)


def test_a_step_that_does_not_converge_says_when():
    with refusal("result", "", "0.02", by=SolverError):
        errors(2e-2, True)
