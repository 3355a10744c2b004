"""Members with large deflections in a file, both ways: the group ``parameterised`` of a body.

Equations are in docs/background/gmp_equations.md, an evaluator that needs only these datasets in
docs/reference/member_file.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from morembs.base.errors import InputError
from morembs.dynamics.gmp.chebyshev import ChebyshevTable
from morembs.dynamics.gmp.data import Parameterised
from morembs.storage.checksums import GROUP, Checksums
from morembs.storage.hdf5 import MEMBERS, is_format, reading, refuse_newer, tree
from morembs.storage.table import Row, Table, read_rows, table_of
from morembs.storage.table_check import TableCheck
from morembs.storage.writer import writing


class MemberFormat:
    """Format of files of ``write_members``."""

    NAME = MEMBERS
    VERSION = 1


def _member(reach: float, table: Any, energy: Any, **own: Any) -> Parameterised:
    return Parameterised(
        reach=reach,
        table=ChebyshevTable(reach=reach, coefficients=table),
        energy=ChebyshevTable(reach=reach, coefficients=energy, curved=True),
        **own,
    )


MEMBER = table_of(Parameterised, build=_member)
_MEMBERS = Table(
    (
        Row("format", "text", when="files of 0.1.0 lack it"),
        Row("format_version", "whole", when="files of 0.1.0 lack it"),
        Row("recipe", "json", when="of members of jobs, since 0.2", doc="what was asked for, as JSON"),
        Row("bodies/*", Table((Row("parameterised", MEMBER),))),
    )
)


def _read_checked(path: Path, group: Any) -> Parameterised:
    """A member from its open HDF5 ``group``.

    Raises:
        InputError: a dataset is missing, holds what is no finite number, or is of another size than the others say.
    """
    check, at = TableCheck(path, group.file, "member"), f"{group.name.lstrip('/')}/"
    check.table(at, MEMBER, {})
    data: Parameterised = read_rows(group, MEMBER)
    size, every = data.fields.size, len(data.squares)
    for name, columns in (("M", size), ("table", 2 * size + 2 + every + data.count**2)):
        if group[name].shape[-1] != columns:
            raise check.refuse(f"{at}{name}", f"has the shape {group[name].shape}", f"{columns} along the last axis")
    return data


def write_members(
    path: str | Path,
    members: Mapping[str, Parameterised],
    *,
    recipe: Mapping[str, object] | None = None,
    provenance: Mapping[str, object] | None = None,
) -> Path:
    """A file with one group bodies/NAME/parameterised for each member; the old file stays if that fails.

    Args:
        recipe: what was asked for (the job).
        provenance: where the file comes from, any nested names and values, beside time and version; nothing else in
            the file depends on it. None: the file has none.

    Raises:
        InputError: no member, a name that HDF5 cannot hold.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    if not members:
        raise InputError("there is no member to write; give at least one", kind="missing", keyword="members")
    wrong = [name for name in members if not name or "/" in name or name == "." or "\0" in name]
    if wrong:
        raise InputError(
            f"{wrong[0]!r} was given as the name of a member; expected one without slashes", keyword="name"
        )
    # Checksums of /provenance apart, as nothing outside depends on it.
    with writing(target, excluded=[] if provenance is None else ["provenance"]) as out:
        bodies = {name: {"parameterised": data} for name, data in members.items()}
        head = {"format": MemberFormat.NAME, "format_version": MemberFormat.VERSION, "recipe": recipe}
        out.rows("", _MEMBERS, {**head, "bodies": bodies})
        if provenance is not None:
            out.provenance(provenance)
    return target


def read_members(path: str | Path) -> dict[str, Parameterised]:
    """All members of a file that ``write_members`` wrote.

    Args:
        path: member file.

    Raises:
        InputError: no such file, none with members, or one of a newer version.
    """
    with reading(Path(path), "a file of write_members") as file:
        # Files of 0.1.0 have neither; those of other kinds have versions of their own.
        if is_format(file, MemberFormat.NAME):
            refuse_newer(Path(path), int(file["format_version"][()]), MemberFormat.VERSION)
        bodies = {name: body for name, body in file.get("bodies", {}).items() if "parameterised" in body}
        members = {name: _read_checked(Path(path), body["parameterised"]) for name, body in bodies.items()}
        if not members:
            raise InputError(
                f"{path} holds no group bodies/NAME/parameterised; expected a file of write_members",
                kind="file",
                keyword=Path(path).name,
            )
        Checksums(path, file).verify()
    return members


def read_origin(path: str | Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What was asked for and where the file comes from, by the names of its job; empty where it does not say.

    Raises:
        InputError: no such file, or one that is damaged.
    """
    with reading(Path(path), "a file of write_members") as file:
        recipe = json.loads(file["recipe"][()]) if "recipe" in file else {}
        if "provenance" in file:
            Checksums(path, file["provenance"]).verify()
        return recipe, {name: item for name, item in tree(file.get("provenance", {})).items() if name != GROUP}
