"""The viewer of doubled, degenerate and damaged input: a picture or one message; and lines that jobs take."""

from __future__ import annotations

import json
import shutil
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.couple import interfaces_of
from morembs.app.jobs.stages.model import model_of_files
from morembs.app.jobs.viewing import scene_of_files
from morembs.body.drawing import draw_shapes
from morembs.body.file import read_body
from morembs.body.recovery.recover import recover
from morembs.body.recovery.trajectory import Trajectory
from morembs.body.shapes import shapes_on
from morembs.body.view_scene import scene_of_view
from morembs.fem import ElementBlock, Mesh, Nodes
from morembs.fem.surface import outer_faces, seen_faces
from morembs.fem.viewer.models import scene_of_nodes
from morembs.fem.viewer.page import viewer_page
from tests.support import decks
from tests.support.refusals import refusal

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A body with stress, and its motion over four instants."""
    place = tmp_path_factory.mktemp("view")
    done = RUNNER.invoke(cli.app, ["reduce", str(decks.folder(place, {"stress": 'nodes = "skin"'})), "-q"])
    assert done.exit_code == 0, done.stderr
    body = read_body(place / "part.h5").bodies["cb"]
    swing = np.sin(np.arange(4.0))[:, None] * body.reduced.modes()[1][:, 6]
    recover(
        place / "part.h5", Trajectory(times=np.arange(4.0), coordinates=1e-6 * swing), place / "part.vtkhdf", body="cb"
    )
    return place


# --- Lines of a job


def test_all_selections_of_a_deck_select_in_a_job_what_is_shown(tmp_path: Path) -> None:
    """Node sets with names that are HTML and TOML, couplings, and all faces, each by the line that a click prints."""
    text = (
        decks.deck(decks.BEAM)
        + decks.MATERIAL
        + "*NODE\n900, -20.0, 10.0, 10.0\n901, 80.0, 10.0, 10.0\n*RIGID BODY, NSET=LEFT, REF NODE=900\n"
        "*NSET, NSET=\"a 'b' \\\\ #;]\"\n1, 2, 3\n*NSET, NSET=</script>x\n4, 5, 6\n"
        "*SURFACE, NAME=S1, TYPE=NODE\nRIGHT\n"
        "*COUPLING, CONSTRAINT NAME=C 1, REF NODE=901, SURFACE=S1\n*DISTRIBUTING\n1, 6\n"
    )
    (tmp_path / "part.inp").write_text(text)
    shown = scene_of_files([tmp_path / "part.inp"])[0]
    surface = shown.surfaces[0]
    wanted = {g.select: set(surface.node_ids[g.nodes]) for g in shown.groups if g.select and g.kind != "elements"}
    wanted |= {f.select: set(surface.node_ids[surface.triangles[f.triangles]].ravel()) for f in shown.features}
    # An average element has its point apart from its nodes; a rigid one is held at the point alone.
    wanted["coupling:C 1"] -= {901}
    wanted["coupling:LEFT"] = {900}
    assert len(wanted) == 13 and len(shown.features) == 6
    for select, labels in wanted.items():
        coupling = "" if select.startswith("coupling:") else 'coupling = "direct"\n'
        tables = {"model": 'file = "part.inp"\nunits = "mm-t-s"', "material": None, "interface2": None}
        # As JSON, which the panel prints.
        tables["interface"] = f'name = "x"\n{coupling}nodes = {json.dumps(select)}'
        (tmp_path / "job.toml").write_text(decks.job(tables))
        job = load_job(tmp_path / "job.toml")
        model = model_of_files(job)
        [interface] = interfaces_of(job, model)
        assert set(model.nodes.ids[interface.nodes]) - {901} == labels, select


# --- Doubled, degenerate and empty models


def test_elements_that_are_there_twice_leave_no_hole(tmp_path: Path) -> None:
    """The doubles are in another order of nodes; skins, open edges, faces to click and bodies are as without them."""
    lines = decks.deck(decks.BEAM).splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("*ELEMENT"))
    elements = [line.split(", ") for line in lines[first + 1 : first + 25]]
    turned = [", ".join([f"5{n}", *(nodes[k] for k in (1, 2, 3, 0, 5, 6, 7, 4))]) for n, *nodes in elements]
    lines[first + 25 : first + 25] = turned
    for name, text in (("one.inp", decks.deck(decks.BEAM)), ("two.inp", "\n".join(lines))):
        (tmp_path / name).write_text(text)
    one, two = (scene_of_files([tmp_path / name])[0] for name in ("one.inp", "two.inp"))
    assert len(one.surfaces[0].triangles) == len(two.surfaces[0].triangles) == 112
    assert [feature.select for feature in one.features] == [feature.select for feature in two.features]
    names = [group.name for group in two.groups]
    assert "double-elements" in names and "open edges" not in names


def test_doubles_within_a_mesh_hide_their_faces_once() -> None:
    """Two cubes that meet, one of them twice: the face between them stays inside, and is no face of the skin."""
    xyz = np.array([(x, y, z) for x in range(3) for y in range(2) for z in range(2)], dtype=float)
    cubes = np.array([[0, 4, 6, 2, 1, 5, 7, 3], [4, 8, 10, 6, 5, 9, 11, 7]])
    nodes = Nodes(ids=np.arange(12), xyz=xyz)
    mesh, doubled = (
        Mesh(nodes=nodes, blocks=(ElementBlock(type="hex8", nodes=rows, ids=np.arange(len(rows))),))
        for rows in (cubes, cubes[[0, 1, 1]])
    )
    faces = {frozenset(face) for face in seen_faces(doubled)["quad4"].tolist()}
    assert faces == {frozenset(face) for face in outer_faces(mesh)["quad4"].tolist()} and len(faces) == 10
    assert len(outer_faces(doubled)["quad4"]) == 5


@pytest.mark.parametrize("size", [1e12, 1e-12, 0.0])
def test_coordinates_of_any_size_are_drawn(size: float) -> None:
    xyz = size * np.array(decks.CORNERS, dtype=float)
    nodes = Nodes(ids=np.arange(8), xyz=xyz)
    mesh = Mesh(nodes=nodes, blocks=(ElementBlock(type="hex8", nodes=np.arange(8)[None], ids=np.array([1])),))
    scene = scene_of_nodes("cube", nodes, mesh)
    assert len(scene.surfaces[0].triangles) == 12 and "<canvas" not in viewer_page(scene)


def test_models_without_nodes_are_told(tmp_path: Path) -> None:
    with refusal("missing", "nodes"):
        viewer_page(scene_of_nodes("empty", Nodes(ids=np.empty(0, dtype=int), xyz=np.empty((0, 3))), None))
    np.savez(tmp_path / "k 1.npz", K=np.eye(6), M=np.eye(6))
    done = RUNNER.invoke(cli.app, ["view", str(tmp_path / "k 1.npz"), "--no-open"])
    assert done.exit_code == 2 and "holds matrices alone" in done.stderr and "k 1.npz' writes a job" in done.stderr
    assert len(list(tmp_path.iterdir())) == 1


def test_jobs_without_a_part_of_their_own_tell_what_to_view(folder: Path, tmp_path: Path) -> None:
    """A member of a beam has nothing, one of a mesh its mesh, and an assembly its bodies."""
    path = tmp_path / "job.toml"
    member = '[[reduce]]\nmethod = "global-modal-parameterisation"\nmodes = 2\nreach = 0.3\n'
    member += '[output]\npath = "m.h5"\n[member]\n'
    solid = "young = 3e6\ndensity = 2770.0\n"
    path.write_text(f"{member}{solid}length = 0.3\nelements = 4\nwidth = 0.01\nheight = 0.01\n")
    with refusal("unsupported", "", path, "member", "beam"):
        scene_of_files([path])
    path.write_text(f'{member}{solid}mesh = "strip.msh"\nstart = "set:A"\nend = "set:B"\n')
    with refusal("unsupported", "", path, "member", tmp_path / "strip.msh"):
        scene_of_files([path])
    part = '[[substructure]]\nname = "{}"\nbody = "{}"\n'
    tables = part.format("upper", folder / "part.h5") + part.format("lower", folder / "part.h5")
    tables += (
        '[[couple]]\nbetween = ["upper:RIGHT", "lower:LEFT"]\n[[interface]]\nname = "a"\nnodes = "set:upper:LEFT"\n'
    )
    path.write_text(f'{tables}[[reduce]]\nmethod = "craig-bampton"\nmodes = 6\n[output]\npath = "a.h5"\n')
    with refusal("unsupported", "", path, folder / "part.h5") as caught:
        scene_of_files([path])
    assert "member" not in str(caught.value)


def test_a_mode_that_leaves_the_skin_at_rest_is_drawn(folder: Path) -> None:
    """As one of a mass on a spring within; and a body that is seen edge-on."""
    view = read_body(folder / "part.h5").bodies["cb"].view(2)
    still = view.motion * np.array([0.0, 1.0])[:, None, None]
    shapes = shapes_on(replace(view, motion=still))
    assert shapes is not None and viewer_page(scene_of_view(replace(view, motion=still)))
    line = shapes.points * [1.0, 0.0, 0.0]
    for drawn in (shapes, replace(shapes, points=line)):
        with np.errstate(all="raise"):
            figure = Figure()
            draw_shapes(figure, drawn)
            figure.canvas.draw()


# --- Damaged motions


def _set(name: str, change: Callable[[Any], Any]) -> Callable[[Any], None]:
    def edit(group: Any) -> None:
        old = group[name][()]
        del group[name]
        group[name] = change(old)

    return edit


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (_set("PointData/displacement", lambda u: np.where(np.arange(len(u))[:, None] == 3, np.nan, u)), "NaN"),
        (_set("PointData/displacement", lambda u: np.full_like(u, np.inf)), "NaN or infinity"),
        (_set("PointData/displacement", lambda u: u[:, 0]), "cannot be read as a recovered motion"),
        (_set("PointData/displacement", lambda u: u[:, :2]), "cannot be read as a recovered motion"),
        (_set("Steps/Values", lambda t: t * np.nan), "times of bad.vtkhdf: NaN or infinity"),
        (_set("Steps/Values", lambda t: t[:0]), "has no steps over time"),
        (_set("Points", lambda x: np.where(np.arange(len(x))[:, None] == 3, np.nan, x)), "coordinates of"),
    ],
)
def test_motions_that_are_damaged_are_told_in_one_line(
    folder: Path, tmp_path: Path, edit: Callable[[Any], None], said: str
) -> None:
    bad = tmp_path / "bad.vtkhdf"
    shutil.copy(folder / "part.vtkhdf", bad)
    with h5py.File(bad, "a") as file:
        edit(file["VTKHDF"])
    done = RUNNER.invoke(cli.app, ["view", str(bad), "--no-open"])
    assert done.exit_code == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1
    assert [each.name for each in tmp_path.iterdir()] == ["bad.vtkhdf"]


def test_stress_that_is_infinite_has_no_color(folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.vtkhdf"
    shutil.copy(folder / "part.vtkhdf", bad)
    with h5py.File(bad, "a") as file:
        file["VTKHDF/PointData/von_mises"][3] = np.inf
    assert RUNNER.invoke(cli.app, ["view", str(bad), "--no-open"]).exit_code == 0


# --- Pages


@pytest.mark.parametrize("starts", [True, False])
def test_a_machine_without_a_browser_is_told(folder: Path, monkeypatch: pytest.MonkeyPatch, starts: bool) -> None:
    monkeypatch.setattr(webbrowser, "open", lambda address: starts)
    done = RUNNER.invoke(cli.app, ["view", str(folder / "part.inp")])
    assert done.exit_code == 0 and (folder / "part.inp.view.html").exists()
    assert ("no browser could be started here; open" in done.stderr) is not starts


def test_files_of_one_stem_have_pages_of_their_own(folder: Path, tmp_path: Path) -> None:
    for name in ("part.h5", "part.inp", "part.vtkhdf"):
        shutil.copy(folder / name, tmp_path / name)
        done = RUNNER.invoke(cli.app, ["view", str(tmp_path / name), "--no-open"])
        assert done.exit_code == 0 and f"{name}.view.html" in done.stdout
    assert len(list(tmp_path.glob("*.view.html"))) == 3
