"""Members with large deflections in a file, both ways: the group ``parameterised`` of a body.

Equations and an evaluator that needs nothing but these datasets are in docs/gmp.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import h5py
import numpy as np

from morembs.errors import InputError
from morembs.gmp.chebyshev import Table
from morembs.gmp.data import Formulation, Parameterised
from morembs.gmp.fields import Fields
from morembs.storage.checksums import Checksums, seal
from morembs.storage.hdf5 import reading, refuse_newer
from morembs.storage.safefile import replacing
from morembs.storage.storable import storable

FORMAT, FORMAT_VERSION = "morembs-members", 1
# Stores one dataset: name, value, what it is, its units.
Put = Callable[..., None]
_NUMBERS = {
    "reach": ("largest angle t1, t2 of an end to the chord; beyond it the tables are no more than extended", "rad"),
    "length": ("distance of the frames without load", "m"),
    "count": ("bending modes in use; the others only tell what they would have answered", ""),
}
_FIELDS = {
    "U": ("functions over the nodes, of the x and of the y of positions", ""),
    "Ur": ("functions over the nodes, of rotations", ""),
    "translations": ("per node: coordinates of the component that are its x and y", ""),
    "turning": ("per node: coordinate of the component that is its rotation", ""),
    "one": ("amplitudes of U for a unit translation", ""),
    "turn": ("amplitudes of Ur for a unit turn", ""),
    "M": ("mass matrix of the amplitudes: x, y, rotations", "kg, kg m2"),
}
_MODES = {
    "Psi": ("amplitudes of the bending modes, Psi' M Psi = 1", ""),
    "peaks": ("largest deflection of each mode", ""),
    "squares": ("their angular frequencies squared", "1/s2"),
    "H0": ("diagonal of H at the straight shape", ""),
    "excluded": ("angular frequencies squared of modes of stretching that were left out", "1/s2"),
    "errors": ("of derivatives of the tables: against constraint modes, against reactions", ""),
}
_TABLES = {
    "table": "[i, j] times T_i(t1 / reach) T_j(t2 / reach): X, A, d0, k, c, H in a row",
    "energy": "the same for W, in J",
}


def write_parameterised(put: Put, group: str, its: Parameterised) -> None:
    """Store ``its`` under ``group`` with ``put(name, value, about, units)``."""
    put(f"{group}/formulation", its.formulation, f"one of {', '.join(get_args(Formulation))}")
    for names, source in ((_NUMBERS, its), (_FIELDS, its.fields), (_MODES, its)):
        for name, (about, units) in names.items():
            put(f"{group}/{name}", getattr(source, name), about, units)
    for name, about in _TABLES.items():
        put(f"{group}/{name}", getattr(its, name).coefficients, f"coefficients of Chebyshev polynomials: {about}")


def read_parameterised(group: Any) -> Parameterised:
    """What ``write_parameterised`` wrote, from an open HDF5 ``group``.

    Raises:
        InputError: a dataset is missing, holds what is no finite number, or is of another size than the others say.
    """
    names = ("formulation", *_NUMBERS, *_FIELDS, *_MODES, *_TABLES)
    missing = [name for name in names if not hasattr(group.get(name), "shape")]
    if missing:
        raise InputError(f"the data of a member lack {', '.join(missing)}; write the file again")
    formulation = group["formulation"][()].decode()
    if formulation not in get_args(Formulation):
        raise InputError(f"formulation {formulation!r} was found; expected one of {', '.join(get_args(Formulation))}")
    reach, length, count = float(group["reach"][()]), float(group["length"][()]), int(group["count"][()])
    value = {name: group[name][()] for name in (*_FIELDS, *_MODES, *_TABLES)}
    for name, numbers in {**value, "reach": reach, "length": length}.items():
        if np.asarray(numbers).dtype.kind not in "iuf" or not np.isfinite(numbers).all():
            raise InputError(f"{name} of a member holds what is no finite number; write the file again")
    if value["U"].ndim != 2 or value["Ur"].ndim != 2:
        raise InputError("U or Ur of a member is no table of functions over the nodes; write the file again")
    fields = Fields(**{name: value[name] for name in _FIELDS})
    every = len(value["squares"])
    expected = {
        "translations": (len(fields.U), 2), "turning": (len(fields.Ur),), "one": fields.U.shape[1:],
        "turn": fields.Ur.shape[1:],
        "M": (fields.size, fields.size), "Psi": (fields.size, every), "peaks": (every,), "H0": (every,), "errors": (2,),
        "table": (*(2 * value["table"].shape[:1]), 2 * fields.size + 2 + every + count**2),
        "energy": 2 * value["energy"].shape[:1],
    }  # fmt: skip
    for name, shape in expected.items():
        if value[name].shape != shape or count > every:
            raise InputError(f"{name} of a member has the shape {value[name].shape}; expected {shape}. Write it again")
    return Parameterised(
        formulation=formulation, reach=reach, length=length, count=count, fields=fields,
        table=Table(reach=reach, coefficients=value["table"]),
        energy=Table(reach=reach, coefficients=value["energy"], curved=True),
        **{name: value[name] for name in _MODES},
    )  # fmt: skip


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
    with replacing(target) as safe, h5py.File(safe, "w", libver=("earliest", "v108"), rdcc_nbytes=0) as file:

        def put(name: str, value: object, about: str, units: str = "") -> None:
            safe.doing = name
            data = file.create_dataset(name, data=storable(value))
            for key, words in (("description", about), ("units", units)):
                if words:
                    data.attrs[key] = np.bytes_(words)
            safe.check()

        put("format", FORMAT, "")
        put("format_version", FORMAT_VERSION, "")
        for name, its in members.items():
            write_parameterised(put, f"bodies/{name}/parameterised", its)
        safe.doing = "the checksums"
        seal(file)
        safe.check()
    return target


def read_members(path: str | Path) -> dict[str, Parameterised]:
    """All members of a file that ``write_members`` wrote.

    Raises:
        InputError: no such file, none with members, or one of a newer version.
    """
    with reading(Path(path), "a file of write_members") as file:
        # Files of 0.1.0 have neither; those of other kinds have versions of their own.
        if "format" in file and file["format"][()] == FORMAT.encode():
            refuse_newer(Path(path), int(file["format_version"][()]), FORMAT_VERSION)
        bodies = file.get("bodies", {})
        found = {name: read_parameterised(b["parameterised"]) for name, b in bodies.items() if "parameterised" in b}
        if not found:
            raise InputError(f"{path} holds no group bodies/NAME/parameterised; expected a file of write_members")
        Checksums(path, file).verify()
    return found
