"""Trajectories back at the nodes: V q, moving frames, stresses, what VTK reads, and what is refused."""

import dataclasses
import resource
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.linalg as sl
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from morembs.base.errors import OutputError, OverwriteError
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.body.recovery.expansion import Expander
from morembs.body.recovery.recover import Recovered, Trajectory, expand, read_trajectory, recover
from morembs.body.recovery_shapes import RECOVERY, recovery_parts
from morembs.body.stress_shapes import stress_recovery
from morembs.body.vtkhdf_series import stored_recovery
from morembs.dynamics.multibody import FixedJoint, FlexibleBody, PointLoad, System, ground, simulate
from morembs.dynamics.multibody.rotations import exponential
from morembs.fem import Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.fem.stress_operator import von_mises
from morembs.problem import Problem
from morembs.reducers import CraigBampton, Modal
from morembs.storage.writer import Writer
from tests.support.machine import has_memory
from tests.support.meshes import STEEL, box, steel, where
from tests.support.processes import apart
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """A body file of two bodies of one bar; the stress of the first is in it, "bare" has none."""
    model = steel(box("hex8", (5, 2, 2), (0.5, 0.06, 0.04)))
    interfaces = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left", 0.0), ("right", 0.5))]
    with Problem(model, interfaces) as problem:
        part = make_part(problem)
        cb, bare = CraigBampton(modes=4).reduce(problem, "cb"), Modal(modes=3).reduce(problem, "bare")
        path = write_body(
            tmp_path_factory.mktemp("bar") / "bar.h5", [elastic_body(problem, basis, part) for basis in (cb, bare)]
        )
        stress = stress_recovery(problem, cb, single=False)
    with h5py.File(path, "r+") as file:
        Writer(file).rows("bodies/cb/recovery/", RECOVERY, recovery_parts(stress, part.transformation))
    rng = np.random.default_rng(3)
    given = Trajectory(
        times=np.array([0.0, 0.1, 0.25]),
        coordinates=1e-4 * rng.standard_normal((3, cb.order)),
        loads=1e3 * rng.standard_normal((3, 12)),
    )
    return SimpleNamespace(path=path, source=read_body(path), stress=stress, given=given, model=model, cb=cb)


def save(path, trajectory):
    """NPZ file of a trajectory."""
    given = {name: value for name, value in vars(trajectory).items() if value is not None and name != "times"}
    np.savez(path, time=trajectory.times, **given)
    return path


def steps_of(path):
    """Times and point data of each step, as vtkHDFReader gives them."""
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    # VTK takes a single step for a mesh without time.
    times = (0.0,) if times is None else times
    assert len(times) == reader.GetNumberOfSteps()
    steps = []
    for time in times:
        reader.UpdateTimeStep(time)
        grid = vtk.vtkUnstructuredGrid.SafeDownCast(reader.GetOutputDataObject(0)) or reader.GetOutput()
        data = grid.GetPointData()
        arrays = {data.GetArrayName(i): vtk_to_numpy(data.GetArray(i)).copy() for i in range(data.GetNumberOfArrays())}
        points = vtk_to_numpy(grid.GetPoints().GetData()).copy()
        steps.append((points, grid.GetNumberOfCells(), grid.GetCellType(0), arrays))
    return np.array(times), steps


def close(actual, wanted):
    np.testing.assert_allclose(actual, wanted, rtol=0, atol=1e-6 * np.abs(wanted).max())


def turn(angle, axis):
    a = np.asarray(axis) / np.linalg.norm(axis)
    W = np.cross(np.eye(3), a) * -1
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def test_expansion_is_basis_times_coordinates(bar):
    body = bar.source.bodies["cb"]
    q = bar.given.coordinates
    motion = expand(bar.source, body, bar.given, recovery=bar.stress)
    exact = (body.basis() @ q.T).T.reshape(3, -1, 3)
    assert np.abs(motion.displacement - exact).max() < 1e-13 * np.abs(exact).max()
    assert motion.motion is None
    stress = (bar.stress.stress @ q.T + bar.stress.correction @ bar.given.loads.T).T.reshape(3, -1, 6)
    assert np.abs(motion.stress - stress).max() < 1e-9 * np.abs(stress).max()
    # A basis too large to keep is read in blocks of columns, with the same result.
    few = expand(bar.source, body, bar.given, kept_bytes=8 * 3 * len(bar.source.node_ids) * 5)
    assert np.abs(few.displacement - exact).max() < 1e-13 * np.abs(exact).max()


def test_a_moving_frame_carries_the_body(bar):
    """A rigid turn by the frame, and elastic coordinates that stand for the same deformation as reduced ones."""
    body, x = bar.source.bodies["cb"], bar.source.coordinates
    floating = body.floating.about([0.1, -0.2, 0.3])
    body = dataclasses.replace(body, floating=floating)
    A = np.array([turn(0.3, [1, 2, 3]), turn(2.0, [0, 1, -1])])
    p = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])
    q = 1e-4 * np.random.default_rng(4).standard_normal((2, floating.elastic.shape[1]))
    given = Trajectory(times=np.array([0.0, 1.0]), coordinates=q, position=p, rotation=A)
    for scale in (1.0, 30.0):
        motion = expand(bar.source, body, given, recovery=bar.stress, scale=scale)
        for k in range(2):
            u = (body.basis() @ (floating.elastic @ q[k])).reshape(-1, 3)
            wanted = p[k] + (x - floating.origin + scale * u) @ A[k].T
            np.testing.assert_allclose(motion.motion[k] + x, wanted, rtol=0, atol=1e-13)
            np.testing.assert_allclose(motion.displacement[k], u, rtol=0, atol=1e-15)
    elastic = Trajectory(times=given.times, coordinates=q @ floating.elastic.T)
    same = expand(bar.source, body, elastic, recovery=bar.stress)
    np.testing.assert_allclose(motion.stress, same.stress, rtol=0, atol=1e-9 * np.abs(same.stress).max())
    # Position alone, rotation alone: the other stays as it is in the file.
    still = expand(bar.source, body, Trajectory(times=given.times, coordinates=0 * q, position=p))
    np.testing.assert_allclose(still.motion, np.broadcast_to((p - floating.origin)[:, None], still.motion.shape))
    turned = expand(bar.source, body, Trajectory(times=given.times, coordinates=0 * q, rotation=A))
    arms = x - floating.origin
    np.testing.assert_allclose(turned.motion[1], arms @ A[1].T - arms, rtol=0, atol=1e-14)


def test_scale_magnifies_the_deformation_but_not_the_rigid_part(bar):
    """Reduced coordinates of a free body: a small rigid turn beside one elastic shape."""
    for name in ("cb", "bare"):
        body = bar.source.bodies[name]
        floating = body.floating
        rigid = floating.rigid @ np.array([0.1, 0.2, 0.3, 1e-3, 2e-3, -1e-3])
        shape = floating.elastic @ np.full(floating.elastic.shape[1], 1e-5)
        given = Trajectory(times=np.zeros(1), coordinates=(rigid + shape)[None])
        motion = expand(bar.source, body, given, scale=50.0)
        wanted = (body.basis() @ (rigid + 50 * shape)).reshape(-1, 3)
        assert np.abs(motion.motion[0] - wanted).max() < 1e-9 * np.abs(wanted).max(), name


@pytest.mark.parametrize("framed", [False, True])
def test_vtk_reads_the_series(bar, tmp_path, framed):
    body = bar.source.bodies["cb"]
    given = bar.given
    if framed:
        given = Trajectory(
            times=given.times,
            coordinates=given.coordinates[:, : body.floating.elastic.shape[1]],
            rotation=np.array([turn(a, [1, 1, 0]) for a in (0.0, 1.0, 2.0)]),
            position=np.eye(3),
            loads=given.loads,
        )
    result = recover(bar.path, save(tmp_path / "t.npz", given), tmp_path / "out.vtkhdf", body="cb")
    wanted = expand(bar.source, body, given, recovery=stored_recovery(bar.path, "cb"))
    times, steps = steps_of(tmp_path / "out.vtkhdf")
    np.testing.assert_array_equal(times, given.times)
    inner = np.setdiff1d(bar.source.node_ids, bar.stress.points)
    skin = np.flatnonzero(~np.isin(bar.source.node_ids, inner))
    assert len(steps) == 3 and len(inner)
    for k, (points, cells, kind, data) in enumerate(steps):
        np.testing.assert_array_equal(points, bar.source.coordinates)
        assert (cells, kind) == (20, 12)
        moved = ["motion"] if framed else []
        assert sorted(data) == ["displacement", *moved, "stress", "von_mises", "von_mises_jump"]
        close(data["displacement"], wanted.displacement[k])
        if framed:
            close(data["motion"], wanted.motion[k])
        assert np.array_equal(np.isnan(data["von_mises"]), np.isin(bar.source.node_ids, inner))
        close(data["stress"][skin], wanted.stress[k])
        close(data["von_mises"][skin], von_mises(wanted.stress[k]))
    size = von_mises(wanted.stress)
    step, point = np.unravel_index(np.argmax(size), size.shape)
    assert result.peak == (pytest.approx(size.max()), bar.stress.points[point], given.times[step])
    assert (result.steps, result.nodes, result.body) == (3, len(bar.source.node_ids), "cb")
    assert any(f"{len(inner)} of" in note for note in result.notes)


def test_blocks_of_steps_are_the_whole(bar):
    many = Trajectory(times=np.arange(7.0), coordinates=np.sin(np.outer(np.arange(7.0), np.ones(bar.cb.order))))
    body = bar.source.bodies["cb"]
    whole = expand(bar.source, body, many, recovery=bar.stress, scale=2.0)
    blocks = list(Expander(bar.source, body, bar.stress, 2.0, block_bytes=1).blocks(many))
    assert len(blocks) == 7
    for name in ("times", "displacement", "motion", "stress"):
        close(np.concatenate([getattr(block, name) for block in blocks]), getattr(whole, name))


def test_every_nth_step(bar, tmp_path):
    many = Trajectory(times=np.arange(7.0), coordinates=np.sin(np.outer(np.arange(7.0), np.ones(bar.cb.order))))
    recover(bar.path, many, tmp_path / "out.vtkhdf", body="cb", stress=False, every=3, scale=2.0)
    times, steps = steps_of(tmp_path / "out.vtkhdf")
    assert times.tolist() == [0.0, 3.0, 6.0]
    wanted = expand(bar.source, bar.source.bodies["cb"], many.part(slice(None, None, 3)), scale=2.0)
    for k, (*_, data) in enumerate(steps):
        assert sorted(data) == ["displacement", "motion"]
        close(data["displacement"], wanted.displacement[k])
        close(data["motion"], wanted.motion[k])


def test_notes_say_when_loads_and_correction_do_not_meet(bar, modal, tmp_path):
    """Left out, given as zeros, or of no use: on the terminal and in the file."""
    out = tmp_path / "out.vtkhdf"

    def notes(path, loads, **options):
        given = Trajectory(times=np.zeros(1), coordinates=np.zeros((1, options.pop("order"))), loads=loads)
        given_notes = recover(path, given, out, **options).notes
        with h5py.File(out) as file:
            stored = tuple(line.decode() for line in file["notes"][()]) if "notes" in file else ()
        assert stored == given_notes
        return [note for note in given_notes if "correction" in note]

    zeros, ones = np.zeros((1, 12)), np.ones((1, 12))
    here = {"order": bar.cb.order, "body": "cb"}
    assert notes(bar.path, ones, **here) == []
    assert ["no loads were given" in note for note in notes(bar.path, None, **here)] == [True]
    assert ["all loads are zero" in note for note in notes(bar.path, zeros, **here)] == [True]
    # Static shapes in the basis: displacements lack nothing.
    assert notes(bar.path, None, **here, stress=False) == []
    # A modal body lacks much of both.
    here = {"order": 9}
    assert notes(modal.path, ones, **here) == []
    for stress, what in ((True, "stress and displacements"), (False, "displacements")):
        for loads, why in ((None, "no loads were given"), (zeros, "all loads are zero")):
            (note,) = notes(modal.path, loads, **here, stress=stress)
            assert why in note and f"is in {what}" in note
    (note,) = notes(bar.path, ones, order=9, body="bare", stress=False)
    assert "no mode-acceleration correction for displacements" in note and "loads were not used" in note


@pytest.fixture(scope="module")
def modal(tmp_path_factory):
    """A body of three free modes, with stress, seen from a frame that follows its left end; and its full model."""
    model = steel(box("hex20", (4, 1, 2), (0.5, 0.06, 0.04)))
    faces = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left", 0.0), ("right", 0.5))]
    folder = tmp_path_factory.mktemp("modal")
    with Problem(model, faces) as problem:
        reduced = Modal(modes=3).reduce(problem, "bar")
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=["left"], origin=(0.1, 0, 0))
        body = elastic_body(problem, reduced, make_part(problem, "skin"), floating=frame)
        body = dataclasses.replace(body, recovery=stress_recovery(problem, reduced, single=False))
        path = write_body(folder / "bar.h5", [body])
        K, M, B = problem.K.toarray(), problem.M.toarray(), problem.B.toarray()
        at_nodes = body.part.transformation
        R, pole = problem.coupling.R, problem.coupling.pole
    return SimpleNamespace(path=path, reduced=reduced, K=K, M=M, B=B, R=R, pole=pole, at_nodes=at_nodes, frame=frame)


LOADS = np.array([300.0, 200.0, -100.0, 5.0, 20.0, -30.0, -250.0, 150.0, 400.0, 3.0, 10.0, 20.0])


@pytest.mark.parametrize("share", [0.0, 0.05, 0.1])
def test_displacements_under_loads_are_those_of_the_full_model(modal, tmp_path, share):
    """Static under inertia relief, and harmonic at a share of the first frequency left out: dense solutions."""
    K, M, B, R, reduced = modal.K, modal.M, modal.B, modal.R, modal.reduced
    MR = M @ R
    f = B @ LOADS
    f = f - MR @ np.linalg.solve(R.T @ MR, R.T @ f)
    first = np.sqrt(sl.eigh(K, M, eigvals_only=True, subset_by_index=[9, 9])[0])
    omega = share * first
    # Lagrange multipliers hold the rigid motion at zero; the loads are in balance.
    A = np.block([[K - omega**2 * M, MR], [MR.T, np.zeros((6, 6))]])
    exact = (modal.at_nodes @ np.linalg.solve(A, np.append(f, np.zeros(6)))[: len(K)]).reshape(-1, 3)
    q = np.zeros(reduced.order)
    q[6:] = np.linalg.solve((reduced.K - omega**2 * reduced.M)[6:, 6:], reduced.B[6:] @ LOADS)
    given = Trajectory(times=np.zeros(1), coordinates=q[None], loads=LOADS[None])
    errors = []
    for trajectory in (given, dataclasses.replace(given, loads=None)):
        recover(modal.path, trajectory, tmp_path / "out.vtkhdf", scale=3.0)
        ((_, _, _, data),) = steps_of(tmp_path / "out.vtkhdf")[1]
        close(data["motion"], 3 * data["displacement"])  # no rigid motion is in it
        errors.append(np.abs(data["displacement"] - exact).max() / np.abs(exact).max())
    assert errors[1] > 0.1
    assert errors[0] < max(1e-6, 2 * share**2 * errors[1])


@pytest.mark.parametrize("kind", ["tangent", "mean-axes", "center-of-mass"])
def test_corrected_displacements_keep_to_the_frame(modal, tmp_path, kind):
    """In elastic coordinates a followed interface stays where it is, and the shape is that of reduced coordinates."""
    source = read_body(modal.path)
    body = source.bodies["bar"]
    frame = body.floating.in_frame(kind, [] if kind == "mean-axes" else ["left"])
    body = dataclasses.replace(body, floating=frame)
    stress = stored_recovery(modal.path, "bar")
    p, e = np.zeros((1, 3)), np.linspace(-1, 1, 3)[None] * 1e-5
    seen = expand(
        source, body, Trajectory(times=np.zeros(1), coordinates=e, position=p, loads=LOADS[None]), recovery=stress
    )
    plain = expand(
        source, body, Trajectory(times=np.zeros(1), coordinates=e @ frame.elastic.T, loads=LOADS[None]), recovery=stress
    ).displacement[0]
    difference, x = (seen.displacement[0] - plain), source.coordinates
    arms = np.hstack(
        [
            np.broadcast_to(np.eye(3), (len(x), 3, 3)).reshape(-1, 3),
            -np.cross(np.eye(3)[None], x[:, None], axisa=2, axisb=2).reshape(-1, 3),
        ]
    )
    rigid = arms @ np.linalg.lstsq(arms, difference.ravel(), rcond=None)[0]
    assert np.abs(rigid - difference.ravel()).max() < 1e-9 * np.abs(plain).max()
    left = seen.displacement[0][np.isclose(x[:, 0], 0.0)]
    scale = np.abs(plain).max()
    if kind == "mean-axes":
        assert np.abs(difference).max() < 1e-9 * scale
    elif kind == "tangent":
        assert np.abs(left).max() < 1e-9 * scale < np.abs(difference).max()
    else:
        assert 1e-9 * scale < np.abs(left).max()
    np.testing.assert_allclose(seen.motion[0], seen.displacement[0] - frame.origin, rtol=0, atol=1e-15)


def test_stress_of_a_simulated_body_under_load_is_that_of_beam_theory(tmp_path):
    """Three free modes know little of a cantilever; the loads that the simulator gives make its stress right."""
    L, b, h, P, turn = 0.5, 0.04, 0.03, 200.0, exponential(np.array([0.5, 1.1, -0.4]))
    model = steel(box("hex20", (10, 2, 2), (L, b, h)))
    faces = [
        make_interface(model, name=n, nodes=where(model, 0, x), coupling="average")
        for n, x in (("left", 0.0), ("right", L))
    ]
    with Problem(model, faces) as problem:
        reduced = Modal(modes=3).reduce(problem, "bar")
        delivered = elastic_body(problem, reduced, make_part(problem))
        delivered = dataclasses.replace(delivered, recovery=stress_recovery(problem, reduced, single=False))
        source = read_body(write_body(tmp_path / "bar.h5", [delivered]))
    frame = source.bodies["bar"].floating
    damped = dataclasses.replace(frame, De=2 * np.diag(np.sqrt(np.diag(frame.Ke) * np.diag(frame.integrals.Me))))
    system = System()
    body = system.add(FlexibleBody(damped, rotation=turn, name="bar"))
    at = body.marker("left").place(body.start()[0])
    system.add(FixedJoint(ground.marker_at(at.position), body.marker("left")))
    system.add(PointLoad(body.marker("right"), force=turn @ (0, 0, P)))
    motion = simulate(system, end=0.1, step=1e-3, rho=0.5).trajectory(body, interfaces=["left", "right"])
    last = {name: value[-1:] for name, value in motion.items()}
    assert np.allclose(last["loads"][0], [0, 0, -P, 0, P * L, 0, 0, 0, P, 0, 0, 0], atol=2e-3 * P)
    top = (np.abs(model.nodes.xyz[:, 0] - L / 2) < 1e-9) & (model.nodes.xyz[:, 2] > 0.99 * model.nodes.xyz[:, 2].max())
    labels = model.nodes.ids[top]
    stored = stored_recovery(tmp_path / "bar.h5", "bar")
    exact = -P * (L / 2) * (h / 2) / (b * h**3 / 12)
    for loads, error in ((last["loads"], 0.01), (None, None)):
        stress = expand(source, source.bodies["bar"], Trajectory(**{**last, "loads": loads}), recovery=stored).stress
        axial = stress[0, np.isin(stored.points, labels), 0]
        if error is None:
            assert np.abs(axial / exact - 1).min() > 0.05
        else:
            assert np.abs(axial / exact - 1).max() < error


def test_elastic_coordinates_alone_are_noted(tmp_path):
    model = steel(box("hex8", (3, 1, 1), (0.3, 0.05, 0.04)))
    with Problem(model) as problem:
        reduced = Modal(modes=2).reduce(problem, "bar")
        path = write_body(tmp_path / "bar.h5", [elastic_body(problem, reduced, make_part(problem))])
    still = {"times": np.zeros(1), "position": np.zeros((1, 3)), "rotation": np.eye(3)[None]}
    for given, count, words in (
        (("times",), 2, "no position and rotation of the frame was given: motions are those seen from"),
        (("times", "position"), 2, "no rotation of the frame was given: the rotation of the frame is fixed"),
        (("times", "position", "rotation"), 2, ""),
        (("times",), 8, ""),
    ):
        motion = Trajectory(coordinates=np.zeros((1, count)), **{name: still[name] for name in given})
        notes = recover(path, motion, tmp_path / "out.vtkhdf", stress=False).notes
        assert words in "".join(notes) and bool(notes) == bool(words)
    np.savez(tmp_path / "t.npz", zeit=np.zeros(1), coordinates=np.zeros((1, 8)))
    with refusal("unknown", "", "t.npz", "'zeit'", "times"):
        recover(path, tmp_path / "t.npz", tmp_path / "out.vtkhdf", stress=False)


def test_the_worse_stress_is_shown_where_materials_meet(tmp_path):
    """Bending of two materials: at their common nodes the file shows the stress of the stiff one."""
    mesh = box("hex20", (4, 1, 2), (0.4, 0.05, 0.1))
    low = mesh.nodes.xyz[mesh.blocks[0].nodes].mean(axis=1)[:, 2] < 0.05
    ids = np.random.default_rng(1).permutation(len(mesh.nodes)) + 5
    mesh = Mesh(
        nodes=Nodes(ids=ids, xyz=mesh.nodes.xyz),
        blocks=mesh.blocks,
        element_sets={"soft": (np.flatnonzero(low),), "hard": (np.flatnonzero(~low),)},
    )
    model = assemble(mesh, [isotropic(set="soft", young=1e9, poisson=0.3, density=1e3), isotropic(set="hard", **STEEL)])
    interfaces = [make_interface(model, name=n, nodes=where(model, 0, x)) for n, x in (("left", 0.0), ("right", 0.4))]
    with Problem(model, interfaces) as problem:
        reduced = CraigBampton(modes=0).reduce(problem)
        path = write_body(tmp_path / "two.h5", [elastic_body(problem, reduced, make_part(problem, "skin"))])
        recovery = stress_recovery(problem, reduced, nodes="all")
    with h5py.File(path, "r+") as file:
        Writer(file).rows(f"bodies/{reduced.name}/recovery/", RECOVERY, recovery_parts(recovery))
    assert stored_recovery(path, reduced.name).stress.dtype == np.float32
    q = np.zeros((1, 12))
    q[0, [6, 10]] = 1e-4, 1e-3
    recover(path, Trajectory(times=np.zeros(1), coordinates=q), tmp_path / "out.vtkhdf")
    ((_, _, _, data),) = steps_of(tmp_path / "out.vtkhdf")[1]
    size = von_mises(recovery.at(q)[0])
    labels = read_body(path).node_ids
    worst = np.array([size[recovery.points == label].max() for label in labels])
    seam = [(recovery.points == label).sum() > 1 for label in labels]
    assert sum(seam) > 10 and (np.array([np.ptp(size[recovery.points == n]) for n in labels[seam]]) > 1e5).all()
    close(data["von_mises"], worst)
    close(von_mises(data["stress"]), worst)


def test_every_format_gives_the_same_trajectory(bar, tmp_path):
    A = np.array([turn(0.1, [1, 0, 0]), turn(0.2, [0, 1, 1]), turn(0.3, [1, 2, 3])])
    given = Trajectory(
        times=bar.given.times, coordinates=bar.given.coordinates, position=np.eye(3), rotation=A, loads=bar.given.loads
    )
    save(tmp_path / "t.npz", given)
    with h5py.File(tmp_path / "t.h5", "w") as file:
        for name, value in vars(given).items():
            file[name.replace("times", "time")] = value
    k, m = given.coordinates.shape[1], given.loads.shape[1]
    names = [
        "t",
        *(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)),
        *(f"q{i}" for i in range(k, 0, -1)),
        "x",
        "y",
        "z",
        *(f"F{i}" for i in range(1, m + 1)),
    ]
    table = np.column_stack([given.times, A.reshape(3, 9), given.coordinates[:, ::-1], given.position, given.loads])
    for name, comma, head in (("t.csv", ",", ""), ("t2.csv", ";", ""), ("t.txt", " ", "# "), ("t.dat", "\t", "")):
        lines = [comma.join(repr(float(v)) for v in row) for row in table]
        (tmp_path / name).write_text("\n".join([head + comma.join(names), *lines, ""]))
    for name in ("t.npz", "t.h5", "t.csv", "t2.csv", "t.txt", "t.dat"):
        trajectory = read_trajectory(tmp_path / name)
        for field, value in vars(given).items():
            np.testing.assert_array_equal(getattr(trajectory, field), value, err_msg=f"{name} {field}")


def bad_trajectories():
    t, q = np.arange(3.0), np.ones((3, 16))
    nan = q.copy()
    nan[1, 4] = np.nan
    return {
        "five coordinates": (("value", "coordinates", "5", "16", "'cb'"), {"coordinates": q[:, :5]}),
        "no number": (("value", "coordinates", "t.npz", "2", "3"), {"coordinates": nan}),
        "equal times": (("value", "times", "t.npz", "3", "1"), {"time": np.array([0.0, 1.0, 1.0])}),
        "steps without times": (("value", "coordinates", "(2,", "16)", "(3,"), {"coordinates": q[:2]}),
        "no steps": (("missing", "times", "t.npz"), {"time": t[:0], "coordinates": q[:0]}),
        "three loads": (("value", "loads", "3", "12", "'cb'"), {"loads": q[:, :3]}),
        "frame": (("conflict", "frame", "'cb'", "16", "10"), {"position": np.zeros((3, 3))}),
        "rotation": (("value", "rotation", "t.npz", "1", "7.5e-01"), {"rotation": np.full((3, 3, 3), 0.5)}),
        "unknown": (("unknown", "", "t.npz", "'load'", "'loads'"), {"load": q}),
        "texts": (("value", "", "coordinates", "<U1"), {"coordinates": np.full((3, 16), "a")}),
        "infinite time": (("value", "times", "t.npz", "3"), {"time": np.array([0.0, 1.0, np.inf])}),
        "complex": (("value", "", "coordinates", "complex128"), {"coordinates": q * 1j}),
    }


def test_packed_zeros_do_not_fill_the_memory(bar, tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "t.npz", time=np.arange(3.0), coordinates=np.zeros((3, 10**6)))
    has_memory(monkeypatch, free=7_000_000)
    with refusal("file", "", "t.npz", "2.4e+07", "7e+06"):
        recover(bar.path, tmp_path / "t.npz", tmp_path / "out.vtkhdf", body="cb")


@pytest.mark.parametrize(("words", "arrays"), bad_trajectories().values(), ids=bad_trajectories())
def test_a_bad_trajectory_is_one_message_and_the_old_file_stays(bar, tmp_path, words, arrays):
    out = tmp_path / "out.vtkhdf"
    out.write_text("old")
    np.savez(tmp_path / "t.npz", **{"time": np.arange(3.0), "coordinates": np.ones((3, 16)), **arrays})
    with refusal(*words):
        recover(bar.path, tmp_path / "t.npz", out, body="cb")
    assert out.read_text() == "old" and sorted(p.name for p in tmp_path.iterdir()) == ["out.vtkhdf", "t.npz"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("t.csv", "0,1,2\n", ("value",)),
        ("t.csv", "", ("value",)),
        ("t.csv", "t,q1,q3\n0,1,2\n", ("value", "", "q1", "q2")),
        ("t.csv", "t,q1,q1\n0,1,2\n", ("conflict", "", "q1")),
        ("t.csv", "t,q1,x,y,z,x\n0,1,2,3,4,5\n", ("conflict", "", "x")),
        ("t.csv", "t,q1,rx,ry,rz\n0,1,30,0,0\n", ("value", "", "rx")),
        ("t.csv", "t,q1,q2\n0,1,2\n1,2\n", ("value",)),
        ("t.csv", "t,q1,q2\n0,1\n1,2\n", ("value",)),
        ("t.csv", "t,q1\n0,one\n", ("value",)),
        ("t.csv", "t,q1,v1\n0,1,2\n", ("value", "", "v1")),
        ("t.csv", "t,q1,x,y\n0,1,2,3\n", ("value",)),
        ("t.csv", "t,q1\n", ("missing", "times")),
        ("t.npz", "no zip", ("file", "t.npz")),
        ("t.h5", "no hdf", ("file", "t.h5", "HDF5")),
        ("t.mat", "", ("file",)),
    ],
)
def test_a_bad_trajectory_file_is_one_message(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with refusal(*message):
        read_trajectory(tmp_path / name)


def test_arrays_in_groups_are_not_overlooked(tmp_path):
    with h5py.File(tmp_path / "t.h5", "w") as file:
        file["times"], file["coordinates"], file["at/loads"] = np.zeros(1), np.zeros((1, 9)), np.ones((1, 12))
    with refusal("value", "", "at"):
        read_trajectory(tmp_path / "t.h5")


def test_coordinates_in_other_units_are_noted(modal, tmp_path):
    """Elastic coordinates a thousand times too large: the body would deform by its own size."""
    for size, far in ((0.02, False), (20.0, True)):
        given = Trajectory(times=np.arange(2.0), coordinates=np.array([[0, 0, 0], [size, 0, 0]]))
        notes = recover(modal.path, given, tmp_path / "out.vtkhdf").notes
        assert any("check the units of the coordinates" in note and "at 1 s" in note for note in notes) == far
    rigid = Trajectory(times=np.zeros(1), coordinates=np.eye(9)[:1] * 100)
    assert not any("units" in note for note in recover(modal.path, rigid, tmp_path / "out.vtkhdf").notes)


def test_what_recover_refuses(bar, tmp_path):
    out = tmp_path / "out.vtkhdf"
    save(tmp_path / "t.npz", bar.given)
    for change, message in (
        ({}, ("missing",)),
        ({"body": "bared"}, ("unknown", "", "bare")),
        ({"body": "bare"}, ("value", "coordinates", "9", "16")),
        ({"body": "cb", "every": 0}, ("value", "every")),
        ({"body": "cb", "scale": np.nan}, ("value", "scale")),
    ):
        with refusal(*message):
            recover(bar.path, tmp_path / "t.npz", out, **change)
    nine = Trajectory(times=np.zeros(1), coordinates=np.zeros((1, 9)))
    with refusal("missing", "stress"):
        recover(bar.path, nine, out, body="bare")
    assert isinstance(recover(bar.path, nine, out, body="bare", stress=False), Recovered)
    with refusal("file", "none.npz"):
        recover(bar.path, tmp_path / "none.npz", out, body="cb")
    with refusal("value", "out"):
        recover(bar.path, tmp_path / "t.npz", tmp_path / "out.vtk", body="cb")
    with refusal("output", "", tmp_path / "no", by=OutputError):
        recover(bar.path, tmp_path / "t.npz", tmp_path / "no" / "out.vtkhdf", body="cb")
    same = tmp_path / "t.hdf"
    same.write_text("")
    with refusal("output", "", same, by=OverwriteError):
        recover(bar.path, same, same, body="cb")


def test_a_full_disk_is_one_message_and_the_old_file_stays(bar, tmp_path):
    """The limit of the file size of a process stands for the end of the disk."""
    out = tmp_path / "out.vtkhdf"
    out.write_text("old")
    long = Trajectory(times=np.arange(400.0), coordinates=np.zeros((400, bar.cb.order)))
    save(tmp_path / "t.npz", long)

    def work():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
        with pytest.raises(OutputError) as refused:
            recover(bar.path, "t.npz", "out.vtkhdf", body="cb")
        sys.stdout.write(str(refused.value))

    done = apart(work, tmp_path)
    assert done.code == 0 and not done.errors
    assert "File too large" in done.output and "step" in done.output and "unchanged" in done.output
    assert out.read_text() == "old" and sorted(p.name for p in tmp_path.iterdir()) == ["out.vtkhdf", "t.npz"]
