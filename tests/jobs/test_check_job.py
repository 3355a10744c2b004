"""What ``check`` says is what ``reduce`` does: refusals, warnings about units, and what long work costs."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.base.errors import InputError
from morembs.base.progress import duration_words
from morembs.body.diagnostics import list_warnings
from morembs.fem.interface import make_interface
from morembs.importers.model_file import write_model
from morembs.linalg.sparse.threads import Speed
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, BalancedTruncation, CraigBampton, Gramian, Irka, Krylov, ProblemSummary
from morembs.reducers.cost import mode_seconds
from morembs.responses.direct import why_no_response
from tests.support.commands import FACTORISING, factorisations, without_progress
from tests.support.decks import BEAM, MATERIAL, deck, folder
from tests.support.meshes import box, steel, where
from tests.support.progress import Heard

RUNNER = CliRunner()
IRKA = 'method = "irka"\norder = 4\nband_hz = [0, 5000]'
TWO_SIDED = 'method = "krylov"\ntwo_sided = true\ninputs = ["left"]\noutputs = ["right"]'


def checked(job: Path) -> Any:
    result = RUNNER.invoke(cli.app, ["check", str(job), "--json"])
    assert result.exit_code == 0, (result.stderr, result.exception)
    return json.loads(result.stdout)[0]


def state_space(inputs: str, held: str = "", path: str = "x.npz", more: str = "") -> str:
    return f'path = "{path}"\ninputs = ["{inputs}"]\noutputs = ["right:velocity"]\nheld = [{held}]\n{more}'


REFUSED = {
    "a signal of nothing": ({"state_space": state_space("lefft:force")}, "did you mean 'left'?"),
    "a loose part": ({"state_space": state_space("left:acceleration:x+y+z+ry+rz")}, "is left (rotation about x)"),
    "displacement in a .mat": ({"state_space": state_space("left:displacement", path="x.mat")}, "proper state space"),
    "a body of no name": ({"state_space": state_space("left:force", more='body = "bc"')}, "did you mean 'cb'?"),
    "hysteresis in time": (
        {"state_space": state_space("left:force"), "damping": "structural = 0.02"},
        "structural damping of 0.02",
    ),
    "one file twice": ({"state_space": state_space("left:force"), "output": 'path = "x.npz"'}, "would overwrite"),
    "a chord of nothing": ({"frame": 'kind = "chord"'}, "a chord frame was given 0 interfaces"),
    "poles of structural damping": ({"reduce": IRKA, "damping": "structural = 0.02"}, "structural damping"),
    "all resonances undamped": ({"reduce": 'method = "balanced-truncation"\norder = 4'}, "infinite without damping"),
    "stress at no nodes": ({"stress": 'nodes = "set:FILLET"'}, "[stress]"),
    "inputs of no interface": ({"reduce": 'method = "krylov"\ninputs = ["lefft"]'}, "did you mean 'left'?"),
    "a frame without symmetry": ({"reduce": TWO_SIDED, "envelope": "acceleration = 10.0"}, "two-sided"),
    "a preload on nothing": ({"preload": "wrench = { middle = [1, 0, 0, 0, 0, 0] }"}, "middle"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_check_refuses_what_reduce_refuses(tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str) -> None:
    """Both in the same words, before anything is factorised."""
    caplog.set_level("INFO", FACTORISING)
    tables, words = REFUSED[name]
    job = folder(tmp_path, tables)
    check, reduce = (RUNNER.invoke(cli.app, [verb, str(job)]) for verb in ("check", "reduce"))
    assert (check.exit_code, reduce.exit_code) == (2, 2), (check.stdout, reduce.exception)
    assert without_progress(check.stderr) == without_progress(reduce.stderr) and words in check.stderr
    assert factorisations(caplog.records) == 0


def test_a_model_file_has_no_stress_either(tmp_path: Path) -> None:
    model = steel(box("hex8", (4, 2, 2), (0.4, 0.2, 0.2)))
    ends = {"LEFT": where(model, 0, 0.0), "RIGHT": where(model, 0, 0.4)}
    model = replace(model, mesh=None, materials=(), nodes=replace(model.nodes, sets=ends))
    write_model(tmp_path / "part.model.h5", model)
    for extra in ({"stress": 'nodes = "skin"'}, {"stiffening": ""}, {"output": 'path = "part.h5"\nnodes = "skin"'}):
        job = folder(tmp_path, {"model": 'file = "part.model.h5"', "material": None, **extra})
        check, reduce = (RUNNER.invoke(cli.app, [verb, str(job)]) for verb in ("check", "reduce"))
        assert (check.exit_code, reduce.exit_code) == (2, 2), (extra, check.stdout)
        assert without_progress(check.stderr) == without_progress(reduce.stderr) and "matrices only" in check.stderr


DAMPINGS = {
    "none": Damping(),
    "rayleigh": Damping(alpha=5.0, beta=1e-6),
    "modal": Damping(modal=0.01),
    "structural": Damping(structural=0.02),
    "partial": Damping(modal_table=[[0, 0.0], [9000, 0.1]]),
}
BAND = [0.0, 3000.0]
METHODS = {
    "auto": AutoReducer(band_hz=BAND, tolerance=1e-2),
    "irka": Irka(order=6, band_hz=BAND, max_steps=3),
    "gramian": Gramian(band_hz=BAND, order=12),
    "direct": Gramian(band_hz=BAND, order=12, direct=True, points=6),
    "band": BalancedTruncation(order=8, band_hz=BAND),
    "balanced": BalancedTruncation(order=8, adi_tolerance=1e-4),
    "cb": CraigBampton(modes=4),
    "krylov": Krylov(),
}


@pytest.mark.parametrize(("own", "large"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("damping", DAMPINGS)
def test_damping_is_refused_as_the_reducers_do(damping: str, own: bool, large: bool) -> None:
    """``why_not`` tells before any work which reducers will refuse; they are the judges."""
    # Small models with a damping matrix are taken whole, larger ones are not.
    model = steel(box("hex8", (40 if large else 5, 1, 1), (0.5, 0.05, 0.05)))
    assert bool(why_no_response(DAMPINGS["rayleigh"], True, model.K.shape[0])) == large
    if own:
        model = replace(model, D=sp.csr_array(1e-6 * model.K))
    if own and DAMPINGS[damping].structural:
        return  # refused by the problem itself
    end = make_interface(model, name="end", nodes=where(model, 0, 0.0))
    with Problem(model, [end], damping=DAMPINGS[damping]) as problem:
        for name, reducer in METHODS.items():
            reason = reducer.why_not(ProblemSummary.of(problem))
            try:
                reducer.reduce(problem)
            except InputError as error:
                assert reason, (name, str(error))
            else:
                assert not reason, (name, reason)


SI_IN_MM = 'set = "all"\nyoung = 210e9\npoisson = 0.3\ndensity = 7850.0'


def test_units_are_looked_at_before_any_work(tmp_path: Path) -> None:
    """MPa taken for Pa; SI beside millimetres; and metres where millimetres are meant: ``check`` says so, and
    ``reduce`` before it factorises."""
    cases = [
        ({"model": 'mesh = "part.inp"'}, 'units = "mm-t-s"'),
        ({"material": SI_IN_MM}, "modulus 2.1e+05, density 7.85e-09"),
    ]
    for number, (tables, words) in enumerate(cases):
        (tmp_path / str(number)).mkdir()
        job = folder(tmp_path / str(number), {**tables, "check": "full_modes = 0", "reduce": 'method = "guyan"'})
        warnings = checked(job)["warnings"]
        assert len(warnings) == 1 and words in warnings[0] and ("mm-t-s" in warnings[0])
        listener = Heard()
        result = run_job(load_job(job), listener, listener.told.append)
        assert warnings[0] in result.warnings
        assert listener.told.index(warnings[0]) < listener.told.index("factorise")


def test_a_mesh_in_mm_beside_a_material_in_si(tmp_path: Path) -> None:
    """The part is 60 long: in metres nothing to warn of; ten times larger it is."""
    tables = {"model": 'mesh = "part.inp"', "material": SI_IN_MM}
    assert checked(folder(tmp_path, tables))["warnings"] == []
    warnings = checked(folder(tmp_path, tables, deck(BEAM, size=100.0)))["warnings"]
    assert len(warnings) == 1 and "m long" in warnings[0] and "7.85e-9" in warnings[0]


def test_units_of_a_deck_are_those_that_the_job_declares(tmp_path: Path) -> None:
    """A density in kg/m3 beside a modulus in MPa, in the key of the job for materials that lack one."""
    job = folder(tmp_path, {"interface": 'name = "left"\nnodes = "box:-1,0,0,1,20,20"'})
    text = (tmp_path / "part.inp").read_text() + MATERIAL.replace("*DENSITY\n7.85e-9\n", "")
    (tmp_path / "part.inp").write_text(text)
    tables = '[model]\nfile = "part.inp"\nunits = "mm-t-s"\ndensity = 7850.0\n'
    job.write_text(tables + '[[reduce]]\nmethod = "modal"\nmodes = 3\n[output]\npath = "part.h5"\n')
    (warning,) = (text for text in checked(job)["warnings"] if text.startswith("taken in"))
    assert warning.startswith("taken in mm-t-s as declared") and "density in t/mm3" in warning


def test_warnings_go_to_standard_error_first(tmp_path: Path) -> None:
    job = folder(tmp_path, {"model": 'mesh = "part.inp"', "check": "full_modes = 0", "reduce": 'method = "guyan"'})
    result = RUNNER.invoke(cli.app, ["reduce", str(job), "--json"])
    assert result.exit_code == 0 and "mm-t-s" in result.stderr
    assert without_progress(result.stderr).startswith("warning: ")
    assert json.loads(result.stdout)[0]["warnings"][0] in result.stderr


def test_python_can_ask_for_the_warnings() -> None:
    size = (500.0, 60.0, 40.0)
    assert list_warnings(steel(box("hex8", (6, 2, 2), (0.5, 0.06, 0.04)))) == ()
    (warning,) = list_warnings(steel(box("hex8", (6, 2, 2), size), young=2.1e5, density=7.85e-9))
    assert 'units = "mm-t-s"' in warning


def test_many_motions_and_many_modes_are_warned_of(tmp_path: Path) -> None:
    """Of a model of 3,456 dofs: smaller ones take seconds whatever is asked."""
    text = deck(tuple(itertools.product(range(17), range(7), range(7))))
    direct = 'name = "left"\nnodes = "box:-1,0,0,51,20,10"\ncoupling = "direct"'
    auto = 'method = "auto"\nband_hz = [0, 5000]\ntolerance = 1e-2'
    modes = 'name = "cb"\nmethod = "craig-bampton"\nmodes = 400'
    job = folder(tmp_path, {"interface": direct, "reduce": auto, "reduce2": modes}, text)
    document = checked(job)
    assert set(document["reduction_seconds"]) == {"auto", "cb"} and min(document["reduction_seconds"].values()) > 0
    motions, many = document["warnings"]
    assert f"all {3 * 36 + 6} interface degrees of freedom" in motions
    assert "'auto' about" in motions and "average" in motions
    assert "modes = 400 of" in many and "factor of three" in many
    few = folder(tmp_path, {"reduce": auto, "reduce2": modes.replace("400", "4")}, text)
    assert checked(few)["warnings"] == []
    shown = RUNNER.invoke(cli.app, ["check", str(few)]).stdout
    assert "reductions" in shown and re.search(r"memory of K and M +\d+(\.\d+)? [kM]B", shown)
    assert "within a factor of three" in shown


def test_time_of_modes_grows_as_measured() -> None:
    """10,956 dofs of a connecting rod, seconds of one processor at 30 GFlop/s: of 100 to 3,000 modes."""

    speed = Speed(gemm_gflops=30.0, triad_gbs=10.0)
    measured = {100: 0.95, 200: 1.7, 400: 5.0, 800: 10.1, 3000: 44.0}
    for count, seconds in measured.items():
        assert seconds / 3 < mode_seconds(10956, count, 2_110_617, speed) < 3 * seconds
    assert [duration_words(s) for s in (0.01, 40.0, 600.0, 7200.0)] == ["1 s", "40 s", "10 min", "2.0 h"]
    assert np.isfinite(mode_seconds(1000, 10, 0))
