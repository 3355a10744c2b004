"""Degrees of freedom without place and direction: coordinates of modes inside a model."""

import numpy as np
import pytest
import scipy.linalg as sl
import scipy.sparse as sp

from morembs import CraigBampton, Problem
from morembs.base.units import parse_units
from morembs.body.diagnostics.warnings import diagnosis_of
from morembs.fem import DofMap, Nodes, rigid_motion
from morembs.importers.imported import Imported
from morembs.importers.model_file import read_model, write_model
from morembs.importers.to_model import model_of
from tests.support.meshes import box, ends, steel, where
from tests.support.refusals import refusal


def superelement(modes=20):
    """A bar as its end nodes and fixed-interface modes (Craig and Bampton 1968), which share the first end node."""
    bar = steel(box("hex8", (6, 2, 1), (1.0, 0.2, 0.1)))
    K, M = bar.K.toarray(), bar.M.toarray()
    rows = np.sort(np.concatenate([where(bar, 0, 0.0), where(bar, 0, 1.0)]))
    b = bar.dofs.of_nodes(rows).ravel()
    i = np.setdiff1d(np.arange(bar.size), b)
    _, Phi = sl.eigh(K[np.ix_(i, i)], M[np.ix_(i, i)], subset_by_index=(0, modes - 1))
    T = np.zeros((bar.size, len(b) + modes))
    T[b, np.arange(len(b))] = 1.0
    T[i, : len(b)] = -np.linalg.solve(K[np.ix_(i, i)], K[np.ix_(i, b)])
    T[i, len(b) :] = Phi
    node = np.append(np.repeat(np.arange(len(rows)), 3), np.zeros(modes, dtype=int))
    component = np.append(np.tile(np.arange(3), len(rows)), np.full(modes, 6))
    return bar, Imported(
        source="superelement",
        K=sp.csr_array(T.T @ K @ T),
        M=sp.csr_array(T.T @ M @ T),
        nodes=Nodes(ids=bar.nodes.ids[rows], xyz=bar.nodes.xyz[rows]),
        dofs=DofMap(node=node, component=component),
    )


def test_a_superelement_is_reduced_further_and_keeps_mass_and_frequencies(tmp_path):
    bar, imported = superelement()
    write_model(tmp_path / "a.model.h5", model_of(imported))
    model = read_model(tmp_path / "a.model.h5")
    assert not [finding for finding in diagnosis_of(model).findings if finding.severity != "note"]
    R = rigid_motion(model.nodes.xyz[model.dofs.node], model.dofs.component)
    whole = rigid_motion(bar.nodes.xyz[bar.dofs.node], bar.dofs.component)
    assert np.abs(model.K @ R).max() < 1e-9 * np.abs(model.K.data).max()
    assert np.allclose(R.T @ (model.M @ R), whole.T @ (bar.M @ whole), rtol=1e-12, atol=1e-12)
    with Problem(model, ends(model, left=0.0, right=1.0)) as problem:
        reduced = CraigBampton(modes=44).reduce(problem)
    own = sl.eigh(imported.K.toarray(), imported.M.toarray(), eigvals_only=True)[6:9]
    full = sl.eigh(bar.K.toarray(), bar.M.toarray(), eigvals_only=True)[6:9]
    assert own == pytest.approx(full, rel=1e-3)
    assert sl.eigh(reduced.K, reduced.M, eigvals_only=True)[6:9] == pytest.approx(own, rel=1e-9)


def test_scalars_take_the_units_of_displacements_and_only_they_may_share_a_node():
    _, imported = superelement(2)
    model = model_of(imported, parse_units("mm-t-s"))
    assert np.allclose(model.K.data, imported.K.data * 1e3, rtol=1e-15)
    dofs = imported.dofs
    wrong = Imported(
        source="a",
        K=imported.K,
        M=imported.M,
        nodes=imported.nodes,
        dofs=DofMap(node=dofs.node, component=np.where(dofs.component == 6, 5, dofs.component)),
    )
    with refusal("conflict", "component", "5"):
        model_of(wrong)
