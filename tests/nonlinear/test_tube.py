"""Contact of a beam within a curved tube."""

from dataclasses import replace

import numpy as np
import pytest

from morembs.dynamics.nonlinear import BeamInTube, CurvedTube, PlanarBeam, Section
from tests.support.refusals import refusal

SECTION = Section.of(E=2e11, A=2e-7, I=3e-15, density=7850.0)
RADIUS, CLEARANCE = 0.2, 5e-5


def wire(elements=20, penalty=1e6):
    beam = PlanarBeam.straight(0.1, elements, SECTION)
    return BeamInTube(beam, CurvedTube(radius=RADIUS, clearance=CLEARANCE, penalty=penalty, centre=(0.1, -0.05)))


def along(radius, elements=20):
    turn = np.linspace(-0.05, 0.05, elements + 1) / radius
    return np.column_stack((0.1 + radius * np.sin(turn), -0.05 + radius * np.cos(turn), -turn)).ravel()


def test_forces_and_tangent_are_derivatives_of_the_energy():
    part, h = wire(), 1e-7
    x = along(RADIUS) + np.random.default_rng(2).normal(scale=2e-4, size=part.size)
    assert {-1.0, 0.0, 1.0} <= set(np.sign(part.contact(x)))
    ahead, behind = ([x + sign * h * e for e in np.eye(part.size)] for sign in (1, -1))
    force = [(part.energy(a) - part.energy(b)) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
    tangent = [(part.force(a) - part.force(b)) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
    assert part.force(x) == pytest.approx(np.array(force), abs=1e-5 * np.abs(force).max())
    assert part.tangent(x).toarray() == pytest.approx(np.array(tangent), abs=1e-6 * np.abs(tangent).max())


def test_the_middles_of_elements_are_those_of_the_wall():
    # Nodes on a circle: the cubic through them leaves that circle by l^4 / (384 R^3) only.
    part = wire(penalty=1.0)
    depth = part.contact(along(RADIUS + 2 * CLEARANCE))[1:-1:2] / (4 / 6 * 0.1 / 20)
    assert depth == pytest.approx(CLEARANCE, abs=3e-10)


def test_a_wire_of_a_curved_line_lies_on_its_curve():
    """``PlanarBeam.along`` counts rotations from the line without load, ``PlanarBeam`` from x: the walls are one."""
    turn = np.linspace(-0.5, 0.5, 11)
    line = np.column_stack((RADIUS * np.sin(turn), RADIUS * np.cos(turn), -turn))
    tube = CurvedTube(radius=RADIUS, clearance=CLEARANCE, penalty=1e6)
    moved = replace(tube, centre=tuple(-line[0, :2]))
    parts = BeamInTube(PlanarBeam(line, SECTION), tube), BeamInTube(PlanarBeam.along(line, SECTION), moved)
    rng, pushed = np.random.default_rng(3), []
    change = rng.normal(scale=1e-4, size=parts[0].size)
    for part in parts:
        assert np.abs(part.contact(part.reference)).max() == 0
        x = part.reference + change
        pushed.append((part.energy(x), part.contact(x), part.force(x), part.tangent(x).toarray()))
    for one, other in zip(*pushed, strict=True):
        assert np.abs(other).max() > 0 and other == pytest.approx(one, rel=1e-9, abs=1e-9 * np.abs(one).max())


def test_bad_tubes_are_named():
    for change in ({"clearance": 0.3}, {"penalty": 0.0}, {"radius": np.inf}):
        with refusal("value", *change, *change.values()):
            CurvedTube(**{"radius": 0.2, "clearance": 1e-3, "penalty": 1.0, **change})
