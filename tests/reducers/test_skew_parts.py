"""Models with gyroscopic and circulatory matrices: reduced, measured, kept in files, exported or refused."""

import contextlib
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from rich.console import Console
from scipy.io import mmwrite

from morembs import (
    REDUCERS,
    CraigBampton,
    Damping,
    Flow,
    InputError,
    Krylov,
    Modal,
    Problem,
    add_flow,
    certify,
    direct_response,
    elastic_body,
    export_body,
    full_response,
    make_part,
    read_body,
    reduced_response,
    state_space,
    tube_model,
    write_body,
)
from morembs.app.cli.report_stored import print_stored
from morembs.app.jobs.check import check_job
from morembs.app.jobs.import_job import import_model
from morembs.app.jobs.job import load_job
from morembs.app.jobs.modes import job_modes
from morembs.app.jobs.run import run_job
from morembs.body.diagnostics.findings import Diagnosis
from morembs.exporters import EXPORTERS
from morembs.importers.model_file import read_model, write_model
from morembs.importers.options import ROLES
from morembs.responses.certified import certified_reference
from tests.support.refusals import refusal
from tests.support.tubes import BORE, STEEL, arch, dense, eigenvalues, ports

OMEGA = 2 * np.pi * np.linspace(20, 900, 23)


def circulatory():
    """An arch with flow, stiffness damping and a circulatory force, which feeds energy in."""
    model = arch()
    rng = np.random.default_rng(2)
    pairs = sp.random_array((model.size, model.size), density=0.02, rng=rng)
    return replace(model, D=1e-5 * model.K, N=1e-4 * (pairs - pairs.T) * np.abs(model.K.diagonal()).min())


def exact(model, problem):
    """H of the dense equations."""
    A, B = dense(model), problem.B.toarray()
    return np.array(
        [B.T @ np.linalg.solve(A["K"] + A["N"] + 1j * w * (A["D"] + A["G"]) - w * w * A["M"], B) for w in OMEGA]
    )


def error(H, known):
    return float((np.linalg.norm(H - known, axis=(1, 2)) / np.linalg.norm(known, axis=(1, 2))).max())


@pytest.mark.parametrize("make", [arch, circulatory])
def test_full_and_reduced_responses_are_those_of_the_dense_equations(make):
    model = make()
    with Problem(model, ports(model)) as problem:
        H = exact(model, problem)
        assert error(full_response(problem, OMEGA), H) < 1e-8
        first = eigenvalues(model)[:5]
        for reducer, limit in (
            (Modal(modes=30), 1e-2),
            (CraigBampton(modes=30), 1e-2),
            (Krylov(shifts_hz=[100.0, 400.0, 800.0]), 1e-3),
            (Krylov(shifts_hz=[0.0, 400.0, 800.0], moments=2), 1e-7),
        ):
            reduced = reducer.reduce(problem)
            assert error(reduced_response(reduced, OMEGA), H) < limit
            s = reduced.complex_modes()[0]
            np.testing.assert_allclose(s[:5], first, rtol=1e-4)
            # Congruence: without damping nothing grows, not even by round-off.
            assert make is circulatory or (s.real == 0).all()
            skew = 0.5 * (reduced.D - reduced.D.T)
            np.testing.assert_allclose(skew, reduced.V.T @ (problem.G @ reduced.V), atol=1e-12 * np.abs(skew).max())


def test_the_space_of_the_transpose_matches_moments_twice():
    """Output and input at different nodes: H and its derivative are exact at the shift, not H alone."""
    model = circulatory()
    with Problem(model, ports(model)) as problem:
        reduced = Krylov(shifts_hz=[400.0]).reduce(problem)
        w, h = 2 * np.pi * 400.0, 2.0
        H, H_r = (
            response(np.array([w - h, w, w + h]))
            for response in (
                lambda omega: direct_response(problem, omega),
                lambda omega: reduced_response(reduced, omega),
            )
        )
    slope, slope_r = ((A[2] - A[0]) / (2 * h) for A in (H, H_r))
    assert np.linalg.norm(H_r[1] - H[1]) < 1e-9 * np.linalg.norm(H[1])
    assert np.linalg.norm(slope_r - slope) < 1e-5 * np.linalg.norm(slope)


def test_two_blocks_of_both_spaces_match_four_moments():
    """The error grows with the fourth power of the distance from the shift, also where G is large."""
    model = circulatory()
    model = replace(model, G=30 * model.G)
    with Problem(model, ports(model)) as problem:
        reduced = Krylov(shifts_hz=[400.0], moments=2).reduce(problem)
        near = 2 * np.pi * np.array([420.0, 440.0])
        H, H_r = direct_response(problem, near), reduced_response(reduced, near)
    off = np.linalg.norm(H_r - H, axis=(1, 2))
    assert 14 < off[1] / off[0] < 17


def test_rigid_motion_is_told_from_what_the_flow_makes_softer():
    """A free tube: its translations are rigid, and the fluid drives its rotations, whose stiffness is negative."""
    given = arch()
    flow = Flow(mass_flow=0.4, density=1000.0, area=BORE)
    model = add_flow(tube_model(given.nodes.xyz, STEEL), np.arange(len(given.nodes)), flow)
    with Problem(model, ports(model)) as problem:
        reduced = Krylov(shifts_hz=[50.0, 200.0, 400.0], moments=2).reduce(problem)
        values, r = reduced.modes()[0], problem.rigid.shape[1]
        assert r == 3 and np.abs(values[:r]).max() < 1.0 and values[r] < -1.0
        near = 2 * np.pi * np.array([60.0, 300.0])
        assert error(reduced_response(reduced, near), direct_response(problem, near)) < 1e-6


def test_workers_make_the_same_basis():
    model = circulatory()
    bodies = []
    for workers in (1, 2):
        with Problem(model, ports(model), workers=workers) as problem:
            bodies.append(Krylov(shifts_hz=[100.0, 400.0]).reduce(problem))
    assert np.array_equal(bodies[0].K, bodies[1].K) and np.array_equal(bodies[0].D, bodies[1].D)


def test_the_certificate_measures_and_promises_nothing():
    model = arch()
    with Problem(model, ports(model)) as problem:
        good = Krylov(shifts_hz=[0.0, 500.0, 900.0], moments=2).reduce(problem)
        poor = Modal(modes=4).reduce(problem)
        certificates = certify(problem, [good, poor], [20.0, 900.0], points=12)
        hz = certificates[0].frequencies_hz
        H = direct_response(problem, 2 * np.pi * hz)
        assert certificates[1].error.max() == pytest.approx(
            (
                np.linalg.norm(reduced_response(poor, 2 * np.pi * hz) - H, axis=(1, 2)) / np.linalg.norm(H, axis=(1, 2))
            ).max()
        )
        with refusal("unsupported", "damping_floor"):
            certify(problem, [good], [20.0, 900.0], damping_floor=0.01)
        with refusal("unsupported", "model", "direct_response"):
            certified_reference(problem, [20.0, 900.0])
    for certificate in certificates:
        assert certificate.kind == "sampled" and certificate.limit.upper == np.inf
        assert certificate.verified_below_hz == 0 and len(certificate.mode_mac) == 0
        assert "no limit is proven" in certificate.notes[0]
    assert certificates[0].error.max() < 1e-4 < certificates[1].error.max() and certificates[0].static_error < 1e-8


def test_other_methods_and_damping_without_a_matrix_are_refused():
    model = arch()
    options = {
        "auto": {"band_hz": [0.0, 500.0], "tolerance": 0.01},
        "gramian": {"order": 4, "band_hz": [0.0, 500.0]},
        "balanced-truncation": {"order": 4},
        "irka": {"order": 4, "band_hz": [0.0, 500.0]},
        "free-interface": {"modes": 3},
        "guyan": {},
        "irs": {},
    }
    with Problem(model, ports(model)) as problem:
        for method, given in options.items():
            with refusal("unsupported", "", method):
                REDUCERS[method](**given).reduce(problem)
        with refusal("unsupported", "", "krylov"):
            Krylov(two_sided=True, inputs=["one"], outputs=["two"]).reduce(problem)
    for damping, words in (
        (Damping(modal=0.01), ("unsupported", "damping")),
        (Damping(beta=1e-6), ("unsupported", "damping")),
    ):
        with Problem(model, ports(model), damping=damping) as problem, refusal(*words):
            full_response(problem, OMEGA)
    with refusal("conflict", "damping"):
        Problem(model, damping=Damping(structural=0.01))


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A file of a body with flow, and the body."""
    model = arch()
    with Problem(model, ports(model)) as problem:
        reduced = Krylov(shifts_hz=[0.0, 400.0], moments=2).reduce(problem)
        body = elastic_body(problem, reduced, make_part(problem))
    return write_body(tmp_path_factory.mktemp("flow") / "x.h5", [body]), reduced


def test_a_body_file_keeps_the_skew_parts(stored):
    path, reduced = stored
    read = read_body(path, whole=True)
    body = read.bodies["krylov"]
    assert read.format_version == 3 and not body.symmetric and body.floating is None
    again = body.reduced
    assert again.congruent and not again.symmetric
    assert np.array_equal(again.complex_modes()[0], reduced.complex_modes()[0])
    assert error(reduced_response(again, OMEGA), reduced_response(reduced, OMEGA)) < 1e-12


@pytest.mark.parametrize("to", EXPORTERS)
def test_targets_carry_the_skew_parts_or_refuse_the_body(stored, to):
    try:
        paths = export_body(stored[0], to).paths
    except InputError as error:
        assert re.search("gyroscopic|circulatory", str(error))
    else:
        assert to in ("op4", "matrix-market", "statespace", "modelica") and all(path.exists() for path in paths)


def test_a_state_space_has_the_complex_modes(stored):
    system = state_space(read_body(stored[0]), ["one:force"], ["two:displacement"])
    poles = np.linalg.eigvals(system.A)
    poles = np.sort(poles.imag[poles.imag > 0])
    np.testing.assert_allclose(poles, np.sort(stored[1].complex_modes()[0].imag), rtol=1e-8)


def test_matrices_come_in_from_files_in_their_units(tmp_path):
    """G of Matrix Market and N of npz in mm, kg and ms: stiffness is a million times, damping a thousand times SI."""
    upper = sp.csr_array(np.triu(np.arange(36.0).reshape(6, 6), 1))
    given = {"K": 9 * sp.eye_array(6), "M": sp.eye_array(6), "G": upper - upper.T, "N": upper}
    files = {name: tmp_path / f"{name}.mtx" for name in "KMG"} | {"N": tmp_path / "N.npz"}
    for name, path in files.items():
        (sp.save_npz if name == "N" else mmwrite)(path, sp.csr_array(given[name]))
    paths = {ROLES[role]: path for role, path in files.items()}
    model = import_model(**paths, units="mm-kg-ms")
    np.testing.assert_allclose(model.G.toarray(), 1e3 * given["G"].toarray())
    np.testing.assert_allclose((model.K + model.N).toarray(), 1e6 * (given["K"] + given["N"]).toarray())
    np.testing.assert_array_equal(model.N.toarray(), -model.N.T.toarray())


JOB = """
[model]
file = "tube.model.h5"
unsymmetric = "split"
[[flow]]
path = "set:TUBE"
mass_flow = 0.4
density = 1000.0
area = {area}
[[interface]]
name = "one"
nodes = "ids:14"
coupling = "direct"
components = [0, 2]
[certify]
band_hz = [20.0, 900.0]
points = 8
[[reduce]]
method = "krylov"
shifts_hz = [0.0, 500.0, 900.0]
moments = 2
[output]
path = "tube.h5"
[check]
full_modes = 2
"""


def test_a_job_with_flow_gives_the_body_of_the_same_model(tmp_path, capsys):
    """From a model file whose K is not symmetric, with G of its own; complex modes of it too."""
    plain = arch(mass_flow=0.0)
    extra = 1e-5 * np.triu(plain.K.toarray(), 1)
    write_model(tmp_path / "tube.model.h5", replace(plain, K=plain.K + (extra - extra.T), N=None))
    assert read_model(tmp_path / "tube.model.h5").G is not None
    (tmp_path / "tube.toml").write_text(JOB.format(area=BORE))
    job = load_job(tmp_path / "tube.toml")
    [body] = run_job(job).bodies
    assert body.certificate.kind == "sampled" and body.certificate.error.max() < 1e-3
    print_stored(Console(width=300), "tube.h5", read_body(tmp_path / "tube.h5"), {"krylov": Diagnosis()})
    assert f"krylov: error at most {body.certificate.error.max():.1e} (pointwise) at" in capsys.readouterr().out
    whole = replace(arch(), N=extra - extra.T)
    # The fluid at rest is in the file already.
    whole = replace(whole, M=2 * whole.M - _structure(whole).M)
    assert check_job(job).dofs == plain.size
    (tmp_path / "irka.toml").write_text(
        JOB.format(area=BORE).split("[[reduce]]")[0]
        + '[[reduce]]\nmethod = "irka"\norder = 4\nband_hz = [0.0, 900.0]\n[output]\npath = "irka.h5"\n'
    )
    with refusal("value", "reduce", "irka"):
        check_job(load_job(tmp_path / "irka.toml"))
    assert "symmetric K alone" in job_modes(job, complex_=False, count=4).warnings[0]
    table = job_modes(job, complex_=True, count=4)
    assert not table.warnings
    hz = eigenvalues(whole)[:4].imag / (2 * np.pi)
    np.testing.assert_allclose([row.damped_hz for row in table.rows], hz, rtol=1e-6)
    assert table.complete[0.0] == "no count of modes: a circulatory matrix"


@pytest.mark.parametrize("held", [(), (0,)])
def test_a_tube_that_nothing_keeps_from_turning_is_refused_by_check_and_reduce(tmp_path, held):
    """However little flows: a small pull hides in the stiffness, but not in rigid motion."""
    model = arch(mass_flow=0.0)
    write_model(tmp_path / "tube.model.h5", tube_model(model.nodes.xyz, STEEL, held=held))
    (tmp_path / "tube.toml").write_text(re.sub("mass_flow = .*", "mass_flow = 1e-4", JOB.format(area=BORE)))
    job = load_job(tmp_path / "tube.toml")
    for work in (check_job, run_job):
        with contextlib.nullcontext() if held else refusal("value", "flow"):
            work(job)


def _structure(model):
    return tube_model(model.nodes.xyz, STEEL, held=(0, len(model.nodes) - 1))
