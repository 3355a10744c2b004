"""The viewer: its pages load in a browser without a fault or a request, move, and say what was clicked."""

from __future__ import annotations

import html
import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from urllib.parse import unquote

import h5py
import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.app.jobs.job import load_job
from morembs.app.jobs.stages.couple import interfaces_of
from morembs.app.jobs.stages.forecast import outline_model
from morembs.app.jobs.stages.model import materials_of, mesh_of
from morembs.app.jobs.viewing import scene_of_files
from morembs.app.pages.page import check_report, write_report
from morembs.app.pages.parts import Entry
from morembs.app.report.style import STYLE
from morembs.base.errors import OutputError
from morembs.body.file import read_body
from morembs.body.recovery.recover import recover
from morembs.body.recovery.trajectory import Trajectory
from morembs.fem import Nodes
from morembs.fem.viewer import Scene
from morembs.fem.viewer.models import scene_of_nodes
from morembs.fem.viewer.page import document_of
from morembs.fem.viewer.skin import drawn_surface
from tests.support import decks
from tests.support.browser import CHROMIUM, Page, browser
from tests.support.node import NODE, fetched
from tests.support.refusals import refusal

RUNNER = CliRunner()
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
HOSTILE = "<img src=x onerror=alert(1)>"
VIEWER = "document.querySelector('.morembs-viewer').viewer"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A beam and two bodies of it in one file, and another mesh of it; an interface has a name that is HTML."""
    place = tmp_path_factory.mktemp("view")
    for name, cells in (("part", decks.BEAM), ("other", [(x, 0, 0) for x in range(3)])):
        tables = {"reduce2": 'name = "guyan"\nmethod = "guyan"', "stress": 'nodes = "skin"'}
        tables["interface"] = f"name = '{HOSTILE}'\nnodes = \"set:LEFT\""
        tables |= {"output": f'path = "{name}.h5"', "model": f'mesh = "{name}.inp"\nunits = "mm-t-s"'}
        (place / f"{name}.inp").write_text(decks.deck(cells, 10.0 if name == "part" else 20.0))
        (place / f"{name}.toml").write_text(decks.job(tables))
        done = RUNNER.invoke(cli.app, ["reduce", str(place / f"{name}.toml"), "-q"])
        assert done.exit_code == 0, done.stderr
    return place


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def shown(page: Page, *arguments: str, **how: object) -> Path:
    """Write a page with ``morembs view`` and open it until it is drawn."""
    target = Path(arguments[0]).with_suffix(".page.html")
    done = RUNNER.invoke(cli.app, ["view", *arguments, "-o", str(target), "--no-open"])
    assert done.exit_code == 0, done.stderr
    page.faults.clear(), page.requests.clear()
    page.open(target, **how)
    page.wait(f"{VIEWER}?.drawing")
    return target


def drawn(page: Page) -> NDArray[np.int64]:
    """Pixels of the drawing alone."""
    page.run(f"{VIEWER}.paint(), 1")
    box = page.run(
        "(({x, y, width, height}) => [x, y, width, height])(document.querySelector('.stage').getBoundingClientRect())"
    )
    x, y, width, height = (round(value) for value in box)
    return page.picture()[y : y + height, x : x + width]


def seen_within_a_minute(page: Page, holds: Callable[[NDArray[np.int64]], bool]) -> None:
    """Wait for frames of other pages, into which no script looks."""
    end = time.monotonic() + 60
    while not holds(page.picture()):
        assert time.monotonic() < end
        time.sleep(0.2)


def difference(one: NDArray[np.int64], two: NDArray[np.int64]) -> float:
    """Part of the pixels that differ visibly."""
    return float((np.abs(one - two).max(axis=2) > 24).mean())


def colored(picture: NDArray[np.int64]) -> float:
    """Part of the pixels that have a color: neither paper nor ink."""
    return float((np.ptp(picture, axis=2) > 30).mean())


@needs_browser
def test_a_body_moves_in_a_page_that_asks_nobody(page: Page, folder: Path) -> None:
    path = shown(page, str(folder / "part.h5"))
    first = drawn(page)
    assert 0.05 < colored(first) < 0.7
    # The mode menu changes the picture, and nothing else does: people who want no motion get none.
    page.wait("true")
    assert difference(first, drawn(page)) == 0
    menu = "document.querySelector('.modes')"
    page.run(f"{menu}.value = 2, {menu}.dispatchEvent(new Event('change')), 1")
    assert difference(first, drawn(page)) > 0.02
    names = page.run("[...document.querySelectorAll('.modes option')].map((o) => o.textContent)")
    body = read_body(folder / "part.h5").bodies["cb"]
    assert len(names) == min(12, len(body.frequencies_hz) - 6)
    assert float(names[0].split(": ")[1].removesuffix(" Hz").replace(",", "")) == pytest.approx(
        body.frequencies_hz[6], rel=1e-4
    )
    assert page.faults == []
    assert {url.partition(":")[0] for url in page.requests} <= {"file", "data"}
    assert not re.search(r"https?://|@import|<link|src=\"(?!data:)", path.read_text())
    assert HOSTILE not in path.read_text()


@needs_browser
def test_a_mode_swings_where_motion_is_welcome_and_stops_by_a_key(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"), still=False)
    assert page.run(f"{VIEWER}.playing")
    page.run(f"{VIEWER}.clock = 0, new Promise((done) => setTimeout(done, 300))")
    first = page.picture()
    page.run("new Promise((done) => setTimeout(done, 400))")
    seen_within_a_minute(page, lambda picture: difference(first, picture) > 0.005)
    page.run(f"{VIEWER}.canvas.focus(), 1")
    page.key(" ")
    assert not page.run(f"{VIEWER}.playing")
    page.key("n")
    assert page.run(f"{VIEWER}.panes[0].mode") == 1
    page.key("6")
    assert page.run(f"{VIEWER}.camera.turn.slice(6)") == [0, 0, -1]
    assert page.faults == []


@needs_browser
def test_stress_colors_and_names_are_texts(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"))
    first = drawn(page)
    page.run(f"{VIEWER}.color = 'stress', 1")
    assert difference(first, drawn(page)) > 0.02
    assert HOSTILE in page.run("document.querySelector('.panel').textContent")
    assert page.run("document.images.length") == 0 and page.faults == []


@needs_browser
def test_a_browser_without_streams_that_inflate_shows_the_same(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"))
    first = drawn(page)
    shown(page, str(folder / "part.h5"), before="delete globalThis.DecompressionStream")
    assert page.run("typeof DecompressionStream") == "undefined"
    assert difference(first, drawn(page)) == 0 and page.faults == []


@needs_browser
def test_without_webgl_a_still_picture_is_left(page: Page, folder: Path) -> None:
    target = shown(page, str(folder / "part.h5"))
    page.open(target, before="HTMLCanvasElement.prototype.getContext = () => null")
    page.wait("document.querySelector('.morembs-viewer p:last-child')?.textContent.includes('no WebGL 2')")
    assert page.run("document.querySelector('.still img').naturalWidth") > 300 and page.faults == []


@needs_browser
def test_two_files_stand_side_by_side_with_their_mac(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"), str(folder / "other.h5"))
    picture = drawn(page)
    halves = np.array_split(picture, 2, axis=1)
    assert all(colored(half) > 0.03 for half in halves)
    # Where two modes are one, the other body's is chosen with it.
    best = json.loads(page.run(f"JSON.stringify({VIEWER}.mac().map((row) => Math.max(...row)))"))
    assert max(best) > 0.9
    page.run(f"{VIEWER}.choose(0, 1), 1")
    assert page.run(f"{VIEWER}.mac()[1][{VIEWER}.panes[1].mode] === Math.max(...{VIEWER}.mac()[1])")
    assert page.faults == []


# --- Models, decks and jobs


def clicked(page: Page, point: tuple[float, float, float]) -> list[str]:
    """Lines that a click at a place of the part gives, in the numbers of the job."""
    page.run(f"{VIEWER}.turnTo('0'), 1")
    x, y = seen_at(page, point)
    page.drag((x, y), (x, y))
    return list(page.run("[...document.querySelectorAll('.line code')].map((code) => code.textContent)"))


def seen_at(page: Page, point: tuple[float, float, float]) -> tuple[float, float]:
    """Where a place of the part, in the numbers of the job, is on the page."""
    script = f"""(() => {{ const v = {VIEWER}, {{ turn, zoom, pan }} = v.camera, {{ width, height }} = v.size();
      const p = {list(point)}.map((x, k) => (x * v.data.unit.length - v.data.middle[k]) / v.data.half);
      const along = (k) => turn[3 * k] * p[0] + turn[3 * k + 1] * p[1] + turn[3 * k + 2] * p[2];
      const [x, y] = [0, 1].map((k) => zoom * along(k) + pan[k]);
      const box = v.stage.getBoundingClientRect(), half = Math.min(width, height) / 2;
      return [box.left + 1 + width / 2 + half * x, box.top + 1 + height / 2 - half * y]; }})()"""
    x, y = page.run(script)
    return x, y


def taken(folder: Path, line: str) -> list[list[float]]:
    """Coordinates in mm of the nodes that a job takes whose interface has the line."""
    job = folder / "picked.toml"
    job.write_text(decks.job({"interface": f'name = "picked"\ncoupling = "direct"\n{line}', "interface2": None}))
    loaded = load_job(job)
    mesh = mesh_of(loaded)
    (interface,) = interfaces_of(loaded, outline_model(loaded, mesh, materials_of(loaded)))
    return sorted((mesh.nodes.xyz[interface.nodes] * 1000).round(6).tolist())


@needs_browser
def test_a_click_on_a_face_gives_lines_that_a_job_takes(page: Page, folder: Path) -> None:
    """The beam is 60 x 20 x 20 mm; the first view shows the faces of lowest y and of highest z, and an end."""
    shown(page, str(folder / "part.toml"))
    low, *others = ends_seen(page)
    lines = clicked(page, low)
    face = [[low[0], y, z] for y in (0.0, 10.0, 20.0) for z in (0.0, 10.0, 20.0)]
    assert lines[0].startswith('nodes = "box:') and taken(folder, lines[0]) == face
    name = "LEFT" if low[0] == 0 else "RIGHT"
    assert f'nodes = "set:{name}"' in lines
    (label,) = (line for line in lines if "ids:" in line)
    assert taken(folder, label) == [[low[0], 10.0, 10.0]]
    sphere = next(line for line in lines if "sphere:" in line)
    # Across a cell of 10 x 10 mm: the whole end, and five nodes behind it.
    assert len(taken(folder, sphere)) == 14 and all(place in taken(folder, sphere) for place in face)
    # The top: three rows of seven nodes.
    lines = clicked(page, others[0])
    assert len(taken(folder, lines[0])) == 21 and all(z == 20.0 for _, _, z in taken(folder, lines[0]))
    assert page.faults == []


def ends_seen(page: Page) -> list[tuple[float, float, float]]:
    """The middle of the end that the first view shows, and places on the top."""
    towards = page.run(f"{VIEWER}.data.view[2]")
    return [(0.0 if towards[0] < 0 else 60.0, 8.0, 12.0), (33.0, 8.0, 20.0)]


@needs_browser
def test_a_click_into_a_hole_gives_a_cylinder_that_a_job_runs_with(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The hole of 20 mm at the origin: its wall is seen opposite the viewer."""
    monkeypatch.chdir(tmp_path)
    assert RUNNER.invoke(cli.app, ["init", "--example"]).exit_code == 0
    shown(page, str(tmp_path / "rod.toml"))
    x, y, _ = page.run(f"{VIEWER}.data.view[2]")
    far = 10 / float(np.hypot(x, y))
    line = clicked(page, (-far * x, -far * y, 5.0))[0]
    assert line.startswith('nodes = "cylinder:0,0,-8.') and page.faults == []
    job = (tmp_path / "rod.toml").read_text()
    assert job.count('nodes = "set:BIGEND"') == 1
    (tmp_path / "rod.toml").write_text(job.replace('nodes = "set:BIGEND"', line))
    done = RUNNER.invoke(cli.app, ["reduce", "rod.toml", "-q"])
    assert done.exit_code == 0, done.stderr
    nodes = mesh_of(load_job(tmp_path / "rod.toml")).nodes
    labels = read_body(tmp_path / "rod.h5").interfaces["BIGEND"].node_ids
    assert len(labels) == 264
    radius = np.hypot(*nodes.xyz[np.isin(nodes.ids, labels), :2].T)
    assert radius == pytest.approx(np.full(264, 0.010), rel=1e-6)


@needs_browser
def test_a_drawn_box_gives_the_seen_nodes_within(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.toml"))
    page.run(f"{VIEWER}.turnTo('+z'), {VIEWER}.drawBox(true), 1")
    (x0, y0), (x1, y1) = seen_at(page, (-5.0, 25.0, 20.0)), seen_at(page, (15.0, 5.0, 20.0))
    page.drag((x0, y0), (x1, y1))
    lines = page.run("[...document.querySelectorAll('.line code')].map((code) => code.textContent)")
    expected = [[x, y, 20.0] for x in (0.0, 10.0) for y in (10.0, 20.0)]
    box, labels = lines[:2]
    assert box.startswith('nodes = "box:') and taken(folder, box) == expected
    assert labels.startswith('nodes = "ids:') and taken(folder, labels) == expected
    assert page.run("document.querySelector('.line .soft').textContent") == "4 seen nodes of the skin"
    # What is offered is what the button copies.
    page.run("window.copied = '', navigator.clipboard.writeText = async (text) => { window.copied = text; }, 1")
    page.run("document.querySelector('.line button').click(), new Promise((done) => setTimeout(done, 50))")
    assert page.run("window.copied") == box


@pytest.mark.skipif(NODE is None or CHROMIUM is None, reason="npm or Chromium is not installed")
def test_axe_finds_nothing_in_light_and_dark(page: Page, folder: Path, tmp_path: Path) -> None:
    axe = (fetched("axe-core@4.10.3", tmp_path) / "axe.min.js").read_text()
    for file in ("part.h5", "part.toml"):
        for dark in (False, True):
            shown(page, str(folder / file), dark=dark)
            page.run(f"{axe}; 1")
            found = page.run("axe.run().then((done) => done.violations.map((each) => [each.id, each.nodes[0].html]))")
            assert found == [] and page.faults == []


@needs_browser
def test_a_dark_page_prints_light_and_without_its_panel(page: Page, folder: Path) -> None:
    shown(page, str(folder / "part.h5"), dark=True)
    assert np.median(page.picture()) < 60
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    page.send("Emulation.setEmulatedMedia", media="print", features=dark)
    page.run("dispatchEvent(new Event('beforeprint')), 1")
    assert np.median(page.picture()) > 240 and colored(page.picture()) > 0.03
    assert page.run("getComputedStyle(document.querySelector('.panel')).display") == "none"
    page.send("Emulation.setEmulatedMedia", media="", features=dark)
    page.run("dispatchEvent(new Event('afterprint')), 1")
    assert np.median(page.picture()) < 60 and page.faults == []


@pytest.mark.parametrize("width", [390, 820, 1400])
@needs_browser
def test_a_page_fits_every_width(page: Page, folder: Path, width: int) -> None:
    """Nothing is wider than the page, and the picture keeps most of the width that it can have."""
    shown(page, str(folder / "part.h5"), width=width)
    assert page.run("document.documentElement.scrollWidth") <= width
    stage = page.run("document.querySelector('.stage').clientWidth")
    assert stage > (0.85 if width < 500 else 0.5) * width
    assert 0.03 < colored(drawn(page)) < 0.7


def test_the_picture_of_the_readme_moves_and_is_small() -> None:
    path = Path(__file__).parents[2] / "docs" / "viewer.webp"
    with Image.open(path) as picture:
        assert picture.n_frames >= 20 and path.stat().st_size < 600_000


def scene(path: Path) -> Scene:
    """What a file shows."""
    return scene_of_files([path])[0]


def test_findings_are_shown_where_they_are(tmp_path: Path) -> None:
    """Two cubes apart, an element twice, and a node of no element: each has its nodes."""
    lines = decks.deck(decks.APART).splitlines()
    lines.insert(1, "999, 70.0, 30.0, 40.0")
    first = next(i for i, line in enumerate(lines) if line.startswith("*ELEMENT"))
    lines.insert(first + 1, "500, " + lines[first + 1].partition(", ")[2])
    (tmp_path / "part.inp").write_text("\n".join(lines))
    shown = scene(tmp_path / "part.inp")
    groups = {group.name: group for group in shown.groups}
    surface = shown.surfaces[0]
    assert surface.node_ids[groups["orphan nodes"].nodes].tolist() == [999]
    assert groups["double-elements"].kind == "warning" and len(groups["double-elements"].nodes) == 8
    assert surface.points[groups["double-elements"].nodes].max() == 10.0
    loose = surface.points[groups["loose part"].nodes]
    assert len(loose) == 27 and "part 2 of 2" in groups["loose part"].about
    assert groups["LEFT"].select == "set:LEFT" and groups["FIRST"].kind == "elements"


def test_rigid_and_average_elements_are_lines(tmp_path: Path) -> None:
    text = (
        decks.deck(decks.BEAM)
        + "*NODE\n900, -20.0, 10.0, 10.0\n*RIGID BODY, NSET=LEFT, REF NODE=900\n"
        + decks.MATERIAL
    )
    (tmp_path / "part.inp").write_text(text)
    shown = scene(tmp_path / "part.inp")
    # Three faces of the element at a corner are seen.
    assert [len(group.triangles) for group in shown.groups if group.name == "FIRST"] == [6]
    (rigid,) = (group for group in shown.groups if group.kind == "coupling")
    ends = shown.surfaces[0].points[rigid.lines]
    assert rigid.select.startswith("coupling:") and "rigid" in rigid.name
    assert ends.shape == (9, 2, 3) and (ends[:, 0] == [-20.0, 10.0, 10.0]).all() and (ends[:, 1, 0] == 0).all()


def test_a_large_skin_is_drawn_with_fewer_triangles_of_its_own_nodes() -> None:
    """A box of 500,000 triangles: edges and corners stay, no face is lost, and the page says what it leaves out."""
    n = 205
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    sides = [np.insert(np.column_stack([u, v]), axis, end, axis=1) for axis in range(3) for end in (0, n - 1)]
    points, inverse = np.unique(np.concatenate(sides), axis=0, return_inverse=True)
    cell = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    quads = np.stack([cell, cell + n, cell + n + 1, cell + 1], axis=1)
    faces = np.concatenate([inverse.ravel()[quads + k * n * n] for k in range(6)])
    assert 2 * len(faces) > 499_000
    surface, rows = drawn_surface(points / 100.0, np.arange(len(points)) + 7, {"quad4": faces})
    assert 30_000 < len(surface.triangles) <= 60_000 and "are drawn as" in surface.note
    assert (surface.node_ids == rows + 7).all() and (surface.points == points[rows] / 100.0).all()
    corners = surface.points[surface.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    area = np.linalg.norm(normal, axis=1).sum()
    assert area == pytest.approx(6 * ((n - 1) / 100) ** 2, rel=0.01)
    for end in (points.min(), points.max() / 100):
        assert (np.abs(surface.points - end).max(axis=1) < 1e-9).any()


@needs_browser
def test_a_recovered_motion_plays_over_time(page: Page, folder: Path) -> None:
    body = read_body(folder / "part.h5").bodies["cb"]
    times = np.linspace(0.0, 0.5, 300)
    mode = body.reduced.modes()[1][:, 6]
    trajectory = Trajectory(times=times, coordinates=np.sin(4 * np.pi * times)[:, None] * mode * 1e-6)
    recover(folder / "part.h5", trajectory, folder / "part.vtkhdf", body="cb")
    shown(page, str(folder / "part.vtkhdf"))
    slider = "document.querySelector('input[step=\"0.001\"]')"
    pictures = []
    for place in (0.0, 0.25, 0.75):
        page.run(f"{slider}.value = {place}, {slider}.dispatchEvent(new Event('input')), 1")
        pictures.append(drawn(page))
    assert difference(pictures[0], pictures[1]) > 0.02 and difference(pictures[1], pictures[2]) > 0.02
    assert page.run("document.querySelector('output').textContent").startswith("0.375 s, drawn ")
    assert "120 of 300 steps" in page.run("document.querySelector('.help').textContent")
    legend = page.run(f"{VIEWER}.stressScale(0, 0) * 127")
    assert legend == pytest.approx(np.nanmax(stress_of(folder / "part.vtkhdf")), rel=0.05) and page.faults == []


def stress_of(path: Path) -> NDArray[np.float64]:
    with h5py.File(path) as file:
        return np.asarray(file["VTKHDF/PointData/von_mises"][()])


@needs_browser
def test_a_notebook_shows_a_body_and_a_model_in_frames(page: Page, folder: Path) -> None:
    body = read_body(folder / "part.h5").bodies["cb"]
    (folder / "cells.html").write_text(
        f"<!DOCTYPE html><title>cells</title>{body._repr_html_()}{body.view()._repr_html_()}"
    )
    page.faults.clear()
    page.open(folder / "cells.html", 900, 1400)
    seen_within_a_minute(page, lambda picture: min(colored(picture[200:700]), colored(picture[800:])) > 0.03)
    assert page.faults == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.h5"], "is not there"),
        (["part.h5", "part.h5", "part.h5"], "3 files were given"),
        (["part.h5", "-o", "page.txt"], "ends in .html"),
        (["part.h5", "part.toml"], "expected two body files"),
        (["K.mtx"], "a matrix was given"),
    ],
)
def test_what_cannot_be_shown_is_answered(
    folder: Path, arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (folder / "K.mtx").write_text("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1.0\n")
    done = RUNNER.invoke(cli.app, ["view", *arguments, "--no-open"])
    assert done.exit_code == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1
    assert not list(folder.glob("*.view.html")) and not (folder / "page.txt").exists()


# --- In reports


def report_of(bodies: Sequence[Path], path: Path, sections: int = STYLE.sections_in_page) -> str:
    entries = [
        Entry(name=f"<i>part {n}", job="j.toml", output=str(body), state="done") for n, body in enumerate(bodies)
    ]
    write_report(path, entries, "night", sections=sections)
    return path.read_text()


def test_reports_of_up_to_twenty_parts_have_sections() -> None:
    assert STYLE.sections_in_page == 20


def test_two_parts_of_one_name_have_pages_of_their_own(folder: Path, tmp_path: Path) -> None:
    bodies = [folder / "part.h5", *[folder / "other.h5"] * 2]
    entries = [Entry(name="part", job="j.toml", output=str(body), state="done") for body in bodies]
    write_report(tmp_path / "night.html", entries, "night", sections=2)
    links = re.findall(r'<a href="(night_files/[^"]+)"', (tmp_path / "night.html").read_text())
    one, two, *_ = [(tmp_path / link).read_text() for link in links]
    assert len(links) == 3 and len(set(links)) == 2 and one != two


OPENED = "document.querySelector('.morembs-look').open = true, 1"


@needs_browser
def test_a_report_has_a_viewer_a_part_that_begins_when_it_is_opened(page: Page, folder: Path, tmp_path: Path) -> None:
    text = report_of([folder / "part.h5", folder / "other.h5"], tmp_path / "night.html")
    assert text.count('class="morembs-viewer"') == 2 and len(text) < 2 * 350_000
    page.faults.clear(), page.requests.clear()
    page.open(tmp_path / "night.html")
    assert page.run("[...document.querySelectorAll('.morembs-viewer')].every((each) => !each.viewer)")
    page.run(OPENED)
    page.run("document.querySelector('.morembs-look').scrollIntoView(), 1")
    page.wait(f"{VIEWER}?.drawing")
    page.run("new Promise((done) => setTimeout(done, 300))")
    assert colored(drawn(page)) > 0.05
    assert (
        page.run("[...document.querySelectorAll('.morembs-viewer')].filter((each) => each.viewer?.drawing).length") == 1
    )
    assert page.faults == [] and {url.partition(":")[0] for url in page.requests} <= {"file", "data"}


@needs_browser
def test_many_parts_have_pages_of_their_own(page: Page, folder: Path, tmp_path: Path) -> None:
    """They are written again where something of them has changed alone, and hold all that a section does."""
    body = tmp_path / "body.h5"
    body.write_bytes((folder / "part.h5").read_bytes())
    bodies = [body, *[folder / "other.h5"] * 3]
    text = report_of(bodies, tmp_path / "night.html", 2)
    pages = sorted((tmp_path / "night_files").glob("part-*.html"))
    assert len(pages) == 4 and 'class="morembs-viewer"' not in text and "<section" not in text
    assert sorted(re.findall(r'<a href="([^"]+)">&lt;i&gt;part', text)) == [
        f"night_files/{each.name}" for each in pages
    ]
    times = {each: each.stat().st_mtime_ns for each in pages}
    body.write_bytes((folder / "other.h5").read_bytes())
    report_of(bodies, tmp_path / "night.html", 2)
    assert sum(each.stat().st_mtime_ns != times[each] for each in pages) == 1
    # A page that was edited by hand is written anew.
    own = pages[3].read_bytes()
    pages[3].write_bytes(own.replace(b"</main>", b"<p>no</p></main>"))
    report_of(bodies, tmp_path / "night.html", 2)
    assert pages[3].read_bytes() == own
    page.faults.clear(), page.requests.clear()
    page.open(tmp_path / "night.html")
    page.wait("document.querySelector('#parts img').naturalWidth === 128")
    page.run("document.querySelector('#parts a').click(), 1")
    page.wait("document.querySelector('h1')?.textContent === '<i>part 0' && document.querySelectorAll('.chart').length")
    seen_within_a_minute(page, lambda picture: colored(picture) > 0.03)
    page.run("document.querySelector('p a').click(), 1")
    page.wait("location.hash === '#part-1' && document.querySelector(location.hash)?.cells.length === 11")
    assert page.faults == [] and {url.partition(":")[0] for url in page.requests} <= {"file", "data"}


def test_the_page_of_many_parts_is_small_and_draws_nothing_twice(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What 2,000 parts cost a browser: 5 kB and 20 elements each, where a section has 100 kB and more."""
    bodies = [folder / "other.h5"] * 8
    text = report_of(bodies, tmp_path / "night.html", 2)
    few = report_of(bodies[:3], tmp_path / "few.html", 2)
    assert (len(text) - len(few)) / 5 < 5_000 and (text.count("<") - few.count("<")) / 5 < 40
    monkeypatch.setattr(Figure, "__init__", None)
    monkeypatch.setattr(h5py, "File", None)
    assert report_of(bodies, tmp_path / "night.html", 2) == text


def test_the_folder_of_pages_is_looked_at_before_anything_runs(folder: Path, tmp_path: Path) -> None:
    report = tmp_path / "night.html"
    (tmp_path / "night_files").write_text("mine")
    with refusal("output", "", tmp_path / "night_files", by=OutputError):
        check_report(report, lambda: 3, sections=2)
    # A report of few parts does without.
    few = RUNNER.invoke(cli.app, ["batch", str(tmp_path / "nothing"), "--report", str(report)])
    assert "is not a folder" not in few.stderr
    check_report(report, lambda: 2, sections=2)
    report_of([folder / "other.h5"], report)
    report.unlink()
    with refusal("output", "", tmp_path / "night_files", by=OutputError):
        report_of([folder / "other.h5"] * 3, report, 2)
    assert not report.exists() and (tmp_path / "night_files").read_text() == "mine"


def test_hostile_names_lead_to_the_pages_of_their_parts(folder: Path, tmp_path: Path) -> None:
    """Of the report, of its parts and of their body files."""
    place = tmp_path / """a <b> "q" 'q' # % ü &.d"""
    place.mkdir()
    body = place / "p#%41 <i>.h5"
    body.write_bytes((folder / "other.h5").read_bytes())
    report = place / 'n#1 %20 <x>&".html'
    entries = [Entry(name=f'"><i>{n} %', job=str(place / "j#.toml"), output=str(body), state="done") for n in range(3)]
    write_report(report, entries, "<i>night", sections=2)
    text = report.read_text()
    links = [unquote(html.unescape(link)) for link in re.findall(r'<a href="([^"#]+)">', text)]
    assert len(links) == 3 and "<i>" not in text
    for link in links:
        own = (place / link).read_text()
        assert "<i>" not in own
        for back in re.findall(r'<a href="([^"#]+)', own):
            found = (place / link).parent / unquote(html.unescape(back))
            assert found.is_file() or found.name == "j#.toml"


def test_frames_of_interfaces_have_their_axes_and_places_that_are_unknown_are_told() -> None:
    """A node without coordinates leaves a page of numbers, and says so."""
    xyz = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [np.nan, 0, 0]])
    nodes = Nodes(ids=np.arange(4), xyz=xyz)
    turned = np.vstack([[0.5, 0, 0], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]])
    made = scene_of_nodes("points", nodes, None, frames={"plain": xyz[1], "turned": turned})
    plain, other = document_of(made)["frames"]
    assert plain["axes"] == np.eye(3).tolist() and other["axes"] == turned[1:].tolist() and other["at"] == [0.5, 0, 0]
    assert "1 nodes without coordinates" in made.notes[0] and made.page()
