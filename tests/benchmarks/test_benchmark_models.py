"""The large test models of benchmarks/models.py: sound meshes of the promised shapes and sizes, and jobs that hold."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from morembs.app.jobs.check import check_job
from morembs.app.jobs.job import load_job
from morembs.fem.elements import TYPES

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import models

FACES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
TET10 = TYPES["tet10"]


def volume(points: np.ndarray, cells: np.ndarray) -> float:
    """Volume of straight-sided tetrahedra in m3, by their corners."""
    corners = points[cells[:, :4]]
    return float(np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6)


def crankshaft_volume(crank: models.Crank) -> float:
    """Volume in m3 of journals, pins, webs and flange, from circles and straight lines."""

    def beside(radius: float, start: float, end: float) -> float:
        """Area between an arc about a point of the axis and the axis; angles from the axis."""
        return radius**2 / 2 * (end - start - (math.sin(2 * end) - math.sin(2 * start)) / 2)

    slope = math.pi / 2 - math.radians(crank.flank_degrees)
    x, y = crank.web_radius * math.sin(slope), crank.eccentricity + crank.web_radius * math.cos(slope)
    # Where the flank meets the counterweight: its distance from the journal is shared by both.
    offset = crank.web_radius + crank.eccentricity * math.cos(slope)
    reach = -x * math.cos(slope) + y * math.sin(slope) + math.sqrt(crank.counterweight_radius**2 - offset**2)
    low_x, low_y = x + reach * math.cos(slope), y - reach * math.sin(slope)
    weight = math.atan2(low_x, -low_y)
    half = beside(crank.web_radius, 0, slope) + beside(crank.counterweight_radius, 0, weight)
    web = 2 * (half + (x + low_x) / 2 * (y - low_y))
    throws = len(crank.throws)
    shaft = crank.nose_length + (throws - 1) * crank.journal_length + crank.rear_length
    round_parts = (
        (crank.journal_radius, shaft),
        (crank.pin_radius, throws * crank.pin_length),
        (crank.flange_radius, crank.flange_length),
    )
    return 2 * throws * crank.web_length * web + sum(math.pi * r**2 * length for r, length in round_parts)


@pytest.mark.parametrize("shape", models.SHAPES)
def test_elements_are_sound_and_fit(shape: str) -> None:
    points, cells = models.make(shape, 20_000)
    assert abs(3 * len(points) / 20_000 - 1) < 0.03
    assert np.array_equal(np.unique(cells), np.arange(len(points)))
    # Jacobians at the corners and at the points of the quadrature.
    for _, dN in (TET10.shape(TET10.reference[:4]), TET10.shape(TET10.rule(2).points)):
        jacobian = np.linalg.det(np.einsum("eka,qkr->eqar", points[cells], dN))
        assert jacobian.min() > 1e-3 * jacobian.mean()
    links = np.repeat(cells[:, 0], 9), cells[:, 1:].ravel()
    graph = sp.coo_array((np.ones(9 * len(cells)), links), shape=(len(points),) * 2)
    assert connected_components(graph, directed=False)[0] == 1

    faces = np.sort(cells[:, FACES].reshape(-1, 3), axis=1)
    faces, uses = np.unique(faces, axis=0, return_counts=True)
    assert uses.max() == 2
    # The faces used once are the skin of a body without holes. A crack or a pair of crossed diagonals inside
    # would add faces to it, and change its Euler characteristic.
    skin = faces[uses == 1]
    edges, meeting = np.unique(skin[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=0, return_counts=True)
    assert (meeting == 2).all()
    assert len(np.unique(skin)) - len(edges) + len(skin) == 2
    # Mid-side nodes are shared wherever corners are: as many as there are edges.
    pairs = np.sort(cells[:, [[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]].reshape(-1, 2), axis=1)
    both = np.unique(np.column_stack([pairs, cells[:, 4:].reshape(-1)]), axis=0)
    assert len(both) == len(np.unique(pairs, axis=0)) == len(points) - len(np.unique(cells[:, :4]))


@pytest.mark.parametrize(("shape", "sides"), [("cube", (0.1, 0.1, 0.1)), ("beam", (1.0, 0.05, 0.05))])
def test_box_volume(shape: str, sides: tuple[float, ...]) -> None:
    points, cells = models.make(shape, 20_000)
    assert volume(points, cells) == pytest.approx(math.prod(sides), rel=1e-12)
    assert points.min(axis=0) == pytest.approx([0, 0, 0]) and points.max(axis=0) == pytest.approx(sides)


def test_crankshaft_volume() -> None:
    exact = crankshaft_volume(models.CRANK)
    # Two, then four and eight cells on a quarter of a circle; the chords cut off less with their square.
    coarse, medium, fine = (1 - volume(*models.make("crankshaft", dofs)) / exact for dofs in (20_000, 200_000, 900_000))
    assert 0 < coarse < 0.08
    assert medium == pytest.approx(coarse / 4, rel=0.25) and fine == pytest.approx(medium / 4, rel=0.25)


def test_crankshaft_bearings() -> None:
    crank = models.CRANK
    points, _ = models.make("crankshaft", 20_000)
    along, away = points[:, 0], np.linalg.norm(points[:, 1:], axis=1)
    assert (along.min(), along.max()) == pytest.approx((0.0, crank.length))
    for x, radius in ((0.0, crank.journal_radius), (crank.length, crank.flange_radius)):
        assert away[np.abs(along - x) < 1e-9].max() == pytest.approx(radius)
    assert away[np.abs(along - crank.middle) < 0.49 * crank.journal_length].max() == pytest.approx(crank.journal_radius)


@pytest.mark.parametrize("shape", models.SHAPES)
def test_job(shape: str, tmp_path: Path) -> None:
    forecast = check_job(load_job(models.job(shape, 20_000, tmp_path)))
    assert forecast.rigid_modes == 6
    assert len(forecast.interface_nodes) == 3 and min(forecast.interface_nodes.values()) >= 6
    path = models.job(shape, 20_000, tmp_path, memory="4 GiB", scratch=tmp_path / 'a "b', modes=7)
    tables = load_job(path).tables
    assert (tables.solver.memory, tables.solver.scratch) == ("4 GiB", str(tmp_path / 'a "b'))
    assert tables.reduce[0].options()["modes"] == 7


def test_sizes_that_do_not_exist() -> None:
    with pytest.raises(ValueError, match="nearest has 19"):
        models.make("crankshaft", 4000)
    with pytest.raises(ValueError, match="sphere"):
        models.make("sphere", 4000)
