"""Solid bodies with switched static modes like all of their dofs; curves of paths; runs that cannot go on."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs.body.floating.frame import floating_frame
from morembs.dynamics.multibody import FlexibleBody, RigidBody, System
from morembs.dynamics.multibody.linear_body import LinearBody
from morembs.dynamics.multibody.sliding.body import SwitchingBody
from morembs.dynamics.multibody.sliding.handler import SlidingSwitch, UnfinishedRunError, simulate_sliding
from morembs.dynamics.multibody.sliding.loads import MovingLoad, PathSupport, PointOnPath
from morembs.dynamics.multibody.sliding.response import local_response
from morembs.fem import DofMap, FEModel
from morembs.fem.interface import make_interface
from morembs.fem.stress_operator import stress_operator
from morembs.problem import Problem
from morembs.reducers import StaticModesSwitching
from morembs.responses.static_mode_tables import StaticModeTables
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal
from tests.support.sliding import reduced_beam


@pytest.fixture(scope="module")
def beam():
    return reduced_beam(4)


def rail(cells=(24, 2, 2), size=(1.2, 0.05, 0.08)):
    """A solid rail, held at the lower edges of both ends; the path is the middle line of its top."""
    model = steel(box("hex8", cells, size))
    xyz = model.nodes.xyz
    top = np.flatnonzero((np.abs(xyz[:, 2] - size[2]) < 1e-9) & (np.abs(xyz[:, 1] - size[1] / 2) < 1e-9))
    low = np.abs(xyz[:, 2]) < 1e-9
    first, last = (np.flatnonzero(low & (np.abs(xyz[:, 0] - x) < 1e-9)) for x in (0.0, size[0]))
    out = np.isin(model.dofs.node, first) | (np.isin(model.dofs.node, last) & (model.dofs.component > 0))
    keep = np.flatnonzero(~out)
    nodes = replace(model.nodes, sets={"RAIL": top})
    K, M = (sp.csr_array(A[keep][:, keep]) for A in (model.K, model.M))
    dofs = DofMap(node=model.dofs.node[keep], component=model.dofs.component[keep])
    return model, FEModel(K=K, M=M, nodes=nodes, dofs=dofs, mesh=model.mesh, materials=model.materials)


def full_run(model, path, load, count, h, rho=0.9):
    """Displacements (steps, N) by the trapezoidal rule with all dofs; ``load``(t) gives s and F."""
    K, M = model.K.toarray(), model.M.toarray()
    x = model.nodes.xyz[path, 0]

    def spread(t):
        """Weights of the nodes by Catmull and Rom's cubics, written out anew."""
        s, F = load(t)
        i = min(max(int(np.searchsorted(x, s, side="right")) - 1, 0), len(x) - 2)
        c, L, f = (s - x[i]) / (x[i + 1] - x[i]), x[i + 1] - x[i], np.zeros(model.size)
        weights = {i: 1 - 3 * c * c + 2 * c**3, i + 1: 3 * c * c - 2 * c**3}
        for end, slope in ((i, c * (1 - c) ** 2), (i + 1, c * c * (c - 1))):
            a, b = max(end - 1, max(i - 1, 0)), min(end + 1, min(i + 2, len(x) - 1))
            weights[b] = weights.get(b, 0.0) + slope * L / (x[b] - x[a])
            weights[a] = weights.get(a, 0.0) - slope * L / (x[b] - x[a])
        for j, w in weights.items():
            for axis in range(3):
                dof = np.flatnonzero((model.dofs.node == path[j]) & (model.dofs.component == axis))
                f[dof] += w * F[axis]
        return f

    u, rate, factor = np.zeros(len(K)), np.zeros(len(K)), sl.cho_factor(M + h * h / 4 * K)
    a, states = np.linalg.solve(M, spread(0.0)), [np.zeros(len(K))]
    for k in range(1, count + 1):
        u, rate = u + h * rate + h * h / 4 * a, rate + h / 2 * a
        a = sl.cho_solve(factor, spread(k * h) - K @ u)
        u, rate = u + h * h / 4 * a, rate + h / 2 * a
        states.append(u)
    return np.array(states)


def test_solid_rail_like_all_of_its_dofs():
    solid, model = rail()
    path = model.nodes.sets["RAIL"]
    path = path[np.argsort(model.nodes.xyz[path, 0])]
    reducer = StaticModesSwitching(
        base_options={"modes": 10}, candidates="set:RAIL", directions=[2], stress=True, band=8
    )
    with Problem(model) as problem:
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
    speed, count, begin, F = 60.0, 400, 0.1, np.array([0.0, 0.0, -1e4])
    h = 1.0 / speed / count

    # The load comes on softly, so that its switching on excites no local modes.
    def ramp(t):
        return np.sin(0.5 * np.pi * min(max(t / (40 * h), 0.0), 1.0)) ** 2

    body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=begin)
    system = System()
    system.add(body)
    load = system.add(MovingLoad(body.path(), position=lambda t: begin + speed * t, force=lambda t: ramp(t) * F))
    result = simulate_sliding(system, SlidingSwitch(body), end=count * h, step=h, rho=0.95)
    response = local_response(result, body, load, stress=True)
    u = full_run(model, path, lambda t: (begin + speed * t, ramp(t) * F), count, h)
    all_dofs = np.zeros((count + 1, 3 * len(solid.nodes)))
    all_dofs[:, 3 * model.dofs.node + model.dofs.component] = u
    tensor = stress_operator(solid, path).stress(all_dofs.T).reshape(len(path), 6, -1)
    at = np.searchsorted(stress_operator(solid, path).nodes, path)
    pick = np.round(result.time / h).astype(int)
    x = model.nodes.xyz[path, 0]
    down, sigma = np.empty(len(pick)), np.empty((len(pick), 6))
    for row, (k, s) in enumerate(zip(pick, response.position, strict=True)):
        curve = tables.curve(float(s))
        down[row] = curve.value @ curve.span.base @ all_dofs[k, 3 * path[curve.span.nodes] + 2]
        i = curve.span.interval
        c = (s - x[i]) / (x[i + 1] - x[i])
        sigma[row] = (1 - c) * tensor[at[i], :, k] + c * tensor[at[i + 1], :, k]
    assert np.abs(response.displacement[:, 2] - down).max() < 1e-2 * np.abs(down).max()
    assert np.abs(response.stress - sigma).max() < 1e-2 * np.abs(sigma).max()
    modes_only = np.array(
        [
            tables.stress[tables.curve(float(s)).span.interval] @ q
            for s, q in zip(response.position, result.configuration(body)[:, :10], strict=True)
        ]
    )
    assert np.abs(modes_only - sigma).max() > 0.1 * np.abs(sigma).max()


@pytest.mark.parametrize(("variant", "base"), [("quasi-static", "modal"), ("dynamic", "craig-bampton")])
def test_floating_body_like_all_of_its_dofs(variant, base):
    """A free bar, small rotations: displacement under a load that slides along it."""
    model = steel(box("hex8", (16, 2, 1), (0.8, 0.05, 0.02)))
    xyz = model.nodes.xyz
    path = np.flatnonzero((np.abs(xyz[:, 2] - 0.02) < 1e-9) & (np.abs(xyz[:, 1] - 0.025) < 1e-9))
    path = path[np.argsort(xyz[path, 0])]
    # Static modes of a body that is held at an interface carry momentum, which its frame must feel.
    held = [make_interface(model, name="end", nodes=where(model, 0, 0.0))] if base == "craig-bampton" else []
    path = path[1:] if held else path
    reducer = StaticModesSwitching(
        base=base,
        base_options={"modes": 6},
        candidates="ids:" + ",".join(map(str, model.nodes.ids[path])),
        directions=[0, 1, 2],
    )
    with Problem(model, held) as problem:
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
        frame = floating_frame(problem, reduced)
    x0 = xyz[path[0], 0]
    speed, count, F = 20.0, 300, 1e-3 * np.array([3.0, 5.0, -20.0])
    h = 0.7 / speed / count

    def load(t):
        return 0.05 + speed * t, np.sin(0.5 * np.pi * min(max(t / (60 * h), 0.0), 1.0)) ** 2 * F

    inner = FlexibleBody(frame, position=frame.origin)
    body = SwitchingBody(inner, tables, at=0.05 - x0, variant=variant, damping_ratio=0.3)
    system = System()
    system.add(body)
    moving = system.add(MovingLoad(body.path(), position=lambda t: load(t)[0] - x0, force=lambda t: load(t)[1]))
    result = simulate_sliding(system, SlidingSwitch(body), end=count * h, step=h)
    local = local_response(result, body, moving)
    u = full_run(model, path, load, count, h)[np.round(result.time / h).astype(int)]
    want, computed = np.empty((len(u), 3)), np.empty((len(u), 3))
    x = result.configuration(body)
    for k, s in enumerate(local.position):
        curve = tables.curve(float(s))
        want[k] = curve.value @ curve.span.base @ u[k].reshape(-1, 3)[path[curve.span.nodes]]
        R = x[k, 3:12].reshape(3, 3)
        computed[k] = x[k, :3] + R @ (curve.point - frame.origin + local.displacement[k]) - curve.point
    elastic = np.abs(local.displacement).max()
    assert np.abs(computed - want).max() < 1e-2 * elastic
    assert np.abs(want).max() > elastic


def test_the_path_is_a_smooth_curve():
    angle = np.linspace(0, 2.5, 40) ** 1.1
    xyz = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    c = len(xyz)
    tables = StaticModeTables(
        kind="path",
        node_ids=np.arange(c),
        xyz=xyz,
        node=np.arange(c),
        direction=np.tile([0.0, 0, 1], (c, 1)),
        turns=np.zeros(c, bool),
        modes=np.zeros((c, 1)),
        stiffness=np.eye(1, c),
        mass=np.eye(1, c),
        coupling=np.zeros((1, c)),
        weight=np.zeros((1, 3)),
        static_weight=np.zeros((c, 3)),
    )
    for s in tables.s[1:-1]:
        before, after = tables.curve(s - 1e-9), tables.curve(s + 1e-9)
        assert np.abs(before.point - after.point).max() < 1e-8
        assert np.abs(before.tangent - after.tangent).max() < 1e-6
        # Through the nodes, and the derivative is that of the point.
    mid = 0.5 * (tables.s[7] + tables.s[8])
    step = (tables.curve(mid + 1e-6).point - tables.curve(mid - 1e-6).point) / 2e-6
    assert np.abs(step - tables.curve(mid).tangent).max() < 1e-7
    every = np.arange(c)
    slope = (tables.curve(mid + 1e-6).rows(every) - tables.curve(mid - 1e-6).rows(every)) / 2e-6
    assert np.abs(slope - tables.curve(mid).rows(every, derivative=True)).max() < 1e-7
    radius = [np.linalg.norm(tables.curve(s).point) for s in np.linspace(tables.s[2], tables.s[-3], 200)]
    assert np.abs(np.array(radius) - 1).max() < 1e-4


def test_bad_runs_say_when_and_where_and_keep_what_there_is(beam):
    reduced, tables = beam

    def failed(position, at=0.0, end=1.0, step=1e-3, **keys):
        body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=at, **keys)
        system = System()
        system.add(body)
        system.add(MovingLoad(body.path(), position=position, force=(0, 1, 0), name="wheel"))
        with pytest.raises(UnfinishedRunError) as stopped:
            simulate_sliding(system, SlidingSwitch(body), end=end, step=step)
        return str(stopped.value), stopped.value.result

    text, result = failed(lambda t: 0.8 * t, end=1.5)
    assert "outside all candidates at t = 1.25" in text and "wheel" in text
    # The last step that was on the path is kept, the one that left it is not.
    assert result.time[-1] == pytest.approx(1.25) and len(result.segments) > 20
    text, result = failed(lambda t: 0.2 + (0.5 if t > 0.1005 else 0.0), at=0.2)
    assert "from t = 0.1 s to 0.101 s" in text and "s = 0.2 m to 0.7 m" in text and "look-ahead of 1" in text
    assert result.time[-1] == pytest.approx(0.1)
    with refusal("value", "s"):
        SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=1.2)
    # A stretch of the path whose candidates have no static modes of their own.
    dead = np.array(tables.stiffness)
    removed = (tables.node > 20) & (tables.node < 30)
    for k in range(len(dead)):
        dead[k, removed] = dead[k, np.roll(removed, k) & (np.arange(tables.count) >= k)] = 0.0
    none = replace(tables, stiffness=dead)
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), none, variant="dynamic")
    system = System()
    system.add(body)
    system.add(MovingLoad(body.path(), position=lambda t: 0.8 * t, force=(0, 1, 0)))
    with refusal("result", "", "22,", "27", by=UnfinishedRunError) as stopped:
        simulate_sliding(system, SlidingSwitch(body), end=1.2, step=2e-3)
    assert stopped.value.result.time[-1] > 0.5
    # The same where a mass rides on the compliance of static modes.
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), none, at=0.4)
    rider = RigidBody(1e-3, (1, 1, 1), position=(0.4, 0, 0), velocity=(1, 0, 0), markers={"c": (0, 0, 0)}, name="rider")
    system = System(gravity=(0, -1e-3, 0))
    system.add(body)
    system.add(rider)
    system.add(PathSupport(body.path(), rider.marker("c"), up=(0, 1, 0), name="wheel"))
    with refusal("result", "", "0.2", "0.6", by=UnfinishedRunError) as stopped:
        simulate_sliding(system, SlidingSwitch(body), end=0.5, step=1e-3)
    assert 0.2 < stopped.value.result.time[-1] < 0.4
    rider = RigidBody(1.0, (1, 1, 1), position=(0.75, 0, 0), markers={"c": (0, 0, 0)}, name="rider")
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), none, at=0.75)
    with refusal("model", "", "0.75"):
        PathSupport(body.path(), rider.marker("c"), up=(0, 1, 0))
    # A rider that starts off the path, and two loads where the compliance knows one only.
    rider = RigidBody(1.0, (1, 1, 1), position=(1.3, 0, 0), markers={"c": (0, 0, 0)}, name="rider")
    body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables)
    with refusal("value", "s"):
        PathSupport(body.path(), rider.marker("c"), up=(0, 1, 0))
    with refusal("unsupported", "variant"):
        PointOnPath(body.path(), RigidBody(1.0, (1, 1, 1), markers={"c": (0, 0, 0)}).marker("c"), up=(0, 1, 0))


def test_loads_at_one_place_are_as_one(beam):
    reduced, tables = beam
    results = []
    for shares in ((2.0,), (0.5, 1.5)):
        body = SwitchingBody(LinearBody(reduced.M, reduced.K), tables, at=(0.43,) * len(shares))
        system = System()
        system.add(body)
        loads = [
            system.add(MovingLoad(body.path(k), position=lambda t: 0.43, force=(0, -share, 0), name=f"load {k}"))
            for k, share in enumerate(shares)
        ]
        result = simulate_sliding(system, SlidingSwitch(body), end=0.02, step=2e-3)
        results.append(local_response(result, body, loads[0]).displacement)
    # Static modes answer at once, so that what one load leaves out would be seen in the first step.
    assert np.abs(results[0][0]).max() > 1e-5
    assert np.abs(results[1] - results[0]).max() < 1e-12 * np.abs(results[0]).max()


def test_a_frame_far_from_its_body_is_refused():
    model = steel(box("hex8", (8, 2, 1), (0.8, 0.05, 0.02)))
    reducer = StaticModesSwitching(
        base_options={"modes": 3}, candidates="box:0,0.02,0.019,0.8,0.03,0.021", directions=[2]
    )
    with Problem(model) as problem:
        reduced = reducer.reduce(problem)
        tables = reducer.tabulate_static_modes(problem, reduced)
        near, far = (floating_frame(problem, reduced, origin=origin) for origin in ((0, 0, 0), (3, -20, 11)))
    SwitchingBody(FlexibleBody(near), tables)
    with refusal("value", "frame"):
        SwitchingBody(FlexibleBody(far), tables)
