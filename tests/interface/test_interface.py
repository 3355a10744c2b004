"""Couplings: exact resultants, area-consistent weights, selections."""

import numpy as np
import pytest

from morembs.base.errors import InputError
from morembs.fem import Mesh, Nodes, rigid_motion, skew
from morembs.fem.interface import average_matrix, couple, make_interface
from morembs.fem.selection import select_nodes
from morembs.importers import read_mesh
from tests.support.meshes import box, steel, where
from tests.support.refusals import refusal

CURVED = {"tet10": (3, 3, 2), "hex20": (3, 3, 1), "hex27": (2, 3, 1), "wedge15": (2, 2, 1), "tet4": (3, 3, 2)}


def bore(x):
    """A plate rolled up to half a tube of inner radius 0.05 along z."""
    angle, r = np.pi * (1 - x[..., 0]), 0.05 + x[..., 1]
    return np.stack([r * np.cos(angle), r * np.sin(angle), x[..., 2]], axis=-1)


def tube(kind):
    n = CURVED[kind]
    mesh = box(kind, (6 * n[0], 1, n[2]), (1.0, 0.02, 0.04), warp=bore)
    model = steel(mesh)
    radius = np.hypot(model.nodes.xyz[:, 0], model.nodes.xyz[:, 1])
    return model, np.flatnonzero(radius < 0.0505)


@pytest.mark.parametrize("kind", CURVED)
def test_average_coupling_reproduces_rigid_motion_and_resultants(kind):
    """T R = [[I, -c~], [0, I]]: frame motion under rigid motion, and by transposition force and moment."""
    model, nodes = tube(kind)
    point = np.array([0.01, -0.02, 0.3])
    interface = make_interface(model, name="bore", nodes=nodes, coupling="average", point=point)
    coupling = couple(model, [interface])
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    expected = np.block([[np.eye(3), -skew(point)], [np.zeros((3, 3)), np.eye(3)]])
    assert np.abs(coupling.B.T @ R - expected).max() < 1e-12


@pytest.mark.parametrize("kind", CURVED)
def test_weights_are_the_area_and_average_consistently(kind):
    """Sum of weights is the area; a linear field on the flat face averages as its integral does."""
    model, nodes = tube(kind)
    bore_area = make_interface(model, name="bore", nodes=nodes, coupling="average").weights.sum()
    assert bore_area == pytest.approx(np.pi * 0.05 * 0.04, rel=2e-3 if kind != "tet4" else 2e-2)
    flat = steel(box(kind, (3, 2, 2), (0.4, 0.3, 0.2)))
    face = make_interface(flat, name="face", nodes=where(flat, 2, 0.2), coupling="average")
    assert face.weights.sum() == pytest.approx(0.12, rel=1e-12)
    assert face.point == pytest.approx([0.2, 0.15, 0.2], rel=1e-12)
    x = flat.nodes.xyz[face.nodes]
    quadratic = kind not in ("tet4",)
    moment = face.weights @ (x[:, 0] - 0.2) ** 2
    if quadratic:
        assert moment == pytest.approx(0.3 * 0.4**3 / 12, rel=1e-10)
    T = average_matrix(face, x)
    twist = np.stack([-(x[:, 1] - 0.15), x[:, 0] - 0.2, np.zeros(len(x))], axis=1)
    assert T @ twist.ravel() == pytest.approx([0, 0, 0, 0, 0, 1], abs=1e-12)


def test_unstructured_patch_does_not_pull_towards_its_fine_side():
    """Equal weights would: the reason for areas."""
    mesh = box("hex8", (12, 1, 1), (1.0, 0.1, 0.1), warp=lambda x: np.stack([x[..., 0] ** 2, x[..., 1], x[..., 2]], -1))
    model = steel(mesh)
    top = make_interface(model, name="top", nodes=where(model, 2, 0.1), coupling="average")
    assert top.point[0] == pytest.approx(0.5, abs=1e-12)
    assert model.nodes.xyz[top.nodes][:, 0].mean() < 0.36


def test_rigid_coupling_moves_its_nodes_with_the_frame():
    model = steel(box("hex20", (3, 1, 1), (0.3, 0.1, 0.1)))
    point = (0.0, 0.05, 0.2)
    root = make_interface(model, name="root", nodes=where(model, 0, 0.0), coupling="rigid", point=point)
    coupling = couple(model, [root])
    motion = np.array([1.0, -2.0, 0.5, 0.3, -0.1, 0.7])
    u = np.zeros(coupling.T.shape[1])
    u[-6:] = motion
    moved = (coupling.T @ u).reshape(-1, 3)[root.nodes]
    arms = model.nodes.xyz[root.nodes] - point
    assert moved == pytest.approx(motion[:3] + np.cross(motion[3:], arms), abs=1e-14)
    about_pole = rigid_motion(model.nodes.xyz[model.dofs.node] - coupling.pole, model.dofs.component)
    assert np.abs(coupling.T @ coupling.R - about_pole).max() < 1e-14


def test_selections_agree_with_geometry():
    mesh = box("hex8", (4, 4, 4), (1.0, 1.0, 1.0))
    picked = np.flatnonzero(mesh.nodes.xyz[mesh.blocks[0].nodes].mean(axis=1)[:, 0] < 0.5)
    nodes = Nodes(ids=mesh.nodes.ids + 100, xyz=mesh.nodes.xyz, sets={"corner": np.array([0, 1])})
    model = steel(Mesh(nodes=nodes, blocks=mesh.blocks, element_sets={"half": (picked,)}))
    xyz = model.nodes.xyz
    assert np.array_equal(select_nodes(model, "set:corner"), [0, 1])
    assert np.array_equal(select_nodes(model, "ids:101,103"), [0, 2])
    assert np.array_equal(select_nodes(model, "set:half"), np.flatnonzero(xyz[:, 0] < 0.51))
    assert np.array_equal(
        select_nodes(model, "box:250,0,0,500,1000,1000", length=1e-3),
        np.flatnonzero((xyz[:, 0] > 0.24) & (xyz[:, 0] < 0.51)),
    )
    assert np.array_equal(select_nodes(model, "sphere:0,0,0,0.5"), np.flatnonzero(np.linalg.norm(xyz, axis=1) < 0.501))
    inside = (np.hypot(xyz[:, 0] - 0.5, xyz[:, 1] - 0.5) < 0.26) & (xyz[:, 2] < 0.51)
    assert np.array_equal(select_nodes(model, "cylinder:0.5,0.5,0,0,0,0.5,0.25"), np.flatnonzero(inside))
    half = xyz[select_nodes(model, "skin:half")]
    outside = (half[:, 0] == 0) | (half[:, 0] == 0.5) | (np.abs(half[:, 1:] - 0.5) == 0.5).any(axis=1)
    assert outside.all() and len(half) == 3 * 25 - 1 * 9
    for text in ("set:nothing", "ids:7", "box:1,2", "sphere:9,9,9,0.1", "cone:1", "ids:a"):
        with pytest.raises(InputError):
            select_nodes(model, text)


def test_element_set_skin_of_a_read_mesh(small_meshes):
    mesh = read_mesh(small_meshes / "conrod.msh")
    model = steel(mesh)
    bore_nodes = select_nodes(model, "set:SMALLEND")
    skin = select_nodes(model, "skin:BODY")
    assert np.isin(bore_nodes, skin).all() and len(bore_nodes) < len(skin) < len(model.nodes)


def test_interfaces_that_cannot_work_are_refused():
    model = steel(box("hex8", (2, 2, 2), (1.0, 1.0, 1.0)))
    line = np.flatnonzero((model.nodes.xyz[:, 0] == 0) & (model.nodes.xyz[:, 1] == 0))
    for coupling in ("average", "rigid"):
        with refusal("model", "nodes"):
            make_interface(model, name="line", nodes=line, coupling=coupling)
    a = make_interface(model, name="a", nodes=where(model, 0, 0.0))
    b = make_interface(model, name="b", nodes=where(model, 1, 0.0))
    with refusal("conflict", "nodes"):
        couple(model, [a, b])
    with refusal("conflict", "name"):
        couple(model, [a, a])
    with refusal("unknown", "coupling"):
        make_interface(model, name="c", nodes=line, coupling="ridgid")
    for given, meant in (("RBE2", "rigid"), ("rbe3", "average"), ("Rigid", "rigid")):
        with refusal("unknown", "coupling", meant):
            make_interface(model, name="c", nodes=line, coupling=given)
    with refusal("value", "nodes", "select_nodes", "set:FACE"):
        make_interface(model, name="c", nodes="set:FACE")
    with refusal("value", "nodes", "27", "select_nodes", "ids:27"):
        make_interface(model, name="c", nodes=model.nodes.ids)
    with refusal("value", "nodes"):
        make_interface(model, name="c", nodes=model.nodes.xyz[:, 0] == 0)
