"""Element types that are not what their program means: a warning from the import to the body file, never a note."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import meshio
import pytest
from typer.testing import CliRunner

from morembs import read_body, read_mesh
from morembs.app.cli import app
from morembs.base.units import parse_units
from morembs.body.diagnostics.warnings import diagnosis_of
from morembs.fem.material import isotropic
from morembs.importers import import_file
from morembs.importers.decks.formulations import ansys_meaning, deck_warnings, meaning_of
from morembs.importers.model_file import read_model, write_model
from morembs.importers.to_model import model_of
from tests.support.commands import run
from tests.support.decks import BEAM, MATERIAL, deck, folder
from tests.support.mesh_decks import ansys_archive, nastran_mesh
from tests.support.meshes import STEEL, box


def test_a_warning_goes_from_the_deck_into_the_body_file(tmp_path: Path) -> None:
    path, model = tmp_path / "part.inp", tmp_path / "part.model.h5"
    path.write_text(deck(BEAM, kind="C3D8R") + MATERIAL)
    told = run("import", path, "--units", "mm-t-s", "--dialect", "abaqus", "-o", model)
    (line,) = (line for line in told.splitlines() if "C3D8R" in line)
    assert line.startswith("warning: 24 elements C3D8R are assembled with the mean strain and hourglass stiffness and ")
    assert "Abaqus" in line and line.endswith("[formulation-differs]")
    sentence = line.removeprefix("warning: ")
    (as_json,) = json.loads(
        run("import", path, "--units", "mm-t-s", "--set", "dialect=abaqus", "-o", model, "--json", "--check")
    )
    assert as_json["warnings"] == [sentence] and sentence not in as_json["notes"]
    assert [finding["severity"] for finding in as_json["findings"] if finding["sentence"] == sentence] == ["warning"]
    stored = read_model(model)
    assert stored.warnings == (sentence,)
    assert sentence in [finding.sentence for finding in diagnosis_of(stored).warnings]
    folder(tmp_path, {"model": f'file = "{model.name}"', "material": None})
    assert sentence in json.loads(run("check", tmp_path / "job.toml", "--json"))[0]["warnings"]
    assert f"warning: {sentence}" in run("reduce", tmp_path / "job.toml").replace("\n", " ")
    assert read_body(tmp_path / "part.h5").warnings[0] == sentence
    assert f"warning: {sentence}" in run("info", tmp_path / "part.h5")
    assert sentence in json.loads(run("info", tmp_path / "part.h5", "--json"))[0]["warnings"]


def test_a_job_on_the_deck_itself_carries_the_warning_too(tmp_path: Path) -> None:
    path = folder(tmp_path, None, deck(BEAM, kind="C3D8I"))
    run("reduce", path)
    assert any("24 elements C3D8I" in warning for warning in read_body(tmp_path / "part.h5").warnings)
    assert any("C3D8I" in warning for warning in read_mesh(tmp_path / "part.inp", "mm-t-s").warnings)


def test_which_types_are_what_is_assembled_here() -> None:
    """Decks of Abaqus, of CalculiX and of either; types of Abaqus as its own matrices show, of CalculiX as ccx does."""

    def told(code: str, dialect: str, *, guessed: bool = False) -> list[str]:
        warnings = deck_warnings({code: 3}, dialect, guessed=guessed)
        assert all(code in warning for warning in warnings)
        return warnings

    for code in ("C3D4", "C3D8", "C3D10", "C3D15", "C3D20"):
        assert not told(code, "abaqus")
    for code in ("C3D8R", "C3D8I", "C3D6", "C3D20R", "C3D10M", "C3D8S"):
        assert "3 elements" in told(code, "abaqus")[0] and "[formulation-differs]" in told(code, "abaqus")[0]
    for code in ("C3D4", "C3D6", "C3D8", "C3D10", "C3D10T", "C3D15", "C3D20", "C3D20R"):
        assert not told(code, "calculix")
    assert "distorted" in told("C3D8R", "calculix")[0] and "modes have mass there" in told("C3D8I", "calculix")[0]
    for code in ("C3D8", "C3D4", "C3D6"):
        assert told(code, "calculix", guessed=True)[-1].endswith("[dialect-guessed]")
    assert not told("C3D20", "calculix", guessed=True) and not told("C3D20", "abaqus", guessed=True)


@pytest.mark.parametrize(
    ("code", "plain"),
    [("C3D8H", "C3D8"), ("C3D20RH", "C3D20R"), ("C3D10H", "C3D10"), ("C3D8IH", "C3D8I"), ("C3D10MH", "C3D10M")],
)
def test_hybrid_types_are_assembled_as_plain_ones(code: str, plain: str) -> None:
    of, like = (meaning_of(text, "abaqus") for text in (code, plain))
    assert (of.formulation, of.mass) == (like.formulation, like.mass)
    assert deck_warnings({code: 3}, "abaqus", guessed=False)[0].endswith("[hybrid-as-plain]")


@pytest.mark.parametrize(
    ("text", "formulation", "guessed"),
    [
        ("*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n1\n*END STEP\n", "full", False),
        ("*STEP\n*STATIC\n*NODE FILE\nU\n*END STEP\n", "full", False),
        ("** written for CalculiX\n", "full", False),
        ("*PREPRINT, ECHO=NO\n", "b-bar", False),
        ("*STEP\n*STATIC\n*OUTPUT, FIELD\n*END STEP\n", "b-bar", False),
        ("** Generated by: Abaqus/CAE 2021\n", "b-bar", False),
        ("", "full", True),
        ("** Generated by: Abaqus/CAE 2021\n*STEP\n*STATIC\n*NODE FILE\nU\n*END STEP\n", "full", True),
    ],
)
def test_keywords_and_comments_tell_the_program_of_a_deck(
    tmp_path: Path, text: str, formulation: str, guessed: bool
) -> None:
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM).replace("*NODE FILE\nU\n", "") + MATERIAL + text)
    mesh = import_file(path).mesh
    assert [block.formulation for block in mesh.blocks] == [formulation]
    assert [warning.endswith("[dialect-guessed]") for warning in mesh.warnings] == [True] * guessed
    for dialect, other in (("calculix", "full"), ("abaqus", "b-bar")):
        mesh = import_file(path, options={"dialect": dialect}).mesh
        assert [block.formulation for block in mesh.blocks] == [other] and not mesh.warnings


def test_a_dialect_is_for_decks(tmp_path: Path) -> None:
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM) + MATERIAL)
    mesh = ("--dialect", "abaqus", "--format", "mesh")
    for given, words in ((("--dialect", "ansys"), 'expected "auto", "abaqus" or "calculix"'), (mesh, "without a deck")):
        done = CliRunner().invoke(app, ["import", str(path), *given, "-o", str(tmp_path / "part.model.h5")])
        assert done.exit_code == 2 and words in done.stderr and not (tmp_path / "part.model.h5").exists()


def test_types_of_one_shape_are_blocks_of_their_own(tmp_path: Path) -> None:
    """Elements of C3D8 and C3D8R side by side keep their labels, sets and formulations."""
    path, text = tmp_path / "part.inp", deck(BEAM)
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if line.upper().startswith("*ELEMENT"))
    lines[at + 3 : at + 3] = [lines[at].replace("C3D8", "C3D8R")]
    path.write_text("\n".join(lines) + "\n" + MATERIAL)
    imported = import_file(path, options={"dialect": "abaqus"})
    blocks = imported.mesh.blocks
    assert [(block.type, block.formulation, len(block.ids)) for block in blocks] == [
        ("hex8", "b-bar", 2),
        ("hex8", "mean-strain", 22),
    ]
    assert [len(rows) for rows in imported.mesh.element_sets["EVERY"]] == [2, 22]
    model = model_of(imported, parse_units("mm-t-s"))
    write_model(tmp_path / "part.model.h5", model)
    stored = read_model(tmp_path / "part.model.h5").mesh
    assert [(b.formulation, b.mass) for b in stored.blocks] == [(b.formulation, b.mass) for b in blocks]


def test_the_mass_that_was_asked_for_decides(tmp_path: Path) -> None:
    path = tmp_path / "part.inp"
    block = box("tet10", (2, 1, 1), (0.3, 0.1, 0.08))
    text = ["*NODE"]
    text += [f"{i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(block.nodes.xyz.tolist(), start=1)]
    text += ["*ELEMENT, TYPE=C3D10", *(", ".join(map(str, (7, *(row + 1)))) for row in block.blocks[0].nodes[:1])]
    path.write_text("\n".join(text) + "\n")
    imported = import_file(path, options={"dialect": "calculix"})
    imported = replace(imported, materials=(isotropic(set="all", **STEEL),))
    own, reduced, exact = (model_of(imported, mass_integration=rule) for rule in ("element", "reduced", "exact"))
    assert not own.warnings and not reduced.warnings and abs(own.M - reduced.M).max() == 0
    (told,) = exact.warnings
    assert "1 elements tet10" in told and "takes 'reduced'" in told and abs(own.M - exact.M).max() > 0


def test_solids_of_nastran(tmp_path: Path) -> None:
    """PSOLID with full integration and PARAM COUPMASS are what is assembled here; their defaults are not."""
    path = tmp_path / "part.bdf"
    cells = nastran_mesh(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), "free") + "MAT1,3,2.1+11,,.3,7850.\n"

    def told(text: str) -> tuple[str, ...]:
        path.write_text(cells + text)
        return import_file(path).mesh.warnings

    shear, mass = told("PSOLID,1,3\n")
    assert "2 elements CHEXA with 8 nodes" in shear and "bubble" in shear and "lumped" in mass
    (block,) = import_file(path).mesh.blocks
    assert (block.formulation, block.mass) == ("incompatible", "exact")
    assert len(told("PSOLID,1,3\nPARAM,COUPMASS,1\n")) == 1
    assert not told("PSOLID,1,3,,TWO,,FULL\nPARAM,COUPMASS,1\n") and not told("PSOLID,1,3,,2,,1\nPARAM,COUPMASS,1\n")
    (block,) = import_file(path).mesh.blocks
    assert (block.formulation, block.mass) == ("full", "reduced")
    assert len(told("PSOLID,1,3,,TWO\nPARAM,COUPMASS,1\n")) == 1


def test_bulk_data_without_their_end(tmp_path: Path) -> None:
    path = tmp_path / "part.bdf"
    cells = "SOL 103\nBEGIN BULK\n" + nastran_mesh(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), "free")
    for end, count in (("", 1), ("ENDDATA\n", 0)):
        path.write_text(cells + end)
        assert sum("no ENDDATA" in warning for warning in import_file(path).mesh.warnings) == count


def test_solids_of_ansys(tmp_path: Path) -> None:
    path = tmp_path / "part.cdb"
    path.write_text(ansys_archive(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08))))
    mesh = import_file(path).mesh
    assert (mesh.blocks[0].formulation, mesh.blocks[0].mass) == ("b-bar", "reduced") and not mesh.warnings

    def of(routine: int, keys: dict[int, int], shape: str) -> tuple[str, str, bool]:
        meaning = ansys_meaning(routine, keys, shape)
        return meaning.formulation, meaning.mass, bool(meaning.differs)

    assert of(185, {}, "tet4") == of(187, {}, "tet10") == of(186, {}, "tet10") == ("full", "exact", False)
    assert of(185, {2: 1}, "hex8") == ("mean-strain", "exact", True)
    assert of(185, {2: 2}, "hex8") == of(185, {2: 3}, "hex8") == ("incompatible", "reduced", True)
    assert "enhanced strains" in ansys_meaning(185, {2: 2}, "wedge6").differs
    assert of(186, {}, "hex20") == ("reduced", "irons", False) and of(186, {2: 1}, "hex20") == ("irons", "irons", True)
    assert of(45, {}, "hex8") == ("incompatible", "reduced", True)
    assert of(45, {1: 1}, "hex8") == ("full", "reduced", False)
    assert of(95, {11: 1}, "hex20") == ("reduced", "reduced", True) and of(95, {}, "hex20")[0] == "irons"
    assert "pressure" in ansys_meaning(187, {6: 1}, "tet10").differs


def test_a_mesh_that_stands_twice_in_its_file_is_told(tmp_path: Path) -> None:
    """Meshio reads both, so that the mass is doubled: the import and the reduction warn."""
    mesh = box("hex8", (2, 1, 1), (0.2, 0.1, 0.08))
    cells = [("hexahedron", mesh.blocks[0].nodes)]
    meshio.write(tmp_path / "part.mesh", meshio.Mesh(mesh.nodes.xyz, cells), "medit")
    (tmp_path / "twice.mesh").write_bytes(2 * (tmp_path / "part.mesh").read_bytes())
    meshio.write(tmp_path / "twice.vtu", meshio.Mesh(mesh.nodes.xyz, 2 * cells))
    words = "2 solid elements lie in the place of others, on the same nodes"
    for name in ("twice.mesh", "twice.vtu"):
        material = "young=2.1e11,poisson=0.3,density=7850"
        told = run("import", tmp_path / name, "--material", material, "-o", tmp_path / "part.model.h5")
        assert f"warning: {words}" in told
        model = {
            "model": f'mesh = "{name}"\nunits = "m-kg-s"',
            "material": 'set = "all"\nyoung = 2.1e11\npoisson = 0.3\ndensity = 7850.0',
            "interface": 'name = "a"\nnodes = "box: -1,-1,-1,0.001,1,1"',
            "interface2": None,
        }
        folder(tmp_path, model)
        assert words in " ".join(json.loads(run("reduce", tmp_path / "job.toml", "--json"))[0]["warnings"])
