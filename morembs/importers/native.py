"""The native model file: HDF5, SI units; written by ``morembs.importers.model_file``, described in docs/formats.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.budget import current_budget
from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import DofMap, ElementBlock, Mesh, NamedColumns, Nodes
from morembs.fem.constraints import AverageElement, Equations, RigidElement
from morembs.fem.elements import TYPES
from morembs.fem.fe_model import MATRICES, Component
from morembs.fem.formulations import FORMULATIONS, MASSES, formulation_of
from morembs.fem.material import Material
from morembs.importers.imported import Imported, first_nodes
from morembs.importers.matrices.hdf5 import checked_csr
from morembs.storage.checksums import Checksums
from morembs.storage.hdf5 import reading_format
from morembs.storage.table import Row, Table, read_rows
from morembs.storage.table_check import TableCheck

FORMAT = "morembs-model"
CURE = "import the model again"


class Version(IntEnum):
    """Versions of model files; older readers, which would leave equations or G and N out, refuse higher ones."""

    PLAIN = 1
    WITH_EQUATIONS = 2
    WITHOUT_SYMMETRY = 3


def _matrix(units: str) -> Table:
    """A CSR matrix as SciPy keeps it; imaginary parts have a dataset of their own."""
    return Table(
        (
            Row("data", "later", "any", units=units, doc="values, their real parts"),
            Row("data_imag", "later", "any", units=units, doc="their imaginary parts", when="of complex matrices"),
            Row("indices", "index", "any", doc="columns of the values"),
            Row("indptr", "index", "any", doc="where each row begins"),
            Row("shape", "whole", "2", doc="rows and columns"),
        ),
        parts=_matrix_parts,
    )


def _matrix_parts(matrix: sp.csr_array) -> Mapping[str, object]:
    if not matrix.has_canonical_format:
        matrix = matrix.copy()
        matrix.sum_duplicates()
    imaginary = np.ascontiguousarray(matrix.data.imag) if matrix.data.dtype.kind == "c" else None
    data = np.ascontiguousarray(matrix.data.real)
    return {
        "data": data,
        "data_imag": imaginary,
        "indices": matrix.indices,
        "indptr": matrix.indptr,
        "shape": matrix.shape,
    }


def _sets(names: tuple[str, ...], offsets: Ints, rows: Ints) -> dict[str, Ints]:
    if len(offsets) != len(names) + 1 or offsets[0] != 0 or offsets[-1] != len(rows) or (np.diff(offsets) < 0).any():
        raise ValueError("sets do not fit their names")
    return {name: rows[offsets[i] : offsets[i + 1]] for i, name in enumerate(names)}


def _sets_parts(sets: Mapping[str, Ints]) -> Mapping[str, object]:
    rows = np.concatenate([np.empty(0, dtype=np.int64), *sets.values()])
    return {"names": list(sets), "offsets": np.cumsum([0, *map(len, sets.values())]), "rows": rows}


def _materials(sets: tuple[str, ...], stiffness: Any, density: Any) -> tuple[Material, ...]:
    rows = zip(sets, stiffness, density.tolist(), strict=True)
    return tuple(Material(set=name, stiffness=C, density=rho) for name, C, rho in rows)


def _materials_parts(materials: Iterable[Material]) -> Mapping[str, object]:
    rows = ((material.set, material.stiffness, material.density) for material in materials)
    sets, stiffness, density = zip(*rows, strict=True)
    return {"sets": sets, "stiffness": np.stack(stiffness), "density": density}


def _columns_parts(columns: NamedColumns) -> Mapping[str, object]:
    matrix = columns.matrix
    return {"names": columns.names, "offsets": matrix.indptr, "rows": matrix.indices, "data": matrix.data}


_SOURCE = Table(
    (
        Row("name", "words", doc="of the model"),
        Row("files", "words", "files", "names of the files, in the order of sha256"),
        Row("sha256", "words", "files", doc="checksums of the files"),
        Row("format", "words", doc="what they were read as"),
        Row("units", "words", "", "length, mass and time of the files; everything here is SI"),
        Row("notes", "words", "any", doc="what was said at the import"),
        Row("warnings", "words", "any", "in what the model differs from its source", when="files of 0.1 may lack it"),
        Row("findings", "words", "any", "what the examination found at the import", when="files of 0.1 may lack it"),
    )
)
_SETS = Table(
    (
        Row("names", "words", "sets", doc="of the sets"),
        Row("offsets", "whole", "any", doc="set i holds `rows[offsets[i]:offsets[i+1]]`"),
        Row("rows", "whole", "any", "from 0"),
    ),
    build=_sets,
    parts=_sets_parts,
)
_BLOCK = Table(
    (
        Row("nodes", "whole", "elements corners", "rows of /nodes, from 0, in VTK order"),
        Row("ids", "whole", "elements", "labels of the elements in the source"),
        Row("formulation", "words", doc=f"of the strain, one of {', '.join(FORMULATIONS)}", when="`full` without it"),
        Row("mass", "words", doc=f"rule of the mass, one of {', '.join(MASSES)}", when="`exact` without it"),
    )
)
_ELEMENTS = Table(
    (
        Row("types", "words", "blocks", "of block_0, block_1, ..."),
        Row("node_count", "whole", "", "the first nodes are those of the elements"),
        Row("source", "words", doc="of the mesh"),
        Row("block_#", _BLOCK, field="blocks"),
    )
)
_MATERIALS = Table(
    (
        Row("sets", "words", "materials", doc="sets of elements"),
        Row("stiffness", "real", "materials 6 6", "Voigt order xx, yy, zz, yz, zx, xy, engineering shears", "Pa"),
        Row("density", "real", "materials", units="kg/m3", doc="density"),
    ),
    build=_materials,
    parts=_materials_parts,
)
_COUPLING = Table(
    (
        Row("kind", "words", doc="`rigid` or `average`"),
        Row("reference", "whole", "", "row of /nodes: the master, or the node of the mean motion"),
        Row("nodes", "whole", "followers", "rows of /nodes that follow, or whose mean is taken"),
        Row("components", "few", "any", "0..5: those of the nodes that follow, or of the reference"),
        Row("point", "real", "3", units="m", doc="where the reference is", read=False),
        Row("weights", "real", "followers", when="of average ones", doc="of the nodes"),
    )
)
_NAMED_COLUMNS = Table(
    (
        Row("names", "words", "columns", "of the columns"),
        Row("offsets", "whole", "any", "column j holds `data[offsets[j]:offsets[j+1]]`"),
        Row("rows", "whole", "entries", "rows of the matrices, from 0, of the entries"),
        Row(
            "data",
            "real",
            "entries",
            units="1 or m",
            doc="entries: of displacements without unit, of rotations lengths",
        ),
    ),
    parts=_columns_parts,
)
_EQUATIONS_OF_ONE = Table(
    (
        Row("nodes", "whole", "equations", "rows of /nodes: the dofs that depend on others"),
        Row("components", "whole", "equations", "of these dofs, as in dofs/component"),
        Row("offsets", "whole", "any", "terms of equation i are `offsets[i]:offsets[i+1]`; without any it is held"),
        Row("term_nodes", "whole", "terms", "rows of /nodes"),
        Row("term_components", "whole", "terms", "as in dofs/component"),
        Row("coefficients", "real", "terms", units="1, m or 1/m", doc="of the terms"),
    )
)
_EQUATIONS = Table(
    (
        Row("names", "words", "origins", "of equations_0, equations_1, ...: what they came from"),
        Row("equations_#", _EQUATIONS_OF_ONE, field="equations"),
    )
)
_COUPLINGS = Table(
    (
        Row("names", "words", "couplings", "of coupling_0, coupling_1, ..."),
        Row("coupling_#", _COUPLING, field="couplings"),
    )
)
MODEL = Table(
    (
        Row("format", "text", doc="`morembs-model`", read=False),
        Row("format_version", "whole", doc="1, with equations 2, with G or N 3", read=False),
        Row("unit_system", "text", doc="`SI`", read=False),
        Row("source", _SOURCE),
        Row("matrices/K", _matrix("N/m"), when="if", read=False),
        Row("matrices/M", _matrix("kg"), when="if", read=False, doc="as K, kg; each of them may be absent"),
        Row("matrices/D", _matrix("N s/m"), when="if", read=False, doc="as K, N s/m"),
        Row("matrices/G", _matrix("N s/m"), when="if", read=False, doc="as K, N s/m; skew-symmetric"),
        Row("matrices/N", _matrix("N/m"), when="if", read=False, doc="as K; skew-symmetric"),
        Row("nodes/ids", "whole", "N", "labels of the nodes in the source"),
        Row("nodes/coordinates", "real", "N 3", units="m", field="xyz", doc="of the nodes"),
        Row("node_sets", _SETS),
        Row("dofs/node", "whole", "dofs", "row of /nodes, from 0, of each row of the matrices"),
        Row(
            "dofs/component", "whole", "dofs", "0..2 displacements along x, y, z; 3..5 rotations about them; 6 scalars"
        ),
        Row("elements", _ELEMENTS, when="if"),
        Row("element_sets", _SETS, when="if", doc="as `node_sets`; elements are counted through all blocks"),
        Row("materials", _MATERIALS, when="if"),
        Row("couplings", _COUPLINGS, when="if"),
        Row("equations", _EQUATIONS, when="if"),
        Row("inputs", _NAMED_COLUMNS, when="if"),
        Row("outputs", _NAMED_COLUMNS, when="if", doc="as `inputs`, which are columns of B; rows of C"),
    )
)


def import_native(path: Path) -> Imported:
    """All that a native model file holds, in SI units. Peak memory: that of the matrices.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.
    """
    path, hint = Path(path), "; see morembs import"
    with reading_format(path, "a model file", FORMAT, max(Version), cure=CURE, hint=hint) as file:
        TableCheck(path, file, "model file", CURE).table("", MODEL, {})
        values = read_rows(file, MODEL)
        dofs, source = DofMap(node=values["node"], component=values["component"]), values["source"]
        matrices: dict[str, Any] = {name: _read_matrix(path, file, name, len(dofs.node)) for name in MATRICES}
        nodes = Nodes(ids=values["ids"], xyz=values["xyz"], sets=values["node_sets"])
        for name, rows in nodes.sets.items():
            _refuse_outside(path, rows, len(nodes), f"node set {name!r}")
        rigid, average = _couplings(path, values.get("couplings", {"names": (), "couplings": ()}), len(nodes))
        equations = _equations(path, values.get("equations", {"names": (), "equations": ()}), len(nodes))
        inputs, outputs = (_named_columns(path, values.get(key), key, len(dofs)) for key in ("inputs", "outputs"))
        mesh = _mesh(path, values["elements"], values["element_sets"], nodes) if "elements" in values else None
        Checksums(path, file).verify()
    return Imported(
        source=source["name"],
        **matrices,
        nodes=nodes,
        dofs=dofs,
        mesh=mesh,
        materials=values.get("materials", ()),
        rigid=rigid,
        average=average,
        equations=equations,
        inputs=inputs,
        outputs=outputs,
        notes=source["notes"],
        warnings=source.get("warnings", ()),
    )


def _named_columns(path: Path, values: Mapping[str, Any] | None, key: str, size: int) -> NamedColumns | None:
    if values is None:
        return None
    offsets, rows, count = values["offsets"], values["rows"], len(values["names"])
    if len(offsets) != count + 1 or offsets[0] != 0 or offsets[-1] != len(rows) or (np.diff(offsets) < 0).any():
        raise InputError(f"{path}: {key} does not fit its names; {CURE}")
    _refuse_outside(path, rows, size, key)
    matrix = sp.csc_array((values["data"], rows, offsets), shape=(size, count))
    try:
        return NamedColumns(names=values["names"], matrix=matrix)
    except InputError as error:
        raise InputError(f"{path}: {key}: {error}; {CURE}") from error


def _read_matrix(path: Path, file: Any, name: str, size: int) -> sp.csr_array | None:
    group = file.get(f"matrices/{name}")
    if group is None:
        return None
    parts = []
    for part in ("data", "indices", "indptr"):
        array = current_budget().empty(group[part].shape, group[part].dtype)
        if len(array):
            group[part].read_direct(array)
        parts.append(array)
    data, indices, indptr = parts
    if "data_imag" in group:
        data = data + 1j * group["data_imag"][()]
    shape = tuple(group["shape"][()].tolist())
    if shape != (size, size):
        raise InputError(f"{path}: {name} has the shape {shape}, the dofs are {size}; {CURE}")
    return checked_csr(f"{path}: {name}", data, indices, indptr, (size, size))


def _refuse_outside(path: Path, rows: Ints, count: int, what: str) -> None:
    if len(rows) and not (rows.min() >= 0 and rows.max() < count):
        raise InputError(f"{path}: {what} names rows that do not exist; {CURE}")


def _mesh(path: Path, group: Mapping[str, Any], element_sets: Mapping[str, Ints], nodes: Nodes) -> Mesh:
    count = group["node_count"]
    if not 0 <= count <= len(nodes):
        raise InputError(f"{path}: elements take {count} nodes of {len(nodes)}; {CURE}")
    blocks = []
    for kind, block in zip(group["types"], group["blocks"], strict=True):
        if kind not in TYPES or block["nodes"].shape[1] != TYPES[kind].n_nodes:
            raise InputError(f"{path}: elements of type {kind!r} are damaged; {CURE}")
        _refuse_outside(path, block["nodes"].ravel(), count, f"an element of type {kind}")
        blocks.append(ElementBlock(type=kind, **block))
        try:
            formulation_of(blocks[-1])
        except InputError as error:
            raise InputError(f"{path}: {error}; a newer version wrote it, or it is damaged; {CURE}") from error
    starts = np.concatenate([[0], np.cumsum([len(block.ids) for block in blocks])])
    sets = {}
    for name, rows in element_sets.items():
        _refuse_outside(path, rows, int(starts[-1]), f"element set {name!r}")
        block = np.searchsorted(starts, rows, side="right") - 1
        sets[name] = tuple(rows[block == b] - starts[b] for b in range(len(blocks)))
    return Mesh(nodes=first_nodes(nodes, count), blocks=tuple(blocks), element_sets=sets, source=group["source"])


def _couplings(
    path: Path, group: Mapping[str, Any], count: int
) -> tuple[tuple[RigidElement, ...], tuple[AverageElement, ...]]:
    rigid, average = [], []
    for name, coupling in zip(group["names"], group["couplings"], strict=True):
        reference, nodes, components = coupling["reference"], coupling["nodes"], coupling["components"]
        _refuse_outside(path, np.append(nodes, reference), count, f"coupling {name!r}")
        if not set(components) <= set(range(6)):
            raise InputError(f"{path}: coupling {name!r} has components {components}; expected some of 0 to 5")
        if coupling.pop("kind") == "rigid":
            rigid.append(RigidElement(name=name, master=reference, slaves=nodes, components=components))
        else:
            average.append(AverageElement(name=name, **coupling))
    return tuple(rigid), tuple(average)


def _equations(path: Path, group: Mapping[str, Any], count: int) -> tuple[Equations, ...]:
    equations = []
    for name, given in zip(group["names"], group["equations"], strict=True):
        _refuse_outside(path, np.append(given["nodes"], given["term_nodes"]), count, f"the equations {name!r}")
        components = np.append(given["components"], given["term_components"])
        if not np.isin(components, range(Component.SCALAR + 1)).all():
            raise InputError(f"{path}: the equations {name!r} have components beyond 0 to 6; {CURE}")
        try:
            equations.append(Equations(name=name, **given))
        except InputError as error:
            raise InputError(f"{path}: {error}; {CURE}") from error
    return tuple(equations)
