"""Tables that other packages add to: the package of docs/howto/extending.md, found by its entry points or assigned."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.app.jobs.job import load_job
from morembs.base.plugins import Registry
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.exporters import EXPORTERS, make_exporter
from morembs.fem.interface import COUPLINGS, make_interface
from morembs.importers import IMPORTERS
from morembs.linalg.sparse.select import SOLVERS, available_solvers, select_solver
from morembs.problem import Problem
from morembs.reducers import REDUCERS, CraigBampton
from tests.support.decks import BEAM, deck, folder
from tests.support.meshes import box, steel, where
from tests.support.processes import python
from tests.support.refusals import Refusal, refusal

ROOT = Path(__file__).parent.parent
DOCUMENT = (ROOT / "docs" / "howto" / "extending.md").read_text()
ASSIGNMENT, PACKAGE = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)
TABLES: tuple[Registry, ...] = (REDUCERS, SOLVERS, EXPORTERS, IMPORTERS, COUPLINGS)
REDUCE = 'name = "few"\nmethod = "static-responses"'


def entry_points(folder: Path, text: str) -> None:
    """A distribution that is installed in ``folder``."""
    info = folder / "my_package-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(text)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path; afterwards the tables are as before."""
    there = tmp_path / "site"
    there.mkdir()
    monkeypatch.syspath_prepend(str(there))
    yield there
    for table in TABLES:
        for name in [item for item in table if item not in table.own]:
            del table[name]
        table.reload()
    sys.modules.pop("my_package", None)


def look_again() -> None:
    for table in TABLES:
        table.reload()


def test_a_package_adds_a_reducer_a_solver_an_exporter_and_an_importer(place: Path, tmp_path: Path) -> None:
    (place / "my_package.py").write_text(PACKAGE)
    toml = re.search(r"```toml\n(.*?)```", DOCUMENT, re.DOTALL)
    assert toml is not None
    entry_points(place, re.sub(r'project\.entry-points\."(.*?)"', r"\1", toml[1]).replace('"', ""))
    look_again()
    run = CliRunner().invoke
    (tmp_path / "part.brick").write_text(deck(BEAM))
    model = tmp_path / "part.model.h5"
    steel = "young=210e3,poisson=0.3,density=7.85e-9"
    arguments = ["import", str(tmp_path / "part.brick"), "-o", str(model), "--units", "mm-t-s", "--material", steel]
    done = run(app, [*arguments, "--set", "dialekt=x"])
    assert done.exit_code == 2 and "did you mean 'dialect'" in done.output
    assert run(app, [*arguments, "--set", "dialect=calculix"]).exit_code == 0
    tables = {
        "model": f'file = "{model}"\nunits = "mm-t-s"',
        "material": None,
        "reduce": REDUCE + "\ncount = 8",
        "solver": 'name = "dense"',
    }
    (tmp_path / "job").mkdir()
    job = folder(tmp_path / "job", tables)
    done = run(app, ["reduce", str(job)])
    assert done.exit_code == 0, done.output
    stored = read_body(tmp_path / "job" / "part.h5")
    body = stored.bodies["few"]
    assert len(body.mass_matrix) == 6 + 8 and stored.provenance["solver"] == "dense"
    out = tmp_path / "k.txt"
    done = run(app, ["export", str(job.with_name("part.h5")), "--to", "table", "-o", str(out), "--set", "digits=15"])
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(np.loadtxt(out)[14:], body.stiffness_matrix, rtol=1e-14)
    with refusal("value", "digits"):
        make_exporter("table", {"digits": "3"})
    assert "dense" in available_solvers() and "table: reduced mass" in run(app, ["export", "--list"]).stdout
    refused = folder(job.parent, {**tables, "reduce": REDUCE + "\ncount = 13"})
    done = run(app, ["check", str(refused)])
    assert done.exit_code == 2 and "expected 1 to 12" in done.output


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("raise RuntimeError('no licence')", ("unknown", "method")),
        ("StaticResponses = 5", ("unknown", "method", "5")),
        ("", ("unknown", "method")),
    ],
)
def test_a_package_that_cannot_be_used_is_named_once(
    place: Path, tmp_path: Path, recwarn: pytest.WarningsRecorder, code: str, words: Refusal
) -> None:
    (place / "my_package.py").write_text(code)
    entry_points(place, "[morembs.reducers]\nstatic-responses = my_package:StaticResponses\nguyan = my_package:guyan\n")
    look_again()
    # Built-in methods need no look at other packages.
    assert "guyan" in REDUCERS and not recwarn.list
    job = folder(tmp_path, {"reduce": REDUCE})
    for _ in range(2):
        with refusal(*words) as caught:
            load_job(job)
        assert "the package 'my-package' offers 'static-responses'" in str(caught.value)
    assert len([warning for warning in recwarn.list if "my-package" in str(warning.message)]) == 2
    assert list(REDUCERS) == list(REDUCERS.own)


def test_a_package_adds_a_coupling_and_a_body_file_without_it_names_it(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (place / "my_package.py").write_text(PACKAGE)
    entry_points(place, "[morembs.couplings]\ncentre = my_package:centre\nother = my_package:centre\n")
    look_again()
    model = steel(box("hex8", (4, 1, 1), (0.4, 0.05, 0.03)))
    with pytest.warns(UserWarning, match="its name is 'centre', expected 'other'"):
        left = make_interface(model, name="left", nodes=where(model, 0, 0.0), coupling="centre")
    right = make_interface(model, name="right", nodes=where(model, 0, 0.4), coupling="average")
    with Problem(model, [left, right]) as problem:
        assert problem.B.toarray()[:, 0] @ np.ones(model.size) == pytest.approx(1.0)
        body = elastic_body(problem, CraigBampton(modes=2).reduce(problem), make_part(problem))
    path = write_body(tmp_path / "bar.h5", [body])
    assert read_body(path).interfaces["left"].kind.name == "centre"
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry != str(place)])
    del COUPLINGS["centre"]
    look_again()
    done = CliRunner().invoke(app, ["info", str(path)])
    assert done.exit_code == 2 and "interface left has the coupling 'centre'" in done.output
    assert "rigid, average, direct, matrix, or a package" in done.output and "damaged" not in done.output


def test_assigned_from_python(tmp_path: Path) -> None:
    tables = {"reduce": 'method = "loaded-shapes"\nmodes = 4', "check": "full_modes = 0"}
    folder(tmp_path, tables).rename(tmp_path / "rod.toml")
    done = python(ASSIGNMENT, tmp_path)
    assert done.code == 0 and int(done.output) == 6 + 4 + 12, done.errors


def test_an_unknown_solver_is_refused() -> None:
    with refusal("unknown", "solver", "superlu"):
        select_solver("superlo")
