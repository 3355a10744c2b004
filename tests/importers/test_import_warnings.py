"""Element types that are not what their program means: a warning from the import to the body file, never a note."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import meshio
import pytest
from typer.testing import CliRunner

from morembs import read_body, read_mesh
from morembs.cli import app
from morembs.diagnostics.warnings import diagnosis_of
from morembs.importers import import_file
from morembs.importers.formulations import abaqus_warnings, ansys_warnings
from morembs.importers.model_file import read_model
from morembs.importers.to_model import model_of
from morembs.model.material import isotropic
from tests.importers.test_ansys import deck as archive
from tests.importers.test_nastran_deck import written
from tests.support.decks import BEAM, deck, folder
from tests.support.meshes import STEEL, box

MATERIAL = (
    "*ELSET, ELSET=EVERY, GENERATE\n1, 24, 1\n*MATERIAL, NAME=STEEL\n*ELASTIC\n210e3, 0.3\n*DENSITY\n7.85e-9\n"
    "*SOLID SECTION, ELSET=EVERY, MATERIAL=STEEL\n"
)


def run(*arguments: object) -> str:
    result = CliRunner().invoke(app, list(map(str, arguments)))
    assert result.exit_code == 0, result.stderr
    return result.stdout


def test_a_warning_goes_from_the_deck_into_the_body_file(tmp_path: Path) -> None:
    path, model = tmp_path / "part.inp", tmp_path / "part.model.h5"
    path.write_text(deck(BEAM, kind="C3D8R") + MATERIAL)
    told = run("import", path, "--units", "mm-t-s", "--set", "dialect=abaqus", "-o", model)
    (line,) = (line for line in told.splitlines() if "C3D8R" in line)
    assert line.startswith("warning: 24 elements C3D8R are assembled with full integration and consistent mass, where ")
    sentence = line.removeprefix("warning: ")
    as_json = json.loads(
        run("import", path, "--units", "mm-t-s", "--set", "dialect=abaqus", "-o", model, "--json", "--check")
    )
    assert as_json["warnings"] == [sentence] and sentence not in as_json["notes"]
    assert [one["severity"] for one in as_json["findings"] if one["sentence"] == sentence] == ["warning"]
    stored = read_model(model)
    assert stored.warnings == (sentence,)
    assert sentence in [one.sentence for one in diagnosis_of(stored).warnings]
    folder(tmp_path, {"model": f'file = "{model.name}"', "material": None})
    assert sentence in json.loads(run("check", tmp_path / "job.toml", "--json"))["warnings"]
    assert f"warning: {sentence}" in run("reduce", tmp_path / "job.toml").replace("\n", " ")
    assert read_body(tmp_path / "part.h5").warnings[0] == sentence
    assert f"warning: {sentence}" in run("info", tmp_path / "part.h5")
    assert sentence in json.loads(run("info", tmp_path / "part.h5", "--json"))["warnings"]


def test_a_job_on_the_deck_itself_carries_the_warning_too(tmp_path: Path) -> None:
    path = folder(tmp_path, None, deck(BEAM, kind="C3D8I"))
    run("reduce", path)
    assert any("24 elements C3D8I" in one for one in read_body(tmp_path / "part.h5").warnings)
    assert any("C3D8I" in one for one in read_mesh(tmp_path / "part.inp", "mm-t-s").warnings)


def test_which_types_are_what_is_assembled_here() -> None:
    """decks of Abaqus, of CalculiX and of either; types of Abaqus as its own matrices show, of CalculiX as ccx does."""

    def differ(code: str, dialect: str) -> tuple[bool, bool]:
        whole, mass = abaqus_warnings({code: 3}, dialect)
        assert all(code in one and "3 elements" in one for one in (*whole, *mass))
        return bool(whole), bool(mass)

    for code in ("C3D10", "C3D15", "C3D20"):
        assert differ(code, "abaqus") == (False, False)
    for code in ("C3D4", "C3D8", "C3D8R", "C3D8I", "C3D8H", "C3D6", "C3D20R", "C3D20RH", "C3D10M", "C3D10H", "C3D8S"):
        assert differ(code, "abaqus") == (True, False)
    for code in ("C3D8", "C3D20"):
        assert differ(code, "calculix") == (False, False)
    for code in ("C3D4", "C3D10", "C3D15", "C3D10T"):
        assert differ(code, "calculix") == (False, True)
    for code in ("C3D8R", "C3D8I", "C3D6", "C3D20R"):
        assert differ(code, "calculix") == (True, False)
    assert differ("C3D8", "auto") == (True, False) and differ("C3D4", "auto") == (True, True)


@pytest.mark.parametrize(("text", "count"), [
    ("*STEP\n*FREQUENCY, SOLVER=MATRIXSTORAGE\n1\n*END STEP\n", 0), ("*STEP\n*STATIC\n*NODE FILE\nU\n*END STEP\n", 0),
    ("*PREPRINT, ECHO=NO\n", 1), ("*STEP\n*STATIC\n*OUTPUT, FIELD\n*END STEP\n", 1), ("", 1),
])  # fmt: skip
def test_keywords_tell_the_program_of_a_deck(tmp_path: Path, text: str, count: int) -> None:
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM).replace("*NODE FILE\nU\n", "") + MATERIAL + text)
    found = import_file(path).mesh.warnings
    assert len(found) == count and all("Abaqus takes B-bar" in one for one in found)
    assert not import_file(path, options={"dialect": "calculix"}).mesh.warnings


def test_the_mass_that_was_asked_for_decides(tmp_path: Path) -> None:
    path = tmp_path / "part.inp"
    block = box("tet10", (2, 1, 1), (0.3, 0.1, 0.08))
    text = ["*NODE"]
    text += [f"{i}, {x!r}, {y!r}, {z!r}" for i, (x, y, z) in enumerate(block.nodes.xyz.tolist(), start=1)]
    text += ["*ELEMENT, TYPE=C3D10", *(", ".join(map(str, (7, *(row + 1)))) for row in block.blocks[0].nodes[:1])]
    path.write_text("\n".join(text) + "\n")
    imported = import_file(path, options={"dialect": "calculix"})
    imported = replace(imported, materials=(isotropic(set="all", **STEEL),))
    assert not model_of(imported, mass_integration="reduced").warnings
    (told,) = model_of(imported).warnings
    assert "CalculiX takes 4 points" in told and "--mass-integration reduced" in told


def test_solids_of_nastran(tmp_path: Path) -> None:
    """PSOLID with full integration and PARAM COUPMASS are what is assembled here; their defaults are not."""
    path = tmp_path / "part.bdf"
    cells = written(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), "free") + "MAT1,3,2.1+11,,.3,7850.\n"

    def told(text: str) -> tuple[str, ...]:
        path.write_text(cells + text)
        return import_file(path).mesh.warnings

    shear, mass = told("PSOLID,1,3\n")
    assert "2 elements CHEXA with 8 nodes" in shear and "bubble" in shear and "lumped" in mass
    assert len(told("PSOLID,1,3\nPARAM,COUPMASS,1\n")) == 1
    assert not told("PSOLID,1,3,,TWO,,FULL\nPARAM,COUPMASS,1\n") and not told("PSOLID,1,3,,2,,1\nPARAM,COUPMASS,1\n")
    assert len(told("PSOLID,1,3,,TWO\nPARAM,COUPMASS,1\n")) == 1


def test_bulk_data_without_their_end(tmp_path: Path) -> None:
    path = tmp_path / "part.bdf"
    cells = "SOL 103\nBEGIN BULK\n" + written(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), "free")
    for end, count in (("", 1), ("ENDDATA\n", 0)):
        path.write_text(cells + end)
        assert sum("no ENDDATA" in one for one in import_file(path).mesh.warnings) == count


def test_solids_of_ansys(tmp_path: Path) -> None:
    path = tmp_path / "part.cdb"
    path.write_text(archive(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08))))
    (told,) = import_file(path).mesh.warnings
    assert "2 elements SOLID185" in told and "B-bar" in told
    assert not ansys_warnings(185, {}, "tet4", 1) and not ansys_warnings(187, {}, "tet10", 1)
    assert "enhanced strains" in ansys_warnings(185, {2: 2}, "wedge6", 1)[0]
    assert ansys_warnings(186, {}, "hex20", 1) and not ansys_warnings(186, {2: 1}, "hex20", 1)
    assert not ansys_warnings(186, {}, "tet10", 1) and ansys_warnings(187, {6: 1}, "tet10", 1)
    assert ansys_warnings(45, {}, "hex8", 1) and not ansys_warnings(45, {1: 1}, "hex8", 1)
    assert ansys_warnings(95, {11: 1}, "hex20", 1) and not ansys_warnings(95, {}, "hex20", 1)


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
        model = {"model": f'mesh = "{name}"\nunits = "m-kg-s"', "material": 'set = "all"\nyoung = 2.1e11\npoisson = 0.3'
                 '\ndensity = 7850.0', "interface": 'name = "a"\nnodes = "box: -1,-1,-1,0.001,1,1"',
                 "interface2": None}  # fmt: skip
        folder(tmp_path, model)
        assert words in " ".join(json.loads(run("reduce", tmp_path / "job.toml", "--json"))["warnings"])
