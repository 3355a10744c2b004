"""The HDF5 file of elastic bodies, described in docs/schema.md: written whole or not at all, read lazily."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.former_names import with_progress_argument
from morembs.base.types import Floats
from morembs.body import tables, vtkhdf
from morembs.body.delivery_check import refuse_unsound, stored_findings
from morembs.body.stored import StoredBodies, StoredBody, StoredInterface, basis_columns, stored_bodies
from morembs.body.stored_check import check_file
from morembs.body.tables import BLOCK_BYTES, FORMAT, FORMAT_VERSION, SKEW_PARTS
from morembs.storage import checksums
from morembs.storage.hdf5 import reading_format
from morembs.storage.table import Table, read_rows
from morembs.version import VERSION

if TYPE_CHECKING:
    from morembs.body.body import ElasticBody, Part
    from morembs.body.parametric import ParametricBody
    from morembs.body.vtkhdf_series import View
    from morembs.storage.writer import Writer

# What is compared with its checksums when it is read.
_LATER = re.compile(r"VTKHDF|bodies/[^/]+/(recovery|switching|parametric|basis/)")


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


@with_progress_argument
def write_body(
    path: str | Path,
    bodies: Sequence[ElasticBody],
    *,
    recipe: Mapping[str, object] | None = None,
    provenance: Mapping[str, object] | None = None,
    warnings: Sequence[str] = (),
    block_bytes: int = BLOCK_BYTES,
) -> Path:
    """Write bodies of one part; an interrupted or failed run leaves the old file or none.

    Holds one block of basis columns (``block_bytes``, at least one column) besides the bodies themselves.

    Args:
        recipe: what was asked for (the job); by default the source and the options of each body.
        provenance: where the file comes from, any nested names and values; ``created`` and
            ``morembs_version`` are added where they are missing. Nothing outside /provenance depends on it.
        warnings: what the examination of the model and the bodies warned of, in addition to those of the model itself.

    Raises:
        InputError: no bodies, bodies of different parts, or names that cannot be stored.
        OutputError: the file cannot be written (folder missing or read-only, disk full).

    >>> write_body("bar.h5", [body]).name
    'bar.h5'
    """
    # Not at the top: what reads does without.
    from morembs.storage.writer import writing

    if not isinstance(bodies, Sequence):
        raise InputError(f"{type(bodies).__name__} was given; expected a list of bodies, such as [body]")
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
    # Checksums of /provenance apart, as nothing outside depends on it.
    with writing(target, apart=["provenance"]) as out:
        sentences = list(dict.fromkeys((*part.warnings, *warnings)))
        out.rows("", tables.FILE, _shared(part, bodies, recipe) | {"warnings": sentences})
        out.file.create_group("interfaces")
        for interface in part.interfaces:
            values = vars(interface) | {"node_ids": part.node_ids[interface.nodes], "forces": interface.forces or None}
            out.rows(f"interfaces/{interface.name}/", tables.INTERFACE, values)
        out.doing("the mesh for ParaView")
        vtkhdf.write_grid(out.file.create_group("VTKHDF"), out.file["nodes/coordinates"], part.cells)
        out.check()
        for body in bodies:
            _write_one(out, body, block_bytes)
        stamp = {"created": datetime.now(UTC).isoformat(timespec="seconds"), "morembs_version": VERSION}
        given = {f"{key}_" if key == checksums.GROUP else key: value for key, value in (provenance or {}).items()}
        out.tree("provenance", {**stamp, **given})
    return target


def _shared(part: Part, bodies: Sequence[ElasticBody], recipe: Mapping[str, object]) -> dict[str, object]:
    """Values of everything that the bodies share, by the fields of ``tables.FILE``."""
    from morembs.body.body import input_columns
    from morembs.reducers.base import MODE_KINDS

    index, component, node = input_columns(part.interfaces, part.columns, part.node_ids)
    # Readers of version 1 take the transposed input matrix for the motions, those of version 2 where that is right also
    # symmetric matrices for granted.
    version = max(1 if body.reduced.symmetric else SKEW_PARTS if body.reduced.congruent else 2 for body in bodies)
    return {
        "format": FORMAT,
        "format_version": version,
        "unit_system": "SI",
        "body_names": [body.name for body in bodies],
        "mode_kinds": MODE_KINDS,
        "recipe": recipe,
        "interface_names": [interface.name for interface in part.interfaces],
        "mass": part.mass,
        "center_of_mass": part.center_of_mass,
        "inertia": part.inertia,
        "node_ids": part.nodes.ids,
        "coordinates": part.nodes.xyz,
        "input_interface": index,
        "input_component": component,
        "input_node_id": node,
    }


def _write_one(out: Writer, body: ElasticBody, block_bytes: int) -> None:
    """One body, its basis block by block, and its shapes for ParaView."""
    from morembs.body.stress_shapes import recovery_parts
    from morembs.reducers.base import MODE_KINDS
    from morembs.storage.writer import Columns

    at, reduced = f"bodies/{body.name}/", body.reduced
    rows, count = 3 * len(body.part.nodes), reduced.order

    def basis() -> Iterator[Floats]:
        step = max(1, block_bytes // (8 * max(1, rows)))
        for start in range(0, count, step):
            stop = min(start + step, count)
            yield body.basis(slice(start, stop))
            progress.update(f"{body.name}: {stop} of {count} modes written")

    out.rows(
        at,
        tables.BODY if reduced.symmetric else tables.UNSYMMETRIC,
        {
            "mass_matrix": reduced.M,
            "stiffness_matrix": reduced.K,
            "damping_matrix": reduced.D,
            "input_matrix": reduced.B,
            "output_matrix": None if reduced.symmetric else reduced.C,
            "basis": Columns((rows, count), np.float64, basis()),
            "frequencies_hz": body.frequencies_hz,
            "full_frequencies_hz": body.full_frequencies_hz,
            "mode_kind": [MODE_KINDS.index(kind) for kind in reduced.mode_kind],
            "rigid_count": reduced.rigid_count,
            "recipe": body.recipe,
            "certificate": body.certificate,
            "floating": body.floating,
            "ranking": body.ranking or None,
            "recovery": body.recovery and recovery_parts(body.recovery, body.part.transformation),
            "switching": body.switching,
            "parametric": body.parametric,
            "spin": None
            if body.spin is None
            else replace(body.spin, elongation=body.part.transformation @ body.spin.elongation),
        },
    )
    out.doing(f"mode shapes of {body.name} for ParaView")
    modes = vtkhdf.shown_modes(reduced)
    shown = body.frequencies_hz[reduced.rigid_count :][: modes.shape[1]]
    vtkhdf.write_modes(out.file["VTKHDF"], body.name, out.file[f"{at}basis"], modes, shown, out.check)


def read_body(path: str | Path, *, whole: bool = False) -> StoredBodies:
    """Read a body file; bases stay in it until asked for. Each body is examined: what its file says of it has to be
    what follows from its matrices.

    Args:
        whole: compare everything with its checksums now, also bases, stress shapes, static modes of candidate loads
            and shapes for ParaView, which otherwise are compared when they are read.

    Raises:
        InputError: no such file, not a body file, written by a newer version, damaged or incomplete, or a body that
            contradicts itself.

    >>> path = write_body("bar.h5", [body])
    >>> read_body(path)
    StoredBodies: bodies craig-bampton (order 18); mass 7.85 kg; nodes 20; interfaces LEFT, RIGHT
    """
    stored = read_unexamined(path, whole=whole)
    refuse_unsound(path, stored_findings(stored))
    return stored


def read_unexamined(path: str | Path, *, whole: bool = False) -> StoredBodies:
    """Read a body file as ``read_body`` does, to show what is in it: its bodies may contradict themselves.

    Raises:
        InputError: as ``read_body``, but for that.
    """
    place = Path(path)

    opened = partial(reading_format, place, "a body file", FORMAT, FORMAT_VERSION)

    def read_basis(name: str, columns: slice) -> Floats:
        with opened() as file:
            return basis_columns(file[f"bodies/{name}/basis"], columns)

    def part(name: str, kind: str, table: Table) -> Any:
        with opened() as file:
            checksums.Checksums(place, file).verify(lambda row: row.startswith(f"bodies/{name}/{kind}/"))
            return read_rows(file[f"bodies/{name}/{kind}"], table, f"the {kind} data lack")

    def parametric(name: str) -> ParametricBody:
        # Not at the top: most who read a file do not evaluate it.
        from morembs.body.parametric import ParametricBody

        return ParametricBody(place, stored, stored.bodies[name], part(name, "parametric", tables.PARAMETRIC))

    def view(body: StoredBody, modes: int) -> View:
        # Not at the top: most who read a file do not look at shapes.
        from morembs.body.vtkhdf_series import View, read_grid, stored_modes

        grid, motion = read_grid(place), stored_modes(place, body.name, modes)
        return View(
            body=body.name,
            grid=grid,
            node_ids=stored.node_ids,
            motion=motion,
            frequencies_hz=body.frequencies_hz[body.rigid_count :][: len(motion)],
            interfaces={name: interface.point for name, interface in stored.interfaces.items()},
        )

    with opened() as file:
        check_file(place, file)
        checksums.Checksums(place, file).verify(lambda name: whole or not _LATER.match(name))
        if "provenance" in file:
            checksums.Checksums(place, file["provenance"]).verify()
        stored = stored_bodies(
            file,
            read_basis=read_basis,
            read_view=view,
            read_parametric=parametric,
            read_switching=partial(part, kind="switching", table=tables.SWITCHING),
        )
    return stored


__all__ = [
    "FORMAT",
    "FORMAT_VERSION",
    "StoredBodies",
    "StoredBody",
    "StoredInterface",
    "check_names",
    "read_body",
    "write_body",
]
