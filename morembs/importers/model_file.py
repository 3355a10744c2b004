"""The native model file: what ``morembs import`` writes once, and jobs read. HDF5, SI units; see docs/formats.md.

The reader of the file itself is ``morembs.importers.native``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.former_names import with_budget_argument, with_progress_argument
from morembs.base.types import Ints
from morembs.fem import FEModel, Mesh
from morembs.fem.constraints import RigidElement
from morembs.fem.fe_model import MATRICES
from morembs.importers.native import FORMAT, MODEL, Version, import_native
from morembs.importers.to_model import model_of
from morembs.importers.tolerances import TOL
from morembs.storage.hdf5 import holds_format
from morembs.storage.writer import writing


@with_progress_argument
def write_model(
    path: str | Path,
    model: FEModel,
    *,
    files: Sequence[Path] = (),
    importer: str = "",
    units: str = "",
    findings: Sequence[str] = (),
) -> Path:
    """Write a model (SI); an interrupted or failed run leaves the old file or none.

    Args:
        files: those that the model came from; their names and SHA-256 are kept.
        importer: the name of the format they were read as, ``units`` those that they had.
        findings: sentences of the examination.

    Raises:
        InputError: a source file cannot be read.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    progress.stage(f"writing {target.name}")
    sums = [sha256(file) for file in files]
    with writing(target) as out:
        out.rows(
            "",
            MODEL,
            {
                "format": FORMAT,
                "format_version": _version(model),
                "unit_system": "SI",
                "source": {
                    "name": model.source,
                    "files": [file.name for file in files],
                    "sha256": sums,
                    "format": importer or "none",
                    "units": units or "m-kg-s",
                    "notes": model.notes,
                    "warnings": model.warnings,
                    "findings": list(findings),
                },
                **{name: getattr(model, name) for name in MATRICES},
                "ids": model.nodes.ids,
                "xyz": model.nodes.xyz,
                "node_sets": model.nodes.sets,
                "node": model.dofs.node,
                "component": model.dofs.component,
                "elements": model.mesh and _elements(model.mesh),
                "element_sets": model.mesh and _element_sets(model.mesh),
                "materials": model.materials or None,
                "couplings": _couplings(model) if model.couplings else None,
                "equations": _equations(model) if model.equations else None,
                "inputs": model.inputs,
                "outputs": model.outputs,
            },
        )
        for matrix in out.file.get("matrices", {}).values():
            matrix.attrs["format"] = np.bytes_("csr")
    return target


def _version(model: FEModel) -> int:
    """The lowest version of the format that holds the model."""
    if model.G is not None or model.N is not None:
        return Version.WITHOUT_SYMMETRY
    return Version.WITH_EQUATIONS if model.equations else Version.PLAIN


@with_budget_argument
def read_model(path: str | Path) -> FEModel:
    """The model of a native file, bit by bit as it was written. Peak memory: that of the matrices.

    Raises:
        InputError: no such file, another kind of file, one of a newer version, or one that is damaged.
    """
    if holds_format(Path(path), "morembs-body"):
        raise InputError(
            f"{path} is a body file, the result of a reduction; expected a model file: give what morembs import wrote"
        )
    return model_of(import_native(Path(path)))


def is_model_file(path: Path) -> bool:
    """Whether ``path`` is a model file of ours, sound or not."""
    return holds_format(path, FORMAT)


def sha256(path: Path) -> str:
    """Checksum of a file in hexadecimal digits.

    Raises:
        InputError: it cannot be read.
    """
    total = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(TOL.hashed_bytes):
                total.update(block)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path") from error
    return total.hexdigest()


def _elements(mesh: Mesh) -> dict[str, object]:
    """Elements in VTK order."""
    types = [block.type for block in mesh.blocks]
    return {"types": types, "node_count": len(mesh.nodes), "source": mesh.source, "blocks": mesh.blocks}


def _element_sets(mesh: Mesh) -> dict[str, Ints]:
    """Elements of each set, counted through all blocks."""
    starts = np.concatenate([[0], np.cumsum([len(block.ids) for block in mesh.blocks])])
    return {
        name: np.concatenate([np.asarray(rows) + starts[b] for b, rows in enumerate(parts)]).astype(np.int64)
        for name, parts in mesh.element_sets.items()
    }


def _couplings(model: FEModel) -> dict[str, object]:
    couplings: list[dict[str, object]] = []
    for element in model.couplings.values():
        if isinstance(element, RigidElement):
            kind, reference, nodes = "rigid", element.master, element.slaves
        else:
            kind, reference, nodes = "average", element.reference, element.nodes
        couplings.append(
            {
                "kind": kind,
                "reference": reference,
                "nodes": nodes,
                "components": element.components,
                "point": model.nodes.xyz[reference],
                "weights": getattr(element, "weights", None),
            }
        )
    return {"names": [element.name for element in model.couplings.values()], "couplings": couplings}


def _equations(model: FEModel) -> dict[str, object]:
    return {"names": [given.name for given in model.equations], "equations": model.equations}
