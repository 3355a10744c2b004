"""Bodies with motions that have no mass, on the whole way from the model into files, beside dense descriptor systems.

The references know nothing of the package: K, M and B of the model, its rotations eliminated by their rows alone.
"""

import numpy as np
import pytest
import scipy.linalg as sl

from morembs import elastic_body, make_part, read_body, write_body
from morembs.body.delivery_check import check_delivery
from morembs.certificate.certify import certify
from morembs.certificate.response import full_response
from morembs.exporters import EXPORTERS, ExportContext, export_body, make_exporter, step_for_band
from morembs.exporters.exudyn import for_time_step as exudyn_frame
from morembs.exporters.state_space_files import read_state_space
from morembs.fem.interface import make_interface
from morembs.linalg.massless import split_massless
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton
from tests.exporters.test_c_source import run
from tests.support.diagnoses import grave
from tests.support.fmus import exported, needs_compiler
from tests.support.frames import beams, chain, clamped_beam, lumped, model_on
from tests.support.refusals import refusal

# The slowest mode of the clamped beam is at 14 Hz, its 15th, the highest one, at 8,1 kHz.
FINE, COARSE = 1e-6, 2e-4
# Modes that there are with the interfaces at rest.
ALL = {("held", False): 12, ("held", True): 9, ("free", False): 9, ("free", True): 6}
FREE = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [2.0, 1.0, 1.0]])


def frame(kind):
    """A clamped beam or a free frame, whose rotations have no mass."""
    return lumped(clamped_beam(6) if kind == "held" else model_on(*beams(FREE, chain(4)), FREE, range(6)))


def body_of(kind, folder, damping=None, modes=9, both=False):
    """Its body file, that of ``CraigBampton`` with all modes unless fewer are wanted, and the dense K, M, B."""
    model = frame(kind)
    labels = np.unique(model.dofs.node)
    ends = {"tip": labels[-1]} | ({"base": labels[0]} if both else {})
    interfaces = [make_interface(model, name=name, nodes=np.array([node])) for name, node in ends.items()]
    with Problem(model, interfaces, damping=damping) as problem:
        reduced = CraigBampton(modes=modes).reduce(problem, "frame")
        body = elastic_body(problem, reduced, make_part(problem))
        dense = [A.toarray() for A in (problem.K, problem.M, problem.B)]
    return write_body(folder / "frame.h5", [body], recipe={}), dense


def eliminated(K, M, B):
    """Of the dofs with mass: K, M, B, C, and the compliance D of the others at once."""
    d, s = np.flatnonzero(np.diag(M)), np.flatnonzero(np.diag(M) == 0)
    to_s = -np.linalg.solve(K[np.ix_(s, s)], K[np.ix_(s, d)])
    Kd = K[np.ix_(d, d)] + K[np.ix_(d, s)] @ to_s
    loads = B[d] + to_s.T @ B[s]
    return Kd, M[np.ix_(d, d)], loads, loads.T, B[s].T @ np.linalg.solve(K[np.ix_(s, s)], B[s])


def bent_by(dense, loads, times, alpha):
    """Displacements (n, 6) of the tip under ``loads`` from rest, by the modes of the eliminated system."""
    K, M, B, C, D = eliminated(*dense)
    values, Y = sl.eigh(K, M)
    a = 0.5 * alpha
    w = np.sqrt(values - a**2)
    decay = np.exp(-a * times[:, None]) * (np.cos(w * times[:, None]) + a / w * np.sin(w * times[:, None]))
    return ((1 - decay) * (Y.T @ B @ loads) / values) @ (C @ Y).T + D @ loads


@pytest.mark.parametrize("kind", ["held", "free"])
@pytest.mark.parametrize("both", [False, True])
def test_a_reduction_keeps_the_compliance_of_dofs_without_mass(tmp_path, kind, both):
    """Of the whole response, elastic and rigid, at 60 frequencies up to 2 kHz."""
    path, (K, M, B) = body_of(kind, tmp_path, Damping(alpha=30.0), modes=ALL[kind, both], both=both)
    body = read_body(path).bodies["frame"]
    split = split_massless(body.stiffness_matrix, body.mass_matrix)
    P, Z = split.P, split.Z
    n = Z.shape[1]
    assert n == np.isinf(body.frequencies_hz).sum() > 0 and np.isfinite(body.frequencies_hz[:-n]).all()
    scale = np.sqrt(np.diag(body.stiffness_matrix).max())
    assert np.abs(Z.T @ body.stiffness_matrix @ P).max() < 1e-9 * scale
    assert Z.T @ body.stiffness_matrix @ Z == pytest.approx(np.eye(n), abs=1e-9)
    for hz in np.geomspace(1.0, 2000.0, 60):
        w = 2 * np.pi * hz
        # Rigid motion is not damped: of a free body this is the undamped response.
        D, own = (30.0 * M, body.damping_matrix) if kind == "held" else (0 * M, 0 * body.damping_matrix)
        expected = B.T @ np.linalg.solve(K + 1j * w * D - w**2 * M, B)
        found = body.output_matrix @ np.linalg.solve(
            body.stiffness_matrix + 1j * w * own - w**2 * body.mass_matrix, body.input_matrix.astype(complex)
        )
        size = np.sqrt(np.abs(np.diag(expected)))
        assert (np.abs(found - expected) <= 1e-6 * np.outer(size, size)).all()
    # A mass on them leaves all other modes where they are.
    heavy = split.with_mass(body.stiffness_matrix, body.mass_matrix, 3e4)
    r = body.rigid_count
    own = sl.eigh(eliminated(K, M, B)[0], np.diag(np.diag(M)[np.diag(M) > 0]), eigvals_only=True)[r:]
    values = sl.eigh(body.stiffness_matrix, heavy, eigvals_only=True)[r:]
    assert values == pytest.approx(np.sort([*own, *[9e8] * n]), rel=1e-6)
    assert "massless" in check_delivery(body, read_body(path)).codes and "massless" in grave(
        check_delivery(body, read_body(path))
    )


def test_the_state_space_of_a_step_that_resolves_all_modes_is_the_descriptor_system(tmp_path):
    path, dense = body_of("held", tmp_path, Damping(alpha=30.0), modes=12)
    done = export_body(path, "statespace", path=tmp_path / "x.npz", options={"time_step": FINE})
    assert sum("of 18 coordinates have no mass" in note and "at once" in note for note in done.notes) == 1
    system, (K, M, B) = read_state_space(done.paths[0]), dense
    assert len(system.A) == 30
    for hz in np.geomspace(1.0, 20e3, 80):
        w = 2 * np.pi * hz
        expected = B.T @ np.linalg.solve(K + 30j * w * M - w**2 * M, B)
        found = system.C @ np.linalg.solve(1j * w * np.eye(30) - system.A, system.B) + system.D
        size = np.sqrt(np.abs(np.diag(expected)))
        assert (np.abs(found - expected) <= 1e-6 * np.outer(size, size)).all()
    loads = np.array([3.0, -2.0, 5.0, 0.4, 0.3, -0.2])
    times = np.array([0.0, 1e-3, 2e-3, 5e-3, 20e-3])
    step = sl.expm(np.block([[system.A, system.B], [np.zeros((6, 36))]]) * 1e-3)
    x, found = np.concatenate([np.zeros(30), loads]), []
    for _ in range(21):
        found.append(system.C @ x[:30] + system.D @ loads)
        x = step @ x
    expected = bent_by(dense, loads, times, 30.0)
    assert np.array(found)[[0, 1, 2, 5, 20]] == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())
    # Torsion has no mass at all.
    assert abs(found[0][3]) > 0.1 * abs(found[-1][3])


@pytest.mark.parametrize("damping", [Damping(beta=1e-5), Damping(modal=0.02), Damping(alpha=5.0)])
@pytest.mark.parametrize("kind", ["held", "free"])
def test_the_error_that_a_coarse_step_tells_holds_with_damping_on_motions_without_mass(tmp_path, damping, kind):
    """Stiffness-proportional damping acts on them, with one time constant, beta; modal damping does not."""
    path, _ = body_of(kind, tmp_path, damping, modes=ALL[kind, True], both=True)
    done = export_body(path, "statespace", path=tmp_path / "x.npz", options={"time_step": COARSE})
    lag = "within 1e-05 s, which the error counts" if damping.beta else "at once"
    assert sum(note.endswith(f"follows loads {lag}") for note in done.notes) == 1
    told = [float(word) for word in done.notes[1].rpartition("displacements ")[2].split(", ")]
    system, file = read_state_space(done.paths[0]), read_body(path)
    body, r = file.bodies["frame"], 0 if kind == "held" else 6
    assert len(system.A) < 2 * (len(body.mass_matrix) - np.isinf(body.frequencies_hz).sum())
    length = np.sqrt(np.trace(file.inertia) / (2 * file.mass))
    scale = np.tile(np.repeat([1.0, length], 3), 2)
    K, M, D, B, C = (getattr(body, f"{name}_matrix") for name in ("stiffness", "mass", "damping", "input", "output"))
    values, Y = body.reduced.modes()
    elastic = C @ Y[:, r:] / np.sqrt(np.where(np.isfinite(values[r:]), values[r:], 1.0))
    size = np.abs(scale[:, None] * (elastic @ elastic.T) * scale).max()
    for limit, end in zip(told, np.array([0.1, 0.25, 0.5]) / (2 * np.pi * COARSE), strict=True):
        worst = 0.0
        for hz in np.linspace(0.0, end, 50)[1:]:
            s = 2j * np.pi * hz
            found = system.C @ np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B) + system.D
            expected = C @ np.linalg.solve(K + s * D + s**2 * M, B)
            worst = max(worst, np.abs(scale[:, None] * (found - expected) * scale).max())
        assert worst <= limit * size * (1 + 1e-6) and limit < 0.1


def test_a_step_that_resolves_how_they_follow_loads_is_refused(tmp_path):
    path, _ = body_of("held", tmp_path, Damping(beta=1e-4))
    with refusal("value", "time_step", "1e-05", "0.0001"):
        export_body(path, "statespace", path=tmp_path / "x.npz", options={"time_step": 1e-5})
    assert not (tmp_path / "x.npz").exists()
    # What a check tries stops there, and the best is told.
    found, _ = step_for_band(path, "statespace", 100.0)
    assert found.step > 1e-4
    export_body(path, "statespace", path=tmp_path / "x.npz", options={"time_step": 1e-3})


@needs_compiler
def test_c_code_and_an_fmu_have_the_step_response_of_the_descriptor_system(tmp_path):
    fmpy = pytest.importorskip("fmpy")
    path, dense = body_of("held", tmp_path, Damping(alpha=30.0), modes=12)
    loads, step = np.array([3.0, -2.0, 5.0, 0.4, 0.3, -0.2]), 1e-5
    times = np.arange(1, 401) * step
    expected = bent_by(dense, loads, times, 30.0)
    size = np.abs(expected).max(axis=0)
    options = {"structure": "linear", "time_step": step}
    found = run(exported(path, "lean", to="c", **options), 400, [*loads, *[0.0] * 6])[:, :6]
    assert (np.abs(found - expected) < 1e-6 * size).all()
    fmu = exported(path, "lean", **options)
    names = [f"tip.{kind}.{axis}" for kind in ("force", "moment") for axis in "xyz"]
    outputs = [f"tip.{kind}.{axis}" for kind in ("displacement", "rotation") for axis in "xyz"]
    result = fmpy.simulate_fmu(
        str(fmu),
        stop_time=times[-1],
        output_interval=step,
        start_values=dict(zip(names, loads.tolist(), strict=True)),
        output=outputs,
        fmi_type="CoSimulation",
    )
    found = np.array([result[name] for name in outputs]).T[1:]
    assert (np.abs(found - expected) < 1e-6 * size).all()
    assert "15 of 18 modes" in fmpy.read_model_description(str(fmu)).description


def test_shapes_of_exudyn_have_the_whole_compliance_of_a_free_body(tmp_path):
    """Beside inertia relief of the dense model: loads less the rigid acceleration that they give it."""
    path, (K, M, B) = body_of("free", tmp_path, Damping(alpha=5.0), modes=6, both=True)
    file = read_body(path)
    whole = ExportContext(source=file, body=file.bodies["frame"], path=tmp_path / "x.hdf5")
    context, _ = make_exporter("exudyn", {"time_step": COARSE}).prepare(whole)
    run, found = exudyn_frame(context, COARSE)
    assert found.count == 12 and found.kept < 6
    motion = np.vstack([marker.motion for marker in run.in_frame("mean-axes").markers.values()])
    R = sl.null_space(K, rcond=1e-12)
    assert R.shape[1] == 6
    loads = B - M @ R @ np.linalg.solve(R.T @ M @ R, R.T @ B)
    both = np.vstack([K, R.T @ M]), np.vstack([loads, np.zeros((6, 12))])
    expected = B.T @ np.linalg.lstsq(*both, rcond=1e-14)[0]
    size = np.sqrt(np.diag(expected))
    assert (np.abs(motion @ np.linalg.solve(run.Ke, motion.T) - expected) < 1e-6 * np.outer(size, size)).all()
    vibrations = np.sqrt(sl.eigh(run.Ke, run.integrals.Me, eigvals_only=True))
    assert vibrations.max() * COARSE <= 1 + 1e-6


def test_slides_of_mujoco_stand_for_motions_without_mass(tmp_path):
    """Where the interfaces take little of the mass of light rods, the file is at rest what the body is."""
    path, _ = body_of("free", tmp_path, Damping(beta=1e-5), modes=6, both=True)
    out, told = tmp_path / "x.mujoco.xml", []
    for share in (1e-3, 1e-6):
        notes = export_body(path, "mujoco", path=out, options={"time_step": 1e-4, "share": share}).notes
        assert "6 of 12 modes" in notes[0] and any(note.startswith("6 of 18 coordinates") for note in notes)
        told.append(float(notes[1].rpartition("displacements ")[2].split(", ")[0]))
    # What the interfaces take moves with these motions, which have none: the error tells it.
    assert told[1] < 1e-2 < 1.0 < told[0]


def test_other_targets_name_what_helps_and_matrices_stay_as_they_are(tmp_path):
    path, _ = body_of("free", tmp_path, modes=6, both=True)
    takes = {"op4", "matrix-market", "dmig", "abaqus", "gltf"}
    for name, kind in EXPORTERS.items():
        assert kind.takes_massless is (name in takes)
        out = tmp_path / f"x{kind.suffix}"
        if name not in takes:
            with refusal("unsupported", "mass", "--time-step"):
                export_body(path, name, path=out)
        elif name != "gltf":
            # A model without elements has no picture.
            export_body(path, name, path=out)


def test_responses_and_certificates_are_those_of_the_dense_system(tmp_path):
    """Modes of the full model know nothing of what loads deform without mass: solutions at each frequency do."""
    model, omega = frame("held"), 2 * np.pi * np.array([1.0, 20.0, 300.0, 2e3])
    tip = make_interface(model, name="tip", nodes=np.array([5]))
    with Problem(model, [tip], damping=Damping(beta=1e-5)) as problem:
        K, M, B = (A.toarray() for A in (problem.K, problem.M, problem.B))
        expected = np.array([B.T @ np.linalg.solve(K * (1 + 1e-5j * w) - w**2 * M, B) for w in omega])
        size = np.sqrt(np.abs(np.einsum("nii->ni", expected)))
        found = full_response(problem, omega)
        assert (np.abs(found - expected) <= 1e-7 * size[:, :, None] * size[:, None]).all()
        lean, rich = (CraigBampton(modes=count).reduce(problem, "a") for count in (3, 12))
        few, all_of_them = certify(problem, [lean, rich], [0.0, 300.0])
    assert few.kind == all_of_them.kind == "sampled" and "no mass" in few.notes[0]
    assert all_of_them.error.max() < 1e-6 < few.error.max()
