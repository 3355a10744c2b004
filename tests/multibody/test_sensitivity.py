"""Sensitivities by direct differentiation, against central differences of whole simulations and equilibria."""

import numpy as np
import pytest

from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
from morembs.body.floating.integrals import PERMUTATION, ShapeIntegrals
from morembs.body.floating.parametric import frame_terms
from morembs.dynamics import multibody as mb
from morembs.dynamics.multibody.tangents import pulls, stiffness_and_damping
from morembs.dynamics.multibody.variation import variations
from morembs.parametric.model import parametric_model
from morembs.parametric.terms import AffineProblem, varied_model
from tests.support.parametric import STEEL, bracket, interfaces, longer, parameters, some_basis
from tests.support.refusals import refusal

SPEED, RADIUS = 300.0, 0.02
VALUES = {"E_arm": 1.9e11, "rho": 8000.0, "alpha": 30.0, "t": 1.1}
OUTPUTS = ("position", "velocity", "axes", "load")


@pytest.fixture(scope="module")
def reduced():
    """Model and frame terms of the bracket, and the options of a frame at its foot."""
    mesh = bracket()
    varied = varied_model(mesh, [STEEL], (*parameters(), longer(mesh)))
    with AffineProblem(varied, interfaces(varied.model(varied.box.nominal))) as problem:
        V = some_basis(problem, modes=2, corners=0)
        options = {"kind": "tangent", "interfaces": ("FOOT",), "origin": problem.interfaces[0].point}
        return parametric_model(problem, V), frame_terms(problem, V), options


def nearby(model, name):
    """Four values of one parameter about ``VALUES``, and their distance."""
    j, p = model.box.names.index(name), model.box.point(VALUES)
    step = 2e-3 * (model.box.high[j] - model.box.low[j])
    return [p + k * step * np.eye(len(p))[j] for k in (-2, -1, 1, 2)], step


def differences(values, step):
    a, b, c, d = values
    return (8 * (c - b) - (d - a)) / (12 * step)


def same(given, expected, tolerance):
    return np.abs(given - expected).max() <= tolerance * np.abs(expected).max()


def agrees(given, values, step):
    """To 1e-6 with differences of histories that are known to 1e-13, at the start also by themselves."""
    exact, noise = differences(values, step), 1e-13 * np.abs(values).max() / step
    return all(
        np.abs(given[at] - exact[at]).max() <= 1e-6 * np.abs(exact[at]).max() + noise for at in (slice(None), slice(1))
    )


def arm(reduced, p, derivatives=False, **at):
    """The bracket as a body, with a frame whose shapes are its modes at ``p``."""
    model, terms, options = reduced
    there = model.at(p)
    slopes = terms.derivatives(there, **options) if derivatives else None
    return mb.FlexibleBody(terms.frame(there, **options), name="arm", derivatives=slopes, **at)


def crank(reduced, p, derivatives=False, spring=()):
    """The bracket on a crank that turns at constant speed, under a following load and between springs."""
    system, axle, axis = mb.System(gravity=(3.0, 2.0, -9.81)), mb.ground.marker_at(), (0, 0, 1)
    disc = system.add(
        mb.RigidBody(
            0.5,
            (1e-4, 1e-4, 1e-4),
            name="disc",
            angular_velocity=(0, 0, SPEED),
            markers={"axle": (0, 0, 0), "pin": (RADIUS, 0, 0)},
        )
    )
    moving = {"velocity": (0, SPEED * RADIUS, 0), "angular_velocity": (0, 0, SPEED)}
    body = system.add(arm(reduced, p, derivatives, position=(RADIUS, 0, 0), **moving))
    system.add(mb.RevoluteJoint(axle, disc.marker("axle"), axis=axis))
    system.add(mb.DrivenAngle(axle, disc.marker("axle"), axis=axis, motion=mb.Motion.steady(SPEED)))
    pin = system.add(mb.RevoluteJoint(disc.marker("pin"), body.marker("FOOT"), axis=axis))
    system.add(mb.PointLoad(body.marker("TIP"), force=(5, 3, 20.0), moment=(2.0, 3.0, 1.0), follows=True))
    for damping in spring:
        system.add(mb.SpringDamper(axle, body.marker("TIP"), stiffness=3e4, damping=damping, length=0.05))
    return system, body, pin


@pytest.mark.parametrize(("name", "spring"), [("E_arm", ()), ("rho", (0.0, 3.0)), ("t", (0.0,))])
def test_each_step_is_differentiated_as_it_stands(reduced, name, spring):
    run = {"end": 4e-4, "step": 2e-5, "rho": 0.8, "tolerance": 1e-11}
    at, step = nearby(reduced[0], name)
    histories = []
    for p in at:
        system, body, pin = crank(reduced, p, spring=spring)
        result = mb.simulate(system, **run)
        histories.append([getattr(result, of)(body.marker("TIP")) for of in OUTPUTS] + [result.reaction(pin)])
    system, body, pin = crank(reduced, reduced[0].box.point(VALUES), derivatives=True, spring=spring)
    slopes = mb.simulate(system, sensitivities=[f"arm.{name}"], **run).sensitivity(f"arm.{name}")
    tip = body.marker("TIP")
    known = [slopes.position(tip), slopes.velocity(tip), slopes.of(lambda result: result.axes(tip)), slopes.load(tip)]
    known.append(slopes.reaction(pin))
    for given, *values in zip(known, *histories, strict=True):
        assert agrees(given, values, step)


def test_rotations_in_space(reduced):
    run = {"end": 4e-4, "step": 2e-5, "tolerance": 1e-11}

    def tumbling(p, derivatives=False):
        system = mb.System()
        body = system.add(arm(reduced, p, derivatives, angular_velocity=(400.0, 300.0, -500.0)))
        system.add(mb.SphericalJoint(mb.ground.marker_at(), body.marker("FOOT")))
        system.add(mb.PointLoad(body.marker("TIP"), force=(50.0, -30.0, 20.0)))
        return mb.simulate(system, sensitivities=derivatives, **run), body

    at, step = nearby(reduced[0], "t")
    values = [result.position(body.marker("TIP")) for result, body in map(tumbling, at)]
    result, body = tumbling(reduced[0].box.point(VALUES), derivatives=True)
    assert agrees(result.sensitivity("arm.t").position(body.marker("TIP")), values, step)


def test_joints_stay_closed_where_a_parameter_moves_them(reduced):
    """A body that starts deflected and in motion, on a joint that the parameter would open and tear."""
    p, rng = reduced[0].box.point(VALUES), np.random.default_rng(4)
    # Less of the higher modes, which the step does not resolve.
    shares = 0.5 ** np.arange(arm(reduced, p).inertia.n)
    moving = {"elastic": 1e-5 * shares, "elastic_rate": 1e-2 * shares}
    moving = {name: values * rng.standard_normal(len(shares)) for name, values in moving.items()}
    turning = np.array([40.0, 30.0, -50.0])
    body = arm(reduced, p, **moving)
    place = body.marker("TIP").place(body.start()[0])
    velocity = -place.jacobian[:3, 3:] @ np.concatenate((turning, moving["elastic_rate"]))

    def held(body):
        system = mb.System()
        system.add(body)
        return system, system.add(mb.SphericalJoint(mb.ground.marker_at(place.position), body.marker("TIP")))

    run = {"end": 1e-4, "step": 2e-5, "tolerance": 1e-10}
    body = arm(reduced, p, derivatives=True, velocity=velocity, angular_velocity=turning, **moving)
    system, pin = held(body)
    result = mb.simulate(system, sensitivities=["arm.t"], **run)
    slope, free = result.sensitivity("arm.t"), body.derivatives["t"].markers["TIP"].motion[:3]
    # Round-off of positions of 0.1 m leaves 1e-15.
    assert np.abs(slope.position(body.marker("TIP"))).max() < 1e-8 * np.abs(free @ moving["elastic"]).max()
    torn = np.abs(free @ moving["elastic_rate"]).max()
    assert np.abs(slope.velocity(body.marker("TIP"))[0]).max() < 1e-7 * torn
    # Runs of nearby bodies in the same shapes, from where their joints put them.
    (model, terms, options), step, reactions = reduced, 1e-4, []
    x, v = slope.configuration_step[0], slope.of(lambda result: result.speeds(body))[0]
    for change in step * np.array([-2, -1, 1, 2]):
        value = p + change * (np.array(model.box.names) == "t")
        frame = terms.frame(model.at(value), shapes=model.at(p).Y[:, 6:], **options)
        system, joint = held(mb.FlexibleBody(frame, name="arm"))
        start, still = mb.Assembly(system), np.zeros(len(x))
        state = mb.State(
            assembly=start,
            time=0.0,
            x=start.move(result.segments[0].x[0], change * x),
            v=result.segments[0].v[0] + change * v,
            acceleration=still,
            multipliers=np.zeros(3),
        )
        reactions.append(mb.simulate(system, start=state, **run).reaction(joint))
    assert same(slope.reaction(pin), differences(reactions, step), 1e-5)


def swing(reduced, p, derivatives=False):
    """The bracket on a hinge with a spring, under a load that begins to grow."""
    system = mb.System(gravity=(0, 0, -9.81))
    body = system.add(arm(reduced, p, derivatives))
    hinge = system.add(mb.RevoluteJoint(mb.ground.marker_at(), body.marker("FOOT"), axis=(0, 1, 0)))
    system.add(mb.TorsionSpring(mb.ground.marker_at(), body.marker("FOOT"), axis=(0, 1, 0), stiffness=3.0))
    system.add(mb.PointLoad(body.marker("TIP"), force=lambda t: (40.0 * (1 + 1e6 * t * t), 3.0, -2.0)))
    return system, body, hinge


@pytest.mark.parametrize("name", ["E_arm", "t"])
def test_equilibria_and_runs_from_them(reduced, name):
    run = {"end": 2e-4, "step": 2e-5, "tolerance": 1e-11}
    at, step = nearby(reduced[0], name)
    still, moving = [], []
    for p in at:
        system, body, hinge = swing(reduced, p)
        rest = mb.equilibrium(system, tolerance=1e-12)
        result = mb.simulate(system, start=rest, **run)
        for kept, of in ((still, rest.result), (moving, result)):
            kept.append([of.position(body.marker("TIP")), of.axes(body.marker("FOOT")), of.reaction(hinge)])
    system, body, hinge = swing(reduced, reduced[0].box.point(VALUES), derivatives=True)
    rest = mb.equilibrium(system, tolerance=1e-12, sensitivities=True)
    result = mb.simulate(system, start=rest, sensitivities=[f"arm.{name}"], **run)
    for kept, of in ((still, rest.result), (moving, result)):
        slopes = of.sensitivity(f"arm.{name}")
        foot = slopes.of(lambda result: result.axes(body.marker("FOOT")))
        known = slopes.position(body.marker("TIP")), foot, slopes.reaction(hinge)
        for given, *values in zip(known, *kept, strict=True):
            assert agrees(given, values, step)


def cloud(rng, n=4, points=12):
    """The frame of point masses with ``n`` random shapes."""
    x, m, phi = rng.standard_normal((points, 3)), rng.uniform(0.5, 1, points), 0.2 * rng.standard_normal((points, 3, n))
    x_phi = np.einsum("n,na,nbl->abl", m, x, phi)
    phi_phi = np.einsum("n,nak,nbl->abkl", m, phi, phi)
    second, half = np.einsum("n,na,nb->ab", m, x, x), rng.standard_normal((n, n))
    parts = ShapeIntegrals(
        mass=m.sum(),
        first=m @ x,
        inertia=np.trace(second) * np.eye(3) - second,
        second=second,
        x_phi=x_phi,
        Ct=np.einsum("n,nbl->lb", m, phi),
        Cr=np.einsum("abc,bcl->la", PERMUTATION, x_phi),
        phi_phi=phi_phi,
        Me=np.einsum("aakl->kl", phi_phi),
    )
    markers = {k: InterfaceMarker(point=rng.standard_normal(3), motion=rng.standard_normal((6, n))) for k in "abc"}
    return FloatingFrame(
        kind="mean-axes",
        origin=np.zeros(3),
        elastic=np.zeros((n + 6, n)),
        rigid=np.zeros((n + 6, 6)),
        integrals=parts,
        Ke=100 * half @ half.T,
        De=half @ half.T,
        markers=markers,
    )


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_exact_tangents_are_those_of_the_equations(damping):
    rng, system = np.random.default_rng(1), mb.System(gravity=(1, 2, -9.81))
    first, second = (
        system.add(
            mb.FlexibleBody(
                cloud(rng),
                name=name,
                elastic=0.3 * rng.standard_normal(4),
                elastic_rate=rng.standard_normal(4),
                position=rng.standard_normal(3),
                velocity=rng.standard_normal(3),
                angular_velocity=rng.standard_normal(3),
            )
        )
        for name in ("first", "second")
    )
    third = system.add(mb.RigidBody(2.0, (1, 2, 2.5), markers={"a": (1, 0.2, 0), "b": (0, 1, 0.3)}, name="third"))
    held, motion, axis = mb.ground.marker_at((0.1, 0.2, 0.3)), mb.Motion.steady(2.0), (1, 2, 3)
    for kind in (mb.RevoluteJoint, mb.PrismaticJoint, mb.FixedJoint):
        system.add(kind(first.marker("a"), second.marker("b"), axis=axis))
    system.add(mb.SphericalJoint(third.marker("a"), second.marker("c")))
    system.add(mb.DrivenAngle(held, third.marker("b"), axis=axis, motion=motion))
    system.add(mb.DrivenAngle(first.marker("c"), third.marker("b"), axis=(1, -2, 3), motion=motion))
    system.add(mb.DrivenPosition(first.marker("b"), third.marker("b"), axis=axis, motion=motion))
    system.add(mb.PointLoad(first.marker("b"), force=(1, 2, 3), moment=(3, 2, -1), follows=True))
    system.add(mb.PointLoad(second.marker("b"), force=(1, 2, 3), moment=(3, 2, -1)))
    ends = second.marker("a"), third.marker("b")
    system.add(mb.SpringDamper(*ends, stiffness=100.0, damping=damping))
    system.add(mb.SpringDamper(*ends, stiffness=100.0, damping=damping, length=0.0))
    system.add(mb.TorsionSpring(*ends, axis=axis, stiffness=100.0, damping=damping))
    a = mb.Assembly(system)
    x, v = a.start()
    x, acceleration, multipliers = (
        a.move(x, 0.2 * rng.standard_normal(a.size)),
        rng.standard_normal(a.size),
        rng.standard_normal(a.rows),
    )

    def residual(x, v):
        M, g, _, B = a.equations(0.0, x, v)
        return M @ acceleration + g + multipliers @ B

    steps = 1e-3 * np.eye(a.size)
    by_x, by_v = (
        np.array([differences([residual(*at(k * e)) for k in (-2, -1, 1, 2)], 1e-3) for e in steps]).T
        for at in (lambda e: (a.move(x, e), v), lambda e: (x, v + e))
    )
    state = mb.State(assembly=a, time=0.0, x=x, v=v, acceleration=acceleration, multipliers=multipliers)
    K, C = stiffness_and_damping(a, 0.0, x, v, acceleration, multipliers, known=pulls(a, state))
    assert same(K, by_x, 1e-9)
    assert same(C, by_v, 1e-9)


def test_partial_derivatives_at_large_deflections():
    """Of the equations at fixed unknowns, against differences of those of bodies with changed data."""
    rng, system = np.random.default_rng(3), mb.System(gravity=(1, 2, -9.81))
    body = system.add(mb.FlexibleBody(cloud(rng), name="body", derivatives={"p": cloud(rng)}))
    other = system.add(mb.RigidBody(2.0, (1, 2, 2.5), markers={"a": (1, 0.2, 0)}, name="other"))
    for kind, end in ((mb.FixedJoint, "a"), (mb.PrismaticJoint, "b")):
        system.add(kind(body.marker(end), other.marker("a"), axis=(1, 2, 3)))
    system.add(mb.PointLoad(body.marker("c"), force=(1, 2, 3), moment=(3, 2, -1), follows=True))
    for damping in (0.0, 3.0):
        system.add(mb.SpringDamper(body.marker("c"), other.marker("a"), stiffness=100.0, damping=damping))
    a = mb.Assembly(system)
    state = mb.State(
        assembly=a,
        time=0.0,
        x=a.move(a.start()[0], 0.3 * rng.standard_normal(a.size)),
        v=rng.standard_normal(a.size),
        acceleration=rng.standard_normal(a.size),
        multipliers=rng.standard_normal(a.rows),
    )
    of = variations(a, True)[0]

    def equations(change):
        M, g, Phi, B = of.at(change).equations(0.0, state.x, state.v)
        return np.concatenate((M @ state.acceleration + g + state.multipliers @ B, Phi))

    expected = differences([equations(k * 1e-3) for k in (-2, -1, 1, 2)], 1e-3)
    assert same(np.concatenate(of.partials(state, pulls(a, state))), expected, 1e-9)


def test_what_allows_no_derivatives_is_refused(reduced):
    p = reduced[0].box.point(VALUES)
    run = {"end": 1e-4, "step": 2e-5}
    system, body, _ = crank(reduced, p)
    with refusal("missing", "derivatives"):
        mb.simulate(system, sensitivities=True, **run)
    system, body, _ = crank(reduced, p, derivatives=True)
    with refusal("unknown", "sensitivities", "arm.rh", "arm.rho"):
        mb.simulate(system, sensitivities=["arm.rh"], **run)
    assert [of.name for of in variations(mb.Assembly(system), "arm.rho")] == ["arm.rho"]
    with refusal("unknown", "sensitivity", "arm.rho"):
        mb.simulate(system, **run).sensitivity("arm.rho")

    class Never(mb.EventHandler):
        def time(self, before, after):
            return None

        def change(self, state):
            raise NotImplementedError

    with refusal("unsupported", "sensitivities"):
        mb.simulate(system, sensitivities=True, events=Never(), **run)
    resting = swing(reduced, p, derivatives=True)[0]
    with refusal("unknown", "sensitivity", "arm.rho"):
        mb.simulate(resting, sensitivities=["arm.rho"], start=mb.equilibrium(resting), **run)

    class Remembers(mb.PointLoad):
        def for_run(self):
            return self

    system.add(Remembers(body.marker("TIP"), name="friction"))
    with refusal("unsupported", "force", "friction"):
        mb.simulate(system, sensitivities=True, **run)
    system.forces.pop()
    loaded = body.marker_at((0, 0, 0.01), np.zeros((3, body.inertia.n)), name="node")
    system.add(mb.PointLoad(loaded, force=(1, 0, 0)))
    with refusal("unsupported", "derivatives"):
        mb.simulate(system, sensitivities=True, **run)
