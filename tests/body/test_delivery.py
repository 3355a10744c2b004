"""What jobs deliver with a body, through the command line: frames, stiffening, rankings, stress, exports."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs import Envelope, assemble, elastic_body, make_part, read_body, write_body
from morembs.app.cli import app
from morembs.base.units import parse_units
from morembs.body.floating.frame import floating_frame
from morembs.body.floating.stiffening_terms import geometric_stiffening
from morembs.body.stress_shapes import stress_recovery
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.fem.selection import select_nodes
from morembs.fem.stress_operator import von_mises
from morembs.importers import read_mesh
from morembs.problem import Problem
from morembs.reducers import CraigBampton
from tests.support.decks import folder

TABLES = {
    "frame": 'kind = "tangent"\ninterfaces = ["left"]\norigin = [0.0, 10.0, 10.0]',
    "envelope": "acceleration = 9810.0\nspeed = 100.0\nforce = 500.0",
    "stiffening": "share = 1e-5",
    "stress": 'nodes = "skin"\nsingle = false',
}


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def delivered(tmp_path_factory):
    path = tmp_path_factory.mktemp("delivery")
    done = run("reduce", folder(path, TABLES))
    assert done.exit_code == 0, done.output
    return path / "part.h5", done.stdout


@pytest.fixture(scope="module")
def direct(delivered):
    """The same through the Python interface."""
    mesh = read_mesh(delivered[0].with_name("part.inp"), parse_units("mm-t-s"))
    model = assemble(mesh, [isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)])
    sets = {name: select_nodes(model, f"set:{name.upper()}") for name in ("left", "right")}
    ends = [make_interface(model, name=name, nodes=nodes) for name, nodes in sets.items()]
    with Problem(model, ends) as problem:
        reduced = CraigBampton(modes=4).reduce(problem)
        frame = floating_frame(problem, reduced, kind="tangent", interfaces=("left",), origin=(0.0, 0.01, 0.01))
        envelope = Envelope(acceleration=9.81, speed=100.0, force=0.5 * 1000, share=1e-5)
        stiff = geometric_stiffening(problem, reduced, frame, envelope)
        yield problem, reduced, frame, stiff, stress_recovery(problem, reduced, single=False)


def test_a_job_delivers_what_the_python_interface_gives_in_si_units(delivered, direct):
    body = read_body(delivered[0]).bodies["cb"]
    _, _, frame, stiff, _ = direct
    stored = body.floating
    assert (stored.kind, stored.interfaces) == ("tangent", ("left",))
    assert np.abs(stored.origin - [0.0, 0.01, 0.01]).max() < 1e-15
    # Eigenvectors may differ in sign; what they span and weigh does not.
    values = np.sort(np.linalg.eigvals(np.linalg.solve(stored.integrals.Me, stored.Ke)).real)
    expected = np.sort(np.linalg.eigvals(np.linalg.solve(frame.integrals.Me, frame.Ke)).real)
    assert np.abs(values / expected - 1).max() < 1e-8
    assert np.abs(stored.integrals.inertia / frame.integrals.inertia - 1)[np.eye(3) > 0].max() < 1e-12
    moved, expected = (np.linalg.norm(floating.markers["right"].motion) for floating in (stored, frame))
    assert moved == pytest.approx(expected, rel=1e-8)
    assert set(stored.stiffening.dropped) == set(stiff.dropped) and stored.stiffening.least_share == 1e-5
    for name, share in stiff.share.items():
        assert stored.stiffening.share[name] == pytest.approx(share, rel=1e-6, abs=1e-12)
    assert body.ranking and {term.equation for term in body.ranking} <= {"force", "moment", "elastic"}
    assert body.ranking[0].share >= body.ranking[-1].share
    assert "tangent frame at left" in delivered[1] and "inertia terms: " in delivered[1]


def test_a_share_without_a_load_is_one_of_unit_loads(direct, tmp_path):
    problem, reduced, frame, stiff, _ = direct
    first, *others = stiff.share
    few = replace(stiff, load={first: 7.0})
    body = elastic_body(problem, reduced, make_part(problem), floating=replace(frame, stiffening=few))
    stored = read_body(write_body(tmp_path / "part.h5", [body])).bodies[body.name].floating.stiffening
    assert stored.load == {first: 7.0, **dict.fromkeys(others, 1.0)} and stored.share == stiff.share


def test_info_tells_what_is_in_the_file(delivered):
    shown = run("info", delivered[0]).stdout
    assert "tangent frame at left" in shown and "stress recovery" in shown and "inertia terms" in shown
    document = json.loads(run("info", "--json", delivered[0]).stdout)[0]["bodies"]["cb"]
    assert document["frame"] == "tangent" and document["stress_recovery"] and document["ranking"][0][2] > 0


def test_a_motion_is_recovered_with_its_stress(delivered, direct, tmp_path):
    """A table of coordinates on the command line gives the stresses that the shapes give."""
    _, _, _, _, shapes = direct
    body = read_body(delivered[0]).bodies["cb"]
    q = np.zeros((3, len(body.stiffness_matrix)))
    q[1:, 6] = [1e-6, 2e-6]
    table = tmp_path / "motion.csv"
    lines = ["t," + ",".join(f"q{k + 1}" for k in range(q.shape[1]))]
    lines += [",".join(map(repr, [0.1 * step, *row.tolist()])) for step, row in enumerate(q)]
    table.write_text("\n".join(lines))
    done = run("recover", delivered[0], table, "--out", tmp_path / "motion.vtkhdf", "--json")
    assert done.exit_code == 0, done.output
    (document,) = json.loads(done.stdout)
    expected = von_mises(shapes.at(q)).max()
    assert document["steps"] == 3 and document["peak"]["time_s"] == 0.2
    assert document["peak"]["von_mises_pa"] == pytest.approx(expected, rel=1e-6)
    jumps = shapes.jumps_at(q)
    step, point = np.unravel_index(np.argmax(jumps), jumps.shape)
    assert document["worst_jump"] == {
        "jump_pa": pytest.approx(jumps.max(), rel=1e-5),
        "node": shapes.points[point],
        "time_s": 0.1 * step,
    }
    at_peak = jumps[2, np.argmax(von_mises(shapes.at(q))[2])]
    assert document["peak"]["jump_pa"] == pytest.approx(at_peak, rel=1e-5)
    output = run("recover", delivered[0], table, "--out", tmp_path / "motion.vtkhdf").stdout
    assert f"elements around it miss the average by {at_peak / expected:.1%}" in output
    assert f"({jumps.max() / expected:.1%} of that stress) at node {shapes.points[point]}" in output
    assert ("mesh is coarse there" in output) == (at_peak > 0.05 * expected)


@pytest.mark.parametrize(
    "target", ["exudyn", "sid", "simscape", "mbdyn", "op4", "dmig", "abaqus", "matrix-market", "fmu", "c"]
)
def test_every_target_takes_the_body(delivered, tmp_path, target):
    out = tmp_path / {"exudyn": "part.hdf5", "c": "part.c"}.get(target, "part.out")
    done = run("export", delivered[0], "--to", target, "--out", out, "--json")
    assert done.exit_code == 0, done.output
    (document,) = json.loads(done.stdout)
    assert all((tmp_path / path).stat().st_size > 100 for path in document["written"])
    assert any("stress shapes" in note for note in document["notes"])
    if target != "sid":
        assert any("stiffening" in note for note in document["notes"])


def test_the_frame_can_be_changed_at_export(delivered, tmp_path):
    done = run("export", delivered[0], "--to", "sid", "--frame", "mean-axes", "--out", tmp_path / "a.SID_FEM")
    assert done.exit_code == 0 and "stiffening belongs to the frame" in done.stdout
    for frame, words in (("tangent", "was given 0 interfaces"), ("tangent:lefft", "did you mean 'left'"), ("x", "x")):
        done = run("export", delivered[0], "--to", "sid", "--frame", frame, "--out", tmp_path / "b.SID_FEM")
        assert done.exit_code == 2 and words in done.output and done.output.count("\n") == 1
        assert not (tmp_path / "b.SID_FEM").exists()


@pytest.mark.parametrize(
    "arguments, words",
    [
        ((), "the body file is missing"),
        (("--to", "exodyn"), "did you mean 'exudyn'"),
        (("--to", "sid", "--set", "dialect"), "expected --set dialect=VALUE"),
        (("--to", "sid", "--set", "dialekt=1"), "'dialect'"),
        (("--to", "sid", "--set", "dialect=other"), "fembs"),
        (("--to", "op4", "--body", "cc"), "no body 'cc'"),
    ],
)
def test_impossible_exports_are_refused_in_one_line(delivered, arguments, words):
    done = run("export", *([delivered[0]] if arguments else []), *arguments)
    assert done.exit_code == 2 and words in done.output and done.output.count("\n") == 1


@pytest.mark.parametrize(
    "tables, words",
    [
        ({"frame": 'kind = "tangent"\ninterfaces = ["leftt"]'}, "did you mean 'left'"),
        ({"frame": 'kind = "chord"\ninterfaces = ["left"]'}, "expected 2"),
        ({"frame": 'kind = "tangential"'}, "tangent"),
        ({"envelope": "speed = -1.0"}, "zero or more"),
        ({"stiffening": "share = 2.0"}, "from 0 to 1"),
        ({"stress": 'nodes = "set:NOWHERE"'}, "NOWHERE"),
        (
            {"frame": TABLES["frame"], "reduce": 'method = "modal"\nmodes = 3\ninterfaces = "fixed"'},
            "a free body with six",
        ),
    ],
)
def test_impossible_deliveries_are_refused_in_one_line(tmp_path, tables, words):
    done = run("reduce", folder(tmp_path, tables))
    assert done.exit_code == 2 and words in done.output and done.output.count("\n") == 1
    assert not (tmp_path / "part.h5").exists()
