"""Exact beams as bodies of the simulator: against statics, planar beams, and what free motion conserves."""

import numpy as np
import pytest

from morembs.dynamics.multibody import RevoluteJoint, System, ground, rotation, simulate
from morembs.dynamics.nonlinear import (
    BeamBody,
    FullMember,
    Mechanism,
    PlanarBeam,
    Section,
    SpatialBeam,
    SpatialSection,
    follow_equilibrium,
)
from morembs.dynamics.nonlinear import simulate as simulate_planar
from tests.support.refusals import refusal

SOFT = SpatialSection(EA=30.0, GA2=10.0, GA3=15.0, GJ=0.03, EI2=0.02, EI3=0.04, mass=1.3, rotary=(0.03, 0.01, 0.02))


def configuration(beam, x):
    """Positions and sections of a beam for its coordinates."""
    body = BeamBody(beam)
    start, step = body.start()[0], x - beam.reference
    # Rotation vectors are along the fixed axes, spins of the body along those of its sections.
    by = step.reshape(-1, 6).copy()
    by[:, 3:] = np.einsum("nij,ni->nj", beam.sections, by[:, 3:])
    return body, body.move(start, by.ravel())


def test_a_beam_in_static_equilibrium_has_no_force_but_its_load():
    bend = SpatialSection(
        EA=1e7, GA2=0.5e7, GA3=0.5e7, GJ=1e7 / 12, EI2=1e7 / 12, EI3=1e7 / 12, mass=1.0, rotary=(1 / 6, 1 / 12, 1 / 12)
    )
    beam = SpatialBeam.arc(100.0, np.pi / 4, 6, bend)
    load = np.zeros(beam.size)
    load[-4] = 600.0
    static = follow_equilibrium(beam, held=np.arange(6), load=load, steps=4)
    body, x = configuration(beam, static.x)
    force = body.dynamics(0.0, x, np.zeros(body.size), np.zeros(3))[1].reshape(-1, 6)
    assert force[-1, :3] == pytest.approx([0, 0, 600], abs=1e-4)
    assert np.abs(force[1:-1]).max() < 1e-4 and np.abs(force[-1, 3:]).max() < 1e-3
    # About 47.2, 15.8, 53.4 (Bathe and Bolourchi 1979).
    assert body.nodes(x)[-1] == pytest.approx([47.2, 15.8, 53.4], abs=0.3)


def test_a_thrown_beam_keeps_energy_and_momenta():
    body = BeamBody(SpatialBeam.arc(1.0, 1.2, 3, SOFT), velocity=(0.3, 0, 0.1), angular_velocity=(1.0, -2.0, 1.5))
    system = System()
    system.add(body)
    result = simulate(system, end=0.5, step=5e-3, rho=1.0)

    def momenta(x, v):
        M = body.dynamics(0.0, x, v, np.zeros(3))[0]
        p = (M @ v).reshape(-1, 6)
        R = x.reshape(-1, 12)[:, 3:].reshape(-1, 3, 3)
        turning = np.einsum("nij,nj->ni", R, p[:, 3:])
        return np.concatenate((p[:, :3].sum(axis=0), (np.cross(body.nodes(x), p[:, :3]) + turning).sum(axis=0)))

    (run,) = result.segments
    first, last = (momenta(run.x[k], run.v[k]) for k in (0, -1))
    total = result.energy().total
    assert np.abs(last[:3] - first[:3]).max() < 1e-9
    assert np.abs(last[3:] - first[3:]).max() < 2e-4 * np.abs(first[3:]).max()
    assert np.ptp(total) < 1e-3 * total[0] and np.ptp(result.energy().potential) > 0.02 * total[0]


def test_a_strip_falls_as_the_planar_beam_does():
    E, A, I, density = 1e8, 1.2e-4, 0.02 * 0.006**3 / 12, 1100.0  # noqa: E741
    flat = SpatialSection.rectangle(0.02, 0.006, E=E, nu=0.3, density=density, shear=6 / 7)
    body = BeamBody(SpatialBeam.straight(0.5, 3, flat))
    system = System(gravity=(0, 0, -9.81))
    system.add(body)
    system.add(RevoluteJoint(ground.marker_at(), body.marker("start"), axis=(0, 1, 0)))
    path = simulate(system, end=0.25, step=5e-3).position(body.marker_at(3))
    member = FullMember(PlanarBeam.straight(0.5, 3, Section.of(E=E, A=A, I=I, density=density)))
    mechanism = Mechanism(gravity=(0, -9.81))
    mechanism.add(member, mechanism.point((0, 0), fixed="xy"), mechanism.point((0.5, 0)))
    planar = member.nodes(simulate_planar(mechanism, end=0.25, step=5e-3).x[0])[-3:-1].T
    assert planar[-1, 1] < -0.2
    assert np.abs(path[:, [0, 2]] - planar).max() < 1e-3 * 0.5 and np.abs(path[:, 1]).max() < 1e-9


def test_damping_takes_what_its_power_says_and_nothing_of_rigid_motion():
    rng = np.random.default_rng(3)
    body = BeamBody(SpatialBeam.arc(1.0, 1.2, 3, SOFT), damping=0.02, rotation=rotation((1, 1, 0), 0.7))
    x = body.move(body.start()[0], 0.3 * rng.standard_normal(body.size))
    v, h, still = rng.standard_normal(body.size), 1e-6, np.zeros(3)
    strain = [body.energy(body.move(x, s * h * v), 0 * v, still)[1] for s in (1, -1)]
    inner = body.dynamics(0.0, x, v, still)[1] @ v
    assert body.power(x, v) < 0
    assert inner == pytest.approx((strain[0] - strain[1]) / (2 * h) - body.power(x, v), rel=1e-6)
    thrown = BeamBody(body.beam, damping=0.02, angular_velocity=(1, 2, 3), velocity=(1, 0, 0))
    assert thrown.power(*thrown.start()) == pytest.approx(0, abs=1e-20)


@pytest.mark.parametrize("elements", [1, 5])
def test_slopes_are_derivatives_of_the_forces(elements):
    rng = np.random.default_rng(4)
    body = BeamBody(SpatialBeam.arc(1.0, 1.2, elements, SOFT), damping=0.02)
    x = body.move(body.start()[0], 0.3 * rng.standard_normal(body.size))
    v, d = rng.standard_normal((2, body.size))

    def force(a, b):
        return body.dynamics(0.0, body.move(x, a * d), v + b * d, np.zeros(3))[1]

    for slope, (a, b) in zip(body.slopes(0.0, x, v), ((1e-5, 0), (0, 1e-5)), strict=True):
        exact = (force(a, b) - force(-a, -b)) / 2e-5
        assert np.abs(slope @ d - exact).max() < 1e-4 * np.abs(exact).max()


def test_bad_input_is_named():
    beam = SpatialBeam.straight(1.0, 2, SOFT)
    with refusal("value", "damping", "-1"):
        BeamBody(beam, damping=-1)
    bare = SpatialSection(EA=1, GA2=1, GA3=1, GJ=1, EI2=1, EI3=1, mass=1)
    with refusal("model", "rotary"):
        BeamBody(SpatialBeam.straight(1.0, 2, bare))
    with refusal("unknown", "", "tip"):
        BeamBody(beam).marker("tip")
    with refusal("value", "node"):
        BeamBody(beam).marker_at(3)
