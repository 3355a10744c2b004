"""The MuJoCo model, run by MuJoCo, against the simulator of morembs."""

from xml.etree import ElementTree

import numpy as np
import pytest
import scipy.linalg as sl

from morembs import elastic_body, make_part, read_body, write_body
from morembs.body.floating.frame import floating_frame
from morembs.dynamics.multibody import FlexibleBody, PointLoad, System, simulate
from morembs.exporters import export_body
from morembs.exporters.mujoco_slides import largest_responses
from morembs.exporters.read_back import FirstOrder
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

INSTALL = "MuJoCo is not installed: pip install mujoco"


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    """A soft rod, stored in a tangent frame."""
    model = steel(box("hex8", (6, 1, 1), (0.5, 0.02, 0.02)), young=2e9)
    faces = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.5))]
    with Problem(model, faces, damping=Damping(beta=1e-5)) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=("left",), origin=(0.1, 0.0, 0.01))
        body = elastic_body(problem, reduced, make_part(problem), floating=frame)
    return write_body(tmp_path_factory.mktemp("rod") / "rod.h5", [body])


@pytest.fixture(scope="module")
def stiff(tmp_path_factory):
    """A rod with modes from 377 to 7,300 Hz."""
    model = steel(box("hex8", (6, 1, 1), (0.5, 0.02, 0.02)), young=2e10)
    faces = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.5))]
    with Problem(model, faces, damping=Damping(beta=1e-6)) as problem:
        body = elastic_body(problem, CraigBampton(modes=6).reduce(problem, "cb"), make_part(problem))
    return write_body(tmp_path_factory.mktemp("stiff") / "rod.h5", [body])


def test_a_pushed_rod_moves_and_bends_as_it_should(rod, tmp_path):
    mujoco = pytest.importorskip("mujoco", reason=INSTALL)
    done = export_body(rod, "mujoco", path=tmp_path / "rod.xml")
    model = mujoco.MjModel.from_xml_path(str(done.paths[0]))
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0
    push, end, step = np.array([0.0, 0.0, 5.0]), 0.02, model.opt.timestep
    tip = model.body("cb:right").id
    data.xfrc_applied[tip, :3] = push
    times, places = [], []
    while data.time < end:
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        times.append(data.time)
        places.append(data.xpos[tip].copy())
    stored = read_body(rod).bodies["cb"].floating
    system = System(gravity=(0, 0, 0))
    body = system.add(FlexibleBody(stored.in_frame("mean-axes"), position=stored.origin))
    system.add(PointLoad(body.marker("right"), force=push))
    result = simulate(system, end=end + 2 * step, step=2e-5)
    # Under a constant force the steps of MuJoCo are half a step ahead.
    ahead = np.array(times) + 0.5 * step
    wanted = np.stack([np.interp(ahead, result.time, values) for values in result.position(body.marker("right")).T], 1)
    bent = np.abs(stored.in_frame("mean-axes").markers["right"].motion[:3] @ result.elastic(body).T).max()
    assert 4e-5 < bent < 6e-5 and wanted[-1, 2] - wanted[0, 2] > 2e-3
    assert np.abs(np.array(places) - wanted).max() < 1e-3 * bent


def test_mass_and_inertia_are_those_of_the_part(rod, tmp_path):
    """What the interfaces take is taken off elsewhere."""
    mujoco = pytest.importorskip("mujoco", reason=INSTALL)
    source = read_body(rod)
    model = mujoco.MjModel.from_xml_path(str(export_body(rod, "mujoco", path=tmp_path / "rod.xml").paths[0]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moved = range(1, 4)
    masses = model.body_mass[list(moved)]
    assert masses.sum() == pytest.approx(source.mass, rel=1e-9)
    assert masses @ data.xipos[list(moved)] / masses.sum() == pytest.approx(source.center_of_mass, abs=1e-9)
    J = np.zeros((3, 3))
    for body in moved:
        R, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - source.center_of_mass
        J += R @ np.diag(model.body_inertia[body]) @ R.T
        J += model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    assert pytest.approx(source.inertia, abs=1e-9 * np.trace(source.inertia)) == J


def test_fast_modes_may_be_left_out_as_far_as_the_compliance_stays(rod, tmp_path):
    whole = export_body(rod, "mujoco", path=tmp_path / "all.xml")
    assert whole.notes[0].startswith("10 of 10 modes")
    options = {"highest_hz": 2000.0, "tolerance": 0.2}
    fewer = export_body(rod, "mujoco", path=tmp_path / "few.xml", options=options)
    step = [float(ElementTree.parse(done.paths[0]).find("option").get("timestep")) for done in (whole, fewer)]
    assert step[1] > 1.5 * step[0]
    for highest in (400.0, 10.0):
        with refusal("value", "highest_hz"):
            export_body(rod, "mujoco", path=tmp_path / "x.xml", options={"highest_hz": highest})
    for key in ("share", "tolerance"):
        with refusal("value", key, "'mujoco'", "1.5"):
            export_body(rod, "mujoco", path=tmp_path / "x.xml", options={key: 1.5})
    with refusal("value", "share"):
        export_body(rod, "mujoco", path=tmp_path / "x.xml", options={"share": 0.4})
    # Less mass than MuJoCo takes, with a time step or without.
    for more in ({}, {"time_step": 1e-4}):
        with refusal("value", "share", "1e-14", "1e-15"):
            export_body(rod, "mujoco", path=tmp_path / "x.xml", options={"share": 1e-14} | more)
    assert not (tmp_path / "x.xml").exists()
    assert not (tmp_path / "x.xml").exists()


def swung(path, axis, hz, refined=1):
    """Times and motions of the right end under a burst of a force along ``axis``, and that force."""
    mujoco = pytest.importorskip("mujoco", reason=INSTALL)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    model.opt.gravity[:] = 0
    model.opt.timestep /= refined
    tip = model.body("cb:right").id
    mujoco.mj_forward(model, data)
    start, end, step, places = float(data.xpos[tip, axis]), 4 / hz, model.opt.timestep, []

    def force(time):
        return np.sin(np.pi * time / end) ** 2 * np.cos(2 * np.pi * hz * time)

    for k in range(round(1.5 * end / step)):
        data.xfrc_applied[tip, axis] = force(k * step) if k * step < end else 0.0
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        places.append(data.xpos[tip, axis] - start)
    return step, np.array(places), lambda time: force(time) if time < end else 0.0


def exact(body, axis, step, count, force, fine=20):
    """The same motion by the matrices of the body file, at ``count`` steps."""
    n, row = len(body.mass_matrix), 6 + axis
    load = np.linalg.solve(body.mass_matrix, body.input_matrix[:, row])
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:n, n : 2 * n] = np.eye(n)
    parts = np.hstack([body.stiffness_matrix, body.damping_matrix])
    whole[n : 2 * n] = np.hstack([-np.linalg.solve(body.mass_matrix, parts), load[:, None]])
    once = sl.expm(step / fine * whole)[: 2 * n]
    x, result = np.zeros(2 * n), []
    for k in range(count * fine):
        x = once @ np.append(x, force((k + 0.5) * step / fine))
        if (k + 1) % fine == 0:
            result.append(body.output_matrix[row] @ x[:n])
    return np.array(result)


@pytest.mark.parametrize("axis", [0, 2])
def test_in_real_time_a_rod_moves_as_it_should(stiff, tmp_path, axis):
    """Up to 100 Hz, by 10,000 steps a second. Along the axis all stretch is that of slides: 1 % of the motion."""
    done = export_body(stiff, "mujoco", path=tmp_path / "rod.xml", options={"time_step": 1e-4})
    assert done.notes[0].startswith(
        "time step 0.0001 s: 5 of 12 modes, up to 1592 Hz; the others are static compliance"
    )
    assert float(done.notes[1].partition("displacements ")[2].partition(",")[0]) < 5e-3
    assert "at most: displacements" in done.notes[1] and "1% of damping at resonances" in done.notes[4]
    assert any(note.startswith("1 s costs ") and note.endswith("step 0.0001 s") for note in done.notes)
    text = done.paths[0].read_text()
    assert "costs" not in text
    assert "<!-- time step 0.0001 s: 5 of 12 modes" in text and 'timestep="0.0001"' in text
    step, places, force = swung(done.paths[0], axis, 100.0)
    wanted = exact(read_body(stiff).bodies["cb"], axis, step, len(places), force)
    assert len(places) == 600
    assert np.abs(places - wanted).max() < 1e-3 * np.abs(wanted).max()


@pytest.mark.parametrize("damping", [0.0, 1e-3, 0.4])
def test_the_limit_of_a_response_holds_between_its_peaks_and_is_sharp(damping):
    """Of two chains that differ a little, beside 20,000 frequencies."""
    rng = np.random.default_rng(5)
    omega = np.array([30.0, 170.0, 171.0, 900.0, 4000.0, 4000.0])
    still = np.zeros((6, 6))
    parts = [
        np.block([[still, np.diag(w)], [-np.diag(w), -2 * damping * np.diag(w)]])
        for w in (omega, omega * (1 + 1e-3 * rng.standard_normal(6)))
    ]
    B, C = rng.standard_normal((12, 2)), rng.standard_normal((3, 12))
    system = FirstOrder(A=sl.block_diag(*parts), B=np.vstack([B, B]), C=np.hstack([C, -C]), D=np.zeros((3, 2)))
    bands = [20.0, 200.0, 1000.0]
    values = np.abs([system.at(w * (1 - 0.01j), 0.0)[0] for w in np.linspace(0.0, 1000.0, 20001)]).max(axis=(1, 2))
    for limit, end in zip(largest_responses(system, bands), (401, 4001, 20001), strict=True):
        true = values[:end].max()
        assert true * (1 - 1e-9) <= limit <= 1.2 * true


def test_the_error_of_the_steps_is_told_apart_from_that_of_the_modes(stiff, tmp_path):
    """At 795.8 Hz, between resonances: steps put frequencies off by 1.1 %; a tenth leaves that of the modes."""
    done = export_body(stiff, "mujoco", path=tmp_path / "rod.xml", options={"time_step": 1e-4})
    assert "beside that, the steps of MuJoCo put frequencies too high by 4.2e-04 at 159.2 Hz" in done.notes[3]
    assert "1.1e-02 at 795.8 Hz" in done.notes[3]
    errors = []
    for refined in (1, 10):
        step, places, force = swung(done.paths[0], 2, 795.8, refined)
        wanted = exact(read_body(stiff).bodies["cb"], 2, step, len(places), force, fine=4)
        errors.append(np.abs(places - wanted).max() / np.abs(wanted).max())
    assert errors[0] > 0.02 and errors[1] < 0.2 * errors[0]


def test_slides_are_as_stiff_as_the_modes_that_are_gone(stiff, tmp_path):
    """The fastest joint vibrates as fast as the step resolves; a shorter step keeps all modes."""
    path = export_body(stiff, "mujoco", path=tmp_path / "rod.xml", options={"time_step": 1e-4}).paths[0]
    stiffness = [
        float(joint.get("stiffness")) for joint in ElementTree.parse(path).iter("joint") if joint.get("stiffness")
    ]
    assert len(stiffness) > 5 and np.sqrt(max(stiffness)) * 1e-4 <= 1 + 1e-9
    done = export_body(stiff, "mujoco", path=tmp_path / "rod.xml", options={"time_step": 1e-6})
    assert "resolves all 12 modes" in done.notes[0]
    # Where no mode is slow enough, slides have the compliance of all.
    done = export_body(stiff, "mujoco", path=tmp_path / "rod.xml", options={"time_step": 5e-4})
    assert "0 of 12 modes" in done.notes[0] and done.notes[2].startswith("modes from 1 on stand for")
    for options, words in (
        ({"time_step": 1e-4, "highest_hz": 900.0}, ("value", "highest_hz", "900", "0.0001")),
        ({"time_step": -0.1}, ("value", "time_step", "-0.1")),
    ):
        with refusal(*words):
            export_body(stiff, "mujoco", path=tmp_path / "x.xml", options=options)
    assert not (tmp_path / "x.xml").exists()


def test_tendons_that_yield_more_than_the_body_are_named_with_the_cure(tmp_path):
    """A steel rod that MuJoCo's tendons cannot hold: half the step makes them four times as stiff, as the mass does."""
    model = steel(box("hex8", (6, 1, 1), (0.1, 0.02, 0.02)))
    faces = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.1))]
    with Problem(model, faces, damping=Damping(beta=1e-7)) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        path = write_body(tmp_path / "stiff.h5", [elastic_body(problem, reduced, make_part(problem))])
    yields, errors = [], []
    for step, share in ((1e-4, 1e-3), (5e-5, 1e-3), (1e-4, 4e-3)):
        options = {"time_step": step, "share": share}
        notes = export_body(path, "mujoco", path=tmp_path / "x.mujoco.xml", options=options).notes
        (told,) = (note for note in notes if "tendons of MuJoCo yield" in note)
        assert "share=0.05" in told
        yields.append(float(told.partition(" ")[0]))
        errors.append(float(notes[1].rpartition("displacements ")[2].split(", ")[0]))
    assert yields[0] / yields[1] == pytest.approx(4, rel=0.2) and yields[0] / yields[2] == pytest.approx(4, rel=0.2)
    assert errors == pytest.approx(yields, rel=0.2)
