"""Middle nodes in another order than the format wants: put in order where it is known, refused where it is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from morembs import assemble, isotropic, read_mesh
from morembs.fem import ElementBlock, Mesh
from morembs.fem.assembly import check_mesh
from morembs.importers import import_file
from morembs.importers.to_model import model_of
from tests.support.mesh_decks import abaqus_mesh, ansys_archive, nastran_mesh
from tests.support.meshes import STEEL, box
from tests.support.refusals import refusal

# Order of the middle nodes (places in VTK order) as the programs document it; hex27 with its faces and centre.
KNOWN = {
    ("tet10", "gmsh"): [0, 1, 2, 3, 5, 4],
    ("tet10", "Netgen"): [0, 2, 3, 1, 4, 5],
    ("tet10", "FEniCS"): [5, 4, 1, 3, 2, 0],
    ("hex20", "Nastran or Exodus"): [0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7],
    ("hex20", "gmsh"): [0, 3, 8, 1, 9, 2, 10, 11, 4, 7, 5, 6],
    ("hex27", "gmsh"): [0, 3, 8, 1, 9, 2, 10, 11, 4, 7, 5, 6, 16, 14, 12, 13, 15, 17, 18],
    ("hex27", "Exodus"): [0, 1, 2, 3, 8, 9, 10, 11, 4, 5, 6, 7, 18, 16, 17, 12, 13, 14, 15],
    ("wedge15", "Nastran or Exodus"): [0, 1, 2, 6, 7, 8, 3, 4, 5],
    ("wedge15", "gmsh"): [0, 2, 6, 1, 7, 8, 3, 5, 4],
}
CORNERS = {"tet10": 4, "hex20": 8, "hex27": 8, "wedge15": 6}
# Of each kind an order that no program has: that of tet10 lost 30 % of the mass, that of hex20 raised frequencies 48 %.
UNKNOWN = {
    "tet10": [0, 1, 2, 4, 5, 3],
    "hex20": [*range(8), 9, 10, 11, 8],
    "wedge15": [*range(6), 7, 8, 6],
    "hex27": [*range(8), 9, 10, 11, 8, *range(12, 19)],
}


def bent(x: np.ndarray) -> np.ndarray:
    """A thick arc of 70 degrees, so that middle nodes leave their chords."""
    angle, radius = 1.2 * x[..., 0] / 0.3, 0.15 + x[..., 1]
    return np.stack([radius * np.sin(angle), radius * np.cos(angle), x[..., 2]], axis=-1)


def mixed(mesh: Mesh, order: list[int], rows: slice = slice(None)) -> Mesh:
    """The mesh with the middle nodes of the elements ``rows`` listed in the ``order`` of another program."""
    (block,) = mesh.blocks
    at, nodes = CORNERS[block.type], block.nodes.copy()
    nodes[rows, at:] = block.nodes[rows, at:][:, order]
    return replace(mesh, blocks=(ElementBlock(type=block.type, nodes=nodes, ids=block.ids),))


def steel() -> list[object]:
    return [isotropic(set="all", **STEEL)]


@pytest.mark.parametrize(("kind", "program"), KNOWN)
def test_orders_of_other_programs_are_put_right_and_named(kind: str, program: str) -> None:
    for warp in (None, bent):
        mesh = box(kind, (2, 2, 1), (0.3, 0.1, 0.08), warp)
        right = assemble(mesh, steel())
        model = assemble(mixed(mesh, KNOWN[kind, program]), steel())
        assert abs(model.K - right.K).max() == 0 and abs(model.M - right.M).max() == 0
        assert not right.warnings and len(model.warnings) == 1
        assert f"in the order of {program}" in model.warnings[0] and kind in model.warnings[0]
        check_mesh(mixed(mesh, KNOWN[kind, program]), steel())


@pytest.mark.parametrize("kind", UNKNOWN)
def test_orders_that_no_program_has_are_refused(kind: str) -> None:
    mesh = mixed(box(kind, (2, 2, 1), (0.3, 0.1, 0.08)), UNKNOWN[kind])
    for take in (assemble, check_mesh):
        with refusal("model", "", kind):
            take(mesh, steel())


@pytest.mark.parametrize("kind", UNKNOWN)
def test_one_element_in_another_order_is_refused_by_its_label(kind: str) -> None:
    mesh = mixed(box(kind, (3, 2, 2), (0.3, 0.1, 0.08), bent), UNKNOWN[kind], slice(4, 5))
    with refusal("model", "", "5"):
        assemble(mesh, steel())


@pytest.mark.parametrize("kind", ["hex20", "hex27", "wedge15"])
def test_a_thin_plate_with_its_faces_exchanged_is_seen(kind: str) -> None:
    """Middle nodes of the lower and upper edges of elements 30 times as wide as high."""
    count = {"hex20": 4, "hex27": 4, "wedge15": 3}[kind]
    rest = list(range(2 * count, {"hex20": 12, "hex27": 19, "wedge15": 9}[kind]))
    order = [*range(count, 2 * count), *range(count), *rest]
    mesh = mixed(box(kind, (2, 2, 1), (0.3, 0.3, 0.005)), order)
    with refusal("model", "", kind):
        assemble(mesh, steel())


def test_curved_edges_and_quarter_points_are_what_they_are() -> None:
    """An arc of 35 degrees per element that is thinner than its sagitta; middle nodes at a quarter of an edge."""
    thin = box("hex20", (2, 1, 1), (0.3, 0.004, 0.08), bent)
    assert not assemble(thin, steel()).warnings
    for kind, corners in CORNERS.items():
        mesh = box(kind, (1, 1, 1), (0.3, 0.1, 0.08))
        (block,) = mesh.blocks
        xyz = mesh.nodes.xyz.copy()
        tip = int(np.flatnonzero((xyz == 0).all(axis=1))[0])
        for row in np.unique(block.nodes[:, corners:]):
            ends = 2 * xyz[row] - xyz[tip]
            if kind != "hex27" and (np.abs(mesh.nodes.xyz - ends).max(axis=1) < 1e-12).any():
                xyz[row] = xyz[tip] + (ends - xyz[tip]) / 4
        moved = replace(mesh, nodes=replace(mesh.nodes, xyz=xyz))
        assert not assemble(moved, steel()).warnings


def test_decks_of_every_program_and_meshes_by_hand(tmp_path: Path) -> None:
    """Written in an order that the format does not have, each reader puts tet10 right or refuses it."""
    mesh = box("tet10", (2, 1, 1), (0.3, 0.1, 0.08))
    right = assemble(mesh, steel())
    forms = {
        ".inp": lambda m: abaqus_mesh(m),
        ".bdf": lambda m: nastran_mesh(m, "free"),
        ".cdb": lambda m: ansys_archive(m),
    }
    for ending, text in forms.items():
        path = tmp_path / f"part{ending}"
        path.write_text(text(mixed(mesh, KNOWN["tet10", "gmsh"])))
        model = model_of(replace(import_file(path), materials=tuple(steel()), incomplete={}))
        assert any("in the order of gmsh" in warning for warning in model.warnings), ending
        assert model.M.sum() == pytest.approx(right.M.sum(), rel=1e-9)
        if ending != ".cdb":
            assert any("in the order of gmsh" in warning for warning in read_mesh(path).warnings)
        path.write_text(text(mixed(mesh, UNKNOWN["tet10"])))
        with refusal("model", "", f"part{ending}", "tet10"):
            model_of(replace(import_file(path), materials=tuple(steel()), incomplete={}))


def test_surfaces_of_a_deck_in_another_order(tmp_path: Path) -> None:
    """A face of elements takes its middle nodes from the element as it is put in order."""
    mesh = box("hex20", (1, 1, 1), (0.3, 0.1, 0.08))
    surface = "*SURFACE, NAME=SIDE\n1, S3\n"
    surfaces = []
    for name, ordered in (("right", mesh), ("other", mixed(mesh, KNOWN["hex20", "Nastran or Exodus"]))):
        path = tmp_path / f"{name}.inp"
        path.write_text(abaqus_mesh(ordered) + surface)
        surfaces.append(import_file(path).surfaces["SIDE"])
    assert np.array_equal(surfaces[0], surfaces[1]) and len(surfaces[0]) == 8
