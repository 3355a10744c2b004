"""Structured meshes of hexahedra."""

import numpy as np
import pytest

from morembs.fem.grid import box_mesh, grid_cells, grid_mesh
from tests.support.meshes import box, steel
from tests.support.refusals import refusal


@pytest.mark.parametrize("element", ["hex8", "hex20", "hex27"])
def test_a_box_has_its_mass_and_inertia(element):
    size = (0.3, 0.2, 0.1)
    mesh = box_mesh(size, (3, 2, 1), element)
    other = box(element, (3, 2, 1), size)
    assert len(mesh.nodes) == len(other.nodes) and mesh.blocks[0].nodes.shape == other.blocks[0].nodes.shape
    model = steel(mesh)
    down = (model.dofs.component == 2).astype(float)
    x = mesh.nodes.xyz[model.dofs.node, 0] * down
    mass = 7850.0 * np.prod(size)
    assert down @ model.M @ down == pytest.approx(mass)
    assert x @ model.M @ x == pytest.approx(mass * size[0] ** 2 / 3)


def test_a_grid_bends_to_whatever_its_points_are():
    """A quarter of a tube: its volume comes near the exact one, and no element is inside out."""
    angle, radius, height = np.meshgrid(np.linspace(0, np.pi / 2, 9), [0.2, 0.15, 0.1], [0.0, 0.5, 1.0], indexing="ij")
    model = steel(grid_mesh(np.stack((radius * np.cos(angle), radius * np.sin(angle), height), axis=-1)))
    along = (model.dofs.component == 0).astype(float)
    assert along @ model.M @ along == pytest.approx(7850.0 * np.pi / 4 * (0.2**2 - 0.1**2), rel=1e-4)


@pytest.mark.parametrize(
    ("shape", "element", "words"),
    [
        ((3, 3, 4), "hex20", ("value", "shape", "hex20")),
        ((2, 1, 2), "hex8", ("value", "shape")),
        ((3, 3, 3), "tet4", ("value", "element", "hex8", "hex20", "hex27")),
    ],
)
def test_grids_that_elements_do_not_fill(shape, element, words):
    with refusal(*words):
        grid_cells(shape, element)
