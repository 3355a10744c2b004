"""Members with large deflections in a file, both ways: the group ``parameterised`` of a body.

Equations and an evaluator that needs nothing but these datasets are in docs/gmp.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from morembs.base.errors import InputError
from morembs.dynamics.gmp.chebyshev import ChebyshevTable
from morembs.dynamics.gmp.data import Formulation, Parameterised
from morembs.dynamics.gmp.fields import Fields
from morembs.storage.checksums import Checksums
from morembs.storage.hdf5 import is_format, reading, refuse_newer
from morembs.storage.table import Row, Table, read_rows
from morembs.storage.table_check import TableCheck
from morembs.storage.writer import writing


class MemberFormat:
    """Format of files of ``write_members``."""

    NAME = "morembs-members"
    VERSION = 1


_FORMULATIONS = ", ".join(get_args(Formulation))
_FIELDS = (
    Row("U", "real", "n r", "functions over the nodes, of the x and of the y of positions"),
    Row("Ur", "real", "nr rr", "functions over the nodes, of rotations"),
    Row("translations", "whole", "n 2", "per node: coordinates of the component that are its x and y"),
    Row("turning", "whole", "nr", "per node: coordinate of the component that is its rotation"),
    Row("one", "real", "r", "amplitudes of U for a unit translation"),
    Row("turn", "real", "rr", "amplitudes of Ur for a unit turn"),
    Row("M", "real", "p p", "mass matrix of the amplitudes: x, y, rotations", "kg, kg m2"),
)
_COEFFICIENTS = "coefficients of Chebyshev polynomials: "


def _member(formulation: Formulation, reach: float, table: Any, energy: Any, **values: Any) -> Parameterised:
    fields = Fields(**{row.name: values.pop(row.name) for row in _FIELDS})
    return Parameterised(
        formulation=formulation,
        reach=reach,
        fields=fields,
        table=ChebyshevTable(reach=reach, coefficients=table),
        energy=ChebyshevTable(reach=reach, coefficients=energy, curved=True),
        **values,
    )


def _member_parts(data: Parameterised) -> Mapping[str, object]:
    tables = {"table": data.table.coefficients, "energy": data.energy.coefficients}
    return vars(data) | vars(data.fields) | tables


MEMBER = Table(
    (
        Row("formulation", "text", "", f"one of {_FORMULATIONS}"),
        Row(
            "reach",
            "real",
            "",
            "largest angle t1, t2 of an end to the chord; beyond it the tables are no more than extended",
            "rad",
        ),
        Row("length", "real", "", "distance of the frames without load", "m"),
        Row("count", "whole", "", "bending modes in use; the others only tell what they would have answered"),
        *_FIELDS,
        Row("Psi", "real", "p k", "amplitudes of the bending modes, Psi' M Psi = 1"),
        Row("peaks", "real", "k", "largest deflection of each mode"),
        Row("squares", "real", "k", "their angular frequencies squared", "1/s2"),
        Row("H0", "real", "k", "diagonal of H at the straight shape"),
        Row("excluded", "real", "any", "angular frequencies squared of modes of stretching that were left out", "1/s2"),
        Row("errors", "real", "2", "of derivatives of the tables: against constraint modes, against reactions"),
        Row(
            "table",
            "real",
            "c c s",
            f"{_COEFFICIENTS}[i, j] times T_i(t1 / reach) T_j(t2 / reach): X, A, d0, k, c, H in a row",
        ),
        Row("energy", "real", "ce ce", f"{_COEFFICIENTS}the same for W, in J"),
    ),
    build=_member,
    parts=_member_parts,
)
_MEMBERS = Table(
    (
        Row("format", "text", when="files of 0.1.0 lack it"),
        Row("format_version", "whole", when="files of 0.1.0 lack it"),
        Row("bodies/*", Table((Row("parameterised", MEMBER),))),
    )
)


def _checked(path: Path, group: Any) -> Parameterised:
    """A member from its open HDF5 ``group``.

    Raises:
        InputError: a dataset is missing, holds what is no finite number, or is of another size than the others say.
    """
    check, at = TableCheck(path, group.file, "member"), f"{group.name.lstrip('/')}/"
    check.table(at, MEMBER, {})
    data: Parameterised = read_rows(group, MEMBER)
    if data.formulation not in get_args(Formulation):
        raise check.refuse(f"{at}formulation", f"is {data.formulation!r}", f"one of {_FORMULATIONS}")
    size, every = data.fields.size, len(data.squares)
    if not 0 <= data.count <= every:
        raise check.refuse(f"{at}count", f"is {data.count}", f"0 to {every}, the length of squares")
    for name, columns in (("M", size), ("table", 2 * size + 2 + every + data.count**2)):
        if group[name].shape[-1] != columns:
            raise check.refuse(f"{at}{name}", f"has the shape {group[name].shape}", f"{columns} along the last axis")
    return data


def write_members(path: str | Path, members: Mapping[str, Parameterised]) -> Path:
    """A file with one group bodies/NAME/parameterised for each member; the old file stays if that fails.

    Raises:
        InputError: no member, a name that HDF5 cannot hold.
        OutputError: the file cannot be written.
    """
    target = Path(path)
    if not members:
        raise InputError("there is no member to write; give at least one")
    wrong = [name for name in members if not name or "/" in name or name == "." or "\0" in name]
    if wrong:
        raise InputError(f"{wrong[0]!r} was given as the name of a member; expected one without slashes")
    with writing(target) as out:
        bodies = {name: {"parameterised": data} for name, data in members.items()}
        out.rows("", _MEMBERS, {"format": MemberFormat.NAME, "format_version": MemberFormat.VERSION, "bodies": bodies})
    return target


def read_members(path: str | Path) -> dict[str, Parameterised]:
    """All members of a file that ``write_members`` wrote.

    Raises:
        InputError: no such file, none with members, or one of a newer version.
    """
    with reading(Path(path), "a file of write_members") as file:
        # Files of 0.1.0 have neither; those of other kinds have versions of their own.
        if is_format(file, MemberFormat.NAME):
            refuse_newer(Path(path), int(file["format_version"][()]), MemberFormat.VERSION)
        bodies = {name: body for name, body in file.get("bodies", {}).items() if "parameterised" in body}
        members = {name: _checked(Path(path), body["parameterised"]) for name, body in bodies.items()}
        if not members:
            raise InputError(f"{path} holds no group bodies/NAME/parameterised; expected a file of write_members")
        Checksums(path, file).verify()
    return members
