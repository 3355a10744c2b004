"""Files of a model, as a user has them: meshes and decks, or matrices with or without nodes."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import scipy.io
import scipy.sparse as sp

from morembs import from_matrices
from morembs.importers.model_file import write_model
from tests.fuzz.models import Model

MESHES = ("part.msh", "part.vtk", "part.vtu", "part.inp", "part.xdmf")
MATRICES = ("mtx", "npz", "mat")
_NAMES = {"hex8": "hexahedron", "tet4": "tetra", "wedge6": "wedge", "tet10": "tetra10"}
_DECK = {"hex8": "C3D8", "tet4": "C3D4", "wedge6": "C3D6", "tet10": "C3D10"}
# Lengths, and so moduli and densities, of the two systems of units, per SI unit.
UNITS = {"m-kg-s": (1.0, 1.0, 1.0), "mm-t-s": (1e3, 1e-6, 1e-12)}
MODEL = "part.model.h5"


def write_mesh(folder: Path, model: Model, name: str, units: str) -> str:
    """Write the mesh, and give the tables of a job that reads it."""
    solid, (_, stress, density) = model.solid, UNITS[units]
    xyz = np.round(solid.xyz * 1e3, 6) if units == "mm-t-s" else solid.xyz
    path = folder / name
    lines = [f'mesh = "{name}"', f'units = "{units}"', 'mass_integration = "exact"']
    if path.suffix == ".inp":
        write_deck(path, model, xyz)
        lines.append('dialect = "calculix"')
    else:
        mesh = meshio.Mesh(xyz, [(_NAMES[solid.kind], solid.cells)])
        if path.suffix == ".msh":
            tags = [np.ones(len(solid.cells), dtype=int)]
            mesh.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
            meshio.gmsh.write(path, mesh, fmt_version="2.2", binary=False)
        else:
            meshio.write(path, mesh)
    material = f"young = {solid.young * stress!r}\npoisson = {solid.poisson}\ndensity = {solid.density * density!r}\n"
    return "[model]\n" + "\n".join(lines) + "\n[[material]]\n" + material


def write_deck(path: Path, model: Model, xyz: np.ndarray) -> None:
    """Nodes, and elements where there are any."""
    rows = [f"{k}, " + ", ".join(repr(float(c)) for c in x) for k, x in enumerate(xyz, 1)]
    text = ["*NODE", *rows]
    if model.solid is not None:
        text.append(f"*ELEMENT, TYPE={_DECK[model.solid.kind]}, ELSET=ALL")
        text += [f"{k}, " + ", ".join(str(n + 1) for n in cell) for k, cell in enumerate(model.solid.cells, 1)]
    path.write_text("\n".join(text) + "\n")


def write_matrices(folder: Path, model: Model, kind: str) -> tuple[str, list[str]]:
    """Write K, M, D and what maps them to nodes; the table of a job, and the arguments of the import before it."""
    matrices = {"K": model.K, "M": model.M} | ({} if model.D is None else {"D": model.D})
    table = f'[model]\nfile = "{MODEL}"\n'
    if model.nodes and (model.solid is None or not model.elements):
        made = from_matrices(**matrices, nodes=model.xyz, node=model.node, component=model.component, name="part")
        write_model(folder / MODEL, made)
        return table, []
    arguments = ["import", "-o", MODEL]
    if model.nodes:
        write_deck(folder / "nodes.inp", model, model.xyz)
        rows = [f"{n + 1},{c + 1}" for n, c in zip(model.node.tolist(), model.component.tolist(), strict=True)]
        (folder / "map.csv").write_text("node,dof\n" + "\n".join(rows) + "\n")
        arguments += ["--nodes", "nodes.inp", "--dofs", "map.csv"]
    if model.inputs is not None:
        matrices["B"] = model.inputs
    if kind == "mtx":
        for name, A in matrices.items():
            symmetry = "general" if name == "B" else "symmetric"
            scipy.io.mmwrite(folder / f"{name}.mtx", sp.coo_array(A), precision=17, symmetry=symmetry)
        for name, option in (("K", "--stiffness"), ("M", "--mass"), ("D", "--damping")):
            arguments += [option, f"{name}.mtx"] if name in matrices else []
        return table, arguments + (["--set", "B=B.mtx"] if "B" in matrices else [])
    file = folder / ("matrices.npz" if kind != "mat" else "matrices.mat")
    if kind == "mat":
        scipy.io.savemat(file, {name: sp.csc_array(A) for name, A in matrices.items()})
    else:
        np.savez(file, **matrices)
    arguments.insert(1, file.name)
    for name in matrices:
        arguments += ["--set", f"{name}={name}"]
    return table, arguments
