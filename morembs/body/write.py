"""Bodies to a file, described in docs/reference/schema.md: written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body import vtkhdf
from morembs.body.body import BODY, UNSYMMETRIC, Body
from morembs.body.stored import FILE, INTERFACE, FormatVersion, StoredBodies
from morembs.storage.checksums import GROUP
from morembs.storage.safefile import one_file
from morembs.storage.tolerances import TOL as STORAGE

if TYPE_CHECKING:
    from morembs.body.part import Part
    from morembs.body.vtkhdf_series import Grid
    from morembs.storage.writer import Writer


def check_names(names: Sequence[str], what: str = "body") -> None:
    """Check that ``names`` can name groups of a file.

    Raises:
        InputError: an empty name, one with a slash or a control character, or one that comes twice.
    """
    for name in names:
        if not name.isprintable() or name.strip(".") == "" or "/" in name:
            raise InputError(
                f"{what} name {name!r} cannot be stored; take a name without slashes and control characters, "
                "not empty and not only dots",
                keyword="name",
            )
        if list(names).count(name) > 1:
            raise InputError(
                f"the {what} name {name!r} was given more than once; give each its own name",
                kind="conflict",
                keyword="name",
            )


def write_body(
    path: str | Path,
    bodies: Sequence[Body],
    *,
    recipe: Mapping[str, object] | None = None,
    provenance: Mapping[str, object] | None = None,
    warnings: Sequence[str] = (),
    block_bytes: int = STORAGE.block_bytes,
) -> Path:
    """Write bodies of one part; an interrupted or failed run leaves the old file or none.

    Holds one block of basis columns (``block_bytes``, at least one column) besides the bodies themselves.

    Args:
        recipe: settings of the reduction, such as the job; by default the source and the options of each body.
        provenance: origin of the file, as nested names and values. Missing values of ``created`` and
            ``morembs_version`` are added. No data outside /provenance depend on it.
        warnings: warnings about the bodies, stored together with the warnings of the model.

    Raises:
        InputError: no bodies, bodies of different parts, or names that cannot be stored.
        OutputError: the file cannot be written (folder missing or read-only, disk full).

    >>> write_body("bar.h5", [body]).name
    'bar.h5'
    """
    if not isinstance(bodies, Sequence):
        raise InputError(
            f"bodies = one {type(bodies).__name__} was given; expected a list of bodies, such as [body]",
            keyword="bodies",
        )
    if not bodies:
        raise InputError("there is no body to write; give at least one", kind="missing", keyword="bodies")
    for other in bodies:
        if not isinstance(other, Body):
            raise InputError(
                f"bodies = a list with one {type(other).__name__} was given; expected a list of bodies, which "
                "elastic_body(problem, reduced, part) makes",
                keyword="bodies",
            )
    part = bodies[0].part
    if any(body.part is not part for body in bodies):
        raise InputError(
            "bodies of different parts were given; write one file for each part", kind="conflict", keyword="bodies"
        )
    check_names([body.name for body in bodies])
    check_names([interface.name for interface in part.interfaces], "interface")
    if recipe is None:
        recipe = {"source": part.source, "bodies": {body.name: body.recipe for body in bodies}}
    content = _content(part, bodies, recipe, tuple(dict.fromkeys((*part.warnings, *warnings))))
    return _write(Path(path), content, part.cells, provenance or {}, block_bytes)


def _write(
    target: Path,
    content: StoredBodies,
    cells: Sequence[vtkhdf.CellBlock],
    provenance: Mapping[str, object],
    block_bytes: int,
) -> Path:
    """All of a body file, with ``provenance`` in addition to time and version."""
    # Not at the top: what reads does without.
    from morembs.storage.writer import writing

    progress.stage(f"writing {target.name}")
    # Checksums of /provenance apart, as nothing outside depends on it.
    with writing(target, excluded=["provenance"]) as out:
        out.rows("", FILE, content)
        out.file.create_group("interfaces")
        for name, interface in content.interfaces.items():
            out.rows(f"interfaces/{name}/", INTERFACE, interface)
        out.name_step("the mesh for ParaView")
        vtkhdf.write_grid(out.file.create_group("VTKHDF"), out.file["nodes/coordinates"], cells)
        out.check()
        for body in content.bodies.values():
            _write_one(out, body, block_bytes)
        out.provenance({f"{key}_" if key == GROUP else key: value for key, value in provenance.items()})
    return target


def _content(
    part: Part, bodies: Sequence[Body], recipe: Mapping[str, object], warnings: tuple[str, ...]
) -> StoredBodies:
    """What the file of some bodies of a part holds."""
    from morembs.body.part import input_columns

    index, component, node = input_columns(part.interfaces, part.columns, part.node_ids)
    # Readers of version 1 take the transposed input matrix for the motions, those of version 2 where that is right also
    # symmetric matrices for granted.
    version = max(
        FormatVersion.PLAIN
        if body.reduced.symmetric
        else FormatVersion.SKEW_PARTS
        if body.reduced.congruent
        else FormatVersion.TWO_BASES
        for body in bodies
    )
    labelled = (replace(interface, node_ids=part.node_ids[interface.nodes]) for interface in part.interfaces)
    return StoredBodies(
        format_version=version,
        recipe=recipe,
        warnings=warnings,
        mass=part.mass,
        center_of_mass=part.center_of_mass,
        inertia=part.inertia,
        node_ids=part.nodes.ids,
        coordinates=part.nodes.xyz,
        input_interface=index,
        input_component=component,
        input_node_id=node,
        interfaces={interface.name: interface for interface in labelled},
        bodies={body.name: body for body in bodies},
        provenance={},
    )


def _write_one(out: Writer, body: Body, block_bytes: int) -> None:
    """One body, its basis block by block, and its shapes for ParaView."""
    from morembs.storage.writer import Columns

    at, rows, count = f"bodies/{body.name}/", 3 * len(out.file["nodes/ids"]), len(body.mass_matrix)

    def basis() -> Iterator[Floats]:
        step = max(1, block_bytes // (8 * max(1, rows)))
        for start in range(0, count, step):
            stop = min(start + step, count)
            yield body.basis(slice(start, stop))
            progress.update(f"{body.name}: {stop} of {count} modes written")

    table = BODY if body.reduced.symmetric else UNSYMMETRIC
    out.rows(at, table, body, basis=Columns((rows, count), np.float64, basis()))
    out.name_step(f"mode shapes of {body.name} for ParaView")
    modes = vtkhdf.shown_modes(body.reduced)
    shown = body.frequencies_hz[body.rigid_count :][: modes.shape[1]]
    vtkhdf.write_modes(out.file["VTKHDF"], body.name, out.file[f"{at}basis"], modes, shown, out.check)


def write_stored(path: str | Path, bodies: StoredBodies, body: Body, source: Path) -> Path:
    """Write the one ``body`` of ``bodies``, whose basis and cells are those of the file ``source``.

    Holds one block of basis columns. What belongs to one load or one value (certificate, stress, static modes of
    candidate loads, parameters) is left out.

    Raises:
        InputError: ``path`` is the source.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    if one_file(target, source):
        raise InputError(f"{target} would overwrite the body file itself; give another name", kind="output")
    # Not at the top: what reads does without.
    from morembs.body.vtkhdf_series import read_grid

    content = replace(bodies, format_version=FormatVersion.PLAIN, bodies={body.name: body})
    return _write(target, content, _cells(read_grid(source)), {"source": source.name}, STORAGE.block_bytes)


def _cells(grid: Grid) -> list[vtkhdf.CellBlock]:
    """The cells of a grid, in runs of one type."""
    # No type has the code 0.
    starts = np.flatnonzero(np.diff(grid.types.astype(np.int64), prepend=0))
    ends = np.append(starts[1:], len(grid.types))
    return [
        vtkhdf.CellBlock(
            vtk=int(grid.types[first]),
            connectivity=grid.connectivity[grid.offsets[first] : grid.offsets[last]].reshape(last - first, -1),
        )
        for first, last in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
