"""Chains of slender links in deformation coordinates, and joints that start with an acceleration."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from morembs.dynamics.nonlinear import Chain, Link, Mechanism, Section, simulate
from tests.support.refusals import refusal

SECTION = Section.of(E=7.3e10, A=4e-4, I=3.33e-9, density=2700.0)
LINKS = (Link(length=0.5, section=SECTION, tip=1.0), Link(length=0.7, section=SECTION, elements=2, tip=0.3))


def swing(t):
    return 0.6 * t * t * (3 - 2 * t)


def test_the_jacobian_is_the_derivative_of_the_motion():
    chain, h = Chain(LINKS), 1e-5
    q = np.random.default_rng(3).normal(scale=0.3, size=chain.size)
    differences = np.array([(chain.at(q + h * e).x - chain.at(q - h * e).x) / (2 * h) for e in np.eye(chain.size)]).T
    assert np.abs(chain.at(q).J - differences).max() < 1e-9


def test_a_clamped_link_has_the_frequencies_of_a_beam():
    link = [Link(length=0.7, section=SECTION, elements=12)]
    squares, V = Chain(link).modes([0.4])
    exact = np.array([1.875104, 4.694091, 7.854757]) ** 4 * SECTION.EI / SECTION.mass / 0.7**4
    assert squares[:3] == pytest.approx(exact, rel=1e-3)
    # Modes are those of the chain that is made with them.
    assert Chain(link, V[:, :2]).modes([0.4])[0] == pytest.approx(squares[:2], rel=1e-10)


def by_a_general_integrator(chain, times):
    """Tip (2, T) for the joints swing(t), -swing(t), from Lagrange's equations; (dJ/dt) q' by differences."""
    count, free = chain.size - 2, slice(2, None)

    def rates(t, y):
        turn, speed, rate = swing(t), 3.6 * t * (1 - t), 3.6 * (1 - 2 * t)
        q, v = np.array([turn, -turn, *y[:count]]), np.array([speed, -speed, *y[count:]])
        state, d = chain.at(q), 1e-5
        bending = (chain.at(q + d * v).J - chain.at(q - d * v).J) @ v / (2 * d)
        J = state.J[:, free]
        known = bending + state.J[:, :2] @ [rate, -rate]
        return np.concatenate(
            (y[count:], np.linalg.solve(J.T @ (chain.M @ J), -J.T @ (chain.M @ known) - state.force[free]))
        )

    path = solve_ivp(rates, (0, times[-1]), np.zeros(2 * count), method="DOP853", rtol=1e-9, atol=1e-12, t_eval=times)
    states = [chain.at(np.array([swing(t), -swing(t), *y[:count]])) for t, y in zip(times, path.y.T, strict=True)]
    return np.array([chain.nodes(state.x)[-1] for state in states]).T


def turned(step, end):
    _, V = Chain(LINKS).modes([0, 0])
    chain, mechanism = Chain(LINKS, V[:, :2]), Mechanism()
    mechanism.chain(chain, [mechanism.drive(0.0, f) for f in (swing, lambda t: -swing(t))])
    return chain, simulate(mechanism, end=end, step=step, rho=0.9)


def test_places_are_of_second_order_in_the_step():
    errors = []
    for step in (2e-3, 1e-3):
        chain, motion = turned(step, 0.2)
        errors.append(np.abs(chain.nodes(motion.x[0])[-1] - by_a_general_integrator(chain, motion.times)).max())
    assert errors[1] < 2e-5 and errors[0] / errors[1] == pytest.approx(4, abs=0.5)


def test_velocities_are_too_where_a_motion_starts_with_an_acceleration():
    third, second, first = (turned(step, 6e-3)[1].kinetic[-1] for step in (5e-4, 1e-3, 2e-3))
    assert (first - second) / (second - third) == pytest.approx(4, abs=0.2)


def test_links_on_free_joints_fall_and_keep_their_energy():
    chain, mechanism = Chain(LINKS), Mechanism(gravity=(0, -9.81))
    mechanism.chain(chain, [mechanism.angle(0.0), mechanism.angle(0.4)])
    motion = simulate(mechanism, end=0.3, step=1e-3, rho=1.0)
    total = motion.kinetic + motion.potential
    assert motion.kinetic.max() > 5 and np.ptp(total) < 1e-4 * motion.kinetic.max()
    # All of it by hand: the masses of beams act at the middles of elements, those of the tips at the tips.
    nodes = chain.nodes(motion.x[0][:, -1])[:, 1]
    mass = SECTION.mass * np.repeat([0.5 / 3, 0.7 / 2], (3, 2))
    fallen = 9.81 * (mass @ (nodes[1:] + nodes[:-1]) / 2 + 1.0 * nodes[3] + 0.3 * nodes[5])
    assert motion.potential[-1] == pytest.approx(fallen, rel=2e-3)


def test_the_example_of_the_documentation():
    text = (Path(__file__).parents[2] / "docs" / "howto" / "chains.md").read_text()
    (code,) = re.findall(r"```python chain\n(.*?)```", text, re.DOTALL)
    reduced, full = {}, {}
    exec(code, reduced)
    exec(code.replace("Chain(links, V)", "Chain(links)"), full)
    assert np.abs(reduced["tip"] - full["tip"]).max() < 1e-5
    # The link has turned by 4 t2 (0.75 - t) = 0.088 rad, and lags behind by its bending.
    assert 0.01 < reduced["tip"][1, -1] - 0.7 * np.sin(0.5) < 0.7 * (np.sin(0.588) - np.sin(0.5))


def test_bad_chains_are_named():
    with refusal("missing", "links"):
        Chain([])
    with refusal("value", "modes", "10"):
        Chain(LINKS, np.ones((3, 1)))
    with refusal("value", "modes"):
        Chain(LINKS, np.ones((10, 2)))
    for count, words in ((0, ("value", "elements")), (2.5, ("value", "elements", "2.5"))):
        with refusal(*words):
            Link(length=1.0, section=SECTION, elements=count)
    with refusal("value", "angles"):
        Chain(LINKS).modes([0.0])
    mechanism = Mechanism()
    with refusal("value", "joints"):
        mechanism.chain(Chain(LINKS), [mechanism.angle(0.0)])
    angle = mechanism.angle(0.0)
    for other in (angle, mechanism.drive(0.0, swing, seen_from=angle)):
        with refusal("conflict", "joints"):
            mechanism.chain(Chain(LINKS), [angle, other])
