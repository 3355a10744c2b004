"""Numbers of a viewer's page: what the browser reads is what was written, and a page is small."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from morembs.fem.viewer import Motion, Scene, Surface, viewer_page
from morembs.fem.viewer.page import document_of
from morembs.fem.viewer.skin import drawn_surface
from tests.support.browser import CHROMIUM, Page, browser

VIEWER = "document.querySelector('.morembs-viewer').viewer"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def tube(around: int, along: int) -> Surface:
    """A tube that is open at both ends, of quadrilaterals in no order."""
    angle, z = (x.ravel() for x in np.meshgrid(np.arange(around) / around * 2 * np.pi, np.arange(along) / along))
    points = np.stack([0.2 * np.cos(angle), 0.1 * np.sin(angle), z], axis=1)
    cell = np.arange(around * (along - 1)).reshape(along - 1, around)
    right = np.roll(cell, -1, axis=1)
    quads = np.stack([cell, right, right + around, cell + around], axis=2).reshape(-1, 4)
    random = np.random.default_rng(1)
    new = random.permutation(len(points))
    mixed = np.empty_like(points)
    mixed[new] = points
    surface, _ = drawn_surface(mixed, random.permutation(len(points)) + 5, {"quad4": new[random.permutation(quads)]})
    return surface


def waves(surface: Surface, count: int) -> NDArray[np.float64]:
    """Smooth shapes (count, n, 3)."""
    z = surface.points[:, 2]
    return np.array(
        [
            [0.2 * np.sin(k * z) * surface.points[:, 1], np.sin(k * z), np.cos(2 * k * z) ** 2]
            for k in range(1, count + 1)
        ]
    ).transpose(0, 2, 1)


def read_by(page: Page, scene: Scene, tmp_path: Path) -> dict[str, Any]:
    """What the script of a page makes of a scene."""
    (tmp_path / "page.html").write_text(viewer_page(scene))
    page.open(tmp_path / "page.html")
    page.wait(f"{VIEWER}?.fields && {VIEWER}.drawing")
    lists = "(given) => given && given.map((numbers) => [...numbers])"
    script = f"""(() => {{ const v = {VIEWER}, lists = {lists};
      const own = ["points", "triangles", "labels", "sides"].map((key) => [key, lists(v.surfaces.map((s) => s[key]))]);
      const [shapes, stress] = ["shapes", "stress"].map((key) => v.fields.map((field) => lists(field[key])));
      return JSON.stringify({{ ...Object.fromEntries(own), shapes, stress }}); }})()"""
    return dict(json.loads(page.run(script)))


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_the_browser_reads_the_numbers_that_were_written(page: Page, tmp_path: Path) -> None:
    """On a tube with its doubles, thin triangles and lone points; the second motion is the first one upside down."""
    whole = tube(40, 20)
    thin = np.array([[0, 1, 1], [3, 900, 4]])
    alone = np.random.default_rng(2).normal(size=(7, 3))
    surface = Surface(
        points=np.concatenate([whole.points, whole.points[:1] * [1, 1, 1.0000001], alone]),
        node_ids=np.append(whole.node_ids, np.arange(8) + 5000),
        triangles=np.concatenate([whole.triangles, whole.triangles[:9], np.minimum(thin, len(whole.points))]),
        sides=np.append(whole.sides, np.full(11, 7)),
    )
    shapes = waves(surface, 3)
    stress = np.where(np.arange(len(surface.points)) % 50 == 0, np.nan, shapes[:, :, 1] ** 2)
    one = Motion(name="one", surface=0, shapes=shapes, values=np.arange(3.0), stress=stress)
    two = Motion(name="two", surface=0, shapes=-2 * shapes[[2, 0]], values=np.arange(2.0))
    steps = Motion(name="steps", surface=0, shapes=shapes, values=np.arange(3.0), over_time=True)
    scene = Scene(title="tube", surfaces=(surface,), motions=(one, two, steps))
    read = read_by(page, scene, tmp_path)

    assert read["triangles"][0] == surface.triangles.ravel().tolist()
    assert read["labels"][0] == surface.node_ids.tolist() and read["sides"][0] == surface.sides.tolist()
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    half = np.linalg.norm(high - low) / 2
    places = np.reshape(read["points"][0], (-1, 3)) * half + (low + high) / 2
    assert np.abs(places - surface.points).max() < half / 2**17
    for motion, field in zip(scene.motions, read["shapes"], strict=True):
        for shape, numbers in zip(motion.shapes, field, strict=True):
            assert numbers == np.round(shape / np.abs(shape).max() * 2047).ravel().tolist()
    for values, numbers in zip(stress, read["stress"][0], strict=True):
        expected = np.where(np.isnan(values), -128, np.round(values / np.nanmax(values) * 127))
        assert numbers == expected.tolist()
    assert page.faults == []
    written = document_of(scene)["motions"]
    # Modes that another body has too take next to nothing, steps over time refer to none.
    assert [shape.get("like") for motion in written for shape in motion["shapes"]] == [None] * 3 + [2, 0] + [None] * 3
    assert all(len(shape["data"]) < 100 for shape in written[1]["shapes"])


def test_triangles_begin_with_their_first_point_and_keep_their_sides() -> None:
    surface = tube(40, 20)
    assert (surface.triangles[:, 0] < surface.triangles[:, 1:].min(axis=1)).all()
    corners = surface.points[surface.triangles]
    for k in range(3):
        first, second = corners[:, k], corners[:, (k + 1) % 3]
        # Diagonals of quadrilaterals lead to another height and another angle: they are no sides.
        slanted = (np.abs(first[:, 2] - second[:, 2]) > 1e-9) & (np.abs(first - second)[:, :2].max(axis=1) > 1e-9)
        assert ((surface.sides >> k & 1) == ~slanted).all()


def test_numbers_of_a_smooth_surface_are_small() -> None:
    """Of 2,400 points: two bits for each displacement, in base 64, and less for each triangle."""
    surface = tube(60, 40)
    scene = Scene(
        title="tube",
        surfaces=(surface,),
        motions=(Motion(name="modes", surface=0, shapes=waves(surface, 4), values=np.arange(4.0)),),
    )
    document = document_of(scene)
    numbers = 3 * len(surface.points)
    assert all(len(shape["data"]) < 0.25 * numbers for shape in document["motions"][0]["shapes"])
    assert len(document["surfaces"][0]["triangles"]["data"]) < 0.2 * len(surface.triangles)
