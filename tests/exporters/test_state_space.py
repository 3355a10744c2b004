"""State space: against dense dynamic stiffnesses, mass properties and static solutions; read back by other programs."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import scipy.signal
import scipy.sparse as sp
import scipy.sparse.linalg as spl

import morembs
from morembs import elastic_body, make_part, state_space
from morembs.body.build import body_of
from morembs.body.file import read_body, write_body
from morembs.exporters import export_body
from morembs.exporters.state_space_files import read_state_space, write_state_space
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.problem.damping import STRUCTURAL
from morembs.reducers import CraigBampton, Krylov
from tests.support.meshes import beam, box, ends, steel, where
from tests.support.processes import morembs as command
from tests.support.refusals import refusal

BASE, TIP = slice(0, 6), slice(6, 12)
EVERYTHING = ["base:reaction", "tip:displacement", "tip:velocity", "tip:acceleration"]


def reduced_body(coupling="rigid", reducer=None, young=2.1e11, **damping):
    model = steel(box("hex8", (6, 2, 2), (0.5, 0.05, 0.03)), young=young)
    with Problem(model, ends(model, coupling, base=0.0, tip=0.5), damping=Damping(**damping)) as problem:
        return elastic_body(problem, (reducer or CraigBampton(modes=8)).reduce(problem, "body"), make_part(problem))


@pytest.fixture(scope="module")
def body():
    """Soft free beam, so that dense dynamic stiffnesses are known to many digits at low frequencies. Its damping is not
    symmetric: part of the stiffness and a skew part, as flow in a tube has."""
    free = reduced_body(young=1e5, beta=1e-3)
    D = free.reduced.D
    size = np.sqrt(np.outer(np.diag(free.reduced.M), np.diag(free.reduced.M)))
    skewed = np.triu(np.random.default_rng(3).standard_normal(D.shape) * size, 1)
    reduced = replace(free.reduced, D=D + 2 * (skewed - skewed.T), W=free.reduced.V)
    return body_of(reduced, free.part, free.frequencies_hz)


def response(system, omega):
    """H(i omega) (p, m)."""
    return system.D + system.C @ np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B)


def exact(body, omega):
    """Outputs EVERYTHING under unit base accelerations and tip forces, by the condensed dynamic stiffness: interface
    degrees of freedom are coordinates of this body."""
    r, s = body.reduced, 1j * omega
    assert np.array_equal(r.B[:12], np.eye(12))
    Z = s * s * r.M + s * r.D + r.K
    b, e = slice(0, 6), slice(6, None)
    q = np.linalg.solve(Z[e, e], np.hstack([-Z[e, b] / s**2, np.eye(len(Z) - 6, 6)]))
    support = np.hstack([np.eye(6) / s**2, np.zeros((6, 6))])
    reaction = Z[b, b] @ support + Z[b, e] @ q
    return np.vstack([reaction, q[:6], s * q[:6], s * s * q[:6]])


def blockwise(H, wanted):
    """Largest error of each block of six rows and six columns, in parts of its largest entry."""
    return max(
        np.abs(H[r : r + 6, c : c + 6] - wanted[r : r + 6, c : c + 6]).max()
        / np.abs(wanted[r : r + 6, c : c + 6]).max()
        for r in range(0, len(H), 6)
        for c in (0, 6)
    )


@pytest.mark.parametrize("omega", [1.0, 30.0, 200.0])
def test_support_motion_is_that_of_the_condensed_stiffness(body, omega):
    system = state_space(body, ["base:acceleration", "tip:force"], EVERYTHING)
    assert blockwise(response(system, omega), exact(body, omega)) < 1e-10


def test_supports_that_strain_the_part(body):
    """Both ends move as told, twelve degrees of freedom of a part with six rigid-body motions."""
    system = state_space(body, ["base:acceleration", "tip:acceleration"], ["base:reaction", "tip:reaction"])
    r = body.reduced
    for omega in (1.0, 30.0):
        s = 1j * omega
        Z = s * s * r.M + s * r.D + r.K
        wanted = (Z[:12, :12] - Z[:12, 12:] @ np.linalg.solve(Z[12:, 12:], Z[12:, :12])) / s**2
        assert blockwise(response(system, omega), wanted) < 1e-10
    assert len(system.A) == 2 * 12 + 2 * (r.order - 12)


def test_the_large_mass_method_has_fewer_digits(body):
    """What a support loaded with a large mass gives for the reaction per acceleration, and what the product gives."""
    system, r, s = state_space(body, ["base:acceleration", "tip:force"], EVERYTHING), body.reduced, 30j
    wanted = exact(body, 30.0)[BASE, BASE]
    errors = []
    for factor in (1e3, 1e6, 1e9):
        M = r.M.copy()
        heavy = factor * np.diag(np.diag(r.M)[:6])
        M[:6, :6] += heavy
        q = np.linalg.solve(s * s * M + s * r.D + r.K, np.eye(len(M), 6) @ heavy)
        reaction = heavy - s * s * heavy @ q[:6]
        errors.append(np.abs(reaction - wanted).max() / np.abs(wanted).max())
    assert min(errors) > 1e-9
    assert np.abs(response(system, 30.0)[BASE, BASE] - wanted).max() < 1e-10 * np.abs(wanted).max() < min(errors)


def test_a_shaken_part_pulls_with_its_mass(body):
    """Slow accelerations of the only support: the reaction is the rigid mass, and no state drifts with the support."""
    damped = reduced_body(modal=0.02)
    system = state_space(damped, ["base:acceleration"], ["base:reaction", "tip:acceleration"])
    assert len(system.A) == 2 * (damped.reduced.order - 6)
    assert system.poles().real.max() < 0
    gain = system.dc_gain()
    part = damped.part
    arm = part.center_of_mass - part.interfaces[0].point
    cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
    rigid = np.block(
        [[part.mass * np.eye(3), -part.mass * cross], [part.mass * cross, part.inertia - part.mass * cross @ cross]]
    )
    assert gain[:6] == pytest.approx(rigid, rel=1e-9, abs=1e-9 * part.mass)
    assert gain[6:9, :3] == pytest.approx(np.eye(3), abs=1e-9)


def test_a_held_part_bends_as_its_elements_do():
    """Force at the tip, static: the solution of the full model, which constraint modes hold exactly."""
    model = beam((6, 2, 2))
    tip = make_interface(model, name="tip", nodes=where(model, 0, 0.5), coupling="average")
    base = make_interface(model, name="base", nodes=where(model, 0, 0.0), coupling="direct")
    with Problem(model, [base, tip]) as problem:
        reduced = CraigBampton(modes=4).reduce(problem, "cb")
        body = elastic_body(problem, reduced, make_part(problem))
    system = state_space(body, ["tip:force:y+z"], ["tip:displacement:y+z", "base:reaction"], held=["base"])
    gain = system.dc_gain()
    load = np.zeros((model.size, 2))
    rows = where(model, 0, 0.5)
    free = np.setdiff1d(np.arange(model.size), model.dofs.of_nodes(where(model, 0, 0.0)).ravel())
    weights = tip.weights / tip.weights.sum()
    for at, axis in enumerate((1, 2)):
        load[model.dofs.of_nodes(rows)[:, axis], at] = weights
    K = sp.csc_array(model.K)[free][:, free]
    wanted = load[free].T @ spl.spsolve(K, load[free])
    assert gain[:2] == pytest.approx(wanted, rel=1e-7, abs=1e-9 * wanted.max())
    # The support takes what the tip is loaded with.
    assert gain[2:].reshape(-1, 3, 2).sum(axis=0) == pytest.approx(np.eye(3, 2, -1) * -1.0, abs=1e-7)
    assert system.names["outputs"][2] == f"base:reaction:x@{model.nodes.ids[where(model, 0, 0.0)][0]}"


def test_displacements_go_in_with_their_derivatives(body):
    by_force = state_space(body, ["base:acceleration", "tip:force"], EVERYTHING)
    system = state_space(body, ["base:displacement", "tip:force"], EVERYTHING)
    assert system.names["inputs"][:3] == ("base:displacement:x", "base:velocity:x", "base:acceleration:x")
    assert system.units["inputs"][:3] == ("m", "m/s", "m/s2") and len(system.A) == len(by_force.A) - 12
    s = 200j
    H = response(system, 200.0)
    together = H[:, 0:18:3] + s * H[:, 1:18:3] + s * s * H[:, 2:18:3]
    assert blockwise(np.hstack([together, H[:, 18:]]) / np.repeat([s * s, 1.0], 6), exact(body, 200.0)) < 1e-10


def test_a_two_sided_body(tmp_path):
    """Forces and motions of its interfaces are not of one coordinate; prescribed motion is that of the outputs."""
    two_sided = Krylov(shifts_hz=[400.0], two_sided=True, inputs=["base"], outputs=["base", "tip"])
    body = reduced_body(reducer=two_sided, beta=1e-5)
    r = body.reduced
    assert not r.symmetric
    system = state_space(read_body(write_body(tmp_path / "b.h5", [body])), ["base:acceleration"], EVERYTHING[:2])
    for omega in (30.0, 3000.0):
        s = 1j * omega
        Z = np.block([[s * s * r.M + s * r.D + r.K, -r.B[:, :6]], [r.C[:6], np.zeros((6, 6))]])
        q = np.linalg.solve(Z, np.vstack([np.zeros((r.order, 6)), np.eye(6) / s**2]))
        wanted = np.vstack([q[r.order :], r.C[6:] @ q[: r.order]])
        H = response(system, omega)
        for rows in (BASE, TIP):
            assert np.abs(H[rows] - wanted[rows]).max() < 1e-8 * np.abs(wanted[rows]).max()


@pytest.mark.parametrize("end", [".npz", ".mat"])
@pytest.mark.parametrize("step", [0.0, 1e-5])
def test_files_keep_every_bit(body, tmp_path, end, step):
    system = state_space(body, ["base:acceleration:z", "tip:force"], EVERYTHING, held=["base:x+y+rx+ry+rz"])
    system = system.discrete(step) if step else system
    write_state_space(tmp_path / f"x{end}", system)
    first = (tmp_path / f"x{end}").read_bytes()
    again = read_state_space(tmp_path / f"x{end}")
    assert all(np.array_equal(getattr(again, key), getattr(system, key)) for key in ("A", "B", "C", "D", "dt"))
    assert again.names == system.names and again.units == system.units
    write_state_space(tmp_path / f"x{end}", again)
    assert (tmp_path / f"x{end}").read_bytes() == first


def test_scipy_takes_both_files(body, tmp_path):
    source = write_body(tmp_path / "b.h5", [body])
    options = {"inputs": ["base:acceleration", "tip:force"], "outputs": EVERYTHING}
    wanted = exact(body, 200.0)
    for name in ("x.npz", "x.mat"):
        (path,) = export_body(source, "statespace", path=tmp_path / name, options=options).paths
        values = scipy.io.loadmat(path) if name == "x.mat" else np.load(path)
        system = scipy.signal.StateSpace(*(values[key] for key in "ABCD"))
        H = response(system, 200.0)
        assert blockwise(H, wanted) < 1e-10


def test_a_fixed_step_is_exact_for_held_inputs(body):
    """Against the matrix exponential over many short steps of Runge and Kutta, in scipy."""
    system = state_space(body, ["tip:force:z"], ["tip:displacement:z"], held=["base"])
    step = 1e-4
    discrete = system.discrete(step)
    assert discrete.dt == step and discrete.names == system.names
    force = np.array([1.0, -2.0, 0.5, 3.0])
    _, stepped, _ = scipy.signal.dlsim((discrete.A, discrete.B, discrete.C, discrete.D, step), force)
    x, reached = np.zeros(len(system.A)), []
    for value in force:
        reached.append((system.C @ x + system.D @ [value])[0])
        done = scipy.integrate.solve_ivp(
            lambda _, x, u=value: system.A @ x + system.B[:, 0] * u, (0, step), x, "Radau", rtol=1e-10, atol=1e-16
        )
        x = done.y[:, -1]
    assert stepped[:, 0] == pytest.approx(np.array(reached), rel=1e-7, abs=1e-9 * np.abs(reached).max())
    for wrong in (0.0, -1.0, np.nan):
        with refusal("value", "step"):
            system.discrete(wrong)
    with refusal("value", "step"):
        discrete.discrete(step)


def test_python_control_reads_it(body, tmp_path):
    control = pytest.importorskip("control", reason="python-control is not installed: pip install control")
    source = write_body(tmp_path / "b.h5", [body])
    options = {"inputs": ["base:acceleration", "tip:force"], "outputs": EVERYTHING}
    (path,) = export_body(source, "statespace", options=options).paths
    assert path.name == "b.statespace.npz"
    with np.load(path) as file:
        system = control.ss(
            *(file[key] for key in "ABCD"),
            float(file["dt"]),
            **{key: file[key].tolist() for key in ("states", "inputs", "outputs")},
        )
    H = system["tip:acceleration:z", "base:acceleration:z"](200j)
    assert complex(H) == pytest.approx(complex(exact(body, 200.0)[18 + 2, 2]), rel=1e-9)
    (path,) = export_body(source, "statespace", options={**options, "step": 1e-6}).paths
    with np.load(path) as file:
        assert control.ss(*(file[key] for key in "ABCD"), float(file["dt"])).isdtime(strict=True)


def test_generalised_forces(tmp_path):
    """A column of B of an imported system is an input with its own name, a displacement of it an output."""
    model = beam((3, 1, 1))
    free = np.setdiff1d(np.arange(model.size), model.dofs.of_nodes(where(model, 0, 0.0)).ravel())
    drive = np.zeros(model.size)
    drive[model.dofs.of_nodes(where(model, 0, 0.5))[:, 2]] = 0.25
    K, M = (sp.csc_array(A)[free][:, free] for A in (model.K, model.M))
    system = morembs.from_matrices(K=K, M=M, B=drive[free][:, None])
    interface = morembs.matrix_interface(system, name="drive", matrix="B")
    with Problem(system, [interface]) as problem:
        body = elastic_body(problem, CraigBampton(modes=4).reduce(problem, "cb"), make_part(problem, "interfaces"))
    reduced = state_space(body, ["drive:force"], ["drive:displacement"])
    (name,) = reduced.names["inputs"]
    assert name.startswith("drive:force:") and reduced.units["inputs"] == ("N",)
    wanted = drive[free] @ spl.spsolve(K, drive[free])
    assert reduced.dc_gain() == pytest.approx(np.array([[wanted]]), rel=1e-9)


def test_bad_input(body, tmp_path):
    cases = [
        (["nobody:force"], ["tip:displacement"], [], ("unknown", "input")),
        (["tip"], ["tip:displacement"], [], ("value", "input")),
        (["tip:velocity"], ["tip:displacement"], [], ("value", "input", "velocity")),
        (["tip:force:q"], ["tip:displacement"], [], ("unknown", "input", "tip", "q")),
        (["tip:force"], ["tip:force"], [], ("value", "output")),
        (["tip:force", "tip:force:z"], ["tip:velocity"], [], ("conflict", "input")),
        ([], ["tip:velocity"], [], ("value", "s")),
        ("tip:force", ["tip:velocity"], [], ("value", "s")),
        (["base:acceleration", "base:force:z"], ["tip:velocity"], [], ("conflict", "inputs")),
        (["base:acceleration", "base:displacement:z"], ["tip:velocity"], [], ("conflict", "inputs")),
        (["tip:force"], ["base:reaction"], [], ("value", "outputs")),
        (["base:acceleration:x+y+z+ry+rz"], ["tip:velocity"], [], ("model", "", "base")),
        (["base:acceleration:x+z+rx+ry+rz"], ["tip:velocity"], [], ("model",)),
        (["tip:force"], ["tip:velocity"], ["base:x+y+z"], ("model",)),
    ]
    for inputs, outputs, held, message in cases:
        with refusal(*message):
            state_space(body, inputs, outputs, held=held)
    with refusal("value", "held", "base"):
        state_space(body, ["tip:force"], ["tip:velocity"], held="base")
    hysteretic = replace(body, recipe={**body.recipe, STRUCTURAL: 0.02})
    with refusal("unsupported", "", "0.02"):
        state_space(hysteretic, ["tip:force"], ["tip:velocity"])
    source = write_body(tmp_path / "b.h5", [body])
    with refusal("value", "inputs"):
        export_body(
            source,
            "statespace",
            path=tmp_path / "x.mat",
            options={"inputs": ["base:displacement"], "outputs": ["base:reaction"]},
        )
    (tmp_path / "y.npz").write_bytes(b"PK nothing")
    for name in ("y.npz", "no.npz", "no.mat"):
        with refusal("file", "path"):
            read_state_space(tmp_path / name)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.h5", "y.npz"]


def test_on_the_command_line(tmp_path):
    write_body(tmp_path / "b.h5", [reduced_body(modal=0.02)])
    done = command(
        "export",
        "b.h5",
        "--to",
        "statespace",
        "--set",
        "inputs=base:acceleration:z",
        "--set",
        "outputs=base:reaction:z,tip:acceleration:z",
        "--set",
        "held=base:x+y+rx+ry+rz",
        "--out",
        "x.mat",
        folder=tmp_path,
    )
    assert done.code == 0, done.errors
    lines = done.output.splitlines()
    assert lines[:2] == ["written: x.mat", "note: 28 states, 1 inputs, 2 outputs"]
    assert lines[2].startswith("note: poles and their damping: ")
    assert (
        lines[3] == "note: static gain: base:reaction:z by base:acceleration:z 5.8875, "
        "tip:acceleration:z by base:acceleration:z 1"
    )
    assert read_state_space(tmp_path / "x.mat").names["inputs"] == ("base:acceleration:z",)
    done = command("export", "b.h5", "--to", "statespace", "--set", "inputs=base:push", folder=tmp_path)
    assert done.code == 2 and done.errors.startswith("error: input 'base:push': 'push' was given; expected base: with")
