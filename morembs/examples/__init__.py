"""Parts to try morembs with, made here and written into a folder; the table below is the contents page.

Each function writes its files and returns the path of the one that is read first. Files that are there already stay:
the same ones are taken as they are, others are refused. All is in mm, t and s but for the matrices, which are in SI.

>>> import morembs
>>> rod = morembs.read_mesh(morembs.examples.rod(), "mm-t-s")
>>> rod
Mesh: nodes 2078; elements 300 hex20; node sets 4 of them; element sets BUSHES, BODY; source rod.msh
>>> {name: len(rows) for name, rows in rod.nodes.sets.items()}
{'BUSHES': 1144, 'BODY': 1418, 'BIGEND': 264, 'SMALLEND': 220}
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.examples.shapes import Shape, bar_shape, bracket_shape, faces_of, rod_shape
from morembs.storage.safefile import replacing_all

__all__ = ["EXAMPLES", "bracket", "deck", "matrices", "rod"]

Folder = str | Path


def rod(folder: Folder = ".") -> Path:
    """Write ``rod.msh``: a connecting rod 120 mm long (300 hex20), with the node sets BIGEND and SMALLEND.

    Args:
        folder: place of the new file.

    Raises:
        InputError: another file of this name is there.
    """
    return EXAMPLES["rod"].write(folder)


def bracket(folder: Folder = ".") -> Path:
    """Write ``bracket.msh``: an L of FOOT and LUG (104 hex20), with the node sets BOLTS and PIN of its holes.

    Args:
        folder: place of the new file.

    Raises:
        InputError: another file of this name is there.
    """
    return EXAMPLES["bracket"].write(folder)


def deck(folder: Folder = ".") -> Path:
    """Write ``deck.inp`` for Abaqus and CalculiX: the rod of steel with bushes of bronze, its bores rigid.

    Args:
        folder: place of the new file.

    Raises:
        InputError: another file of this name is there.
    """
    return EXAMPLES["deck"].write(folder)


def matrices(folder: Folder = ".") -> Path:
    """Write ``K.mtx`` and ``M.mtx`` of a steel bar held at one end and ``B.mtx``, a force across it at the other.

    Args:
        folder: place of the new files.

    Raises:
        InputError: another file of these names is there.
    """
    return EXAMPLES["matrices"].write(folder)


@dataclass(frozen=True)
class Example:
    """What an example is, its files, the first one to be read, and the function that gives their bytes."""

    about: str
    files: tuple[str, ...]
    units: str
    make: Callable[[], Sequence[bytes]]

    def write(self, folder: Folder) -> Path:
        """Write what is not there yet, and give the path of the first file.

        Raises:
            InputError: a file that is there holds something else.
        """
        paths = dict(zip((Path(folder) / name for name in self.files), self.make(), strict=True))
        there = [path for path in paths if path.exists()]
        for path in there:
            if not path.is_file() or path.read_bytes() != paths[path]:
                raise InputError(
                    f"{path} is there already and no example; choose another folder", kind="output", keyword=path.name
                )
        missing = [path for path in paths if path not in there]
        with replacing_all(missing) as written:
            for path, file in zip(missing, written, strict=True):
                file.write(paths[path])
        return next(iter(paths))


def _gmsh(shape: Shape) -> bytes:
    """A file of Gmsh, MSH 2.2, whose physical groups are the sets."""
    groups = [*((3, name) for name in shape.element_sets), *((2, name) for name in shape.node_sets)]
    tags = {name: number for number, (_, name) in enumerate(groups, start=1)}
    # Gmsh walks along the edges from the first corner on, VTK around both ends (Gmsh's manual, node ordering).
    order = [*range(8), 8, 11, 16, 9, 17, 10, 18, 19, 12, 15, 13, 14]
    # Types 17 and 16 of Gmsh: hexahedra of 20 nodes, quadrilaterals of 8.
    cells = [(17, tags[name], shape.cells[rows][:, order]) for name, rows in shape.element_sets.items()]
    cells += [(16, tags[name], faces_of(shape, rows)) for name, rows in shape.node_sets.items()]
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups))]
    lines += [f'{dimension} {tags[name]} "{name}"' for dimension, name in groups]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(shape.points)), *_number_lines(shape.points, " "), "$EndNodes"]
    lines += ["$Elements", str(sum(len(rows) for *_, rows in cells))]
    heads = [f"{kind} 2 {tag} {tag} {_text(row + 1, ' ')}" for kind, tag, rows in cells for row in rows]
    lines += [f"{label} {line}" for label, line in enumerate(heads, start=1)]
    return "\n".join([*lines, "$EndElements", ""]).encode()


def _abaqus(shape: Shape) -> bytes:
    """A deck with the materials of both element sets, and a rigid body on each node set with a node at its middle."""
    # Young's modulus in MPa, Poisson's ratio, density in t/mm^3: a steel, a tin bronze.
    materials = {"STEEL": (210e3, 0.3, 7.85e-9), "BRONZE": (110e3, 0.34, 8.8e-9)}
    count = len(shape.points)
    lines = [
        "** A connecting rod of steel with bushes of bronze; mm, t, s",
        "*NODE",
        *_number_lines(shape.points, ", "),
    ]
    middles = np.array([shape.points[rows].mean(axis=0).round(9) + 0.0 for rows in shape.node_sets.values()])
    lines += _number_lines(middles, ", ", count)
    for name, rows in shape.element_sets.items():
        lines.append(f"*ELEMENT, TYPE=C3D20, ELSET={name}")
        for row in rows:
            # Sixteen numbers a line are the most that both programs take.
            labels = [row + 1, *(shape.cells[row] + 1)]
            lines += [f"{_text(labels[:16], ', ')},", _text(labels[16:], ", ")]
    for name, rows in shape.node_sets.items():
        lines += [f"*NSET, NSET={name}", *(_text(rows[i : i + 16] + 1, ", ") for i in range(0, len(rows), 16))]
    for name, (young, poisson, density) in materials.items():
        lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{young:g}, {poisson:g}", "*DENSITY", f"{density:g}"]
    for name, material in (("BODY", "STEEL"), ("BUSHES", "BRONZE")):
        lines.append(f"*SOLID SECTION, ELSET={name}, MATERIAL={material}")
    for number, name in enumerate(shape.node_sets, start=count + 1):
        lines.append(f"*RIGID BODY, NSET={name}, REF NODE={number}")
    return "\n".join([*lines, ""]).encode()


def _matrices(shape: Shape) -> list[bytes]:
    """K, M and B as Matrix Market has them."""
    import scipy.io
    import scipy.sparse as sp

    from morembs.fem import ElementBlock, Mesh, Nodes
    from morembs.fem.assembly import assemble
    from morembs.fem.material import isotropic

    numbers = np.arange(1, len(shape.points) + 1)
    # Steel in SI units; the shape is in mm.
    steel = isotropic(set="all", young=210e9, poisson=0.3, density=7850.0)
    block = ElementBlock(type="hex20", nodes=shape.cells, ids=np.arange(1, len(shape.cells) + 1))
    mesh = Mesh(nodes=Nodes(ids=numbers, xyz=shape.points / 1000), blocks=(block,), source="bar")
    model = assemble(mesh, [steel])
    free = ~np.isin(model.dofs.node, shape.node_sets["LEFT"])
    pushed = np.isin(model.dofs.node, shape.node_sets["RIGHT"]) & (model.dofs.component == 2)
    column = sp.csc_array((pushed / pushed.sum())[free, None])
    files = []
    K, M = (A[free][:, free] for A in (model.K, model.M))
    for matrix, kind in ((K, "symmetric"), (M, "symmetric"), (column, "general")):
        text = io.BytesIO()
        scipy.io.mmwrite(text, sp.coo_array(matrix), symmetry=kind)
        files.append(text.getvalue())
    return files


def _number_lines(points: Floats, between: str, start: int = 0) -> list[str]:
    """A line for each point, its label first."""
    return [f"{label}{between}{_text(point, between)}" for label, point in enumerate(points, start=start + 1)]


def _text(numbers: Floats | Ints | list[int], between: str) -> str:
    return between.join(f"{number:.9g}" if isinstance(number, float) else str(number) for number in numbers)


# By their names at the command line.
EXAMPLES: Mapping[str, Example] = {
    "rod": Example("a connecting rod (mesh of Gmsh)", ("rod.msh",), "mm-t-s", lambda: [_gmsh(rod_shape())]),
    "bracket": Example("a bracket (mesh of Gmsh)", ("bracket.msh",), "mm-t-s", lambda: [_gmsh(bracket_shape())]),
    "deck": Example("a rod with bushes (deck of Abaqus)", ("deck.inp",), "mm-t-s", lambda: [_abaqus(rod_shape())]),
    "matrices": Example("a bar", ("K.mtx", "M.mtx", "B.mtx"), "m-kg-s", lambda: _matrices(bar_shape())),
}
