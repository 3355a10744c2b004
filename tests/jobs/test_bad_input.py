"""Every way to be wrong gives one message, exit code 2, no traceback, and leaves old results alone."""

from __future__ import annotations

import resource
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from morembs.app.cli import app
from tests.support.commands import OLD_RESULT, refused
from tests.support.decks import APART, BEAM, HINGED, Cell, deck, folder
from tests.support.processes import apart, program

STEEL = "young = 210e3\npoisson = 0.3\ndensity = 7.85e-9"
FREE = {"interface": None, "interface2": None, "reduce": 'method = "modal"\nmodes = 3'}


def test_missing_mesh(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"model": 'mesh = "other.inp"'}))
    assert "other.inp" in message and "does not exist" in message and "check the path" in message


@pytest.mark.parametrize(("name", "text"), [("part.inp", "no deck at all\n"), ("part.msh", "$MeshFormat\nrubbish\n")])
def test_unreadable_mesh(tmp_path: Path, name: str, text: str) -> None:
    job = folder(tmp_path, {"model": f'mesh = "{name}"'})
    (tmp_path / name).write_text(text)
    message = refused(job)
    assert name in message and "expected" in message


def test_missing_job(tmp_path: Path) -> None:
    message = refused(tmp_path / "nowhere.toml")
    assert "nowhere.toml" in message and "check the path" in message


def test_toml_syntax(tmp_path: Path) -> None:
    job = folder(tmp_path)
    job.write_text("[model]\nmesh = = 3\n")
    message = refused(job)
    assert "not valid TOML" in message and "line 2" in message and "correct that line" in message


@pytest.mark.parametrize(
    ("name", "text"), [("part.inp", b"*NODE\n1, 0.0, 0.0, 0.0\n"), ("part.model.h5", b"\x89HDF\r\n")]
)
def test_mesh_in_place_of_a_job(tmp_path: Path, name: str, text: bytes) -> None:
    (tmp_path / name).write_bytes(text)
    message = refused(tmp_path / name)
    assert f"morembs init {tmp_path / name} writes one" in message and "mend" not in message


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"material": "young = 1.0\npoisson = 0.3\ndensty = 1.0"}, ["densty", "'density'", "[[material]] 1"]),
        ({"interface": 'name = "a"\nnods = "set:LEFT"'}, ["nods", "'nodes'", "[[interface]] 1"]),
        ({"dampin": "modal = 0.1"}, ["dampin", "'damping'"]),
        ({"damping": "rayleigh = { alpha = 1.0, beto = 1.0 }"}, ["[damping], rayleigh", "beto", "'beta'"]),
        ({"reduce": 'method = "craig-bampton"\nmods = 3'}, ["mods", "'modes'", "craig-bampton"]),
        ({"reduce": 'method = "craig-bamton"\nmodes = 3'}, ["craig-bamton", "'craig-bampton'"]),
        ({"reduce": 'method = "guyan"\nmodes = 3'}, ["guyan", "no key 'modes'"]),
        ({"model": 'mesh = "part.inp"\nunits = "mm-to-s"'}, ["mass", "'to'", "'t'"]),
        ({"interface": 'name = "a"\nnodes = "set:LEFT"\ncoupling = "rigit"'}, ["rigit", "'rigid'"]),
        ({"solver": 'name = "mump"'}, ["mump", "'mumps'"]),
    ],
)
def test_unknown_word_names_the_nearest(tmp_path: Path, tables: dict[str, str], words: list[str]) -> None:
    message = refused(folder(tmp_path, tables))
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"material": 'young = "210e3"\npoisson = 0.3\ndensity = 7.85e-9'}, ["young = '210e3'", "one positive number"]),
        ({"material": "young = 210e3\npoisson = 0.3"}, ["density is missing", "expected a positive number"]),
        ({"model": 'mesh = "part.inp"\nunits = { length = "mm", mass = "t" }'}, ["time is missing", "a unit of time"]),
        ({"interface": 'name = "a"\nnodes = "set:LEFT"\npoint = [0.0, 1.0]'}, ["point = [0.0, 1.0]", "[x, y, z]"]),
        ({"reduce": 'method = "craig-bampton"\nmodes = 3.5'}, ["modes = 3.5", "integer"]),
        ({"reduce": 'method = "craig-bampton"'}, ["modes = COUNT or up_to_hz"]),
        ({"reduce2": 'name = "cb"\nmethod = "guyan"'}, ["two [[reduce]]", "'cb'"]),
        ({"reduce": 'name = "a/b"\nmethod = "guyan"'}, ["a/b", "letters"]),
        ({"solver": 'memory = "4 Gigs"'}, ["4 Gigs", "4 GiB"]),
        ({"damping": "modal = 0.01\nrayleigh = { alpha = 1.0 }"}, ["rayleigh and modal", "choose one"]),
        ({"output": 'path = "part.h5"\nnodes = "skn"'}, ["'skn'", '"skin"']),
        ({"response": "from_hz = 10.0\nto_hz = 5.0"}, ["from_hz = 10", "to_hz = 5"]),
    ],
)
def test_wrong_value(tmp_path: Path, tables: dict[str, str], words: list[str]) -> None:
    message = refused(folder(tmp_path, tables))
    for word in words:
        assert word in message


def test_every_wrong_key_has_its_line(tmp_path: Path) -> None:
    job = folder(tmp_path, {"output": "pth = 3", "material": 'young = "x"\npoisson = 0.3\ndensity = 1.0'})
    lines = CliRunner().invoke(app, ["check", str(job)]).stderr.strip().splitlines()
    assert len(lines) == 2
    assert "young" in lines[0] and "pth" in lines[1] and "'path'" in lines[1]


def test_unknown_node_set_lists_those_there_are(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"interface": 'name = "a"\nnodes = "set:LFT"'}))
    assert "'a'" in message and "'LFT'" in message
    for name in ("LEFT", "RIGHT", "LINE", "FIRST"):
        assert name in message


def test_empty_set(tmp_path: Path) -> None:
    text = deck(BEAM) + "*NSET, NSET=EMPTY\n"
    message = refused(folder(tmp_path, {"interface": 'name = "a"\nnodes = "set:EMPTY"'}, text))
    assert "'EMPTY'" in message and "empty" in message and "LEFT" in message


def test_unknown_element_set(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"material": f'set = "FRIST"\n{STEEL}'}))
    assert "'FRIST'" in message and "'FIRST'" in message


def test_elements_without_material(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"material": f'set = "FIRST"\n{STEEL}'}))
    assert "23 elements have no material" in message and "FIRST" in message


@pytest.mark.parametrize("poisson", [0.5, 0.7, -1.0, -3.0])
def test_poisson(tmp_path: Path, poisson: float) -> None:
    table = f'set = "all"\nyoung = 210e3\npoisson = {poisson}\ndensity = 7.85e-9'
    message = refused(folder(tmp_path, {"material": table}))
    assert f"poisson = {poisson}" in message and "between -1 and 0.5" in message


@pytest.mark.parametrize("density", ["0.0", "-7.85e-9"])
def test_density(tmp_path: Path, density: str) -> None:
    table = f'set = "all"\nyoung = 210e3\npoisson = 0.3\ndensity = {density}'
    message = refused(folder(tmp_path, {"material": table}))
    assert "density" in message and "positive" in message


def test_inverted_element(tmp_path: Path) -> None:
    text = deck(BEAM)
    line = next(line for line in text.split("*ELEMENT")[1].split("\n") if line.startswith("7, "))
    first, second, *rest = line.split(", ")[1:]
    # Two corners exchanged: right-handed at some points, left-handed at others.
    message = refused(folder(tmp_path, text=text.replace(line, ", ".join(["7", second, first, *rest]))))
    assert "1 hex8 elements are inverted" in message and ": 7 (" in message


def test_degenerate_element(tmp_path: Path) -> None:
    # The upper face of element 3 becomes its lower one.
    lines = deck(((0, 0, 0), (1, 0, 0), (2, 0, 0))).splitlines()
    at = lines.index("*ELEMENT, TYPE=C3D8") + 3
    nodes = lines[at].split(", ")
    lines[at] = ", ".join([*nodes[:5], *nodes[1:5]])
    message = refused(folder(tmp_path, FREE, "\n".join(lines) + "\n"))
    assert "degenerate" in message and ": 3 (" in message


def test_unsupported_element(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, text=deck(BEAM, kind="S8R")))
    assert "S8R" in message and "not supported" in message and "C3D8" in message


def test_rigid_interfaces_share_nodes(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"interface2": 'name = "line"\nnodes = "ids:1,2,3,4,5"'}))
    assert "'left'" in message and "'line'" in message and "share node 1" in message


@pytest.mark.parametrize("coupling", ["average", "rigid"])
def test_collinear_interface(tmp_path: Path, coupling: str) -> None:
    table = f'name = "line"\nnodes = "set:LINE"\ncoupling = "{coupling}"'
    message = refused(folder(tmp_path, {"interface": None, "interface2": table}))
    assert "'line'" in message and "lie on a line" in message and "at least three" in message


@pytest.mark.parametrize(("cells", "count"), [(HINGED, 7), (APART, 12)])
def test_more_rigid_modes_than_a_body_has(tmp_path: Path, cells: Sequence[Cell], count: int) -> None:
    job = folder(tmp_path, FREE, deck(cells))
    message = refused(job, ["reduce"])
    assert f"{count} rigid-body modes" in message and "6" in message and "merge" in message
    assert ("mechanism" if cells is HINGED else "unconnected parts") in message
    # Without a factorisation, by the graph of the mesh alone.
    checked = CliRunner().invoke(app, ["check", str(job)])
    assert checked.exit_code == 0
    assert f"warning: the mesh has {count} rigid-body modes where one free body has 6: unconnected" in checked.stdout


def test_more_modes_than_dofs(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"reduce": 'name = "many"\nmethod = "craig-bampton"\nmodes = 5000'}))
    # 63 nodes, of which 18 follow two frames of 6 dofs.
    assert "'many'" in message and "modes = 5000" in message and "147 degrees of freedom" in message


def test_output_folder_missing(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"output": 'path = "nowhere/part.h5"'}))
    assert "nowhere" in message and "does not exist" in message and "make it" in message


def test_output_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    message = refused(folder(tmp_path, {"output": 'path = "taken"'}))
    assert "taken" in message and "is a folder" in message


def test_picture_folder_missing(tmp_path: Path) -> None:
    message = refused(folder(tmp_path, {"output": 'path = "part.h5"\npicture = "nowhere/part.png"'}))
    assert "nowhere" in message and "does not exist" in message


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file size are POSIX")
@pytest.mark.parametrize("existed", [True, False])
def test_full_disk(tmp_path: Path, existed: bool) -> None:
    job = folder(tmp_path)
    output = tmp_path / "part.h5"
    if existed:
        output.write_bytes(OLD_RESULT)
    before = sorted(tmp_path.iterdir())
    command = program(["reduce", str(job)])

    def work() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
        command()

    done = apart(work, tmp_path)
    assert done.code == 2, done.errors
    assert done.errors.startswith("error: ") and len(done.errors.strip().splitlines()) == 1
    assert "part.h5 could not be written" in done.errors and "free space" in done.errors
    assert sorted(tmp_path.iterdir()) == before
    assert not existed or output.read_bytes() == OLD_RESULT
