"""Interfaces and labels in the viewer: frames move with their nodes; bodies without faces are drawn by their nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from morembs import read_mesh
from morembs.app.cli import commands as cli
from morembs.app.jobs.viewing import scene_of_files
from morembs.body.file import read_body
from morembs.body.recovery.recover import recover
from morembs.body.recovery.trajectory import Trajectory
from tests.support import decks
from tests.support.browser import CHROMIUM, Page, browser

RUNNER = CliRunner()
VIEWER = "document.querySelector('.morembs-viewer').viewer"
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A body with rigid ends, and its flight: a quarter turn about z, nearly rigid."""
    place = tmp_path_factory.mktemp("frames")
    ends = {f"interface{n}": f'name = "{s.lower()}"\nnodes = "set:{s}"\ncoupling = "rigid"' for n, s in _ENDS}
    decks.folder(place, ends)
    done = RUNNER.invoke(cli.app, ["reduce", str(place / "job.toml"), "-q"])
    assert done.exit_code == 0, done.stderr
    body = read_body(place / "part.h5").bodies["cb"]
    times = np.linspace(0.0, 1.0, 5)
    turns = np.array([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in times * np.pi / 2])
    flight = Trajectory(
        times=times,
        coordinates=1e-12 * np.sin(times)[:, None] * np.ones(body.floating.elastic.shape[1]),
        position=np.zeros((5, 3)),
        rotation=turns,
    )
    recover(place / "part.h5", flight, place / "part.vtkhdf", body="cb", stress=False)
    return place


_ENDS = (("", "LEFT"), ("2", "RIGHT"))


def open_view(page: Page, path: Path) -> None:
    target = path.with_suffix(".page.html")
    done = RUNNER.invoke(cli.app, ["view", str(path), "-o", str(target), "--no-open"])
    assert done.exit_code == 0, done.stderr
    page.faults.clear()
    page.open(target)
    page.wait(f"{VIEWER}?.drawing")


def frame_of(page: Page, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Origin in m and axes of a frame as they are drawn now."""
    read = page.run(f"{VIEWER}.frameIn({VIEWER}.panes[0], {VIEWER}.data.frames[{number}])")
    middle, half = page.run(f"[{VIEWER}.data.middle, {VIEWER}.data.half]")
    return np.array(read["origin"]) * half + middle, np.array(read["axes"])


@needs_browser
def test_frames_of_interfaces_move_with_the_mode(page: Page, folder: Path) -> None:
    """A rigid end moves as its frame does, which the body tells by its coordinates."""
    open_view(page, folder / "part.h5")
    stored = read_body(folder / "part.h5")
    body = stored.bodies["cb"]
    columns = body.reduced.modes()[1][:, 6]
    page.run(f"{VIEWER}.amplitude = 0.2, {VIEWER}.show.names = true, 1")
    amp = page.run(f"{VIEWER}.moved({VIEWER}.panes[0]).amp * {VIEWER}.data.half")
    sign = None
    for number, (name, interface) in enumerate(stored.interfaces.items()):
        origin, axes = frame_of(page, number)
        moved = origin - interface.point
        # Outputs of a rigid interface are the motions of its frame.
        told = amp * (body.input_matrix.T @ columns)[6 * number : 6 * number + 6]
        sign = np.sign(moved @ told[:3]) if sign is None else sign
        assert np.linalg.norm(told[:3]) > 0 and moved == pytest.approx(
            sign * told[:3], abs=0.02 * np.abs(told[:3]).max()
        )
        # Turns are small here: the axes turn about told[3:].
        assert axes[0] == pytest.approx(np.array([1.0, 0, 0]) + np.cross(sign * told[3:], [1.0, 0, 0]), abs=0.02), name
    page.run(f"{VIEWER}.amplitude = 0, 1")
    origin, axes = frame_of(page, 0)
    assert origin == pytest.approx(stored.interfaces["left"].point, abs=1e-6) and axes == pytest.approx(np.eye(3))
    assert page.faults == []


@needs_browser
def test_frames_and_labels_of_a_recovered_flight(page: Page, folder: Path) -> None:
    stored = read_body(folder / "part.h5")
    scene, _ = scene_of_files([folder / "part.vtkhdf"])
    nodes = read_mesh(folder / "part.inp", "mm-t-s").nodes
    at = nodes.xyz[np.searchsorted(nodes.ids, scene.surfaces[0].node_ids)]
    assert np.abs(at - scene.surfaces[0].points).max() < 1e-9
    assert list(scene.frames) == ["left", "right"]
    open_view(page, folder / "part.vtkhdf")
    page.run(f"{VIEWER}.play(false), {VIEWER}.time = 0.999999, {VIEWER}.amplitude = 1 / {VIEWER}.magnification(0), 1")
    origin, axes = frame_of(page, 1)
    # A quarter turn about z through the origin of the model.
    x, y, z = stored.interfaces["right"].point
    assert origin == pytest.approx([-y, x, z], abs=1e-4 * x)
    # Half a step of the largest displacement, of 2,047, over half the width of the end, which turns the axes: 2e-3.
    assert axes == pytest.approx(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]), abs=2e-3) and page.faults == []


@needs_browser
def test_bodies_without_faces_are_drawn_by_their_nodes(page: Page, tmp_path: Path) -> None:
    """A body that keeps the nodes of its interfaces alone, as assemblies and beams do."""
    decks.folder(tmp_path, {"output": 'path = "part.h5"\nnodes = "interfaces"'})
    assert RUNNER.invoke(cli.app, ["reduce", str(tmp_path / "job.toml"), "-q"]).exit_code == 0
    stored = read_body(tmp_path / "part.h5")
    scene, _ = scene_of_files([tmp_path / "part.h5"])
    (surface,) = scene.surfaces
    labels, counts = np.unique(surface.node_ids, return_counts=True)
    assert labels.tolist() == sorted(stored.node_ids.tolist()) and set(counts) == {6}
    assert "nodes alone are drawn" in surface.note
    open_view(page, tmp_path / "part.h5")
    picture = page.picture()
    page.run(f"{VIEWER}.choose(0, 1), {VIEWER}.paint(), 1")
    assert (np.abs(picture - page.picture()).max(axis=2) > 24).mean() > 0.001 and page.faults == []
