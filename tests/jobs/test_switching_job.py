"""Static modes of candidate loads through job files: units, what the file holds, what is refused."""

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.body.file import read_body
from morembs.problem import Problem
from morembs.reducers import StaticModesSwitching
from tests.support.decks import job
from tests.support.meshes import box, steel
from tests.support.refusals import refusal

# The top middle line of the bar, in mm.
LINE = "box:0,49,99,800,51,101"


def deck(model, path):
    """An Abaqus deck in mm."""
    (block,) = model.mesh.blocks
    ids = model.nodes.ids
    nodes = [f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in zip(ids, 1e3 * model.nodes.xyz, strict=True)]
    cells = [", ".join(map(str, (i, *ids[row]))) for i, row in zip(block.ids, block.nodes, strict=True)]
    path.write_text("\n".join(["*NODE", *nodes, "*ELEMENT, TYPE=C3D8, ELSET=ALL", *cells, ""]))


def run(folder, candidates=LINE, more="", command="reduce"):
    model = steel(box("hex8", (8, 2, 2), (0.8, 0.1, 0.1)))
    deck(model, folder / "part.inp")
    rail = f'base_options = {{ modes = 5 }}\ncandidates = "{candidates}"\ndirections = [2]\n{more}'
    tables = {
        "interface": None,
        "interface2": None,
        "reduce": f'name = "rail"\nmethod = "static-modes-switching"\n{rail}',
        "reduce2": 'method = "modal"\nmodes = 5',
    }
    (folder / "job.toml").write_text(job(tables))
    return model, CliRunner().invoke(app, [command, str(folder / "job.toml")])


def test_a_job_in_millimetres_stores_what_the_reducer_makes_in_metres(tmp_path):
    model, result = run(tmp_path, more="stress = true\nband = 3")
    assert result.exit_code == 0, result.stderr
    bodies = read_body(tmp_path / "part.h5").bodies
    stored = bodies["rail"].switching()
    with Problem(model) as problem:
        reducer = StaticModesSwitching(
            base_options={"modes": 5},
            candidates="box:0,0.049,0.099,0.8,0.051,0.101",
            directions=[2],
            stress=True,
            band=3,
        )
        tables = reducer.tabulate_static_modes(problem, reducer.reduce(problem))
    assert stored.count == tables.count == 9
    # Signs and mixtures of equal modes may differ, what is left of static answers does not.
    for name in ("xyz", "stiffness", "mass", "static_stress"):
        want = getattr(tables, name)
        assert np.abs(getattr(stored, name) - want).max() < 1e-6 * np.abs(want).max(), name
    assert bodies["rail"].has_switching and not bodies["modal"].has_switching
    assert np.allclose(bodies["rail"].mass_matrix, bodies["modal"].mass_matrix, atol=1e-9)
    with refusal("missing", "", "'modal'", "static-modes-switching"):
        bodies["modal"].switching()
    info = CliRunner().invoke(app, ["info", str(tmp_path / "part.h5")])
    assert info.stdout.count("static modes of candidate loads") == 1


@pytest.mark.parametrize("command", ["check", "reduce"])
def test_candidates_that_cannot_be_are_refused_before_the_work(tmp_path, command):
    _, result = run(tmp_path, candidates="box:0,0,900,800,100,950", command=command)
    assert result.exit_code == 2 and "[[reduce]] 'rail': candidates: " in result.stderr
    assert "Traceback" not in result.stderr and not (tmp_path / "part.h5").exists()
    _, result = run(tmp_path, more="kind = 'line'", command=command)
    assert result.exit_code == 2 and "kind = 'line' was given" in result.stderr
