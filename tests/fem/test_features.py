"""Plane faces and round holes are found in skins of known shapes, and nothing else is taken for a hole."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from morembs import ElementBlock, Mesh, Nodes, read_mesh
from morembs.examples.shapes import bracket_shape
from morembs.fem.features import Skin, plane_faces, round_holes
from tests.support.meshes import box

AXIS = np.array([2.0, -1.0, 2.0]) / 3
# Columns: two directions across the axis, and the axis.
TURNED = np.column_stack([[1.0, 2.0, 0.0] / np.sqrt(5), np.cross(AXIS, [1.0, 2.0, 0.0] / np.sqrt(5)), AXIS])


def mesh_of(points: np.ndarray, cells: np.ndarray, kind: str) -> Mesh:
    nodes = Nodes(ids=np.arange(1, len(points) + 1), xyz=points)
    return Mesh(nodes=nodes, blocks=(ElementBlock(type=kind, nodes=cells, ids=np.arange(1, len(cells) + 1)),))


def ring(inner: Callable[[np.ndarray, np.ndarray], np.ndarray], *, part: float = 1.0, sectors: int = 16) -> Mesh:
    """A block of 40 x 40 x 10 about an opening of the radius ``inner(angle, z)``, or a part of its turn."""
    layers = np.array([0, 0.3, 1, 3, 5, 7, 9, 9.7, 10])
    closed = part == 1
    angle = 2 * np.pi * part * np.arange(sectors if closed else sectors + 1) / sectors
    angle, z = (grid.ravel() for grid in np.meshgrid(angle, layers, indexing="ij"))
    radius = inner(angle, z)
    # A square with corners at multiples of 45 degrees, so that all sides are plane.
    outer = 20 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    points = np.concatenate(
        [np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) for r in (radius, (radius + outer) / 2, outer)]
    )
    at = np.arange(len(angle)).reshape(-1, len(layers))
    after = np.roll(at, -1, axis=0) if closed else at[1:]
    before = at if closed else at[:-1]
    cells = []
    for low in (0, len(angle)):
        high = low + len(angle)
        for one, two in zip(before, after, strict=False):
            for k in range(len(layers) - 1):
                face = [(one[j] + low, one[j] + high, two[j] + high, two[j] + low) for j in (k, k + 1)]
                cells.append([*face[0], *face[1]])
    return mesh_of(points, np.array(cells), "hex8")


def test_a_box_has_six_plane_faces_and_no_hole() -> None:
    skin = Skin.of(box("tet4", (4, 3, 2), (4.0, 3.0, 2.0)))
    faces = plane_faces(skin)
    assert [face.area for face in faces] == pytest.approx([12, 12, 8, 8, 6, 6])
    assert {tuple(face.normal.round(12) + 0.0) for face in faces} == {
        tuple(sign * axis + 0.0) for axis in np.eye(3) for sign in (1, -1)
    }
    for face in faces:
        height = skin.xyz @ face.normal
        np.testing.assert_array_equal(face.nodes, np.flatnonzero(height > height.max() - 1e-9))
    assert not round_holes(skin)


@pytest.mark.parametrize("kind", ["hex20", "hex8"])
def test_holes_of_the_bracket_wherever_it_lies(kind: str) -> None:
    shape = bracket_shape()
    cells = shape.cells if kind == "hex20" else shape.cells[:, :8]
    used, renumbered = np.unique(cells, return_inverse=True)
    points = 1e-3 * (shape.points[used] @ TURNED.T + [300.0, -200.0, 50.0])
    mesh = mesh_of(points, renumbered.reshape(cells.shape), kind)
    holes = round_holes(Skin.of(mesh))
    # The shape has its places to the nanometre.
    assert [hole.radius for hole in holes] == pytest.approx([8e-3, 5.5e-3, 5.5e-3], abs=1e-9)
    for hole, axis in zip(holes, (TURNED[:, 0], TURNED[:, 2], TURNED[:, 2]), strict=True):
        assert abs(hole.axis @ axis) == pytest.approx(1, abs=1e-9) and hole.length == pytest.approx(8e-3)
        middle = ((hole.start + hole.length / 2 * hole.axis) / 1e-3 - [300.0, -200.0, 50.0]) @ TURNED
        expected = [(-4, 40, 28)] if hole is holes[0] else [(20, 20, 4), (20, 60, 4)]
        assert min(np.linalg.norm(middle - place) for place in expected) < 1e-6
    pin = np.isin(used, shape.node_sets["PIN"])
    np.testing.assert_array_equal(holes[0].nodes, np.flatnonzero(pin))


def test_holes_of_a_rod_of_tetrahedra(small_meshes: Path, tmp_path: Path) -> None:
    """As Gmsh meshes it: triangles of no order, of which some edges in the bores are convex."""
    (tmp_path / "rod.msh").write_bytes(gzip.decompress((small_meshes / "connecting_rod.msh.gz").read_bytes()))
    mesh = read_mesh(tmp_path / "rod.msh")
    holes = round_holes(Skin.of(mesh))
    assert [hole.radius for hole in holes] == pytest.approx([25, 11, 4.5, 4.5], rel=1e-7)
    for hole, name in zip(holes, ("BIGEND", "SMALLEND"), strict=False):
        np.testing.assert_array_equal(hole.nodes, mesh.nodes.sets[name])


@pytest.mark.parametrize("sectors", [8, 16, 64])
def test_a_round_opening_is_a_hole(sectors: int) -> None:
    (hole,) = round_holes(Skin.of(ring(lambda angle, z: 8 + 0 * z, sectors=sectors)))
    assert hole.radius == pytest.approx(8) and hole.length == pytest.approx(10)
    np.testing.assert_allclose([hole.start, hole.axis], [[0, 0, 0], [0, 0, 1]], atol=1e-9)


def test_a_fine_wall_is_no_plane_face() -> None:
    """Neighbours of half a degree are alike, all of them together are not plane."""
    skin = Skin.of(ring(lambda angle, z: 8 + 0 * z, sectors=720))
    (hole,) = round_holes(skin)
    assert hole.radius == pytest.approx(8)
    assert [face.area for face in plane_faces(skin)] == pytest.approx([1600 - np.pi * 8**2] * 2 + [400] * 4, rel=1e-4)


def test_a_rounded_rim_is_left_out() -> None:
    def inner(angle: np.ndarray, z: np.ndarray) -> np.ndarray:
        depth = np.minimum(z, 10 - z)
        return 8 + 0.2 * (depth < 0.2) + 0.03 * (depth < 1)

    (hole,) = round_holes(Skin.of(ring(inner)))
    assert hole.radius == pytest.approx(8) and hole.length == pytest.approx(8)


@pytest.mark.parametrize(
    "inner",
    [
        pytest.param(lambda angle, z: 8 / np.sqrt(np.cos(angle) ** 2 + 1.1 * np.sin(angle) ** 2), id="ellipse"),
        pytest.param(lambda angle, z: 8 + 0.05 * z, id="cone"),
        pytest.param(lambda angle, z: 8 + 0.02 * (z - 5) ** 2, id="barrel"),
        pytest.param(lambda angle, z: 8 / np.maximum(abs(np.cos(angle)), abs(np.sin(angle))), id="square"),
    ],
)
def test_other_openings_are_no_round_holes(inner: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    assert not round_holes(Skin.of(ring(inner, sectors=32)))


def test_fillets_and_shafts_are_no_holes() -> None:
    assert not round_holes(Skin.of(ring(lambda angle, z: 8 + 0 * z, part=0.5)))
    mesh = ring(lambda angle, z: 8 + 0 * z)
    # Outwards and inwards change: a shaft of radius 8 in place of a hole.
    x, y, z = mesh.nodes.xyz.T
    away = np.hypot(x, y)
    turned = np.column_stack([x, y, z]) * np.column_stack([8 / away**2 * 8, 8 / away**2 * 8, np.ones(len(x))])
    shaft = mesh_of(turned, mesh.blocks[0].nodes[:, [4, 5, 6, 7, 0, 1, 2, 3]], "hex8")
    assert not round_holes(Skin.of(shaft))
