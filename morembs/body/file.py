"""The HDF5 file of elastic bodies, described in docs/schema.md: written whole or not at all, read lazily."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from morembs.body import vtkhdf
from morembs.body.stored import (
    StoredBodies,
    StoredBody,
    StoredInterface,
    basis_columns,
    refuse_missing,
    stored_bodies,
)  # fmt: skip
from morembs.body.stored_certificate import write_certificate
from morembs.body.stored_check import check_file
from morembs.body.stored_frame import write_frame, write_ranking
from morembs.body.stored_switching import read_switching, write_switching
from morembs.errors import InputError
from morembs.progress import SILENT, Progress
from morembs.storage import checksums
from morembs.storage.hdf5 import reading, refuse_newer
from morembs.storage.safefile import SafeFile, check_writable, replacing
from morembs.storage.storable import json_text, plain, storable, text
from morembs.version import VERSION

if TYPE_CHECKING:
    from morembs.body.body import ElasticBody, Part
    from morembs.reducers.switching_tables import Switching

Floats = NDArray[np.float64]
FORMAT = "morembs-body"
FORMAT_VERSION = 2
# Columns of a basis that are in memory at a time.
BLOCK_BYTES = 16 * 2**20
# Largest chunk HDF5 allows is 4 GiB.
CHUNK_ROWS = 2**28
# What is compared with its checksums when it is read.
_LATER = re.compile(r"VTKHDF|bodies/[^/]+/(recovery|switching|basis/)")
_MATRICES = ("mass_matrix", "stiffness_matrix", "damping_matrix")


def check_names(names: Sequence[str], what: str = "body") -> None:
    """Check that ``names`` can name groups of a file.

    Raises:
        InputError: an empty name, one with a slash or a control character, or one that comes twice.
    """
    for name in names:
        if not name.isprintable() or name.strip(".") == "" or "/" in name:
            raise InputError(
                f"{what} name {name!r} cannot be stored; take a name without slashes and control characters, "
                "not empty and not only dots"
            )
        if list(names).count(name) > 1:
            raise InputError(f"the {what} name {name!r} was given more than once; give each its own name")


def write_body(
    path: str | Path, bodies: Sequence[ElasticBody], *, recipe: Mapping[str, object] | None = None,
    provenance: Mapping[str, object] | None = None, warnings: Sequence[str] = (), progress: Progress = SILENT,
) -> Path:  # fmt: skip
    """Write bodies of one part; an interrupted or failed run leaves the old file or none.

    Holds one block of basis columns (16 MiB, at least one column) besides the bodies themselves.

    Args:
        recipe: what was asked for (the job); by default the source and the options of each body.
        provenance: where the file comes from, any nested names and values; ``created`` and
            ``morembs_version`` are added where they are missing. Nothing outside /provenance depends on it.
        warnings: what the examination of the model and the bodies warned of, beside what the model brings itself.

    Raises:
        InputError: no bodies, bodies of different parts, or names that cannot be stored.
        OutputError: the file cannot be written (folder missing or read-only, disk full).
    """
    if not bodies:
        raise InputError("there is no body to write; give at least one")
    part = bodies[0].part
    if any(body.part is not part for body in bodies):
        raise InputError("bodies of different parts were given; write one file for each part")
    check_names([body.name for body in bodies])
    check_names([interface.name for interface in part.interfaces], "interface")
    if recipe is None:
        recipe = {"source": part.source, "bodies": {body.name: body.recipe for body in bodies}}
    target = Path(path)
    progress.stage(f"writing {target.name}")
    # The oldest layout: every reader knows it, and its groups carry no time stamps. Without a chunk
    # cache parts of chunks are read without the rest.
    with replacing(target) as safe, h5py.File(safe, "w", libver=("earliest", "v108"), rdcc_nbytes=0) as file:
        out = _Writer(file, safe)
        _write_common(out, part, bodies, recipe)
        told = dict.fromkeys((*part.warnings, *warnings))
        out.put("check/warnings", text(*told), "what to know before the bodies are used, a sentence each")
        out.safe.doing = "the mesh for ParaView"
        grid = file.create_group("VTKHDF")
        vtkhdf.write_grid(grid, file["nodes/coordinates"], part.cells)
        safe.check()
        for body in bodies:
            _write_one(out, body, progress)
        made = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "morembs_version": VERSION}
        given = {f"{key}_" if key == checksums.GROUP else key: value for key, value in (provenance or {}).items()}
        out.tree("provenance", {**made, **given})
        safe.doing = "the checksums"
        # Those of /provenance apart, as nothing outside depends on it.
        checksums.seal(file["provenance"])
        checksums.seal(file, apart=["provenance"])
        safe.check()
    return target


@dataclass(frozen=True)
class _Writer:
    file: Any
    safe: SafeFile

    def put(self, name: str, value: object, about: str = "", units: str = "") -> None:
        """Store one dataset with what it is and its units, then look whether that went well."""
        self.safe.doing = name
        self.mark(self.file.create_dataset(name, data=storable(value)), about, units)

    def mark(self, item: Any, about: str, units: str = "") -> None:
        """Attributes for people; no number is kept in them."""
        for key, words in (("description", about), ("units", units)):
            if words:
                item.attrs[key] = np.bytes_(words)
        self.safe.check()

    def tree(self, name: str, value: object) -> None:
        """Store nested mappings as groups; None is left out, rows of equal keys become columns."""
        value = plain(value)
        if isinstance(value, list | tuple) and value:
            rows = [plain(row) for row in value]
            if all(isinstance(row, Mapping) and row.keys() == rows[0].keys() for row in rows):
                value = {key: [row[key] for row in rows] for key in rows[0]}
        if isinstance(value, Mapping):
            self.file.require_group(name)
            for key, inner in value.items():
                self.tree(f"{name}/{str(key).replace('/', '_').strip('.') or '_'}", inner)
        elif value is not None:
            self.put(name, value)


def _write_common(out: _Writer, part: Part, bodies: Sequence[ElasticBody], recipe: Mapping[str, object]) -> None:
    """Everything the bodies share."""
    from morembs.reducers.base import MODE_KINDS

    out.put("format", FORMAT)
    # Readers of version 1 take the transposed input matrix for the motions.
    plain_bodies = all(body.reduced.symmetric for body in bodies)
    out.put("format_version", 1 if plain_bodies else FORMAT_VERSION)
    out.put("unit_system", "SI")
    out.put("body_names", [body.name for body in bodies], "groups of /bodies in their order")
    names = text(*(interface.name for interface in part.interfaces))
    out.put("interface_names", names, "groups of /interfaces in their order")
    out.put("mode_kinds", list(MODE_KINDS), "names of the codes in mode_kind, from 0")
    out.put("recipe", json_text(recipe), "what was asked for, as JSON")
    out.put("mass_properties/mass", part.mass, units="kg")
    out.put("mass_properties/center_of_mass", part.center_of_mass, units="m")
    out.put("mass_properties/inertia", part.inertia, "about the centre of mass, axes of the model", "kg m2")
    out.put("nodes/ids", part.nodes.ids, "labels of the nodes in the source")
    out.put("nodes/coordinates", part.nodes.xyz, units="m")
    out.file.create_group("interfaces")
    width = bodies[0].reduced.B.shape[1]
    index, component, node = (np.full(width, -1, dtype=np.int64) for _ in range(3))
    for number, interface in enumerate(part.interfaces):
        labels, group = part.node_ids[interface.nodes], f"interfaces/{interface.name}"
        columns, (exposed, rows) = part.columns[interface.name], interface.kind.columns(interface)
        index[columns], component[columns] = number, exposed
        node[columns] = np.where(rows < 0, -1, part.node_ids[rows])
        out.put(f"{group}/coupling", interface.coupling)
        components = np.array(interface.components, dtype=np.int64)
        out.put(f"{group}/components", components, "exposed degrees of freedom 0..5")
        out.put(f"{group}/point", interface.point.astype(float), "origin of the frame", "m")
        out.put(f"{group}/axes", interface.axes.astype(float), "axes of the frame as rows")
        out.put(f"{group}/node_ids", labels, "labels of the nodes")
        out.put(f"{group}/weights", interface.weights.astype(float), "share of each node (area in m2, or 1)")
    out.put("inputs/interface_index", index, "per column of input_matrix: place in /interface_names from 0")
    out.put("inputs/component", component, "degree of freedom: 0..2 along x, y, z; 3..5 about them")
    out.put("inputs/node_id", node, "label of the node of a direct interface, -1 for a frame")


def _write_one(out: _Writer, body: ElasticBody, progress: Progress) -> None:
    """One body, its basis block by block, and its shapes for ParaView."""
    from morembs.body.stress_shapes import write_recovery
    from morembs.reducers.base import MODE_KINDS

    group, reduced = f"bodies/{body.name}", body.reduced
    about = "reduced matrix, symmetric" if reduced.symmetric else "reduced matrix, not symmetric"
    for name, matrix in zip(_MATRICES, (reduced.M, reduced.K, reduced.D), strict=True):
        out.put(f"{group}/{name}", matrix, about)
    turned = "; the transpose gives the motions" if reduced.symmetric else ""
    out.put(f"{group}/input_matrix", reduced.B, f"forces on the coordinates{turned}")
    out.put(f"{group}/frequencies_hz", body.frequencies_hz, "eigenfrequencies, undamped, ascending", "Hz")
    if body.full_frequencies_hz is not None:
        full = body.full_frequencies_hz
        out.put(f"{group}/full_frequencies_hz", full, "those of the full model as far as computed", "Hz")
    codes = np.array([MODE_KINDS.index(kind) for kind in reduced.mode_kind], dtype=np.uint8)
    out.put(f"{group}/mode_kind", codes, "kind of each coordinate, code of /mode_kinds")
    out.put(f"{group}/rigid_count", reduced.rigid_count, "number of rigid-body motions")
    out.put(f"{group}/recipe", json_text(body.recipe), "options of the reduction, as JSON")
    if not reduced.symmetric:
        out.put(f"{group}/output_matrix", reduced.C, "interface degrees of freedom; not the transpose of input_matrix")
    if body.certificate is not None:
        write_certificate(out.put, f"{group}/certificate", body.certificate)
    if body.floating is not None:
        write_frame(out.put, f"{group}/floating_frame", body.floating)
        write_ranking(out.put, f"{group}/ranking", body.ranking)
    if body.switching is not None:
        write_switching(out.put, f"{group}/switching", body.switching)
    if body.recovery is not None:
        out.safe.doing = f"{group}/recovery"
        recovery = out.file.create_group(f"{group}/recovery")
        write_recovery(recovery, body.recovery, out.safe.check, body.part.transformation)
    rows, count = 3 * len(body.part.nodes), reduced.order
    chunks = (min(rows, CHUNK_ROWS), 1) if rows and count else None
    out.safe.doing = f"{group}/basis"
    data = out.file.create_dataset(f"{group}/basis", (rows, count), np.float64, chunks=chunks)
    out.mark(data, "row 3 i + c: displacement of node i along axis c per unit of each coordinate")
    step = max(1, BLOCK_BYTES // (8 * max(1, rows)))
    for start in range(0, count, step):
        stop = min(start + step, count)
        block = body.basis(slice(start, stop))
        for column in range(start, stop):
            data[:, column] = block[:, column - start]
            out.safe.check()
        del block
        progress.update(f"{body.name}: {stop} of {count} modes written")
    out.safe.doing = f"mode shapes of {body.name} for ParaView"
    modes = vtkhdf.shown_modes(reduced)
    shown = body.frequencies_hz[reduced.rigid_count :][: modes.shape[1]]
    vtkhdf.write_modes(out.file["VTKHDF"], body.name, data, modes, shown, out.safe.check)


def read_body(path: str | Path, *, whole: bool = False) -> StoredBodies:
    """Read a body file; bases stay in it until asked for.

    Args:
        whole: compare everything with its checksums now, also bases, stress shapes, static modes of candidate loads
            and shapes for ParaView, which otherwise are compared when they are read.

    Raises:
        InputError: no such file, not a body file, written by a newer version, damaged or incomplete.
    """
    place = Path(path)

    def read_basis(name: str, columns: slice) -> Floats:
        with _opened(place) as file:
            return basis_columns(file[f"bodies/{name}/basis"], columns)

    def switching(name: str) -> Switching:
        with _opened(place) as file:
            checksums.Checksums(place, file).verify(lambda one: one.startswith(f"bodies/{name}/switching/"))
            return read_switching(file[f"bodies/{name}/switching"])

    with _opened(place) as file:
        check_file(place, file)
        checksums.Checksums(place, file).verify(lambda name: whole or not _LATER.match(name))
        if "provenance" in file:
            checksums.Checksums(place, file["provenance"]).verify()
        return stored_bodies(file, read_basis, switching)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The HDF5 file, open for reading, once it is known to be a body file of a known version."""
    with reading(path, "a body file") as file:
        _refuse_other(path, file)
        yield file


def _refuse_other(path: Path, file: Any) -> None:
    """Only body files, and none from the future."""
    found = file.get("format")
    if not isinstance(found, h5py.Dataset) or found.shape != () or found[()] != FORMAT.encode():
        raise InputError(f"{path} is an HDF5 file but not a body file of morembs (no /format {FORMAT!r})")
    refuse_missing(path, file, ["format_version"])
    refuse_newer(path, int(file["format_version"][()]), FORMAT_VERSION)


__all__ = [
    "FORMAT", "FORMAT_VERSION", "StoredBodies", "StoredBody", "StoredInterface", "check_names",
    "check_writable", "read_body", "write_body",
]  # fmt: skip
