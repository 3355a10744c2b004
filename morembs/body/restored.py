"""A body that was read, and perhaps changed, as a file again: its basis and mesh are taken from where it came."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body import tables, vtkhdf
from morembs.body.stored import StoredBodies, StoredBody
from morembs.body.tables import BLOCK_BYTES, FORMAT
from morembs.body.vtkhdf_series import Grid, read_grid
from morembs.reducers.base import MODE_KINDS
from morembs.storage.safefile import one_file
from morembs.storage.writer import Columns, writing
from morembs.version import VERSION


def write_stored(path: str | Path, bodies: StoredBodies, body: StoredBody, source: Path) -> Path:
    """Write the one ``body`` of ``bodies``, whose basis and cells are those of the file ``source``.

    Holds one block of basis columns. What belongs to one load or one value (certificate, stress, static modes of
    candidate loads, parameters) is left out.

    Raises:
        InputError: ``path`` is the source.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    if one_file(target, source):
        raise InputError(f"{target} would overwrite the body file itself; give another name")
    rows, count = 3 * len(bodies.coordinates), len(body.mass_matrix)
    step = max(1, BLOCK_BYTES // (8 * max(1, rows)))

    def basis() -> Iterator[Floats]:
        for start in range(0, count, step):
            yield body.basis(slice(start, min(start + step, count)))

    with writing(target, apart=["provenance"]) as out:
        out.rows("", tables.FILE, _shared(bodies, body))
        out.file.create_group("interfaces")
        for name, interface in bodies.interfaces.items():
            out.rows(f"interfaces/{name}/", tables.INTERFACE, vars(interface) | {"forces": interface.forces or None})
        out.doing("the mesh for ParaView")
        vtkhdf.write_grid(out.file.create_group("VTKHDF"), out.file["nodes/coordinates"], _cells(read_grid(source)))
        at, empty = f"bodies/{body.name}/", dict.fromkeys(("certificate", "recovery", "switching", "parametric"))
        out.rows(
            at,
            tables.BODY,
            vars(body)
            | empty
            | {
                "output_matrix": None,
                "basis": Columns((rows, count), np.float64, basis()),
                "mode_kind": [MODE_KINDS.index(kind) for kind in body.mode_kind],
                "ranking": body.ranking or None,
            },
        )
        out.doing(f"mode shapes of {body.name} for ParaView")
        modes = vtkhdf.shown_modes(body.reduced())
        shown = body.frequencies_hz[body.rigid_count :][: modes.shape[1]]
        vtkhdf.write_modes(out.file["VTKHDF"], body.name, out.file[f"{at}basis"], modes, shown, out.check)
        stamp = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "morembs_version": VERSION}
        out.tree("provenance", {**stamp, "source": source.name})
    return target


def _shared(bodies: StoredBodies, body: StoredBody) -> Mapping[str, Any]:
    """Values of everything but the body, by the fields of ``tables.FILE``."""
    return vars(bodies) | {
        "format": FORMAT,
        "format_version": 1,
        "unit_system": "SI",
        "body_names": [body.name],
        "mode_kinds": MODE_KINDS,
        "interface_names": list(bodies.interfaces),
    }


def _cells(grid: Grid) -> list[vtkhdf.Cells]:
    """The cells of a grid, in runs of one type."""
    # No type has the code 0.
    starts = np.flatnonzero(np.diff(grid.types.astype(np.int64), prepend=0))
    ends = np.append(starts[1:], len(grid.types))
    return [
        vtkhdf.Cells(
            vtk=int(grid.types[first]),
            connectivity=grid.connectivity[grid.offsets[first] : grid.offsets[last]].reshape(last - first, -1),
        )
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
