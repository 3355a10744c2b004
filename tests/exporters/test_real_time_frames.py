"""Floating frames for real time: bodies bend at once where their fast modes did, in FMUs, C code and Exudyn."""

import subprocess
from dataclasses import replace

import h5py
import numpy as np
import pytest
import scipy.linalg

from morembs import read_body
from morembs.body.vtkhdf_series import stored_recovery
from morembs.exporters import export_body, step_for_band
from morembs.exporters.exudyn_system import ExudynBody, ExudynSystem
from morembs.exporters.slow_frame import SplitFrame
from morembs.reducers import CraigBampton
from tests.support.fmus import HEIGHT, LENGTH, WIDTH, InCasadi, by_axes, exported, needs_compiler, run, strip

STEP, NODE = 1e-4, 8
ENDS = ("left_end", "tip")
LOADS = by_axes(*(f"{end}.{kind}" for end in ENDS for kind in ("force", "moment")))


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return strip(tmp_path_factory.mktemp("frames"), CraigBampton(modes=30), kind="mean-axes")


def fast_compliance(source, step=STEP):
    """(12, 12): static compliance of the interfaces by the modes beyond the step, from the matrices of the file."""
    body = read_body(source).bodies["strip"]
    values, Y = body.reduced.modes()
    fast = np.sqrt(np.maximum(values, 0.0)) * step > 1
    motion = (body.output_matrix @ Y)[:, fast]
    return (motion / values[fast]) @ motion.T


@needs_compiler
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_floating_fmu_bends_at_once_by_the_modes_that_are_gone(source, fmi):
    """Positions and stresses under loads at rest, beside those of all modes that have come to rest."""
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    fmu = exported(source, f"bent{fmi[0]}", fmi=fmi, time_step=STEP, stress=[NODE])
    assert not validation.validate_fmu(str(fmu))
    loads = np.random.default_rng(1).standard_normal(12)
    short = InCasadi(fmu)
    (_, bent), (_, free) = (short({"quaternion.w": 1.0}, dict(zip(LOADS, k * loads, strict=True))) for k in (1, 0))
    places = by_axes("left_end.position", "tip.position")
    shift = np.array([bent[name] - free[name] for name in places])
    wanted = (fast_compliance(source) @ loads)[[0, 1, 2, 6, 7, 8]]
    assert np.abs(shift - wanted).max() < 1e-9 * np.abs(wanted).max() and np.abs(wanted).max() > 1e-8
    # Half of the rotation vector, as it is small.
    turn = np.array([2 * bent[f"tip.quaternion.{axis}"] for axis in "xyz"])
    assert turn == pytest.approx((fast_compliance(source) @ loads)[9:], rel=1e-6)
    # Outputs say that they follow inputs.
    description = fmpy.read_model_description(str(fmu))
    for output in description.outputs:
        assert {"tip.force.x", "left_end.moment.z"} <= {variable.name for variable in output.dependencies}


def test_coordinates_with_next_to_no_mass_become_their_compliance_and_nothing_else(source):
    """The tip on springs whose coordinates vibrate at 1e8 rad/s: what a message proposes for ones without mass."""
    frame = read_body(source).bodies["strip"].floating
    K, P = np.diag([2e6, 1e6, 1e6, 2e2, 3e2, 3e2]), np.eye(frame.count, frame.count + 6)
    parts, add = frame.integrals, scipy.linalg.block_diag
    integrals = replace(
        parts,
        Ct=P.T @ parts.Ct,
        Cr=P.T @ parts.Cr,
        Me=add(parts.Me, 1e-16 * K),
        x_phi=parts.x_phi @ P,
        phi_phi=P.T @ parts.phi_phi @ P,
    )
    markers = {
        name: replace(marker, motion=np.hstack([marker.motion, np.eye(6) * (name == "tip")]))
        for name, marker in frame.markers.items()
    }
    light = replace(
        frame,
        elastic=np.pad(frame.elastic, ((0, 0), (0, 6))),
        Ke=add(frame.Ke, K),
        De=add(frame.De, 0 * K),
        integrals=integrals,
        markers=markers,
    )
    whole, split = (SplitFrame.of(each, STEP) for each in (frame, light))
    assert split.slow.sum() == whole.slow.sum() and split.omega.max() == pytest.approx(1e8, rel=1e-6)
    expected = whole.static_modes.motion @ whole.static_modes.motion.T
    expected[6:, 6:] += np.linalg.inv(K)
    size = np.sqrt(np.diag(expected))
    found = split.static_modes.motion @ split.static_modes.motion.T
    assert np.abs((found - expected) / np.outer(size, size)).max() < 1e-9
    # The shapes of Exudyn's file have it, too, and vibrate no faster than the step resolves.
    run, _ = split.with_static_shapes(LENGTH)
    motion = np.vstack([marker.motion for marker in run.in_frame("mean-axes").markers.values()])
    slow = split.motion[:, split.slow] / split.omega[split.slow]
    short = motion @ np.linalg.solve(run.Ke, motion.T) - slow @ slow.T
    assert np.abs((short - expected) / np.outer(size, size)).max() < 1e-8
    assert scipy.linalg.eigh(run.Ke, run.integrals.Me, eigvals_only=True)[-1] ** 0.5 * STEP <= 1 + 1e-6


@needs_compiler
def test_a_step_that_resolves_no_mode_leaves_rigid_motion_and_compliance(source):
    """The slowest mode is at 166 Hz. Code without elastic states compiles without a warning, and moves as all modes."""
    step, loads = 2e-3, np.random.default_rng(2).standard_normal(12)
    code = exported(source, "rigid", to="c", time_step=step)
    assert "0 of 36 modes" in (text := code.with_suffix(".h").read_text()) and "RIGID_STATES = 13" in text
    subprocess.run(
        ["cc", "-c", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", code], cwd=code.parent, check=True
    )
    short = InCasadi(exported(source, "rigid", time_step=step))
    rates, bent = short({"quaternion.w": 1.0}, dict(zip(LOADS, loads, strict=True)))
    _, free = short({"quaternion.w": 1.0}, {})
    shift = [bent[name] - free[name] for name in by_axes("left_end.position", "tip.position")]
    wanted = (fast_compliance(source, step) @ loads)[[0, 1, 2, 6, 7, 8]]
    assert shift == pytest.approx(wanted, rel=1e-8, abs=1e-9 * np.abs(wanted).max())
    # Newton's law at the centre of mass.
    integrals = read_body(source).bodies["strip"].floating.integrals
    speeding, turning = ([rates[f"{name}.{axis}"] for axis in "xyz"] for name in ("velocity", "angular_velocity"))
    moved = integrals.mass * (np.array(speeding) + np.cross(turning, integrals.center))
    assert moved == pytest.approx(loads[:3] + loads[6:9], rel=1e-6)
    done = export_body(source, "exudyn", path=source.with_name("few.exudyn.hdf5"), options={"time_step": step})
    assert "0 of 36 modes" in done.notes[0]
    with h5py.File(done.paths[0]) as file:
        assert file["stiffnessMatrixReduced"].shape == (12, 12)


@needs_compiler
def test_stretch_and_stress_of_a_spinning_body_are_those_of_all_modes(source):
    """Damped until it rests in the turning frame: the modes that are gone follow the spin, too."""
    fmpy = pytest.importorskip("fmpy")
    found = []
    for name, options in (("every", {}), ("slow", {"time_step": STEP})):
        fmu = exported(source, f"spun_{name}", stress=[NODE], **options)
        outputs = [*by_axes("left_end.position", "tip.position"), f"stress.node_{NODE}.xx"]
        start = {"angular_velocity.z": 60.0, "damping_ratio": 0.7}
        last = run(fmpy, fmu, 0.1, 1e-3, outputs, start_values=start)[-1]
        found.append((np.linalg.norm(last[3:6] - last[:3]) - LENGTH, last[6]))
    assert found[0][0] > 1e-6
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    # Fast modes carry most of both: the first one along the axis is at 1,614 Hz.
    split = SplitFrame.of(read_body(source).bodies["strip"].floating, STEP)
    gone = split.static_modes
    assert abs(np.diff((gone.motion @ gone.x_phi[0])[[0, 6]])[0]) * 60.0**2 > 0.5 * found[0][0]


@needs_compiler
def test_velocities_are_the_rates_of_positions_while_loads_stay(source):
    """Of a spinning body: in its frame the loads turn, and with them the static deflection."""
    short = InCasadi(exported(source, "rates", time_step=STEP))
    states = {"quaternion.w": 1.0, "angular_velocity.z": 20.0, "velocity.x": 1.0}
    # The same on both ends, along an axis of the section, so that the spin stays.
    loads = {f"{end}.force.{axis}": value for end in ENDS for axis, value in zip("xyz", (0.0, 3e4, 0.0), strict=True)}
    rates, now = short(states, loads)
    dt, later = 1e-6, []
    for sign in (-1, 1):
        moved = {name: states.get(name, 0.0) + sign * dt * rate for name, rate in rates.items()}
        later.append(short(moved, loads)[1])
    for end in ENDS:
        for axis in "xyz":
            rate = (later[1][f"{end}.position.{axis}"] - later[0][f"{end}.position.{axis}"]) / (2 * dt)
            assert now[f"{end}.velocity.{axis}"] == pytest.approx(rate, rel=1e-6, abs=1e-7)
    assert abs(now["tip.velocity.x"] - 1.0) > 1e-4


def test_shapes_in_exudyns_file_have_the_compliance_of_the_modes_and_the_error_holds(source, tmp_path):
    """Beside the modes of the body file, on the imaginary axis; nothing vibrates faster than the step resolves."""
    done = export_body(source, "exudyn", path=tmp_path / "x.exudyn.hdf5", options={"time_step": STEP})
    assert done.notes[0].startswith(
        "time step 0.0001 s: 7 of 36 modes, up to 1592 Hz; the others are static compliance"
    )
    assert done.notes[2] == "modes from 8 on stand for the compliance of the others"
    body = read_body(source).bodies["strip"]
    with h5py.File(done.paths[0]) as file:
        M, K = file["massMatrixReduced"][()], file["stiffnessMatrixReduced"][()]
        assert file.attrs["time_step"] == STEP and list(file.attrs["real_time"]) == list(done.notes[:4])
        basis = file["modeBasis"][()].reshape(-1, 3, len(M))
    values = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True))
    assert len(values) == 19 and values.max() * STEP <= 1 + 1e-9
    # Mean displacement of the nodes of a rigid interface is that of its point.
    points = [interface.nodes for interface in read_body(source).interfaces.values()]
    motion = np.vstack([basis[nodes].mean(axis=0) for nodes in points])
    every, Y = body.reduced.modes()
    elastic = every > 1.0
    rows = (body.output_matrix @ Y)[[0, 1, 2, 6, 7, 8]][:, elastic]

    def difference(omega):
        short = motion @ np.linalg.solve(K - omega**2 * M, motion.T)
        return np.abs(short - (rows / (every[elastic] - omega**2)) @ rows.T).max()

    size = np.abs((rows / every[elastic]) @ rows.T).max()
    assert difference(0.0) < 1e-9 * size
    told = [float(word) for word in done.notes[1].partition("displacements ")[2].partition(";")[0].split(", ")]
    for hz, limit in zip((159.1, 397.8, 795.7), told, strict=True):
        worst = max(
            difference(2 * np.pi * f)
            for f in np.linspace(0.0, hz, 40)
            if abs(every[elastic] - (2 * np.pi * f) ** 2).min() > 1.0
        )
        assert worst / size <= limit


def test_exudyn_moves_a_body_with_fewer_coordinates_as_with_all(source):
    """A strip held at its left end under a burst of 100 Hz, at steps of 1e-4 s, beside all modes at a tenth of it."""
    pytest.importorskip("exudyn")
    force = np.array([100.0, 0.3, 0.5])

    def path(time_step, step):
        body = ExudynBody.of(source, time_step=time_step)
        system = ExudynSystem()
        part = system.elastic(body, position=body.floating.origin)
        system.joint(system.at_ground((0, WIDTH / 2, HEIGHT / 2)), system.at_interface(part, "left-end"), (1,) * 6)
        tip = system.at_interface(part, "tip")

        def load(_mbs, t, _load):
            return (force * np.sin(2 * np.pi * 100 * t) * np.sin(np.pi * t / 0.02) ** 2).tolist()

        system.mbs.AddLoad(
            system.items.LoadForceVector(markerNumber=tip, loadVector=force.tolist(), loadVectorUserFunction=load)
        )
        (moved,) = system.solve(end=0.02, step=step, watch=[tip])[1]
        return body.floating.count, (moved - moved[0])[:: round(STEP / step)]

    (many, expected), (few, found), (_, fine) = path(None, STEP / 10), path(STEP, STEP), path(STEP, STEP / 10)
    assert (many, few) == (36, 19)
    size = np.abs(expected).max(axis=0)
    # Steps cost more than modes: (w h)^2 / 12 in the phase of each period.
    assert (np.abs(found - expected).max(axis=0) < 6e-3 * size).all()
    assert (np.abs(fine - expected).max(axis=0) < 3e-3 * size).all()


def test_a_check_knows_the_step_for_exudyn(source):
    found, errors = step_for_band(source, "exudyn", 100.0)
    assert found.kept < found.count and errors["displacements"] <= 1e-3
    assert errors["steps"] == pytest.approx((2 * np.pi * 100 * found.step) ** 2 / 12, rel=0.01)


@needs_compiler
def test_the_error_of_stresses_is_told_and_holds_beside_all_modes(source):
    """Under loads at the interfaces, by the modes of the body file on the imaginary axis."""
    done = export_body(source, "c", path=source.with_name("stressed.c"), options={"time_step": STEP, "stress": [NODE]})
    (note,) = (note for note in done.notes if "; stresses " in note)
    told = [float(word) for word in note.partition("stresses ")[2].partition(";")[0].split(", ")]
    split = SplitFrame.of(read_body(source).bodies["strip"].floating, STEP)
    recovery = stored_recovery(source, "strip")
    at = 6 * int(np.flatnonzero(recovery.points == NODE)[0]) + np.arange(6)
    elastic = read_body(source).bodies["strip"].floating.elastic
    stress = np.asarray(recovery.stress[at], float) @ recovery.deformation @ elastic @ split.T
    fast, squares, d = ~split.slow, split.omega**2, np.diag(split.damping)
    arm = np.sqrt(np.trace(read_body(source).inertia) / (2 * read_body(source).mass))
    loads = np.tile(np.repeat([1.0, arm], 3), 2)

    def response(s, which):
        return (stress[:, which] / (squares + s * d + s**2)[which]) @ split.motion[:, which].T * loads

    size = max(np.abs(response(0.0, slice(None))[:, at : at + 3]).max() for at in (0, 3, 6, 9))
    for hz, limit in zip((159.1, 397.8, 795.7), told, strict=True):
        worst = max(
            np.abs(response(2j * np.pi * f, fast) - response(0.0, fast)).max() for f in np.linspace(0.0, hz, 30)
        )
        assert 0.1 * limit * size < worst <= limit * size
