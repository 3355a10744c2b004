"""What the verbs for body files do with files of planar members."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from morembs.app.cli.messages import print_json, printing
from morembs.base.errors import InputError, nearest

if TYPE_CHECKING:
    from morembs.dynamics.gmp import Configuration


def evaluate_member(file: Path, name: str | None, at: Mapping[str, float], out: Path | None, as_json: bool) -> None:
    """Print where a member is between frames that are held, and write its nodes to a .csv file.

    Raises:
        InputError: an unknown member or coordinate, another name of the file, or frames beyond the tables.
        SolverError: no equilibrium was found.
        OutputError: the file cannot be written.
    """
    # Not at the top: help needs no numbers.
    from morembs.dynamics.gmp import ReducedMember, configuration
    from morembs.dynamics.gmp.configuration import FRAME_COORDINATES
    from morembs.dynamics.gmp.stored import read_members

    members = read_members(file)
    if name is None and len(members) > 1:
        raise InputError(f"{file} holds the members {', '.join(members)}; name one of them by --body")
    chosen = next(iter(members)) if name is None else name
    if chosen not in members:
        raise InputError(f"{file} has no member {chosen!r}; {nearest(chosen, members)}", kind="unknown")
    if out is not None and out.suffix != ".csv":
        raise InputError(
            f"--out {out} was given for the nodes of a planar member; expected a name that ends in .csv",
            kind="unsupported",
            keyword="out",
        )
    found = configuration(ReducedMember.of(members[chosen]), at)
    written = [] if out is None else [str(_write_nodes(out, found))]
    frames, loads = (
        dict(zip(FRAME_COORDINATES, values.tolist(), strict=True)) for values in (found.frames, found.loads)
    )
    with printing(written):
        if as_json:
            document = {"file": str(file), "member": chosen, "at": frames, "written": written, "energy_j": found.energy}
            ends = {"end_angles_rad": found.ends.tolist(), "amplitudes": found.eta.tolist()}
            print_json([{**document, **ends, "loads": loads, "places": found.places.tolist()}])
            return
        typer.echo(f"{chosen} at " + ", ".join(f"{key} = {value:.6g}" for key, value in frames.items()) + " (m, rad)")
        typer.echo(
            f"end angles to its chord: {found.ends[0]:.6g} and {found.ends[1]:.6g} rad; "
            f"strain energy {found.energy:.6g} J"
        )
        for frame in ("start", "end"):
            x, y, moment = (loads[f"{frame}.{part}"] for part in ("x", "y", "angle"))
            typer.echo(f"what holds the {frame}: {x:.6g} and {y:.6g} N along x and y, {moment:.6g} N m")
        for path in written:
            typer.echo(f"written: {path}")


def _write_nodes(out: Path, found: Configuration) -> Path:
    """Places of the nodes, and rotations where all have one."""
    from morembs.storage.safefile import replacing

    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    turned = len(found.rotations) == len(found.places)
    rows.writerow(["x_m", "y_m", *(["rotation_rad"] if turned else [])])
    for k, place in enumerate(found.places.tolist()):
        rows.writerow([repr(value) for value in (*place, *([float(found.rotations[k])] if turned else []))])
    with replacing(out) as file:
        file.write(text.getvalue().encode())
    return out
