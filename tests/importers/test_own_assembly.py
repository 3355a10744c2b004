"""Stiffness and mass of decks, assembled here, against the matrices that Abaqus and ANSYS wrote of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

from morembs.fem import ElementBlock, FEModel, Mesh
from morembs.fem.assembly import assemble
from morembs.fem.material import isotropic
from morembs.importers import import_file
from morembs.importers.matrices.abaqus import read_abaqus_matrix
from morembs.importers.matrices.ansys_text import import_ansys_matrices
from morembs.importers.to_model import model_of


def apart(A: sp.csr_array, B: sp.csr_array) -> float:
    return float(np.abs(A - B).max() / np.abs(B).max())


def deck(path: Path) -> FEModel:
    return model_of(import_file(path, options={"dialect": "abaqus"}))


@pytest.mark.parametrize("kind", ["C3D4", "C3D8", "C3D10"])
def test_blocks_of_abaqus(shared_data: Path, kind: str) -> None:
    """The dialect is told by the deck; no warning is left."""
    model = model_of(import_file(shared_data / "abaqus_block" / f"block{kind}.inp"))
    for name, own in (("STIF", model.K), ("MASS", model.M)):
        path = shared_data / "abaqus_block" / f"block{kind}_{name}1.mtx"
        assert apart(own, read_abaqus_matrix(path).matrix) <= 1e-11
    assert model.warnings == ()


def test_distorted_elements_of_abaqus(shared_data: Path) -> None:
    """Jacobians differ by a factor of 2.2 within one element: B-bar takes the mean of the volume strain, not its value
    in the centre, and the mass is the sum of rows, not an eighth. The stiffness of the file is 100 times too large."""
    model = deck(shared_data / "ansys_rotor" / "rotorDiscTest.inp")
    K, M = (read_abaqus_matrix(shared_data / "ansys_rotor" / f"rotorDiscTest{kind}1.mtx") for kind in ("STIF", "MASS"))
    scale = 0.01 if apart(model.K, K.matrix) > 0.5 else 1.0
    assert apart(model.K, scale * K.matrix) <= 1e-11 and apart(model.M, M.matrix) <= 1e-11


def test_distorted_solid185(shared_data: Path) -> None:
    """The rotor of ANSYS, whose mass was lumped."""
    folder = shared_data / "ansys_rotor"
    theirs = import_ansys_matrices(
        folder / "rotorAnsysStiffnessMatrixSparse.txt",
        mass=folder / "rotorAnsysMassMatrixSparse.txt",
        mapping=folder / "rotorAnsysMatrixDofMappingVector.txt",
        nodes=folder / "rotorAnsysNodalCoordinates.txt",
    )
    words = [line.split() for line in (folder / "rotorAnsysElements.txt").read_text().splitlines()[1:] if line.strip()]
    nodes = np.searchsorted(theirs.nodes.ids, np.array([row[2:10] for row in words], dtype=int))
    block = ElementBlock(type="hex8", nodes=nodes, ids=np.arange(len(nodes)), formulation="b-bar", mass="row-sum")
    material = isotropic(set="all", young=2.1e9, poisson=0.3, density=7850.0)
    model = assemble(Mesh(nodes=theirs.nodes, blocks=(block,)), [material])
    order = 3 * theirs.dofs.node + theirs.dofs.component
    assert apart(model.K[order][:, order], theirs.K) <= 1e-10 and apart(model.M[order][:, order], theirs.M) <= 1e-10


def test_solid186(shared_data: Path) -> None:
    """A beam of 40 elements, held at one end."""
    folder = shared_data / "mapdl_reader"
    theirs = import_file(folder / "file.full", options={"nodes": str(folder / "HexBeam.cdb"), "drop_constrained": True})
    material = isotropic(set="all", young=16.9e6, poisson=0.31, density=4.1408e-4)
    ours = import_file(folder / "HexBeam.cdb")
    assert ours.mesh.warnings == ()
    model = model_of(replace(ours, materials=(material,)))
    rows = np.searchsorted(model.nodes.ids, theirs.nodes.ids[theirs.dofs.node])
    order = 3 * rows + theirs.dofs.component
    assert apart(model.K[order][:, order], theirs.K) <= 1e-10 and apart(model.M[order][:, order], theirs.M) <= 1e-10
