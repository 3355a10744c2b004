"""Method "auto" against direct solutions, its order against another way to choose a basis, and whole jobs with it."""

import hashlib
import json

import numpy as np
import pytest
import scipy.linalg as sl
from rich.console import Console
from typer.testing import CliRunner

from benchmarks import certificates as campaign
from morembs.app.cli import app
from morembs.app.cli.messages import without_nan
from morembs.app.jobs.document import sections_of
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.jobs.stages.response import RESPONSE
from morembs.app.report.text import print_document
from morembs.base.errors import SolverError
from morembs.body.file import read_body
from morembs.certificate.certify import certify
from morembs.importers import read_mesh
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer
from morembs.responses.band import band_frequencies
from morembs.responses.measures import MEASURES
from tests.certificate.test_certify import BODIES, DAMPINGS, Truth, beam, ends, errors_of, norms, pair, round_off, show
from tests.support.meshes import steel
from tests.support.refusals import refusal
from tests.support.released import described

BAND = {"beam average": [50.0, 3000.0], "square beam": [100.0, 5000.0], "angle": [0.0, 9000.0]}


def full(problem, band, points=6):
    """Frequencies in rad/s that the method does not look at itself, and H there."""
    omega = 2 * np.pi * band_frequencies(problem, band, points=points)
    omega = np.unique(np.concatenate([omega, 0.5 * (omega[1:] + omega[:-1])]))
    modes = problem.elastic_modes(below=float(omega[-1] ** 2) * 1.6).eigenvalues
    # Beside an undamped resonance a relative error means nothing.
    near = (np.abs(omega[:, None] / np.sqrt(modes) - 1) < 0.9e-3).any(axis=1)
    omega = omega[~near]
    return omega, Truth(problem)(omega), np.outer(problem.motion_scale, problem.motion_scale), modes


@pytest.mark.parametrize(
    ("name", "damping"),
    [("beam average", "undamped"), ("beam average", "rayleigh"), ("square beam", "rayleigh"), ("angle", "undamped")],
)
def test_the_tolerance_holds(name, damping):
    model, interfaces = BODIES[name]()
    with Problem(model, interfaces, damping=DAMPINGS[damping]) as problem:
        omega, H, scale, modes = full(problem, BAND[name])
        floor = round_off(problem, omega, modes)
        orders = []
        for tolerance in (1e-2, 1e-6):
            body = AutoReducer(band_hz=BAND[name], tolerance=tolerance, measure="pointwise").reduce(problem)
            error = errors_of(body, omega, H, scale)
            show(name, damping, f"{tolerance:.0e}: {body.order - 6}", body.recipe["orders"], f"error {error.max():.1e}")
            assert (error <= tolerance * 1.01 + floor).all()
            assert body.recipe["certified"] <= tolerance
            assert body.rigid_count == 6 and body.recipe["family"] in body.recipe["orders"]
            assert body.recipe["orders"][body.recipe["family"]] == body.order - 6
            orders.append(body.order)
        assert orders == sorted(orders) and orders[0] < orders[-1]


@pytest.mark.parametrize(("number", "measure"), [(6, "pointwise"), (14, "envelope")])
def test_a_tolerance_that_a_body_just_holds_is_not_refused(number, measure):
    """Limits that are sharp to a few per cent lay above tolerances that the search had found to hold."""
    case = campaign.drawn(np.random.default_rng([1, number]), number)
    with case.problem as problem:
        body = AutoReducer(band_hz=[0.0, case.high], tolerance=1e-2, measure=measure).reduce(problem)
        assert 0.99e-2 < body.recipe["certified"] <= 1e-2
        omega, error = campaign.dense_errors(problem, body, (0.0, case.high))
        assert len(omega) > 20_000 and error[:, MEASURES.index(measure)].max() <= 1e-2


def test_a_band_far_above_all_modes_is_refused_for_that():
    model, interfaces = ends("average", n=(2, 1, 1))
    with (
        Problem(model, interfaces, damping=DAMPINGS["rayleigh"]) as problem,
        refusal("result", "tolerance", "0.01", "9e+11", by=SolverError),
    ):
        AutoReducer(band_hz=[0.0, 9e11], tolerance=1e-2).reduce(problem)


def galerkin(problem, V, omega, scale):
    """Scaled transfer matrices of the projection on ``V``."""
    K, M = (V.T @ (A @ V) for A in (problem.K, problem.M))
    B, d = problem.B.T @ V, problem.damping
    return (
        np.array(
            [
                B @ np.linalg.solve((1 + 1j * w * d.beta) * K + (1j * w * d.alpha - w**2) * M, B.T.astype(complex))
                for w in omega
            ]
        )
        * scale
    )


@pytest.mark.parametrize("damping", DAMPINGS)
def test_no_snapshots_make_a_much_smaller_basis(damping):
    """Principal vectors of dense responses need more than four fifths of the order for the same tolerance."""
    model, interfaces = ends("average", n=(6, 1, 1))
    with Problem(model, interfaces, damping=DAMPINGS[damping]) as problem:
        band, tolerance = [50.0, 3000.0], 1e-4
        body = AutoReducer(band_hz=band, tolerance=tolerance, measure="pointwise").reduce(problem)
        omega = 2 * np.pi * band_frequencies(problem, band, points=30)
        truth = Truth(problem)
        states = [truth.states(w).astype(complex) * problem.motion_scale for w in omega]
        H = np.array([problem.B.T @ x * problem.motion_scale[:, None] for x in states])
        scale = np.outer(problem.motion_scale, problem.motion_scale)
        X = problem.K.toarray() + omega.mean() ** 2 * problem.M.toarray()
        L = np.linalg.cholesky(X)
        fewer = int(0.8 * (body.order - 6))
        for sizes in (1.0, norms(H)):
            weight = np.sqrt(np.gradient(omega)) / sizes
            S = np.hstack([w * part for w, x in zip(weight, states, strict=True) for part in (x.real, x.imag)])
            U = sl.svd(L.T @ S, full_matrices=False)[0]
            V = sl.solve_triangular(L.T, U[:, :fewer])
            error = norms(galerkin(problem, V, omega, scale) - H) / norms(H)
            show(f"{damping}: auto {body.order - 6}, {fewer} snapshots' vectors: error {error.max():.1e}")
            assert error.max() > tolerance


def test_samples_on_undamped_resonances_of_twins(small_meshes):
    """The reference has the damping that is assumed: without it no space is good enough on a resonance."""
    model = steel(read_mesh(small_meshes / "beam.msh"))
    with Problem(model, pair(model, "rigid")) as problem:
        body = AutoReducer(band_hz=[0.0, 5000.0], tolerance=1e-4).reduce(problem)
    assert body.recipe["damping_floor"] == 0.01 and body.recipe["reference_order"] < 120


@pytest.mark.parametrize("coupling", ["rigid", "average"])
def test_static_responses_are_exact_if_asked_for(coupling):
    model, interfaces = ends(coupling)
    with Problem(model, interfaces) as problem:
        plain, exact = (
            AutoReducer(band_hz=[50.0, 3000.0], tolerance=1e-2, static_exact=s).reduce(problem) for s in (False, True)
        )
        certificates = certify(problem, [plain, exact], [50.0, 2000.0], points=4)
        loose, tight = (certificate.static_error for certificate in certificates)
        show(coupling, f"static error {loose:.1e} {tight:.1e}, orders {plain.order} {exact.order}")
        assert tight < 1e-9 < loose
        assert exact.order >= plain.order


def test_inertia_loads_of_the_frame_are_followed_if_asked_for():
    """Deformation under centrifugal load: a dense static solution stays in the span."""
    model, interfaces = ends("average")
    with Problem(model, interfaces) as problem:
        K, M, Z = problem.K.toarray(), problem.M.toarray(), problem.rigid
        x = model.nodes.xyz[model.dofs.node] - problem.coupling.pole
        load = M @ np.where(model.dofs.component == 0, x[:, 0], 0.0)
        load -= M @ (Z @ (Z.T @ load))
        shift = K + (M @ Z) @ (M @ Z).T * 1e6
        u = np.linalg.solve(shift, load)
        left = []
        for follow in (False, True):
            V = AutoReducer(band_hz=[0.0, 2000.0], tolerance=1e-3, inertia_loads=follow).reduce(problem).V
            rest = u - V @ np.linalg.solve(V.T @ K @ V + (V.T @ M @ Z) @ (Z.T @ M @ V) * 1e6, V.T @ load)
            left.append(np.sqrt((rest @ K @ rest) / (u @ K @ u)))
        show("inertia loads left out, followed:", left)
        assert left[1] < 0.05 and left[1] < left[0]


def test_what_cannot_be_reached_is_said():
    model, interfaces = ends("average", n=(3, 1, 1))
    with Problem(model, interfaces) as problem, refusal("result", "tolerance", "1e-15", by=SolverError):
        AutoReducer(band_hz=[50.0, 3000.0], tolerance=1e-15).reduce(problem)


@pytest.mark.parametrize(
    "band", [[100.0], [3000.0, 50.0], [-1.0, 50.0], [0.0, 0.0], [1.0, float("nan")], [1.0, 2.0, 3.0]]
)
def test_bad_bands(band):
    with refusal("value", "band_hz", "HIGH"):
        AutoReducer(band_hz=band, tolerance=1e-3)


@pytest.mark.parametrize("tolerance", [0.0, -1e-3, 1.0, 7.0, float("nan")])
def test_bad_tolerances(tolerance):
    with refusal("value", "tolerance"):
        AutoReducer(band_hz=[0.0, 100.0], tolerance=tolerance)


def test_auto_needs_interfaces():
    with Problem(beam()) as problem, refusal("unsupported", "", '"auto"', "[[interface]]"):
        AutoReducer(band_hz=[0.0, 100.0], tolerance=1e-3).reduce(problem)


def test_two_runs_are_equal_to_the_last_bit():
    runs = []
    for _ in range(2):
        model, interfaces = ends("average")
        with Problem(model, interfaces, damping=Damping(alpha=5.0, beta=2e-6)) as problem:
            body = AutoReducer(band_hz=[50.0, 3000.0], tolerance=1e-4).reduce(problem)
            (certificate,) = certify(problem, [body], [50.0, 3000.0], points=9)
            parts = [body.V, body.K, body.M, body.D, body.B, certificate.error, certificate.bound]
            runs.append([hashlib.sha256(np.ascontiguousarray(part).tobytes()).hexdigest() for part in parts])
            runs[-1].append(json.dumps(dict(body.recipe)))
    assert runs[0] == runs[1]


def test_a_band_below_the_first_mode_needs_few_vectors():
    model = beam(n=(6, 1, 1))
    with Problem(model, pair(model, "average")) as problem:
        first = problem.elastic_modes(count=1).frequencies_hz[0]
        band = [0.0, 0.3 * float(first)]
        body = AutoReducer(band_hz=band, tolerance=1e-3, measure="pointwise").reduce(problem)
        omega, H, scale, _ = full(problem, band)
        assert errors_of(body, omega, H, scale).max() <= 1.01e-3 and body.order - 6 <= 12


JOB = """
[model]
mesh = "{mesh}"
units = "mm-t-s"
[[material]]
young = 2.1e5
poisson = 0.3
density = 7.85e-9
[[interface]]
name = "root"
nodes = "set:ROOT"
[[interface]]
name = "tip"
nodes = "set:TIP"
coupling = "average"
[damping]
{damping}
[[reduce]]
method = "auto"
band_hz = [500.0, 30000.0]
tolerance = 1e-3
[[reduce]]
method = "free-interface"
modes = 6
[[reduce]]
method = "guyan"
[output]
path = "{name}.h5"
{certify}
"""
RAYLEIGH, MODAL = "rayleigh = { alpha = 5.0, beta = 2e-8 }", "modal = 0.01"
CERTIFY = "[certify]\nband_hz = [0.0, 40000.0]\npoints = 20\n"


def write_job(folder, mesh, name="job", damping=RAYLEIGH, certify=CERTIFY):
    path = folder / f"{name}.toml"
    path.write_text(JOB.format(mesh=mesh / "wedge.msh", name=name, damping=damping, certify=certify))
    return path


def strict(text):
    """JSON without the words that JSON does not have."""

    def refuse(word):
        raise AssertionError(f"{word} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize(
    ("damping", "certify"), [(RAYLEIGH, CERTIFY), (MODAL, ""), (RAYLEIGH, CERTIFY + "bound = false\n")]
)
def test_certificates_of_a_job_are_stored_and_told(small_meshes, tmp_path, damping, certify):
    result = run_job(load_job(write_job(tmp_path, small_meshes, damping=damping, certify=certify)))
    stored = read_body(tmp_path / "job.h5")
    assert [body.name for body in result.bodies] == ["auto", "free-interface", "guyan"]
    for body in result.bodies:
        certificate, kept = body.certificate, stored.bodies[body.name].certificate
        assert certificate is not None and kept is not None
        written, read = (str(sorted(described(each.datasets).items())) for each in (certificate, kept))
        assert read == written
        assert kept.bound_kind == ("none" if "false" in certify else "bound")
    ends_ = result.bodies[0].certificate.frequencies_hz[[0, -1]]
    assert ends_ == pytest.approx([0.0, 4e4] if certify else [500.0, 3e4])
    auto = result.bodies[0].certificate
    inside = (auto.frequencies_hz >= 500.0) & (auto.frequencies_hz <= 3e4)
    assert result.bodies[0].recipe["certified"] <= 1e-3
    if "false" not in certify:
        assert (auto.error[inside] <= auto.bound[inside]).all() and (certify or auto.limit.upper <= 1e-3)
        kept = stored.bodies["auto"].certificate
        assert kept.format_version == 2 and kept.limit.upper == auto.limit.upper
        assert np.array_equal(auto.cells_hz[1:, 0], auto.cells_hz[:-1, 1])
        # What is drawn: the pointwise error below its limit; the tolerance is one of the envelope, and not drawn.
        shown = result[RESPONSE]
        assert not shown.tolerance and shown.bound["auto"][1].max() == auto.cell_limit[:, 2].max()
        assert shown.error["auto"].max() <= shown.bound["auto"][1].max()
    told = result.document()
    document = strict(json.dumps(without_nan(told), allow_nan=False))
    assert document["bodies"]["auto"]["certificate"]["error"] == pytest.approx(auto.error.tolist())
    console = Console(record=True, width=200)
    print_document(console, told, sections_of(told))
    text = console.export_text()
    assert ("certificate: holds at every frequency from" in text) == ("false" not in certify)
    assert "elastic coordinates, the smallest found that keeps 0.001" in text
    assert ("sampled" in text) == ("false" in certify) and ("proven" in text) == ("false" not in certify)


def test_certificates_on_the_command_line(small_meshes, tmp_path):
    path = write_job(tmp_path, small_meshes)
    result = CliRunner().invoke(app, ["reduce", "--json", str(path)])
    assert result.exit_code == 0, result.output
    document = strict(result.stdout)
    assert "NaN" not in result.stdout and "Infinity" not in result.stdout
    flat = json.dumps(document)
    assert '"certificate"' in flat and '"bound_kind": "bound"' in flat


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tolerance = 1e-3", "tolerance = 2.0", ("value", "tolerance")),
        ("band_hz = [500.0, 30000.0]", "band_hz = [30000.0, 500.0]", ("value", "band_hz", "HIGH")),
        ("band_hz = [0.0, 40000.0]", "band_hz = [10.0, 1.0]", ("value", "band_hz", "HIGH")),
        ("points = 20", "points = 1", ("value", "points")),
        ("tolerance = 1e-3", "", ("missing", "tolerance")),
    ],
)
def test_faults_in_a_job_are_named(small_meshes, tmp_path, old, new, message):
    path = write_job(tmp_path, small_meshes)
    path.write_text(path.read_text().replace(old, new, 1))
    with refusal(*message):
        load_job(path)


def test_a_band_so_narrow_that_samples_fall_together():
    """Frequencies in Hz that differ by the last digit may be one in rad/s."""
    band = [700.0, 700.0 * (1 + 1e-9)]
    model, interfaces = ends("average", n=(3, 1, 1))
    with Problem(model, interfaces, damping=DAMPINGS["rayleigh"]) as problem:
        hz = band_frequencies(problem, band)
        assert len(np.unique(2 * np.pi * hz)) < len(np.unique(hz))
        assert AutoReducer(band_hz=band, tolerance=1e-3).reduce(problem).recipe["certified"] <= 1e-3
