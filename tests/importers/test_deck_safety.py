"""Decks of strangers and broken decks: includes, byte order marks, cut files, materials that lack something."""

from __future__ import annotations

import codecs
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs import read_mesh
from morembs.app.cli import app
from morembs.base.errors import InputError
from morembs.importers import import_file
from morembs.importers.model_file import read_model
from tests.support.decks import BEAM, JOB, MATERIAL, deck, folder
from tests.support.mesh_decks import ansys_archive, nastran_mesh
from tests.support.meshes import box
from tests.support.refusals import Refusal, refusal

BULK = nastran_mesh(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), "free") + "MAT1,3,2.1+11,,.3,7850.\nPSOLID,1,3\n"
SECRET = "root:x:0:0:root:/root:/bin/sh\ndaemon:x:1:1\n"


@pytest.fixture
def inside(tmp_path: Path) -> Path:
    path = tmp_path / "deck"
    path.mkdir()
    return path


def imported(path: Path, *more: object, code: int = 0) -> str:
    out = path.with_suffix(".model.h5")
    result = CliRunner().invoke(app, ["import", str(path), "--units", "mm-t-s", "-o", str(out), *map(str, more)])
    assert result.exit_code == code, result.output
    assert out.is_file() == (code == 0)
    return result.stdout if code == 0 else result.stderr


def named(ending: str, name: object) -> str:
    """A complete deck that takes its mesh from a file."""
    if ending == ".inp":
        return f"*INCLUDE, INPUT={name}\n{MATERIAL}"
    return f"INCLUDE '{name}'\nMAT1,4,2.1+11,,.3,7850.\n"


MESHES = {".inp": deck(BEAM), ".bdf": BULK}


@pytest.mark.parametrize("ending", MESHES)
def test_includes_stay_in_the_folder_of_the_deck(inside: Path, ending: str) -> None:
    path, mesh = inside / f"part{ending}", inside.parent / f"mesh{ending}"
    mesh.write_text(MESHES[ending])
    (inside / "below").mkdir()
    (inside / "below" / "mesh.txt").write_text(MESHES[ending])
    (inside / "link.txt").symlink_to(mesh)
    for name in (f"../mesh{ending}", mesh, "link.txt", "below/../../mesh" + ending, "../none.txt", "/etc/none"):
        path.write_text(named(ending, name))
        told = imported(path, code=2)
        assert "--allow-includes-outside" in told and "not in the folder of the deck" in told
    for name in (f"../mesh{ending}", mesh, "link.txt"):
        path.write_text(named(ending, name))
        imported(path, "--allow-includes-outside")
        assert read_mesh(path, allow_includes_outside=True).blocks
        path.with_suffix(".model.h5").unlink()
    path.write_text(named(ending, "below/mesh.txt"))
    imported(path)


def test_jobs_and_nodes_of_matrices_have_the_key_too(inside: Path) -> None:
    (inside.parent / "mesh.inp").write_text(deck(BEAM))
    for allowed, code in (("false", 2), ("true", 0)):
        model = f"{JOB['model']}\nallow_includes_outside = {allowed}"
        path = folder(inside, {"model": model}, "*INCLUDE, INPUT=../mesh.inp\n")
        result = CliRunner().invoke(app, ["check", str(path), "--json"])
        assert result.exit_code == code, result.output


@pytest.mark.parametrize("ending", MESHES)
def test_no_message_shows_lines_of_files_that_are_no_decks(inside: Path, ending: str) -> None:
    path, secret = inside / f"part{ending}", inside.parent / "secret"
    begins = ["", MESHES[ending]]
    if ending == ".inp":
        begins += ["*NODE\n", "*NSET, NSET=A\n", "*HEADING\n", f"*NODE, INPUT={secret}\n"]
    for content in (SECRET, SECRET.rstrip(), "127.0.0.1\tlocalhost\n", "-----BEGIN KEY-----\nroot:\n"):
        secret.write_text(content)
        for begin in begins:
            path.write_text(begin + named(ending, secret))
            told = imported(path, "--allow-includes-outside", code=2)
            assert not any(word in told for word in ("root", "daemon", "localhost", "ROOT", "BEGIN KEY")), told
            assert "secret" in told and "not shown" in told
    path.write_text(SECRET)
    assert "root" not in imported(path, code=2).lower()


@pytest.mark.parametrize("ending", MESHES)
def test_includes_have_an_end(inside: Path, ending: str) -> None:
    """120 files each in the other; 25 files that include the one before twice; too many bytes."""
    word = "*INCLUDE, INPUT={0}\n" if ending == ".inp" else "INCLUDE '{0}'\n"
    path = inside / f"part{ending}"
    for k in range(120):
        (inside / f"f{k}").write_text(word.format(f"f{k + 1}"))
    (inside / "f120").write_text(MESHES[ending])
    path.write_text(word.format("f0"))
    assert "51 deep; at most 50" in imported(path, code=2)
    path.write_text(word.format("f80"))
    read_mesh(path)
    for k in range(1, 26):
        (inside / f"f{k}").write_text(2 * word.format(f"f{k - 1}"))
    (inside / "f0").write_text("** nothing\n" if ending == ".inp" else "$ nothing\n")
    path.write_text(word.format("f25"))
    assert "includes 1001 files" in imported(path, code=2)
    # A file with a hole: it takes no room on the disk.
    os.truncate(inside / "f120", 5 << 30)
    path.write_text(word.format("f120"))
    assert "1 files of 5369 MB together" in imported(path, code=2)


@pytest.mark.parametrize("ending", [".inp", ".bdf", ".cdb"])
def test_byte_order_marks_are_read(tmp_path: Path, ending: str) -> None:
    text = {**MESHES, ".cdb": ansys_archive(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)))}[ending]
    if ending == ".bdf":
        text = "SOL 103\nPARAM,WTMASS,1.\nBEGIN BULK\n" + text
    path = tmp_path / f"part{ending}"
    path.write_text(text)
    plain = import_file(path).mesh
    wide = codecs.BOM_UTF16_BE + text.encode("utf-16-be")
    for data in (codecs.BOM_UTF8 + text.encode(), text.encode("utf-16"), wide):
        path.write_bytes(data)
        mesh = import_file(path).mesh
        assert (mesh.nodes.xyz == plain.nodes.xyz).all() and (mesh.blocks[0].nodes == plain.blocks[0].nodes).all()
    path.write_bytes(codecs.BOM_UTF16_LE + b"*")
    with refusal("file", path.name, "UTF-16"):
        import_file(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("*HEADING\na title\n*INCLUDE, INPUT=nodes.txt\n", ("value", "", "nodes.txt", "*HEADING,")),
        ("*HEADING\na title\nINCLUDE, INPUT=nodes.txt\n", ("unsupported", "HEADING", "part.inp", "*INCLUDE")),
        ("*BOUNDARY\n include , input=nodes.txt\n", ("unsupported", "BOUNDARY", "part.inp", "*INCLUDE")),
        ("*PART, NAME=A\n*INCLUDE, INPUT=nodes.txt\n*END PART\n", ("missing", "PART", "part.inp", "130")),
        ("*PART, NAME=A\n1, 0., 0., 0.\n*END PART\n", ("missing", "PART", "part.inp", "130")),
        ("*MATERIAL, NAME=A\n2.1e5, 0.3\n", ("missing", "MATERIAL", "part.inp", "130")),
        (
            "*SOLID SECTION, ELSET=EVERY, MATERIAL=STEEL\n1.,\n*INCLUDE, INPUT=nodes.txt\n",
            ("value", "SOLID SECTION", "part.inp", "130"),
        ),
        (
            "*ORIENTATION, NAME=O\n1.,0.,0.,0.,1.,0.\n*ORIENTATION, NAME=O\n0.,1.,0.,1.,0.,0.\n",
            ("conflict", "ORIENTATION", "132", "'O'"),
        ),
        (
            "*SOLID SECTION, ELSET=EVERY, MATERIAL=TWO\n*MATERIAL, NAME=TWO\n*ELASTIC\n1e5, .3\n*ELASTIC\n2e5, .3\n",
            ("conflict", "SOLID SECTION", "*ELASTIC", "134", "'TWO'"),
        ),
        (
            "*SOLID SECTION, ELSET=EVERY, MATERIAL=TWO\n*MATERIAL, NAME=TWO\n*DENSITY\n1e-9\n*DENSITY\n1e-9\n",
            ("conflict", "SOLID SECTION", "*DENSITY", "134", "'TWO'"),
        ),
        ("*MASS, ELSET=FIRST\n1.\n", ("unsupported", "MASS", "'FIRST'")),
        (
            "*ELEMENT, TYPE=MASS, ELSET=P\n900, 1\n*MASS, ELSET=P\n1.\n*MASS, ELSET=P\n2.\n",
            ("unsupported", "MASS", "134", "'P'"),
        ),
    ],
)
def test_data_that_no_keyword_takes_are_not_swallowed(tmp_path: Path, text: str, words: Refusal) -> None:
    (tmp_path / "nodes.txt").write_text("901, 0., 0., 0.\n902, 1., 0., 0.\n")
    path = tmp_path / "part.inp"
    path.write_text(deck(BEAM) + MATERIAL + text)
    with refusal(*words):
        import_file(path)


def test_a_parameter_of_nastran_has_one_value(tmp_path: Path) -> None:
    path = tmp_path / "part.bdf"
    path.write_text(BULK + "PARAM,WTMASS,.5\nPARAM,WTMASS,1.\n")
    with refusal("value", "", "WTMASS"):
        import_file(path)


def ansys(text: str) -> str:
    return ansys_archive(box("hex8", (2, 1, 1), (0.3, 0.1, 0.08)), after=text)


@pytest.mark.parametrize(
    ("name", "whole", "less", "set"),
    [
        ("a.inp", deck(BEAM) + MATERIAL, "*DENSITY\n7.85e-9\n", "EVERY"),
        ("a.inp", deck(BEAM) + MATERIAL, "*ELASTIC\n210e3, 0.3\n", "EVERY"),
        ("a.bdf", BULK, ",7850.", "PSOLID_1"),
        ("a.bdf", BULK, "PSOLID,1,3\n", "PSOLID_1"),
        ("a.cdb", ansys("MP,EX,1,2.1E11\nMP,DENS,1,7850.\n"), "MP,DENS,1,7850.\n", "material 1"),
    ],
)
def test_a_material_that_lacks_something_is_refused_or_replaced_with_a_warning(
    tmp_path: Path, name: str, whole: str, less: str, set: str
) -> None:
    path = tmp_path / name
    assert less in whole
    path.write_text(whole.replace(less, ""))
    told = imported(path, code=2)
    assert set in told and ("has no" in told or "not in the file" in told)
    (said,) = json.loads(imported(path, "--json", "--material", f"young=1e5,poisson=0.3,density=1e-9,set={set}"))
    assert any("the material that was given took its place" in warning for warning in said["warnings"])
    assert any("took its place" in warning for warning in read_model(path.with_suffix(".model.h5")).warnings)


def test_a_second_section_without_density_is_not_covered_by_the_first(tmp_path: Path) -> None:
    """The elements of FIRST have a complete material of another section, and one that the deck means for them."""
    path = tmp_path / "part.inp"
    path.write_text(
        deck(BEAM) + MATERIAL + "*MATERIAL, NAME=ALU\n*ELASTIC\n70e3, 0.3\n*SOLID SECTION, ELSET=FIRST, MATERIAL=ALU\n"
    )
    assert "the material ALU of the set FIRST has no *DENSITY" in imported(path, code=2)


def gmsh(path: Path) -> Path:
    return Path(__file__).parents[2] / "data" / "small_meshes" / "conrod.msh"


def by_meshio(path: Path) -> Path:
    import meshio

    mesh = box("hex8", (2, 1, 1), (0.3, 0.1, 0.08))
    plain = {} if path.suffix == ".mesh" else {"binary": False}
    kind = {".vtk": "vtk", ".mesh": "medit", ".vtu": "vtu", ".msh": "gmsh"}[path.suffix]
    meshio.write(path, meshio.Mesh(mesh.nodes.xyz, [("hexahedron", mesh.blocks[0].nodes)]), file_format=kind, **plain)
    return path


@pytest.mark.parametrize(
    ("ending", "source"),
    [
        (".msh", gmsh),
        (".msh", by_meshio),
        (".vtk", by_meshio),
        (".mesh", by_meshio),
        (".vtu", by_meshio),
        (".inp", lambda path: deck(BEAM) + MATERIAL),
        (".bdf", lambda path: BULK + "ENDDATA\n"),
        (".cdb", lambda path: ansys("MP,EX,1,2.1E11\nMP,DENS,1,7850.\n")),
    ],
)
def test_files_cut_within_their_last_lines_are_noticed(
    tmp_path: Path, ending: str, source: Callable[[Path], Path | str]
) -> None:
    """Cut at any byte of the end that is no end of a line: refused, unless nothing but blanks is missing or the last
    card may be whole, of which the import warns."""
    path = tmp_path / f"part{ending}"
    whole = source(path)
    data = whole.read_bytes() if isinstance(whole, Path) else whole.encode()
    path.write_bytes(data)
    import_file(path)
    ended = len(data.rstrip())
    last = data[:ended].rstrip().rsplit(b"\n", 1)[-1]
    for cut in range(ended - 40, ended):
        if data[:cut].endswith(b"\n") and ending not in (".msh", ".mesh", ".vtu"):
            continue
        if last in (b"FINISH", b"ENDDATA") and data[:cut].rstrip() == data[: ended - len(last)].rstrip():
            continue
        if data[:cut].endswith(b"\nFINI"):
            # Commands of ANSYS may be cut to four letters.
            continue
        path.write_bytes(data[:cut])
        try:
            read = import_file(path)
        except InputError:
            continue
        warnings = (*read.warnings, *read.mesh.warnings)
        place = f"cut {ended - cut} bytes before the end: {data[cut - 30 : cut]!r}"
        assert ending in (".inp", ".bdf", ".cdb") and any("[last-line-open]" in text for text in warnings), place
