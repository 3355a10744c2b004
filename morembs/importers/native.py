"""The native model file: HDF5, SI units; written by ``morembs.importers.model_file``.

docs/reference/formats/model_file.md describes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.fem import FEModel, Mesh, NamedColumns, Nodes
from morembs.fem.constraints import AverageElement, RigidElement
from morembs.fem.elements import TYPES
from morembs.fem.fe_model import MATRICES
from morembs.fem.formulations import formulation_of
from morembs.fem.model_terms import ModelTerms
from morembs.importers.imported import Imported, first_nodes
from morembs.importers.matrices.hdf5 import checked_csr
from morembs.storage.checksums import Checksums, warn_unsealed
from morembs.storage.hdf5 import reading_format
from morembs.storage.table import dataset, derived, read_rows, table_of
from morembs.storage.table_check import TableCheck

FORMAT = "morembs-model"
CURE = "import the model again"


class Version(IntEnum):
    """Versions of model files; older readers, which would leave equations or G and N out, refuse higher ones."""

    PLAIN = 1
    WITH_EQUATIONS = 2
    WITHOUT_SYMMETRY = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFile:
    """All of a model file: the ``model``, and its sources.

    ``files`` are the names of the sources and ``sha256`` their checksums, ``importer`` the name of the format that they
    were read as, ``units`` their units; ``findings`` are sentences of the examination.
    """

    @derived("text", doc=f"`{FORMAT}`")
    def format(self) -> str:
        """What kind of file it is."""
        return FORMAT

    @derived("whole", doc="1, with equations 2, with G or N 3")
    def format_version(self) -> int:
        """The lowest version of the format that holds the model."""
        if self.model.G is not None or self.model.N is not None:
            return Version.WITHOUT_SYMMETRY
        return Version.WITH_EQUATIONS if self.model.equations else Version.PLAIN

    @derived("text", doc="`SI`")
    def unit_system(self) -> str:
        """The units of all numbers."""
        return "SI"

    files: tuple[str, ...] = dataset(
        "words", "files", "names of the files, in the order of sha256", name="source/files"
    )
    sha256: tuple[str, ...] = dataset("words", "files", name="source/sha256", doc="checksums of the files")
    importer: str = dataset("words", name="source/format", doc="formats of the source files")
    units: str = dataset("words", "", "length, mass and time of the files; everything here is SI", name="source/units")
    findings: tuple[str, ...] = dataset(
        "words",
        "any",
        "what the examination found at the import",
        name="source/findings",
        default=(),
        when="files of 0.1 may lack it",
    )
    model: FEModel = dataset(table_of(FEModel, build=dict), inline=True)
    terms: ModelTerms | None = dataset(
        table_of(ModelTerms), default=None, read=False, since="0.2", when="of models with parameters"
    )


MODEL = table_of(ModelFile, build=dict)


def import_native(path: Path) -> Imported:
    """All that a native model file holds, in SI units. Peak memory: that of the matrices.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.
    """
    path, hint = Path(path), "; see morembs import"
    with reading_format(path, "a model file", FORMAT, max(Version), cure=CURE, hint=hint) as file:
        TableCheck(path, file, "model file", CURE).table("", MODEL, {})
        try:
            values = read_rows(file, MODEL)["model"]
            size = len(values["dofs"])
            for name in ("inputs", "outputs"):
                if name in values:
                    values[name] = _named_columns(name, **values[name], size=size)
            if "mesh" in values:
                values["mesh"] = _mesh(values["nodes"], **values["mesh"])
        except InputError as error:
            raise error.restate(f"{path}: {error}; {CURE}") from error
        for name in values.keys() & set(MATRICES):
            values[name] = _matrix(path, name, values[name], size)
        Checksums(path, file).verify()
        values["warnings"] = (*values.get("warnings", ()), *warn_unsealed(path, file, "source/warnings"))
    couplings = values.pop("couplings", ())
    return Imported(
        rigid=tuple(element for element in couplings if isinstance(element, RigidElement)),
        average=tuple(element for element in couplings if isinstance(element, AverageElement)),
        **values,
    )


def import_terms(path: Path) -> ModelTerms:
    """The terms of a native model file with parameters. Peak memory: that of the terms.

    Raises:
        InputError: as ``import_native``, or a model without parameters.
    """
    path = Path(path)
    with reading_format(path, "a model file", FORMAT, max(Version), cure=CURE) as file:
        if "terms" not in file:
            raise InputError(
                f"{path} has no terms of a model with parameters; give the model file that [certify] witness = true "
                "writes beside a body with parameters",
                kind="missing",
                keyword=path.name,
            )
        TableCheck(path, file, "model file", CURE).table("", MODEL, {})
        terms = read_rows(file["terms"], table_of(ModelTerms, build=dict), f"{path}: the terms lack")
        size = len(file["dofs/node"])
        for name in ("K", "M"):
            terms[name] = tuple(
                _matrix(path, f"terms/{name}_{number}", parts, size) for number, parts in enumerate(terms[name])
            )
        Checksums(path, file).verify()
    return ModelTerms(**terms)


def _named_columns(key: str, names: tuple[str, ...], offsets: Any, rows: Any, data: Any, size: int) -> NamedColumns:
    count = len(names)
    if len(offsets) != count + 1 or offsets[0] != 0 or offsets[-1] != len(rows) or (np.diff(offsets) < 0).any():
        raise InputError(f"{key} does not fit its names", kind="unsupported")
    try:
        return NamedColumns(names=names, matrix=sp.csc_array((data, rows, offsets), shape=(size, count)))
    except InputError as error:
        raise error.restate(f"{key}: {error}") from error


def _matrix(path: Path, name: str, parts: Mapping[str, Any], size: int) -> sp.csr_array:
    data = parts["data"] + 1j * parts["data_imag"] if "data_imag" in parts else parts["data"]
    shape = tuple(parts["shape"].tolist())
    if shape != (size, size):
        raise InputError(f"{path}: {name} has the shape {shape}, the dofs are {size}; {CURE}", kind="unsupported")
    return checked_csr(f"{path}: {name}", data, parts["indices"], parts["indptr"], (size, size))


def _mesh(nodes: Nodes, node_count: int, blocks: Any, element_sets: Mapping[str, Any], source: str) -> Mesh:
    for block in blocks:
        if block.type not in TYPES or block.nodes.shape[1] != TYPES[block.type].n_nodes:
            raise InputError(f"elements of type {block.type!r} are damaged", kind="file")
        try:
            formulation_of(block)
        except InputError as error:
            raise error.restate(f"{error}; a newer version wrote it, or it is damaged") from error
    mesh = Mesh(nodes=first_nodes(nodes, node_count), blocks=blocks, source=source)
    return mesh.with_rows_of_sets(element_sets)
