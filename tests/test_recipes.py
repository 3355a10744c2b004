"""Recipes of docs/howto/recipes.md: each from every program, each to every program, with files of those programs."""

import re
import shutil
from pathlib import Path

import pytest

from morembs import read_body, read_deck
from tests.support.mesh_decks import ansys_archive
from tests.support.meshes import box
from tests.support.processes import morembs, python

PAGE = (Path(__file__).parent.parent / "docs" / "howto" / "recipes.md").read_text()
SECTIONS = dict(part.split("\n", 1) for part in PAGE.split("\n## "))


def run(line, folder):
    done = morembs(*line.split(), folder=folder)
    assert done.code == 0, (line, done.errors)


def commands(title):
    return re.findall(r"^    morembs (.*)$", SECTIONS[title], re.MULTILINE)


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """A folder in which the first commands of the page have run."""
    folder = tmp_path_factory.mktemp("example")
    for line in commands("# From Nastran, Abaqus or ANSYS to a simulator"):
        run(line, folder)
    assert (folder / "deck.exudyn.hdf5").exists()
    return folder


def archive():
    """A block of steel as ANSYS writes it, with components at its ends."""
    mesh = box("hex20", (6, 2, 2), (120.0, 20.0, 20.0))
    x, labels = mesh.nodes.xyz[:, 0], range(101, 101 + len(mesh.nodes.xyz))
    components = ""
    for name, place in (("LEFT", 0.0), ("RIGHT", 120.0)):
        found = [label for label, at in zip(labels, x.tolist(), strict=True) if abs(at - place) < 1e-9]
        rows = ["".join(f"{label:10d}" for label in found[k : k + 8]) for k in range(0, len(found), 8)]
        components += "\n".join([f"CMBLOCK,{name},NODE,{len(found)}", "(8i10)", *rows, ""])
    steel = (("EX  ", 210e3), ("PRXY", 0.3), ("DENS", 7.85e-9))
    material = "".join(f"MPDATA,R5.0, 1,{name},       1, 1, {value!r}    ,\n" for name, value in steel)
    return ansys_archive(mesh, after=components + material)


@pytest.mark.parametrize(
    ("title", "interfaces"),
    [
        ("From Abaqus or CalculiX", {"BIGEND", "SMALLEND"}),
        ("From Nastran", {"RBE2_301", "RBE2_302"}),
        ("From ANSYS", {"LEFT", "RIGHT"}),
    ],
)
def test_a_deck_becomes_a_body(title, interfaces, example, tmp_path):
    shutil.copy(example / "deck.inp", tmp_path / "PART.inp")
    if title == "From Nastran":
        read_deck(tmp_path / "PART.inp").write(tmp_path / "PART.bdf", "nastran")
    (tmp_path / "PART.cdb").write_text(archive())
    lines = commands(title)
    assert len(lines) == 3
    for line in lines:
        run(line, tmp_path)
    body = read_body(tmp_path / "PART.h5")
    assert body.interfaces.keys() == interfaces and body.mass > 0.1


def test_matrices_become_a_body(tmp_path):
    for line in commands("From matrices"):
        run(line, tmp_path)
    assert (tmp_path / "matrices.h5").exists()


@pytest.mark.parametrize(
    "line", [line for line in re.findall(r"morembs (export PART.h5 .*?)(?:`|\n)", PAGE) if "extptfm" not in line]
)
def test_a_body_is_exported(line, example, tmp_path):
    shutil.copy(example / "deck.h5", tmp_path / "PART.h5")
    run(line.replace(":NAME", ":BIGEND"), tmp_path)
    made = {path.name for path in tmp_path.iterdir()} - {"PART.h5"}
    assert made
    if "sid" in line:
        assert made == {"PART_tangent-BIGEND.SID_FEM"}
    if "dmig" in line:
        text = (tmp_path / "PART.dmig.bdf").read_text()
        assert "M2GG = MAAX, K2GG = KAAX" in text and "SPOINT" in text


def test_a_deck_is_not_replaced_by_an_export_of_its_body(example, tmp_path):
    for name in ("deck.inp", "deck.h5"):
        shutil.copy(example / name, tmp_path / name)
    deck = (tmp_path / "deck.inp").read_bytes()
    done = morembs("export", "deck.h5", "--to", "abaqus", folder=tmp_path)
    assert done.code == 2 and re.search(r"deck.inp is a file that body '[\w-]+' was made from", done.errors)
    assert {path.name for path in tmp_path.iterdir()} == {"deck.inp", "deck.h5"}
    assert (tmp_path / "deck.inp").read_bytes() == deck
    # Another file of that name may be one of an export before.
    (tmp_path / "deck.inp").write_text("** another deck\n")
    run("export deck.h5 --to abaqus", tmp_path)


def test_the_example_swings_in_exudyn(example, tmp_path):
    pytest.importorskip("exudyn", reason="Exudyn is not here: pip install exudyn")
    (tables,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    shutil.copy(example / "deck.inp", tmp_path / "deck.inp")
    _, rest = (example / "deck.toml").read_text().split("[[reduce]]", 1)
    (tmp_path / "deck.toml").write_text(tables + "\n[[reduce]]" + rest)
    run("reduce deck.toml", tmp_path)
    done = python(code, tmp_path)
    assert done.code == 0, done.errors
    x, y, z = map(float, re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", done.output.splitlines()[-1]))
    # A pendulum of 120 mm falls by about 3/4 g t^2 in 20 ms.
    assert -0.004 < z < -0.002 and abs(y) < 1e-6 and x == pytest.approx(0.12, rel=1e-2)
