"""What README and documents show runs as it stands."""

import importlib
import importlib.util
import re
import subprocess
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import typer

from morembs.app.cli.commands import app
from morembs.app.cli.models import import_command
from morembs.app.jobs.job import job_tables
from morembs.app.simulations.result_file import read_recording
from morembs.app.simulations.tables import SystemTables
from morembs.base.key_tables import read_table
from morembs.body.file import read_body
from morembs.importers.model_file import read_model, write_model
from morembs.reducers import REDUCERS
from scripts.schema import job_keys
from tests.support.fmus import needs_compiler
from tests.support.meshes import box, steel
from tests.support.processes import morembs, python

ROOT = Path(__file__).parent.parent
SHOWN = {**typer.main.get_command(app).commands, "import": import_command()}


def blocks(document):
    """Python of a page of docs."""
    text = (ROOT / "docs" / document).read_text()
    return [
        block.replace("data/small_meshes", str(ROOT / "data" / "small_meshes"))
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    ]


def printed(code, folder):
    """Numbers that ``code`` prints, line by line."""
    done = python(code, folder)
    assert done.code == 0, done.errors
    return [list(map(float, re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", line))) for line in done.output.splitlines()]


@pytest.fixture(scope="module")
def conrod(tmp_path_factory):
    """A folder with the body file of the example of the README."""
    folder = tmp_path_factory.mktemp("conrod")
    text = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    done = python(code, folder)
    assert done.code == 0 and done.output == shown_outputs(text)[0], done.errors
    return folder


def shown_outputs(text):
    """Output of the blocks of a page, in the order of the page."""
    return re.findall(r"```text\n(.*?)```", text, re.DOTALL)


@pytest.fixture(scope="module")
def first_body(tmp_path_factory):
    """A folder with the body file of docs/start/first_body.md."""
    folder = tmp_path_factory.mktemp("first_body")
    done = python(blocks("start/first_body.md")[0], folder)
    assert done.code == 0, done.errors
    assert [done.output] == shown_outputs((ROOT / "docs/start/first_body.md").read_text())
    return folder


def test_the_readme_fits_one_screen_and_a_half():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 90


def test_the_job_of_the_readme_prints_the_lines_that_are_shown(tmp_path):
    text = (ROOT / "README.md").read_text()
    (job,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert len(job.splitlines()) == 5
    assert morembs("init", "--example", folder=tmp_path).code == 0
    (tmp_path / "job.toml").write_text(job)
    done = morembs("reduce", "job.toml", folder=tmp_path)
    assert done.code == 0 and set(shown_outputs(text)[1].splitlines()) <= set(done.output.splitlines()), done.errors
    assert morembs("view", "rod.h5", "--no-open", folder=tmp_path).code == 0


@pytest.mark.parametrize("page", ["index", "start/install", "start/first_job", "reference/commands"])
def test_commands_of_the_start_run(page, tmp_path):
    """The first block of commands of each page, in an empty folder; the lines of output that stand below it."""
    text = (ROOT / "docs" / f"{page}.md").read_text()
    lines = re.findall(r"^    morembs (.*)$", text, re.MULTILINE)
    printed = ""
    for line in lines:
        words = [*line.split(), *(["--no-open"] if line.startswith("view") and "--no-open" not in line else [])]
        done = morembs(*words, folder=tmp_path)
        assert done.code == 0, done.errors
        printed += done.output
    assert len(lines) >= 2
    for output in shown_outputs(text):
        assert set(output.splitlines()) <= set(printed.splitlines())


def test_the_table_of_methods_has_measured_figures(tmp_path):
    text = (ROOT / "docs/start/which_method.md").read_text()
    (job,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert morembs("init", "--example", folder=tmp_path).code == 0
    (tmp_path / "methods.toml").write_text(job)
    done = morembs("compare", "methods.toml", folder=tmp_path)
    assert done.code == 0, done.errors
    rows = [line.replace("*", " ").split() for line in done.output.splitlines()]
    found = {row[0]: row for row in rows if row}
    shown = re.findall(r"^\| `(\S+)` \| (\d+) \| (\S+) \| (\S+) \| (\S+) \|$", text, re.MULTILINE)
    assert len(shown) == len(tomllib.loads(job)["reduce"])
    for name, order, *errors in shown:
        row = found[name]
        assert row[1] == order, name
        for shown_error, error in zip(map(float, errors), (float(row[at]) for at in (2, 5, 6)), strict=True):
            # Below 1e-11 stands round-off.
            assert error == pytest.approx(shown_error, rel=0.1, abs=1e-11), name


def test_the_matrices_of_the_first_body(tmp_path):
    """The response of a chain of 50 masses to a force at its end, against the dense solution."""
    ((response,),) = printed(blocks("start/first_body.md")[2], tmp_path)
    K = np.diag([2.0] * 50) - np.diag([1.0] * 49, 1) - np.diag([1.0] * 49, -1)
    exact = np.linalg.solve(K - (2 * np.pi * 0.001) ** 2 * np.eye(50), np.eye(50)[:, 0])[0]
    assert response == pytest.approx(exact, rel=1e-9)


def test_the_example_swings_in_exudyn(first_body):
    """A stiff pendulum that was let go from the horizontal has fallen by the arc of a compound one."""
    pytest.importorskip("exudyn", reason="Exudyn is not here: pip install exudyn")
    ((x, y, z),) = printed(blocks("start/first_body.md")[1], first_body)
    rod = read_body(first_body / "conrod.h5")
    big, small = (np.asarray(rod.interfaces[name].point) for name in ("BIGEND", "SMALLEND"))
    arm, length = np.linalg.norm(rod.center_of_mass - big), np.linalg.norm(small - big)
    # Small angles: m g a t^2 / (2 J) about the pin.
    fallen = length * 9.81 * 0.05**2 / 2 * rod.mass * arm / (rod.inertia[1, 1] + rod.mass * arm**2)
    assert z - small[2] == pytest.approx(-fallen, rel=0.05) and abs(y) < 1e-5
    assert np.linalg.norm(np.array([x, y, z]) - big) == pytest.approx(length, rel=1e-3)


def test_python_example(conrod):
    body = read_body(conrod / "conrod.h5").bodies["cb30"]
    assert np.linalg.matrix_rank(body.stiffness_matrix, tol=1e-9 * np.abs(body.stiffness_matrix).max()) == 42 - 6
    assert body.frequencies_hz[6] > 1000


@pytest.mark.parametrize(("number", "client"), [(0, "control"), (1, "rumoca"), (2, "mujoco")])
def test_simulator_examples(conrod, number, client):
    pytest.importorskip(client, reason=f"{client} is not installed: pip install {client}")
    code, mass = blocks("howto/simulators.md")[number], read_body(conrod / "conrod.h5").mass
    (values,) = printed(code, conrod)
    if client == "control":
        reaction, said, gain = values[:3]
        assert reaction == pytest.approx(mass, rel=1e-6) and said == pytest.approx(mass)
        assert gain == pytest.approx(1, rel=0.1)
    elif client == "rumoca":
        # Pushed and held against: the ends move apart, the push is elastic.
        assert 1e-10 < values[0] < 1e-6
    else:
        # More than the rigid rod if it were pushed in its centre of mass.
        time, moved = values
        assert 1 < moved / (0.5 * 100 * time**2 / mass) < 20


def test_switching_example(tmp_path):
    first, second = blocks("howto/switching.md")
    code = first + second + "print(body.inner.size, switching.xyz[0, 0], switching.length)\n"
    (deflection, changes), (size, start, length) = printed(code, tmp_path)
    # A beam that is clamped at both ends, 10 N in its middle; the load crosses it in a tenth of a second.
    static = 10 * 0.5**3 / (192 * 2e9 * 0.05 * 0.03**3 / 12)
    assert static < -deflection < 1.15 * static
    assert changes > 10 and size == 6
    # What the page says of positions.
    assert start == pytest.approx(0.025) and length == pytest.approx(0.45)


def test_contact_examples(tmp_path):
    ground, plate, ball, block = blocks("howto/contact.md")
    times, (gap, force, *_, complementarity), (balance,) = printed(ground, tmp_path)
    fall = np.sqrt(2 / 9.81)
    assert times[:2] == pytest.approx([fall, fall * (1 + 2 * 0.8)], abs=1e-9)
    assert gap > 0 and force == 0 and complementarity < 1e-9
    assert balance == pytest.approx(9.81, abs=1e-9)
    ((touch, least, law),) = printed(plate, tmp_path)
    # 10 mm down to the plate, which sags by some micrometres.
    assert touch == pytest.approx(np.sqrt(2 * 0.01 / 9.81), rel=1e-3)
    assert least > -1e-9 and law < 1e-9
    ((*_, after),) = printed(ball, tmp_path)
    # After 80 mm of fall; for 0.6 the law of Flores leaves between 0.47 and 0.68 of the speed.
    speed = np.sqrt(2 * 9.81 * 0.08)
    assert 0.47 < (after + 9.81 * (0.2 - speed / 9.81)) / speed < 0.68
    ((*forces, exponent),) = printed(block, tmp_path)
    assert 0 < forces[0] < forces[1] < forces[2] and exponent > 1.4


def test_import_example(tmp_path):
    """The first command of docs/reference/formats.md needs only the repository; others name files of the reader."""
    text = (ROOT / "docs" / "reference" / "formats.md").read_text()
    first, *others = re.search(r"```\n(morembs import.*?)```", text, re.DOTALL).group(1).splitlines()
    name, *arguments = first.replace("data/", f"{ROOT}/data/").split()
    assert name == "morembs" and morembs(*arguments, folder=tmp_path).code == 0
    assert read_model(tmp_path / "conrod.model.h5").size == 10_956
    for word in " ".join(others).split():
        assert "." not in word or word.startswith("part.model") or word.partition(".")[0].isupper(), word


@pytest.mark.parametrize("page", ["keywords", "elements", "engines"])
def test_imports_of_the_repository(page, tmp_path):
    """Commands of docs/reference/formats that name no file of the reader."""
    text = (ROOT / "docs" / "reference" / "formats" / f"{page}.md").read_text()
    (line,) = re.findall(r"^    morembs (.*)$", text, re.MULTILINE)
    done = morembs(*line.replace("data/", f"{ROOT}/data/").split(), folder=tmp_path)
    assert done.code == 0, done.errors


def test_flow_example(tmp_path):
    """The tube of docs/reference/job/flow.md: its model file, and the modes that the page shows."""
    text = (ROOT / "docs" / "reference" / "job" / "flow.md").read_text()
    printed(re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1), tmp_path)
    (tmp_path / "tube.toml").write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1))
    for changes, ratio in ((), 0.3602), (("--set", "flow.mass_flow=12"), -0.2402):
        done = morembs("modes", "tube.toml", *changes, "--out", "modes.csv", folder=tmp_path)
        assert done.code == 0, done.errors
        table = np.genfromtxt(tmp_path / "modes.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
        assert ratio == pytest.approx(table["ratio"].min() if changes else table["ratio"][0], abs=1e-4)
    assert morembs("reduce", "tube.toml", folder=tmp_path).code == 0


def test_solver_example(tmp_path):
    """The example of docs/howto/solvers.md: a count that the analytic eigenvalues 2 - 2 cos(k pi / 1001) confirm."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "howto" / "solvers.md").read_text(), re.DOTALL).group(1)
    code = code.replace("solver.negative_eigenvalues", "print(solver.negative_eigenvalues", 1).replace(
        "eye_array(1000))  #", "eye_array(1000)))  #"
    )
    done = python(code, tmp_path)
    exact = 2 - 2 * np.cos(np.arange(1, 1001) * np.pi / 1001)
    assert int(done.output.split()[-1]) == int((exact < 0.5).sum())


@needs_compiler
def test_fmu_examples(tmp_path):
    """The connecting rod through both targets; the FMU and the C program of the page give the same."""
    make, simulate = blocks("howto/fmu.md")
    done = python(make, tmp_path)
    assert done.code == 0 and "sources only" not in done.output, done.errors
    (main,) = re.findall(r"```c\n(.*?)```", (ROOT / "docs" / "howto" / "fmu.md").read_text(), re.DOTALL)
    (tmp_path / "main.c").write_text(main)
    flags = ["-Wall", "-Wextra", "-Werror", "-O2"]
    subprocess.run(["cc", *flags, "main.c", "rod.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    bent, reaction = map(float, subprocess.run(tmp_path / "main", check=True, capture_output=True).stdout.split())
    # Some periods later it swings about the place of a cantilever, with the load on its support.
    assert bent > 0 and -2000 < reaction < 0
    pytest.importorskip("fmpy", reason="FMPy is not here: pip install fmpy")
    (z,), found = printed(simulate, tmp_path)
    # The centre of mass flies freely: turned about the origin at the start, then falling. The end is near it.
    rod = read_body(tmp_path / "conrod.h5")
    center = rod.center_of_mass[2] - 50.0 * rod.center_of_mass[0] * 0.1 - 0.5 * 9.81 * 0.1**2
    assert abs(z - center) < np.linalg.norm(np.ptp(rod.coordinates, axis=0))
    assert found == pytest.approx([bent, reaction], rel=1e-8)


def test_a_model_file_is_read_with_h5py_alone(tmp_path, monkeypatch):
    """The Python of docs/reference/formats/model_file.md."""
    monkeypatch.chdir(tmp_path)
    model = steel(box("hex8", (2, 1, 1), (0.2, 0.05, 0.03)))
    write_model("part.model.h5", model)
    (code,), names = blocks("reference/formats/model_file.md"), {}
    exec(code, names)
    assert abs(names["K"] - model.K).max() == 0


def test_a_deck_is_read_by_its_labels(tmp_path, monkeypatch):
    """The Python of docs/reference/formats/decks.md."""
    monkeypatch.chdir(tmp_path)
    (code,), names = blocks("reference/formats/decks.md"), {}
    exec(code, names)
    assert len(names["tip"]) == len(names["model"].nodes.sets["TIP"]) > 0


def test_simulate_example(tmp_path):
    """The commands of docs/howto/simulate.md, from an empty folder."""
    text = (ROOT / "docs" / "howto" / "simulate.md").read_text()
    (tmp_path / "pendulum.toml").write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1))
    for line in re.findall(r"^    morembs (.*)$", text, re.MULTILINE):
        done = morembs(*line.split(), folder=tmp_path)
        assert done.code == 0, done.errors
    told = read_recording(tmp_path / "pendulum.h5")
    # It swings from the horizontal, nearly as a rigid body: energy is kept.
    energy = told.energy.kinetic + told.energy.potential - told.energy.work
    assert len(told.time) == 2001 and np.ptp(energy) < 1e-4 * told.energy.kinetic.max()
    assert told.bodies["rod"].markers["SMALLEND"].position[:, 2].min() < -0.1
    assert (tmp_path / "pendulum.vtkhdf").exists() and "energy" in (tmp_path / "pendulum.html").read_text()
    # Fragments are taken beside the tables of the example.
    whole, *fragments = map(tomllib.loads, re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    for fragment in fragments:
        assert read_table(SystemTables, {**whole, **fragment}).given > fragment.keys()


# Tables of a job that go with those of a fragment.
WHOLE = {
    "model": {"mesh": "part.msh"},
    "material": [{"young": 1.0, "poisson": 0.3, "density": 1.0}],
    "interface": [{"name": "tip", "nodes": "all"}, {"name": "root", "nodes": "all"}],
    "reduce": [{"method": "guyan"}],
    "output": {"path": "part.h5"},
}


JOB_PAGES = ["reference/job.md", *(f"reference/job/{page.name}" for page in (ROOT / "docs/reference/job").glob("*.md"))]


def test_the_first_job(tmp_path):
    """The commands of docs/reference/job.md write and run a job that has the tables which the page shows."""
    text = (ROOT / "docs" / "reference" / "job.md").read_text()
    first, _, _ = text.partition("\n## ")
    for line in re.findall(r"^    morembs (.*)$", first, re.MULTILINE):
        done = morembs(*line.split(), folder=tmp_path)
        assert done.code == 0, done.errors
    shown = tomllib.loads(re.search(r"```toml\n(.*?)```", first, re.DOTALL).group(1))
    job = tomllib.loads((tmp_path / "rod.toml").read_text())
    assert shown["model"] == job["model"] and shown["reduce"] == job["reduce"] and shown["material"] == job["material"]
    assert read_body(tmp_path / "rod.h5").interfaces.keys() == {table["name"] for table in shown["interface"]}


OTHER_FRAGMENTS = [
    "reference/formats.md",
    "reference/formats/matrices.md",
    "howto/switching.md",
    "background/tolerance.md",
]


# Pages whose beginning runs as it stands: commands, files that are written first, programs.
RUNS_FIRST = [
    *("background/methods", "background/certificate", "background/proofs", "background/cannot"),
    *(
        "background/verification",
        "background/verification_assemblies",
        "background/verification_parameters",
        "background/parameter_box",
        "background/flow",
        "background/gmp_equations",
    ),
    *("howto/solvers", "howto/simulators", "howto/fmu", "howto/real_time", "howto/recover", "howto/scale"),
    *("howto/view", "howto/gmp", "howto/extending", "howto/simulate"),
    *("reference/schema", "reference/schema/conventions", "reference/job_keys", "reference/system"),
    *("reference/glossary", "reference/stability", "reference/tolerances", "reference/job/batch"),
    *("reference/job/running", "start/which_method"),
]
WRITTEN_BY_SCRIPTS = ("built/", "reference/api/", "reference/tolerances/")
# Lists of other pages, the record of changes and decisions show nothing to run.
NO_EXAMPLE = {"background/changes.md", "background/decisions.md", "reference/api.md"}
# Ten screens. Pages that scripts write are looked up, not read.
LINES_OF_A_PAGE = 250


def beginning(page):
    """A page before its first section."""
    return (ROOT / "docs" / page).read_text().partition("\n## ")[0]


@pytest.mark.parametrize("page", RUNS_FIRST)
def test_a_page_begins_with_an_example_that_runs(page, tmp_path):
    first, printed = beginning(f"{page}.md"), ""
    step_of_page = r"(?:`(\w+\.toml)`:\n\n)?```(\w+)[^\n]*\n([\s\S]*?)```|^    morembs (.*)$"
    steps = re.finditer(step_of_page, first, re.MULTILINE)
    for step in steps:
        name, kind, code, line = step.groups()
        if kind == "toml" and name:
            (tmp_path / name).write_text(code)
        elif kind == "python":
            done = python(code, tmp_path)
            assert done.code == 0, done.errors
            printed += done.output
        elif line:
            quiet = ["--no-open"] if line.startswith("view") else []
            done = morembs(*line.split(), *quiet, folder=tmp_path)
            assert done.code == 0, (line, done.errors)
            printed += done.output
    # Rows of tables that the page shows are those that are printed.
    shown = re.findall(r"^    (craig-bampton .*)$", first, re.MULTILINE)
    assert printed and all(row in printed for row in [*shown, *shown_outputs(first)])


def test_every_page_begins_with_an_example():
    for path in (ROOT / "docs").rglob("*.md"):
        page = str(path.relative_to(ROOT / "docs"))
        if not (page in NO_EXAMPLE or page.startswith(("background/decisions/", *WRITTEN_BY_SCRIPTS))):
            assert re.search(r"^```|^    \S", beginning(page), re.MULTILINE), page


def test_no_page_is_longer_than_ten_screens():
    for path in (ROOT / "docs").rglob("*.md"):
        page = str(path.relative_to(ROOT / "docs"))
        if not page.startswith(WRITTEN_BY_SCRIPTS):
            assert len(path.read_text().splitlines()) <= LINES_OF_A_PAGE, page


@pytest.mark.parametrize(
    "page", [page for page in [*JOB_PAGES, *OTHER_FRAGMENTS] if "```toml" in (ROOT / "docs" / page).read_text()]
)
def test_fragments_of_jobs_are_taken(page):
    fragments = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    for text in fragments:
        given = tomllib.loads(text)
        whole = {**WHOLE, "material": []} if "model" in given or "substructure" in given else WHOLE
        if "substructure" in given:
            whole = {key: table for key, table in whole.items() if key != "model"}
        tables = read_table(job_tables(), {**whole, **given})
        for table in tables.reduce:
            assert REDUCERS[table.method](**table.options())


def test_the_page_of_jobs_tells_of_every_key():
    pages = "".join((ROOT / "docs" / page).read_text() for page in (*JOB_PAGES, "reference/formats.md"))
    told = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`\n]+`", pages))))
    keys = {row.split("|")[2].strip(" `-") for row in job_keys()}
    assert len(keys) > 40 and keys <= told, keys - told


# Blocks of every language on every page, all of which tests run, here or where the subject is tested; what another
# program would have to run is said to be untested on its page.
def test_contexts_stand_in_for_the_arguments_of_before(tmp_path):
    (code,) = blocks("howto/migrating.md")
    done = python(code + "\n    print(model.K.shape, mesh.nodes is not None)", tmp_path)
    assert done.code == 0, done.errors
    assert done.output.splitlines()[-1].endswith("True")


def test_modules_of_today_are_there_and_those_of_before_are_gone():
    page = (ROOT / "docs" / "howto" / "migrating.md").read_text()
    rows = re.findall(r"^\| `(morembs\.[\w.]+)`.*? \| `(morembs\.[\w.]+)`", page, re.MULTILINE)
    assert len(rows) >= 7
    for old, new in rows:
        assert importlib.util.find_spec(new) is not None, new
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(old)


RUN = {
    "verification_assemblies.md": {"toml": 1},
    "verification_parameters.md": {"toml": 1},
    "README.md": {"python": 1, "toml": 1, "text": 2},
    "first_body.md": {"python": 3, "text": 1},
    "first_job.md": {"text": 1},
    "which_method.md": {"toml": 1},
    "contact.md": {"python": 4},
    "extending.md": {"toml": 1, "python": 2},
    "flow.md": {"toml": 1, "python": 1, "python flow": 1, "text": 1},
    "decks.md": {"python": 1},
    "engines.md": {"": 1},
    "commands.md": {"python": 1},
    "formats.md": {"": 1, "toml": 1, "python": 1},
    "matrices.md": {"": 1, "toml": 2},
    "model_file.md": {"python": 1},
    "fmu.md": {"python": 2, "c": 1},
    "gmp.md": {"toml": 1, "python job": 1},
    "gmp_python.md": {"python": 1, "python divided": 1, "python body": 1},
    "gmp_equations.md": {"python formulations": 1, "text": 1},
    "chains.md": {"python chain": 1},
    "gmp_figures.md": {"python slider-crank": 1},
    "member_file.md": {"python evaluator": 1},
    "job.md": {"toml": 1},
    **{
        f"{page}.md": {"toml": 1}
        for page in ["model", "reduction", "certify", "outputs", "damping", "assemblies", "preload", "spin", "solver"]
    },
    "interfaces.md": {"toml": 1, "python": 1},
    "migrating.md": {"python": 1},
    "multibody.md": {"python": 3, "python divided": 1},
    "multibody_exudyn.md": {"python": 1},
    "parameter_box.md": {"toml": 1},
    "parametric.md": {"toml": 2, "python": 2},
    "scale.md": {"toml": 1, "sh": 1},
    "recipes.md": {"toml": 1, "python": 1},
    "conventions.md": {"python": 1},
    "read_bodies.md": {"python": 3, "octave": 1, "matlab": 1, "sh": 1},
    "recover.md": {"python motion": 1},
    "stability.md": {"python names": 1},
    "tolerances.md": {"python tolerances": 1},
    "simulate.md": {"toml": 4},
    "simulators.md": {"python": 3},
    "solvers.md": {"python": 1},
    "switching.md": {"toml": 1, "python": 2},
    "tolerance.md": {"toml": 1},
}


def test_every_block_of_code_is_run_by_a_test():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    blocks = {}
    for page in pages:
        fences = re.findall(r"^```(.*)$", page.read_text(), re.MULTILINE)
        assert len(fences) % 2 == 0, page.name
        kinds = Counter(kind for kind in fences[::2] if not kind.startswith("{"))
        if kinds and "built" not in page.parts:
            blocks[page.name] = blocks.get(page.name, Counter()) + kinds
    assert blocks == RUN


def command_lines():
    """Commands of morembs that the README and the pages show, as lists of words."""
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        text = page.read_text()
        in_tables = re.findall(r"^\| `morembs ([a-z]+ [^`]*)`", text, re.MULTILINE)
        for line in re.findall(r"^(?:    )?morembs ([a-z]+ .*)$", text, re.MULTILINE) + in_tables:
            if "#" in line or line.split()[0] in SHOWN:
                yield page.name, line.partition("#")[0].split()


def test_commands_that_are_shown_exist():
    seen = 0
    for page, (name, *words) in command_lines():
        assert name in SHOWN, (page, name)
        options = {option for parameter in SHOWN[name].params for option in parameter.opts}
        assert {word for word in words if word.startswith("-")} <= options, (page, name, words)
        seen += 1
    assert seen > 10


def test_documents_that_are_named_exist():
    for document in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", document.read_text()):
            # What the site is built with is drawn then; its own test looks there.
            known = target.removeprefix("../").startswith(("http", "built/")) or (document.parent / target).exists()
            assert known, (document.name, target)
