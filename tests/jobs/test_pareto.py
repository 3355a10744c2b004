"""Reductions side by side, and what they are worth under changed boundary conditions."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.certificate.certify import certify
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import CraigBampton, FreeInterface, Modal
from morembs.responses.band import band_frequencies
from tests.support.decks import job
from tests.support.meshes import box, steel, where

TABLES = {
    "interface": 'name = "BIG"\nnodes = "set:BIGEND"',
    "interface2": 'name = "SMALL"\nnodes = "set:SMALLEND"',
    "damping": "rayleigh = { alpha = 5.0, beta = 2e-7 }",
    "reduce": 'method = "modal"\nmodes = 14',
    "reduce2": 'method = "guyan"',
    "reduce3": 'method = "free-interface"\nmodes = 2',
    "output": 'path = "rod.h5"\nnodes = "interfaces"',
}


def test_errors_with_an_interface_held_are_those_of_the_held_model():
    """Against dense solutions of the whole model, rigid motion included, with the motions of one end made zero."""
    model = steel(box("hex8", (8, 2, 2), (0.5, 0.05, 0.03)))
    ends = [make_interface(model, name=str(x), nodes=where(model, 0, x), coupling="average") for x in (0.0, 0.5)]
    with Problem(model, ends, damping=Damping(alpha=6.0, beta=2e-6)) as problem:
        K, M, B, Z = problem.K.toarray(), problem.M.toarray(), problem.B.toarray(), problem.rigid
        D = 2e-6 * K + 6.0 * (M - M @ Z @ Z.T @ M)
        hz = band_frequencies(problem, [100.0, 2500.0], 8)
        reducers = Modal(modes=9), FreeInterface(modes=6), CraigBampton(modes=6)
        bodies = [reducer.reduce(problem) for reducer in reducers]
        scale = problem.motion_scale
        for body, certificate in zip(bodies, certify(problem, bodies, [100.0, 2500.0], points=8), strict=True):
            for i, (held, free) in enumerate(((slice(0, 6), slice(6, 12)), (slice(6, 12), slice(0, 6)))):
                for j, w in enumerate(2 * np.pi * hz):
                    computed, true = (
                        held_response(P, Q, R, b, c, w, held, free) * np.outer(scale[free], scale[free])
                        for P, Q, R, b, c in ((body.K, body.D, body.M, body.B, body.C), (K, D, M, B, B.T))
                    )
                    error = np.linalg.norm(computed - true) / np.linalg.norm(true)
                    assert certificate.held_error[i, j] == pytest.approx(error, rel=1e-3, abs=1e-7)


def held_response(K, D, M, B, C, w, held, free):
    A = K + 1j * w * D - w**2 * M
    s = 1 / np.sqrt(np.abs(np.diag(A)))
    H = C @ (s[:, None] * np.linalg.solve(s[:, None] * A * s, s[:, None] * B))
    return H[free, free] - H[free, held] @ np.linalg.solve(H[held, held], H[held, free])


@pytest.fixture
def compare(small_meshes, tmp_path):
    def run(certify, *options):
        path = tmp_path / "rod.toml"
        model = f'mesh = "{small_meshes}/conrod.msh"\nunits = "mm-t-s"'
        path.write_text(job({**TABLES, "model": model, "certify": certify}))
        return CliRunner().invoke(app, ["compare", str(path), *options])

    return run


def test_comparison_marks_the_front_and_draws_it(compare, tmp_path):
    done = compare("band_hz = [0, 8000]\npoints = 6", "--json", "--picture", str(tmp_path / "front.png"))
    assert done.exit_code == 0, done.output
    contenders = {contender["name"]: contender for contender in json.loads(done.stdout)[0]["contenders"]}
    assert [contender["order"] for contender in contenders.values()] == [20, 12, 20]
    # Of equal size, many modes beat few with residual statics in the band and lose in statics; the small one is alone.
    assert contenders["modal"]["error"] < contenders["free-interface"]["error"]
    assert contenders["free-interface"]["static_error"] < 1e-8 < 1e-3 < contenders["modal"]["static_error"]
    assert {name for name, contender in contenders.items() if contender["best"]} == {"guyan", "modal"}
    for contender in contenders.values():
        assert contender["measure"] == "envelope"
        assert contender["error"] <= contender["bound"] * (1 + 1e-6) and contender["seconds"] >= 0
    assert (tmp_path / "front.png").read_bytes()[1:4] == b"PNG" and (tmp_path / "rod.h5").exists()


def test_comparison_prints_a_table(compare):
    done = compare("band_hz = [0, 8000]\npoints = 6\nbound = false", "--set", "output.path=other.h5")
    assert done.exit_code == 0 and "other.h5" in done.stdout.splitlines()[-1] and "written: " in done.stdout
    assert "* guyan" in done.stdout and "held, median" in done.stdout
    # Without limits all figures are of samples, and the legend names their measure.
    assert "by the measure of the certificate (pointwise); mean, pointwise:" in done.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("certify", "options", "message"),
    [
        (None, (), r"add a table \[certify\]"),
        ("band_hz = [0, 8000]", ("--picture", "front.jpg"), "ends in .png, .pdf or .svg"),
        ("band_hz = [8000, 0]", (), "0 <= LOW < HIGH"),
    ],
)
def test_comparison_says_what_it_lacks(compare, tmp_path, certify, options, message):
    done = compare(certify, *options)
    assert done.exit_code == 2
    assert message.replace("\\", "") in done.stderr
    assert not (tmp_path / "rod.h5").exists()
