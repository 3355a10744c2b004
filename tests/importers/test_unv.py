"""Universal files, and models of matrices in Python."""

from __future__ import annotations

import h5py
import meshio
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import morembs
from morembs import Problem, read_mesh
from morembs.importers import import_file
from morembs.importers.unv import SOLIDS, read_unv
from tests.support.meshes import box, steel
from tests.support.refusals import refusal

DESCRIPTOR = {kind: number for number, (kind, _) in SOLIDS.items()}


def universal(mesh, *, old: bool = False, exponent: str = "D") -> str:
    """A file as Salome writes it: units, nodes, a beam, solids, a group of nodes and one of elements."""
    lines = ["    -1", "   164", "         1  SI: Meters (newton)         2", "    1.0    1.0    1.0", "    -1"]
    lines += ["    -1", "    15" if old else "  2411"]
    for label, x in zip(mesh.nodes.ids.tolist(), mesh.nodes.xyz.tolist(), strict=True):
        numbers = "".join(f"{value:25.16E}" for value in x).replace("E", exponent)
        head = f"{label:10d}{0:10d}{0:10d}{0:10d}"
        lines += [head + numbers] if old else [f"{label:10d}{1:10d}{1:10d}{11:10d}", numbers]
    lines += ["    -1", "    -1", "  2412", f"{900:10d}{11:10d}{1:10d}{1:10d}{7:10d}{2:10d}"]
    lines += [f"{0:10d}{0:10d}{0:10d}", f"{1:10d}{2:10d}"]
    block = mesh.blocks[0]
    number = DESCRIPTOR[block.type]
    for label, row in zip(block.ids.tolist(), mesh.nodes.ids[block.nodes].tolist(), strict=True):
        listed = [0] * len(row)
        for place, vtk in zip(SOLIDS[number][1], range(len(row)), strict=True):
            listed[place] = row[vtk]
        lines.append(f"{label:10d}{number:10d}{2:10d}{1:10d}{7:10d}{len(row):10d}")
        lines += ["".join(f"{n:10d}" for n in listed[i : i + 8]) for i in range(0, len(row), 8)]
    lines += ["    -1", "    -1", "  2467"]
    lines += [f"{1:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{3:10d}", "LEFT END"]
    lines += ["".join(f"{7:10d}{n:10d}{0:10d}{0:10d}" for n in (1, 2)), f"{7:10d}{3:10d}{0:10d}{0:10d}"]
    lines += [f"{2:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{0:10d}{1:10d}", "FIRST", f"{8:10d}{1:10d}{0:10d}{0:10d}"]
    return "\n".join([*lines, "    -1", ""])


@pytest.mark.parametrize("kind", DESCRIPTOR)
@pytest.mark.parametrize("old", [False, True])
def test_every_solid_comes_back(kind, old, tmp_path):
    mesh = box(kind, (2, 1, 1), (0.3, 0.2, 0.1))
    path = tmp_path / "mesh.unv"
    path.write_text(universal(mesh, old=old))
    imported = read_unv(path).convert()
    assert np.array_equal(imported.mesh.blocks[0].nodes, mesh.blocks[0].nodes)
    assert np.array_equal(imported.nodes.xyz, mesh.nodes.xyz) and imported.nodes.sets["LEFT END"].tolist() == [0, 1, 2]
    assert [rows.tolist() for rows in imported.mesh.element_sets["FIRST"]] == [[0]]
    assert all(any(words in n for n in imported.notes) for words in ("SI: Meters", "1 elements that are no"))
    assert np.array_equal(read_mesh(path, "mm-t-s").nodes.xyz, 1e-3 * mesh.nodes.xyz)
    assert import_file(path).mesh is not None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[: len(t) // 2], ("file", "mesh.unv")),
        (lambda t: t.replace("  2412", "  2999"), ("missing",)),
        (lambda t: t.replace(f"{115:10d}", f"{999:10d}", 1), ("unsupported", "elements", "999")),
        (lambda t: t.replace("    -1\n  2411", "    -1\nnodes"), ("file", "mesh.unv")),
        (lambda t: t.replace(f"\n{3:10d}{1:10d}", f"\n{2:10d}{1:10d}", 1), ("conflict", "node")),
    ],
)
def test_damaged_files_are_refused(change, words, tmp_path):
    path = tmp_path / "mesh.unv"
    path.write_text(change(universal(box("hex8", (2, 1, 1), (0.3, 0.2, 0.1)))))
    with refusal(*words):
        read_unv(path).convert()


def test_matrices_of_any_kind_become_a_model():
    model = steel(box("hex8", (2, 1, 1), (0.3, 0.2, 0.1)))
    for form in (sp.csc_matrix, sp.coo_array, sp.lil_matrix, sp.dok_array, np.asarray, lambda A: A.tolist()):
        dense = form in (np.asarray,) or form.__name__ == "<lambda>"
        K, M = (form(A.toarray() if dense else A) for A in (model.K, model.M))
        rebuilt = morembs.from_matrices(K, M, 1e-5 * model.K, nodes=model.nodes.xyz)
        assert abs(rebuilt.K - model.K).max() == 0 and abs(rebuilt.M - model.M).max() == 0 and rebuilt.D is not None
        with Problem(rebuilt) as problem:
            assert problem.rigid.shape[1] == 6
    order = np.random.default_rng(1).permutation(model.size)
    mixed = morembs.from_matrices(
        model.K[order][:, order],
        model.M[order][:, order],
        nodes=model.nodes,
        node=model.dofs.node[order],
        component=model.dofs.component[order],
        units="mm-t-s",
    )
    assert abs(mixed.K).sum() == pytest.approx(1e3 * abs(model.K).sum()) and np.array_equal(mixed.dofs.node, order // 3)


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        ((np.eye(3), None), {}, ("missing", "M")),
        ((np.eye(3), np.ones((3, 2))), {}, ("value", "M")),
        ((np.eye(3), np.eye(4)), {}, ("conflict", "M")),
        ((np.eye(3) * np.nan, np.eye(3)), {}, ("file", "K")),
        ((np.eye(6), np.eye(6)), {"nodes": np.zeros((2, 2))}, ("value", "nodes")),
        ((np.eye(6), np.eye(6)), {"nodes": np.zeros((3, 3))}, ("conflict", "nodes", "9")),
        ((np.eye(6), np.eye(6)), {"node": [0] * 6}, ("conflict", "nodes")),
        ((np.eye(1), np.eye(1)), {"nodes": np.zeros((1, 3)), "node": [0], "component": [7]}, ("value", "component")),
        ((np.eye(2), np.eye(2)), {"nodes": np.eye(3)[:1], "node": [0, 1], "component": [6, 0]}, ("unknown", "node")),
        ((np.eye(1), np.eye(1)), {"nodes": np.zeros((1, 3)), "node": [0.5], "component": [1]}, ("value", "node")),
    ],
)
def test_matrices_that_make_no_model_are_refused(arguments, options, words):
    with refusal(*words):
        morembs.from_matrices(*arguments, **options)


def test_first_order_systems_are_refused_with_a_sentence(tmp_path):
    path = tmp_path / "system.mat"
    scipy.io.savemat(path, {"A": np.eye(4), "B": np.ones((4, 1)), "C": np.ones((1, 4))})
    with refusal("unsupported", "matrices"):
        import_file(path)


def test_results_of_code_aster_are_meshes(tmp_path):
    """An .rmed with stresses at nodes of elements, for the solids alone, and displacements of a part (a profile)."""
    mesh = box("hex8", (2, 1, 1), (0.3, 0.2, 0.1))
    cells = [("hexahedron", mesh.blocks[0].nodes), ("quad", mesh.blocks[0].nodes[:1, :4])]
    path = tmp_path / "result.rmed"
    meshio.write(path, meshio.Mesh(mesh.nodes.xyz, cells), file_format="med")
    bare = read_mesh(path, "mm-t-s")
    with h5py.File(path, "r+") as file:
        step = file.create_group("CHA/RESU____SIEF_ELNO/0000000000000000000100000000000000000001")
        step.attrs["PDT"] = 1.0
        solid = step.create_group("NOE.HE8")
        solid.attrs["PFL"] = np.bytes_("MED_NO_PROFILE_INTERNAL")
        values = solid.create_group("MED_NO_PROFILE_INTERNAL")
        values.attrs["NBR"], values.attrs["NGA"] = 2, 8
        values["CO"] = np.zeros(6 * 16)
    imported = read_mesh(path, "mm-t-s")
    assert np.array_equal(imported.nodes.xyz, bare.nodes.xyz) and len(imported.blocks) == 1
    assert np.array_equal(imported.blocks[0].nodes, bare.blocks[0].nodes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace("    -1\n  2411", "    -1\n   999"), ("missing", "nodes")),
        (
            lambda t: t.replace(f"{1:10d}{1:10d}{1:10d}{11:10d}", f"{1:10d}{1:10d}  x{1:7d}{11:10d}"),
            ("file", "mesh.unv", "2411"),
        ),
        (lambda t: t.replace(f"{1:10d}{1:10d}{1:10d}{11:10d}", f"{1:10d}{1:10d}{1:10d}"), ("file", "mesh.unv")),
    ],
)
def test_nodes_of_another_form_are_refused(change, words, tmp_path):
    path = tmp_path / "mesh.unv"
    path.write_text(change(universal(box("hex8", (1, 1, 1), (1.0, 1.0, 1.0)))))
    with refusal(*words):
        read_unv(path).convert()
