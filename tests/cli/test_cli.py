"""The verbs, their JSON documents, exit codes, and what goes where."""

from __future__ import annotations

import io
import itertools
import json
import re
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import typer.main
from matplotlib.image import imread
from rich.console import Console
from typer.testing import CliRunner

import morembs
from morembs.app.cli import commands as cli
from morembs.app.cli import screen, terminal
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.app.report.certificates import Certified
from morembs.app.report.frequencies import beside
from morembs.body.drawing import viewed_axes
from morembs.body.file import read_body
from morembs.importers import read_mesh
from morembs.responses.tolerances import TOL as RESPONSES
from tests.support.commands import FACTORISING, factorisations, without_progress
from tests.support.decks import BEAM, HINGED, deck, folder
from tests.support.progress import Heard

RUNNER = CliRunner()
# The beam of BEAM: 60 x 20 x 20 mm of steel.
MASS = 7850 * 0.06 * 0.02 * 0.02


def run(*arguments: str) -> Any:
    """The JSON document of a command that succeeds."""
    result = RUNNER.invoke(cli.app, [*arguments, "--json"])
    assert result.exit_code == 0, (result.stderr, result.exception)
    assert without_progress(result.stderr) == ""
    return json.loads(result.stdout)[0]


def test_reduce_json(tmp_path: Path) -> None:
    tables = {"reduce2": 'method = "guyan"', "response": "from_hz = 100.0\nto_hz = 20000.0\npoints = 20"}
    done = run("reduce", str(folder(tmp_path, tables)))
    assert done["dofs"] == 3 * 7 * 3 * 3
    assert done["output"] == str(tmp_path / "part.h5") and (tmp_path / "part.h5").is_file()
    assert done["solver"] in morembs.available_solvers()
    assert done["mass"] == pytest.approx(MASS, rel=1e-9)
    assert done["center_of_mass"] == pytest.approx([0.03, 0.01, 0.01], rel=1e-9)
    assert done["inertia"][0][0] == pytest.approx(MASS * (0.02**2 + 0.02**2) / 12, rel=1e-9)
    assert len(done["full_frequencies_hz"]) == 6 + 10
    assert list(done["bodies"]) == ["cb", "guyan"]
    cb, guyan = done["bodies"]["cb"], done["bodies"]["guyan"]
    assert (cb["order"], guyan["order"]) == (16, 12)
    assert cb["mode_kind"] == ["constraint"] * 12 + ["fixed-interface"] * 4
    assert done["frequencies_hz"] == cb["frequencies_hz"]
    # Reduced frequencies lie above the full ones, those of the smaller basis highest.
    known = done["full_frequencies_hz"], cb["frequencies_hz"], guyan["frequencies_hz"]
    full, more, fewer = (np.array(frequencies[6:8]) for frequencies in known)
    assert (full <= more * (1 + 1e-9)).all() and (more <= fewer * (1 + 1e-9)).all()
    assert more == pytest.approx(full, rel=0.02)
    assert 0 < cb["largest_response_error"] < guyan["largest_response_error"]
    stages = {"read", "assemble", "couple", "factorise", "compare", "response", "deliver", "write"}
    stages |= {"reduce cb", "reduce guyan"}
    assert set(done["seconds"]) == stages == set(done["peak_memory_bytes"])
    assert all(seconds >= 0 for seconds in done["seconds"].values())
    assert all(count > 1e6 for count in done["peak_memory_bytes"].values())


@pytest.mark.parametrize("damping", [{}, {"damping": "modal = 0.02"}])
def test_errors_at_peaks_without_damping_are_told_as_such(tmp_path: Path, damping: dict[str, str]) -> None:
    tables = {"response": "from_hz = 100.0\nto_hz = 60000.0\npoints = 200"} | damping
    job = folder(tmp_path, tables)
    done = run("reduce", str(job))
    body = done["bodies"]["cb"]
    assert done["response_damped"] is bool(damping)
    assert 0 < body["quasistatic_response_error"] < 0.1
    assert 0 < body["median_response_error"] < body["largest_response_error"]
    assert body["largest_response_error"] > 1
    said = " ".join(RUNNER.invoke(cli.app, ["reduce", str(job)]).stdout.split())
    assert ("the largest errors lie at resonances" in said) is not bool(damping)
    assert f"below half the first resonance {body['quasistatic_response_error']:.1e})" in said


def test_tables_of_a_certificate_fit_a_terminal_of_100_columns(tmp_path: Path) -> None:
    job = folder(tmp_path, {"certify": "band_hz = [0, 20000]"})
    tables = (
        RUNNER.invoke(cli.app, ["reduce", str(job)]).stdout.partition("certificate: ")[2].partition("  error of")[0]
    )
    rows = tables.splitlines()
    assert max(map(len, rows)) <= 100 and sum(row.startswith("cb") for row in rows) == 2
    assert all(
        word in tables for word in ("envelope <=", "pointwise <=", "worst at Hz", "residues off by", "MAC", "kind")
    )


def test_units_and_damping_are_converted(tmp_path: Path) -> None:
    """The same part in mm-t-s and in m-kg-ms gives the same body."""
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    damping = "rayleigh = { alpha = 5.0, beta = 2e-6 }"
    point = 'name = "left"\nnodes = "box:-1,0,0,1,20,20"\npoint = [-5.0, 0.0, 0.0]'
    first = folder(tmp_path / "a", {"damping": damping, "interface": point})
    other = {
        "model": 'mesh = "part.inp"\nunits = { length = "m", mass = "kg", time = "ms" }',
        "material": "young = 210e3\npoisson = 0.3\ndensity = 7850.0",
        "interface": 'name = "left"\nnodes = "box:-0.001,0,0,0.001,0.02,0.02"\npoint = [-0.005, 0.0, 0.0]',
        "damping": "rayleigh = { alpha = 5e-3, beta = 2e-3 }",
    }
    second = folder(tmp_path / "b", other, deck(BEAM, size=0.01))
    for path in (first, second):
        run("reduce", str(path))
    a, b = (read_body(path.parent / "part.h5") for path in (first, second))
    assert b.mass == pytest.approx(a.mass, rel=1e-12)
    assert a.interfaces["left"].point == pytest.approx([-0.005, 0, 0], abs=1e-15)
    assert b.interfaces["left"].point == pytest.approx(a.interfaces["left"].point, abs=1e-15)
    # Modes may differ in sign: the condensed matrices at the interfaces must not.
    for name in ("mass_matrix", "stiffness_matrix", "damping_matrix"):
        A, B = (getattr(x.bodies["cb"], name)[:12, :12] for x in (a, b))
        assert np.abs(A - B).max() < 1e-6 * np.abs(A).max()
    cb = a.bodies["cb"]
    assert np.abs(cb.damping_matrix).max() > 1e-9 * np.abs(cb.stiffness_matrix).max()


def test_orthotropic_equal_to_isotropic(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    G = 210e3 / 2.6
    table = (
        "young = [210e3, 210e3, 210e3]\npoisson = [0.3, 0.3, 0.3]\ndensity = 7.85e-9\n"
        f"shear = [{G!r}, {G!r}, {G!r}]\naxes = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]"
    )
    isotropic = run("reduce", str(folder(tmp_path / "a")))
    orthotropic = run("reduce", str(folder(tmp_path / "b", {"material": table})))
    assert orthotropic["frequencies_hz"][6:] == pytest.approx(isotropic["frequencies_hz"][6:], rel=1e-8)


def test_full_modes_can_be_switched_off(tmp_path: Path) -> None:
    done = run("reduce", str(folder(tmp_path, {"check": "full_modes = 0"})))
    assert done["full_frequencies_hz"] is None
    assert "compare" not in done["seconds"]


def test_reduce_table_and_picture(tmp_path: Path) -> None:
    job = folder(tmp_path, {"output": 'path = "part.h5"\npicture = "part.png"', "damping": "modal = 0.01"})
    result = RUNNER.invoke(cli.app, ["reduce", str(job)])
    assert result.exit_code == 0, (result.stderr, result.exception)
    for words in ("12 constraint + 4 fixed-interface = 16 coordinates", "off by %", "0.1884 kg", "reduce cb"):
        assert words in result.stdout
    pixels = imread(tmp_path / "part.png")[:, :, :3]
    colored = np.ptp(pixels, axis=2) > 0.2
    half = len(colored) // 2
    assert colored[:half, :1250].mean() > 0.05  # modes, the scale beside them not counted
    assert colored[half:].mean() > 0.001  # curves


def test_picture_shows_the_flat_side() -> None:
    """A plate along no axis of the model: its length runs to the right, its normal comes towards the viewer."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    corners = np.array(list(np.ndindex(2, 2, 2))) * [0.3, 0.1, 0.01]
    frame = viewed_axes(corners @ turn.T)
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1)
    length, _, normal = turn.T
    assert abs(frame[0] @ length) > 0.9 and abs(frame[2] @ normal) > 0.8


def test_info(tmp_path: Path) -> None:
    done = run("reduce", str(folder(tmp_path)))
    info = run("info", done["output"])
    for key in ("dofs", "frequencies_hz", "full_frequencies_hz", "mass", "center_of_mass", "inertia", "output"):
        assert info[key] == done[key]
    for key in ("order", "frequencies_hz", "mode_kind", "rigid_count"):
        assert info["bodies"]["cb"][key] == done["bodies"]["cb"][key]
    assert info["interfaces"]["left"]["nodes"] == 9
    result = RUNNER.invoke(cli.app, ["info", done["output"]])
    assert result.exit_code == 0 and "interface left: rigid, 9 nodes" in result.stdout


def test_info_of_another_file(tmp_path: Path) -> None:
    (tmp_path / "x.h5").write_bytes(b"no")
    for name in ("x.h5", "y.h5"):
        result = RUNNER.invoke(cli.app, ["info", str(tmp_path / name)])
        assert result.exit_code == 2 and without_progress(result.stderr).count("\n") == 1 and name in result.stderr


def test_check_forecasts_without_factorising(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", FACTORISING)
    job = folder(tmp_path)
    forecast = run("check", str(job))
    assert factorisations(caplog.records) == 0
    assert (forecast["nodes"], forecast["elements"], forecast["dofs"]) == (63, 24, 189)
    assert forecast["coupled_dofs"] == 189 - 2 * 27 + 2 * 6
    assert forecast["rigid_modes"] == 6
    assert not (tmp_path / "part.h5").exists()
    steel = morembs.isotropic(set="all", young=210e9, poisson=0.3, density=7850)
    K = morembs.assemble(read_mesh(tmp_path / "part.inp"), [steel]).K
    assert forecast["stiffness_nonzeros"] == K.nnz
    run("reduce", str(job))
    assert factorisations(caplog.records) > 0
    # The symbolic analysis counts what the factorisation then stores.
    model = morembs.assemble(read_mesh(tmp_path / "part.inp", morembs.base.units.parse_units("mm-t-s")), [steel])
    assert forecast["solver"] in morembs.available_solvers() and "fastest" in forecast["choice"]
    assert model.K.nnz == forecast["stiffness_nonzeros"]
    factor = run("reduce", str(job))["factor"]
    assert forecast["factor_entries"] == pytest.approx(factor["factor_entries"], rel=0.2)
    assert forecast["factor_flops"] == pytest.approx(factor["flops"], rel=0.25)


def test_rigid_interface_joins_parts(tmp_path: Path) -> None:
    """Two cubes that touch along an edge are one sound body once a rigid frame holds both sides of it."""
    frame = {"interface": 'name = "joint"\nnodes = "box:10,10,0,30,30,20"', "interface2": None}
    checked = run("check", str(folder(tmp_path, frame, deck(HINGED))))
    assert checked["rigid_modes"] == 6


def test_memory_budget_is_that_of_the_process(tmp_path: Path) -> None:
    """A budget that Python alone exceeds is refused before anything is assembled; that of the message will do."""
    output = 'path = "part.h5"\npicture = "part.png"'
    job = folder(tmp_path, {"solver": 'memory = "100 kB"', "output": output})
    assert load_job(job).memory == 100_000
    command = [sys.executable, "-m", "morembs", "reduce", str(job), "--json"]
    advice = r"below what this program itself needs.*give at least (\d+) MB"
    checked = RUNNER.invoke(cli.app, ["check", str(job)])
    assert checked.exit_code == 2 and re.search(advice, checked.stderr)
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2 and without_progress(done.stderr).count("\n") == 1, done.stderr
    needed = int(re.search(advice, done.stderr)[1])  # type: ignore[index]
    folder(tmp_path, {"solver": f'memory = "{needed} MB"', "output": output})
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)[0]["job_peak_memory_bytes"] < 1.05e6 * needed


def test_solvers() -> None:
    result = RUNNER.invoke(cli.app, ["solvers", "--json"])
    solvers = {solver.pop("name"): solver for solver in json.loads(result.stdout)}
    assert list(solvers) == list(morembs.available_solvers())
    assert solvers["superlu"] == {"available": True, "reason": ""}
    assert "superlu: available" in RUNNER.invoke(cli.app, ["solvers"]).stdout


def test_solvers_tells_all_tolerances_with_their_reasons() -> None:
    told = json.loads(RUNNER.invoke(cli.app, ["solvers", "--tolerances", "--json"]).stdout)
    assert all(each["reason"].endswith(".") for each in told)
    values = {(each["room"], each["name"]): each["value"] for each in told}
    assert len(values) == len(told)
    assert values["responses", "sharpness"] == RESPONSES.sharpness and values["dynamics.multibody", "max_turn"] == 0.5
    lines = RUNNER.invoke(cli.app, ["solvers", "--tolerances"]).stdout.splitlines()
    assert len(lines) == len(told) and f"responses: sharpness = {RESPONSES.sharpness}: " in "\n".join(lines)


def test_several_jobs_go_on_after_a_failure(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / name).mkdir()
        folder(tmp_path / name, {"model": 'mesh = "none.inp"'} if name == "a" else None)
    jobs = [str(tmp_path / name / "job.toml") for name in "abc"]
    result = RUNNER.invoke(cli.app, ["reduce", *jobs, "--json"])
    assert result.exit_code == 2
    errors = without_progress(result.stderr)
    assert errors.startswith(f"error: {jobs[0]}: ") and errors.count("\n") == 1
    results = json.loads(result.stdout)
    assert [set(job_result) == {"job", "error", "kind", "keyword"} for job_result in results] == [True, False, False]
    assert [job_result["job"] for job_result in results] == jobs
    assert all((tmp_path / name / "part.h5").is_file() for name in "bc")


def test_memory_that_did_not_suffice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(scipy.linalg, "eigh", fail)
    result = RUNNER.invoke(cli.app, ["reduce", str(folder(tmp_path))])
    assert result.exit_code == 2
    assert "memory" in result.stderr and without_progress(result.stderr).count("\n") == 1


def test_usage() -> None:
    assert RUNNER.invoke(cli.app, ["redduce"]).exit_code == 2
    assert RUNNER.invoke(cli.app, ["reduce"]).exit_code == 2
    assert RUNNER.invoke(cli.app, ["--version"]).stdout == f"morembs {morembs.__version__}\n"
    assert "130 interrupted" in " ".join(RUNNER.invoke(cli.app, ["--help"]).stdout.split())
    for verb in typer.main.get_command(cli.app).commands:
        page = " ".join(RUNNER.invoke(cli.app, [verb, "--help"]).stdout.split())
        assert f"Example: morembs {verb}" in page and "<bool>" not in page and "130 interrupted" not in page


def test_lines_without_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stages on standard error, a clean document on standard output; nothing with --quiet."""
    quarters = itertools.count()
    at_once = partial(terminal.LineProgress, clock=lambda: 15.0 * next(quarters), patience=0.0)
    monkeypatch.setattr(terminal, "LineProgress", at_once)
    job = str(folder(tmp_path))
    result = RUNNER.invoke(cli.app, ["reduce", job, "--json"])
    assert json.loads(result.stdout)[0]["dofs"] == 189
    lines = [re.fullmatch(r"\[[\d,]+ s\] ([a-z ]+).*", line) for line in result.stderr.splitlines()]
    assert all(lines), result.stderr
    assert {"read", "factorise", "compare", "reduce cb", "deliver"} <= {line[1] for line in lines if line}
    result = RUNNER.invoke(cli.app, ["reduce", job, "--json", "--quiet"])
    assert json.loads(result.stdout)[0]["dofs"] == 189 and result.stderr == ""


class Clock:
    """Time that passes only when the test says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_long_work_goes_on_being_told() -> None:
    """A call that reports nothing for long is told all the same, and one that reports a lot is not told each time."""
    clock, lines = Clock(), list[str]()
    progress = terminal.LineProgress(lines.append, clock)

    def pass_time(seconds: int) -> None:
        for _ in range(2 * seconds):
            clock.now += 0.5
            progress.look()

    progress.stage("factorise")
    pass_time(4)
    assert lines == []
    pass_time(36)
    assert lines == ["[5 s] factorise", "[20 s] factorise", "[35 s] factorise"]
    del lines[:]
    progress.stage("solve modes")
    for step in range(700):
        clock.now += 0.0625
        progress.update(f"{step} converged")
    assert lines == ["[40 s] solve modes", "[55 s] solve modes: 239 converged", "[70 s] solve modes: 479 converged"]


def test_a_thread_looks_at_the_clock() -> None:
    """What the work does not tell, and for no longer than the work."""
    clock, heard = Clock(), threading.Event()
    lines = terminal.LineProgress(lambda _: heard.set(), clock)
    with lines.shown() as progress:
        progress.stage("factorise")
        clock.now = 100.0
        assert heard.wait()
        assert len(progress_threads()) == 1
    assert not progress_threads()


def progress_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if "_watch" in thread.name]


@pytest.mark.parametrize("visible", [True, False])
def test_progress_on_a_terminal(visible: bool) -> None:

    class Screen(io.StringIO):
        def write(self, text: str) -> int:
            written = super().write(text)
            if "factorise: half" in self.getvalue():
                seen.set()
            return written

    seen, drawn = threading.Event(), Screen()
    console = Console(file=drawn, force_terminal=True)
    with screen.TerminalProgress(console, visible, patience=0.0).shown() as progress:
        progress.stage("factorise")
        progress.update("half")
        assert seen.wait() if visible else not seen.is_set()
    assert seen.is_set() == visible


def test_stages_are_reported(tmp_path: Path) -> None:
    listener = Heard()
    result = run_job(load_job(folder(tmp_path)), listener)
    assert [stage.name for stage in result.stages] == [s for s in listener.stages if not s.startswith("writing")]


def test_rows_of_frequencies_stand_for_the_same_modes() -> None:
    """Bodies that follow responses have no modes that no load excites: their third may be the fifth of the model."""
    full = np.array([100.0, 110.0, 110.5, 200.0, 300.0])
    assert beside(full, np.array([100.1, 110.4, 299.0, 400.0])).tolist() == pytest.approx(
        [100.1, 110.4, np.nan, np.nan, 299.0], nan_ok=True
    )
    assert np.isnan(beside(full, np.zeros(0))).all()


@pytest.mark.parametrize(
    ("stored", "shown"), [((), ""), (("first", "second"), "first; second"), (np.array(" "), ""), ("one", "one")]
)
def test_notes_of_certificates_read_alike_before_and_after_they_are_stored(stored: Any, shown: str) -> None:
    assert Certified(name="body", order=1, values={"notes": stored}).text("notes") == shown
