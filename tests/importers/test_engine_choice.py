"""``auto`` takes own assembly where all elements are its own, else the program that is there and reads the deck."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs import InputError
from morembs.app.cli import app
from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.body.file import read_body
from morembs.fem import FEModel, rigid_motion
from morembs.fem.material import Material, isotropic
from morembs.importers import import_file
from morembs.importers.decks.problems import DeckError
from morembs.importers.to_model import model_of
from tests.importers.test_engines import PLATE, SHELL, TIED
from tests.support import calculix
from tests.support.calculix import needs_ccx, solids
from tests.support.mystran import needs_mystran, plate
from tests.support.refusals import refusal

BOX = solids("C3D8", (2, 1, 1), (2.0, 1.0, 1.0))
JOB = (
    '[model]\n{}\n[[interface]]\nname = "A"\nnodes = "box:0,0,1.9,1,1,2.1"\n'
    '[[reduce]]\nmethod = "craig-bampton"\nmodes = 2\n[output]\npath = "body.h5"\n'
)
# Own assembly has no membranes.
MEMBRANE = SHELL.replace("S4R", "M3D4R").replace("SHELL", "MEMBRANE")
# Nor layers, which programs of the test do not look at.
LAYERS = PLATE.replace("MATERIAL=STEEL\n0.05", "COMPOSITE\n0.05,,STEEL")
SHEET = plate(2, 2, np.eye(3)) + "PSHELL,1,1,.01,1,,1\nMAT1,1,2.1+11,,.3,7850.\nENDDATA\n"


def mass(model: FEModel) -> float:
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    return float(R[:, 0] @ (model.M @ R[:, 0]))


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture
def no_programs(tmp_path, monkeypatch):
    """A machine without ccx and MYSTRAN."""
    for name in ("MOREMBS_CCX", "MOREMBS_MYSTRAN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("sys.prefix", str(tmp_path))


def test_solids_are_assembled_here_whatever_is_there(tmp_path, no_programs):
    path = written(tmp_path, "box.inp", BOX)
    chosen, own = (model_of(import_file(path, engine=engine)) for engine in ("auto", None))
    assert abs(chosen.K - own.K).max() == 0
    assert chosen.notes[0] == "Assembled by own assembly, which takes all elements of the deck (auto)."


def test_a_program_is_taken_for_what_is_not_assembled_here(tmp_path, monkeypatch):
    path = written(tmp_path, "plate.inp", LAYERS)
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.replay(tmp_path, "plate")))
    done = CliRunner().invoke(app, ["import", str(path), "-o", str(tmp_path / "a.model.h5"), "--engine", "auto"])
    assert done.exit_code == 0, done.stderr
    assert "read as abaqus (auto)" in done.stdout
    assert "Assembled by CalculiX, as own assembly refuses the deck" in done.stdout and "'S4'" in done.stdout


@pytest.mark.parametrize(
    ("name", "deck", "card", "program"),
    [("a.inp", MEMBRANE, "ELEMENT", "CalculiX"), ("a.bdf", SHEET, "CQUAD4", "MYSTRAN")],
)
def test_a_program_that_is_missing_is_named(tmp_path, no_programs, name, deck, card, program):
    with refusal("unsupported", card, name, program, by=DeckError):
        import_file(written(tmp_path, name, deck), engine="auto")


def test_what_both_refuse_is_told_by_the_one_that_needs_least(tmp_path, monkeypatch):
    """Own assembly would have to leave the shells out; CalculiX needs a density."""
    path = written(tmp_path, "plate.inp", LAYERS.replace("*DENSITY\n7850.\n", ""))
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.replay(tmp_path, "plate")))
    with pytest.raises(DeckError) as told:
        import_file(path, engine="auto")
    assert [problem.flags for problem in told.value.problems] == [("--density X",)]
    assert import_file(path, options={"density": 7850.0}, engine="auto").K is not None


def test_what_keeps_supports_goes_to_a_program(tmp_path, monkeypatch):
    path = written(tmp_path, "tied.inp", TIED)
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.replay(tmp_path, "tied")))
    imported = import_file(path, options={"boundary": "keep"}, engine="auto")
    assert "CalculiX, as own assembly refuses the deck: own assembly has no --boundary" in imported.notes[0]


@pytest.mark.parametrize(
    ("name", "deck", "options", "message"),
    [
        ("sheet.bdf", SHEET, {"boundary": "keep", "preload": 1}, ("unsupported", "engine", "MYSTRAN", "--preload")),
        ("sheet.inp", MEMBRANE, {"pretension": "cut"}, ("unsupported", "ELEMENT", "MYSTRAN", "--pretension")),
    ],
)
def test_a_program_without_an_option_does_not_assemble_by_leaving_it_out(
    tmp_path, no_programs, monkeypatch, name, deck, options, message
):
    monkeypatch.setenv("MOREMBS_MYSTRAN", str(calculix.program(tmp_path, "raise SystemExit(1)")))
    with refusal(*message):
        import_file(written(tmp_path, name, deck), options=options, engine="auto")


def test_an_option_that_nobody_has_is_refused(tmp_path):
    with refusal("unknown", "colour"):
        import_file(written(tmp_path, "box.inp", BOX), options={"colour": 1}, engine="auto")


@needs_ccx
def test_a_material_is_given_whoever_assembles(tmp_path):
    bare = written(tmp_path, "bare.inp", BOX.split("*MATERIAL")[0])
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    models = [model_of(import_file(bare, engine=engine, materials=[steel])) for engine in (None, "auto", "calculix")]
    assert [mass(model) for model in models] == pytest.approx([2 * 7850.0] * 3)
    assert abs(models[2].K - models[0].K).max() < 1e-12 * abs(models[0].K).max()


@pytest.mark.parametrize("there", [True, False])
def test_a_material_that_a_deck_does_not_need_is_refused_whoever_could_assemble(
    tmp_path, no_programs, monkeypatch, there
):
    """A mistake of the user is no reason to take another program, or to advise one."""
    for name in ("MOREMBS_CCX", "MOREMBS_MYSTRAN") if there else ():
        monkeypatch.setenv(name, str(calculix.program(tmp_path, "sys.exit()")))
    iron = isotropic(set="all", young=7e10, poisson=0.3, density=1.0)
    with pytest.raises(InputError) as told:
        import_file(written(tmp_path, "box.inp", BOX), engine="auto", materials=[iron])
    assert str(told.value) == "--material was given for 'all', where nothing lacks a material; leave it out"


# Two bricks: of A without density, and of B in no section.
HALVES = BOX.split("*MATERIAL")[0] + (
    "*ELSET,ELSET=A\n1\n*ELSET,ELSET=B\n2\n*MATERIAL,NAME=M\n*ELASTIC\n2.1e11,.3\n*SOLID SECTION,ELSET=A,MATERIAL=M\n"
)


def iron(*sets: str) -> list[Material]:
    return [isotropic(set=name, young=1e11, poisson=0.3, density=2.0 ** (i + 1)) for i, name in enumerate(sets)]


@needs_ccx
@pytest.mark.parametrize("engine", [None, "calculix"])
@pytest.mark.parametrize(
    ("sets", "density", "expected"),
    [
        (("all",), {}, 2.0 + 2.0),
        (("A", "B"), {}, 2.0 + 4.0),
        (("B", "all"), {}, 2.0 + 4.0),
        (("A", "B"), {"all": 1000.0}, 2.0 + 4.0),
        (("B",), {"all": 1000.0}, 1000.0 + 2.0),
        (("all",), {"A": 1000.0}, 1000.0 + 2.0),
        (("all",), {"M": 1000.0}, 1000.0 + 2.0),
    ],
)
def test_materials_and_densities_are_taken_alike_whoever_assembles(tmp_path, engine, sets, density, expected):
    path = written(tmp_path, "halves.inp", HALVES)
    imported = import_file(path, engine=engine, options={"density": density}, materials=iron(*sets))
    assert mass(model_of(imported)) == pytest.approx(expected)


@needs_ccx
@pytest.mark.parametrize("engine", [None, "calculix"])
@pytest.mark.parametrize(("sets", "message"), [(("A", "B", "C"), ("value", "", "C")), (("A", "D"), ("value", "", "D"))])
def test_materials_that_are_not_clear_are_refused_whoever_assembles(tmp_path, engine, sets, message):
    path = written(tmp_path, "halves.inp", HALVES + "*ELSET,ELSET=C\n1\n*ELSET,ELSET=D\n1\n")
    with refusal(*message):
        import_file(path, engine=engine, materials=iron(*sets))


def test_sets_that_share_elements_are_not_given_two_materials(tmp_path):
    path = written(tmp_path, "bare.inp", BOX.split("*MATERIAL")[0] + "*ELSET,ELSET=A\n1\n*ELSET,ELSET=B\n1,2\n")
    with refusal("conflict", "", "B"):
        import_file(path, materials=iron("A", "B"))
    assert mass(model_of(import_file(path, materials=iron("A", "all")))) == pytest.approx(2.0 + 4.0)


def test_the_answer_to_a_deck_names_the_program(tmp_path, no_programs, monkeypatch):
    path = written(tmp_path, "plate.inp", LAYERS.replace("*DENSITY\n7850.\n", ""))
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.program(tmp_path, "sys.exit()")))
    for engine in ("auto", "calculix"):
        with pytest.raises(DeckError) as told:
            import_file(path, engine=engine)
        assert told.value.answer == f"morembs import plate.inp --engine {engine} --density X"


@needs_mystran
def test_nastran_shells_go_to_mystran(tmp_path):
    imported = import_file(written(tmp_path, "sheet.bdf", SHEET), engine="auto")
    assert imported.notes[0].startswith("Assembled by MYSTRAN, as own assembly refuses the deck")


@pytest.mark.parametrize("engine", ["auto", "calculix"])
def test_a_job_reads_a_deck_that_is_assembled_by_whom_it_names(tmp_path, monkeypatch, engine):
    written(tmp_path, "tied.inp", TIED)
    monkeypatch.setenv("MOREMBS_CCX", str(calculix.replay(tmp_path, "tied")))
    run_job(load_job(written(tmp_path, "job.toml", JOB.format(f'file = "tied.inp"\nengine = "{engine}"'))))
    body = read_body(tmp_path / "body.h5")
    assert body.mass == pytest.approx(1.25 * 7850)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('mesh = "a.inp"\nengine = "auto"', ("conflict", "engine")),
        ('file = "a.inp"\nengine = "ansys"', ("unknown", "engine", "ansys")),
        ('file = "a.inp"\nengine = "auto"\nmesh = "a.inp"', ("conflict",)),
    ],
)
def test_engines_of_jobs_that_cannot_be_are_refused(tmp_path, table, message):
    written(tmp_path, "a.inp", BOX)
    with refusal(*message):
        run_job(load_job(written(tmp_path, "job.toml", JOB.format(table))))
