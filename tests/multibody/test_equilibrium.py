"""Static equilibria, their reactions, stability and small motion, against closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import morembs
from morembs.body.floating.frame import FloatingFrame
from morembs.dynamics.multibody import (
    DrivenAngle,
    FlexibleBody,
    Linearization,
    Motion,
    PointLoad,
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SphericalJoint,
    SpringDamper,
    System,
    TorsionSpring,
    equilibrium,
    ground,
    linearize,
    rotation,
    simulate,
)
from tests.support.refusals import refusal

G = 9.81
MESHES = Path(__file__).parents[2] / "data" / "small_meshes"


def pendulum(upwards: bool = False, joint: str = "revolute") -> tuple[System, RigidBody]:
    """A rod of 2 kg and 1 m, hanging or standing on its hinge."""
    system, side = System(gravity=(0, 0, -G)), 0.5 if upwards else -0.5
    markers = {"end": (0, 0, -side), "tip": (0, 0, side)}
    rod = system.add(RigidBody(2.0, (1 / 6, 1 / 6, 1e-3), position=(0, 0, side), markers=markers, name="rod"))
    ends = ground.marker_at(), rod.marker("end")
    system.add(SphericalJoint(*ends) if joint == "spherical" else RevoluteJoint(*ends, axis=(0, 1, 0)))
    return system, rod


def angle(system: System, rod: RigidBody, **options: object) -> float:
    R = equilibrium(system, **options).result.axes(rod.marker("tip"))[0]
    return math.atan2(-R[0, 2], R[2, 2])


def test_a_pendulum_pushed_sideways_takes_the_angle_of_its_loads() -> None:
    system, rod = pendulum()
    system.add(PointLoad(rod.marker("tip"), force=(20.0, 0, 0)))
    # 20 N at the tip against 2 kg at half the length.
    assert angle(system, rod) == pytest.approx(math.atan2(20, G), rel=1e-12)
    assert angle(system, rod, load_steps=4) == pytest.approx(math.atan2(20, G), rel=1e-12)


def test_stability_and_frequency_of_hanging_and_standing_rods() -> None:
    hanging, standing = equilibrium(pendulum()[0]), equilibrium(pendulum(upwards=True)[0])
    assert hanging.stable and not standing.stable
    assert hanging.linear.squares == pytest.approx([1.5 * G], rel=1e-9)
    assert standing.linear.squares == pytest.approx([-1.5 * G], rel=1e-9)
    assert standing.linear.growth == pytest.approx(math.sqrt(1.5 * G), rel=1e-9)
    assert "grows by 3.836 /s" in " ".join(repr(standing).split())


def test_a_motion_without_stiffness_stays_unless_a_load_acts_along_it() -> None:
    system, rod = pendulum(joint="spherical")
    still = equilibrium(system)
    assert still.mobilities == 1 and still.stable  # it turns about its axis
    assert still.linear.squares[1:] == pytest.approx([1.5 * G] * 2, rel=1e-9)
    system.add(PointLoad(rod.marker("tip"), moment=(0, 0, 1e-3)))
    with refusal("model", "load", "rod"):
        equilibrium(system)


def test_two_rods_in_a_row_have_the_frequencies_of_a_double_pendulum() -> None:
    system, first = pendulum()
    second = system.add(RigidBody(2.0, (1 / 6, 1 / 6, 1e-3), position=(0, 0, -1.5), markers={"end": (0, 0, 0.5)}))
    system.add(RevoluteJoint(first.marker("tip"), second.marker("end"), axis=(0, 1, 0)))
    # M = m l^2 [[4/3, 1/2], [1/2, 1/3]], K = m g l diag(3/2, 1/2).
    expected = np.linalg.eigvals(np.linalg.solve([[4 / 3, 0.5], [0.5, 1 / 3]], np.diag([1.5, 0.5]) * G))
    assert equilibrium(system).linear.squares == pytest.approx(np.sort(expected), rel=1e-8)


@pytest.fixture(scope="module")
def links() -> dict[str, FloatingFrame]:
    """A stiff and a soft link of 0.5 m with two modes."""
    mesh, frames = morembs.read_mesh(MESHES / "beam.msh"), {}
    for name, young in (("stiff", 2e9), ("soft", 2e8)):
        model = morembs.assemble(mesh, [morembs.isotropic(set="all", young=young, poisson=0.3, density=1200.0)])
        ends = [morembs.make_interface(model, name=end, nodes=mesh.nodes.sets[end]) for end in ("ROOT", "TIP")]
        with morembs.Problem(model, ends) as problem:
            reduced = morembs.CraigBampton(modes=2).reduce(problem)
            frame = morembs.elastic_body(problem, reduced, morembs.make_part(problem)).floating
            assert frame is not None
            frames[name] = frame
    return frames


# Three springs under a rigid bar that is loaded above the first, one of them a tenth as stiff.
SHARES = {
    2: (933.33333333, 133.33333333, -66.66666667),
    1: (976.19047619, 47.61904762, -23.80952381),
    0: (333.33333333, 1333.33333333, -666.66666667),
}


@pytest.mark.parametrize("which", SHARES)
def test_redundant_elastic_links_share_a_load_by_their_stiffness(which: int, links: dict[str, FloatingFrame]) -> None:
    """The parallelogram of Wojtyra (EUROMECH 524): three vertical links under a rigid coupler."""
    system, up, places = System(), rotation((0, 1, 0), -math.pi / 2), (0.0, 0.5, 1.0)
    markers = {f"joint {i}": (x - 0.5, 0, 0) for i, x in enumerate(places)}
    coupler = system.add(RigidBody(2.0, (0.01, 0.2, 0.2), position=(0.5, 0, 0.5), markers=markers, name="coupler"))
    joints = []
    for i, x in enumerate(places):
        frame = links["soft" if i == which else "stiff"]
        foot = np.array([x, 0, 0])
        link = system.add(
            FlexibleBody(frame, name=f"link {i}", rotation=up, position=foot - up @ frame.markers["ROOT"].point)
        )
        joints.append(system.add(RevoluteJoint(ground.marker_at(foot), link.marker("ROOT"), axis=(0, 1, 0))))
        system.add(RevoluteJoint(link.marker("TIP"), coupler.marker(f"joint {i}"), axis=(0, 1, 0)))
    system.add(PointLoad(coupler.marker("joint 0"), force=(0, 0, -1000.0)))
    still = equilibrium(system)
    assert [still.result.reaction(joint)[0, 2] for joint in joints] == pytest.approx(SHARES[which], abs=1e-4)
    # It stands on hinges: with rigid links the square is -P l / (m l^2 + 3 m_link l^2 / 3).
    assert not still.stable and still.linear.squares[0] == pytest.approx(-1000 * 0.5 / (2.9 * 0.25), rel=5e-3)


def mass_on_spring(damping: float) -> System:
    system = System(gravity=(0, 0, -G))
    mass = system.add(RigidBody(2.0, (1, 1, 1), position=(0, 0, -1.0), name="mass"))
    system.add(PrismaticJoint(ground.marker_at(), mass.marker_at((0, 0, 0)), axis=(0, 0, 1)))
    spring = SpringDamper(ground.marker_at(), mass.marker_at((0, 0, 0), name="hook"), stiffness=800.0, damping=damping)
    system.add(spring)
    return system


def test_eigenvalues_with_damping_are_those_of_an_oscillator() -> None:
    linear = equilibrium(mass_on_spring(damping=4.0)).linear
    # 2 z'' + 4 z' + 800 z = 0
    assert linear.eigenvalues == pytest.approx([-1 - 1j * math.sqrt(399), -1 + 1j * math.sqrt(399)], rel=1e-8)
    assert linear.growth == 0


def test_a_run_that_starts_at_an_equilibrium_stays_there() -> None:
    system = mass_on_spring(damping=0.0)
    hook = system.component("mass").marker("hook")
    still = equilibrium(system)
    assert still.result.position(hook)[0, 2] == pytest.approx(-1 - 2 * G / 800, rel=1e-12)
    run = simulate(system, end=0.1, step=1e-3, start=still.state)
    assert run.position(hook)[:, 2] == pytest.approx(np.full(101, -1 - 2 * G / 800), rel=1e-10)
    again = equilibrium(system, guess=still)
    assert again.iterations == 0
    with refusal("conflict", "state"):
        equilibrium(pendulum()[0], guess=still)
    with refusal("value", "state"):
        linearize(simulate_moving(system))


def simulate_moving(system: System) -> object:
    from dataclasses import replace

    still = equilibrium(system).state
    return replace(still, v=np.ones_like(still.v))


@pytest.mark.parametrize(("load", "stable"), [(0.98, True), (1.02, False)])
def test_a_load_that_follows_makes_zieglers_column_flutter(load: float, stable: bool) -> None:
    """Two rods without mass, 2 m and m at their tips, springs c: flutter at P l / c = 7/2 - sqrt(2) (Ziegler 1952)."""
    length, m, c = 1.0, 1.0, 10.0
    system, base, at = System(), ground.marker_at(), 0.0
    for number, mass in enumerate((2 * m, m)):
        ends = {"foot": (0, 0, -length), "tip": (0, 0, 0)}
        rod = system.add(RigidBody(mass, (1e-9,) * 3, position=(0, 0, at + length), markers=ends, name=f"rod {number}"))
        system.add(RevoluteJoint(base, rod.marker("foot"), axis=(0, 1, 0)))
        system.add(TorsionSpring(base, rod.marker("foot"), axis=(0, 1, 0), stiffness=c))
        base, at = rod.marker("tip"), at + length
    push = load * (3.5 - math.sqrt(2)) * c / length
    system.add(PointLoad(base, force=(0, 0, -push), follows=True))
    still = equilibrium(system)
    assert still.stable is stable
    # The divergence of a load that keeps its direction comes far earlier.
    assert (np.abs(still.linear.eigenvalues.imag) > 0.1).all()


def test_state_space_has_the_gain_of_a_small_load(links: dict[str, FloatingFrame]) -> None:
    system = System(gravity=(0, 0, -G))
    frame = links["soft"]
    link = system.add(FlexibleBody(frame, position=-frame.markers["ROOT"].point, name="link"))
    system.add(RevoluteJoint(ground.marker_at(), link.marker("ROOT"), axis=(0, 1, 0)))
    tip = link.marker("TIP")
    system.add(TorsionSpring(ground.marker_at(), link.marker("ROOT"), axis=(0, 1, 0), stiffness=500.0))
    before = equilibrium(system)
    linear: Linearization = before.linear
    space = linear.state_space({"tip": tip}, {"tip": (tip, "displacement"), "speed": (tip, "velocity")})
    gain = space.dc_gain()
    assert gain is not None
    at = space.names["outputs"].index("tip:displacement:z"), space.names["inputs"].index("tip:force:z")
    assert space.units["outputs"][at[0]] == "m" and space.units["inputs"][at[1]] == "N"
    system.add(PointLoad(tip, force=(0, 0, 1e-3)))
    moved = equilibrium(system).result.position(tip)[0] - before.result.position(tip)[0]
    assert gain[at] == pytest.approx(moved[2] / 1e-3, rel=1e-5)
    assert np.abs(gain[6:]).max() < 1e-9 * np.abs(gain[:6]).max()
    assert np.abs(np.sort(space.poles().imag)[-1]) == pytest.approx(2 * math.pi * linear.frequencies_hz[-1], rel=1e-3)
    with refusal("unknown", "outputs", "jerk"):
        linear.state_space({}, {"tip": (tip, "jerk")})


def test_options_are_checked() -> None:
    with refusal("value", "tolerance", "1.0", "0.01"):
        equilibrium(pendulum()[0], tolerance=1.0, load_steps=0)


def test_what_is_added_later_is_not_part_of_what_was_done_before() -> None:
    system, rod = pendulum()
    before = equilibrium(system)
    system.add(PointLoad(rod.marker("tip"), force=(0, 0, -5.0)))
    assert np.abs(before.result.load(rod.marker("tip"))).max() == 0
    assert equilibrium(system).result.load(rod.marker("tip"))[0, 2] == pytest.approx(-5.0, rel=1e-12)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (5.0, -3.0, 100.0)])
@pytest.mark.parametrize("turn", [0.0, 0.3, 1.4])
def test_a_rod_that_is_let_go_hangs_wherever_the_origin_is(origin: tuple[float, ...], turn: float) -> None:
    system, R = System(gravity=(0, 0, -G)), rotation((0, 1, 0), turn - math.pi / 2)
    hinge, arm = np.array(origin), np.array([0, 0, 0.5])
    rod = system.add(
        RigidBody(2.0, (1 / 6, 1 / 6, 1e-3), position=hinge - R @ arm, rotation=R, markers={"end": arm}, name="rod")
    )
    joint = system.add(RevoluteJoint(ground.marker_at(hinge), rod.marker("end"), axis=R.T @ [0, 1, 0]))
    still = equilibrium(system)
    assert still.result.reaction(joint)[0, :3] == pytest.approx([0, 0, 2 * G], abs=1e-6)
    assert np.abs(still.linear.squares) == pytest.approx([1.5 * G], rel=1e-7)


def test_a_spring_comes_to_rest_without_any_force() -> None:
    system = System()
    wheel = system.add(RigidBody(1.0, (0.1, 0.1, 0.1), name="wheel"))
    system.add(RevoluteJoint(ground.marker_at(), wheel.marker_at((0, 0, 0)), axis=(0, 0, 1)))
    hub = wheel.marker_at((0, 0, 0), name="hub")
    system.add(TorsionSpring(ground.marker_at(), hub, axis=(0, 0, 1), stiffness=40.0, angle=0.3))
    R = equilibrium(system).result.axes(hub)[0]
    assert math.atan2(R[1, 0], R[0, 0]) == pytest.approx(0.3, rel=1e-9)


def test_motions_that_nothing_resists_are_counted() -> None:
    system = System(gravity=(0, 0, -G))
    ball = system.add(RigidBody(1.0, (0.1, 0.1, 0.1), position=(0, 0, -0.4), name="ball"))
    center = ball.marker_at((0, 0, 0))
    system.add(SpringDamper(ground.marker_at(), center, stiffness=250.0))
    still = equilibrium(system)
    assert still.mobilities == 3 and still.stable  # it turns about any axis


def test_prescribed_motions_go_on_from_an_equilibrium() -> None:
    system, rod = pendulum()
    motion = Motion.steady(1.0)
    system.add(DrivenAngle(ground.marker_at(), rod.marker("end"), axis=(0, 1, 0), motion=motion))
    first = equilibrium(system)
    later = equilibrium(system, guess=first, time=0.5)
    R = later.result.axes(rod.marker("tip"))[0]
    assert math.atan2(R[0, 2], R[2, 2]) == pytest.approx(0.5, rel=1e-9)
