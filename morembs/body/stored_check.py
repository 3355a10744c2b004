"""Is a body file what docs/schema.md says? Shapes, kinds and values, before anything is made of them.

The tables name each dataset below some group, what it holds and its shape. A letter in a shape is a size that the
first dataset with it gives and all others share.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.floating.frame import FRAMES
from morembs.interface import COUPLINGS
from morembs.model.elements import FACES, TYPES

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# dataset -> what it holds, shape. "real" numbers are finite, "any" may be NaN or infinite, "later" are looked at when
# they are read; "whole", "text" and "json" say so. A name with ? may be absent, one with * stands for all in the group.
Table = Mapping[str, tuple[str, str]]
_FILE: Table = {
    "body_names": ("text", "bodies"), "interface_names": ("text", "interfaces"), "mode_kinds": ("text", "kinds"),
    "recipe": ("json", ""), "unit_system": ("text", ""), "check/warnings?": ("text", "any"),
    "nodes/ids": ("whole", "N"), "nodes/coordinates": ("real", "N 3"),
    "inputs/interface_index": ("whole", "m"), "inputs/component": ("whole", "m"), "inputs/node_id": ("whole", "m"),
    "mass_properties/mass": ("real", ""), "mass_properties/center_of_mass": ("real", "3"),
    "mass_properties/inertia": ("real", "3 3"),
}  # fmt: skip
_INTERFACE: Table = {
    "coupling": ("text", ""), "components": ("whole", "any"), "point": ("real", "3"), "axes": ("real", "3 3"),
    "node_ids": ("whole", "nodes"), "weights": ("real", "nodes"),
}  # fmt: skip
_BODY: Table = {
    "mode_kind": ("whole", "n"), "mass_matrix": ("real", "n n"), "stiffness_matrix": ("real", "n n"),
    "damping_matrix": ("real", "n n"), "input_matrix": ("real", "n m"), "output_matrix?": ("real", "m n"),
    "basis": ("later", "3N n"), "frequencies_hz": ("any", "n"), "full_frequencies_hz?": ("any", "any"),
    "rigid_count": ("whole", ""), "recipe": ("json", ""),
}  # fmt: skip
# What a body may have: group -> its table.
_PARTS: Mapping[str, Table] = {
    "ranking": {"terms": ("text", "terms"), "equations": ("text", "terms"), "share": ("any", "terms")},
    "recovery": {
        "points": ("whole", "points"), "coordinates": ("later", "points 3"), "material": ("whole", "points"),
        "deformation": ("real", "n n"), "stress": ("later", "6points n"), "correction?": ("later", "6points m"),
        "displacement?": ("later", "3N m"), "markers/*": ("real", "6 m"),
        "jump_point?": ("whole", "jumps"), "jump_element?": ("whole", "jumps"), "jump?": ("later", "6jumps n"),
        "jump_correction?": ("later", "6jumps m"),
    },
    "certificate": {
        **{one: ("any", "lines") for one in ("frequencies_hz", "error", "bound", "full?", "reduced?",
                                            "reference_error?")},
        **{f"{one}?": ("any", "") for one in ("static_error", "absolute_error", "verified_below_hz")},
        **{f"mode_{one}?": ("any", "modes") for one in ("frequencies_hz", "deviation", "mac")},
        "bound_kind": ("text", ""), "notes?": ("text", ""),
        "version?": ("whole", ""), "band_hz?": ("real", "2"), "measure?": ("text", ""), "damping_floor?": ("real", ""),
        "limits/*": ("any", "3"), "block_limit?": ("any", "blocks blocks"), "cells_hz?": ("real", "cells 2"),
        "cell_limit?": ("any", "cells 3"), "uncertainty?": ("any", "lines"), "residue_deviation?": ("any", "modes"),
        "mode_enclosure_hz?": ("any", "modes 2"),
        "block_error?": ("any", "blocks blocks"), "held_error?": ("any", "blocks lines"),
    },
    "switching": {
        **{one: ("later", "any any") for one in ("modes", "stiffness", "mass", "coupling", "weight", "static_weight",
                                                 "xyz", "direction")},
        **{one: ("whole", "any") for one in ("node_ids", "node", "turns", "stress_first?")},
        **{one: ("later", "any 6 any") for one in ("stress?", "static_stress?")},
        "kind": ("text", ""), "notes": ("text", ""),
    },
}  # fmt: skip
_FRAME: Table = {
    "kind": ("text", ""), "interfaces?": ("text", "any"), "origin": ("real", "3"), "elastic": ("real", "n e"),
    "rigid": ("real", "n 6"), "Ke": ("real", "e e"), "De": ("real", "e e"), "notes": ("text", ""),
    "integrals/mass": ("real", ""), "integrals/first": ("real", "3"), "integrals/inertia": ("real", "3 3"),
    "integrals/second": ("real", "3 3"), "integrals/Ct": ("real", "e 3"), "integrals/Cr": ("real", "e 3"),
    "integrals/Me": ("real", "e e"), "integrals/x_phi": ("real", "3 3 e"), "integrals/phi_phi": ("real", "3 3 e e"),
}  # fmt: skip
_STIFFENING: Table = {
    "acceleration": ("real", "3 e e"), "angular_acceleration": ("real", "3 e e"), "rotation": ("real", "6 e e"),
    "wrench/*": ("real", "6 e e"), "least_share": ("real", ""), "terms?": ("text", "loads"),
    "share?": ("any", "loads"), "load?": ("any", "loads"), "dropped?": ("text", "any"),
}  # fmt: skip
_MARKER: Table = {"point": ("real", "3"), "motion": ("real", "6 e")}
_KINDS = {"real": "iuf", "any": "iuf", "later": "f", "whole": "iu", "text": "SO", "json": "SO"}
_WORDS = {"whole": "integers", "text": "text", "json": "text"}
# By how much axes may miss a rotation.
ORTHONORMAL = 1e-6


def check_file(path: Path, file: Any) -> None:
    """Everything of an open body file, except bases and stress shapes, which are large: see ``refuse_not_finite``.

    Raises:
        InputError: a dataset is missing, or is not what it should be; its name is in the message.
    """
    check = _Check(path, file)
    sizes: dict[str, tuple[int, str]] = {}
    check.table("", _FILE, sizes)
    check.one_of("unit_system", ("SI",))
    bodies, interfaces = check.names("body_names"), check.names("interface_names")
    for name in interfaces:
        check.interface(f"interfaces/{name}/")
    check.within("inputs/interface_index", 0, len(interfaces) - 1, ", places in /interface_names")
    check.within("inputs/component", 0, 5)
    check.positive("mass_properties/mass")
    for name in bodies:
        at, mine = f"bodies/{name}/", dict(sizes)
        check.table(at, _BODY, mine)
        check.within(f"{at}mode_kind", 0, len(file["mode_kinds"]) - 1, ", places in /mode_kinds")
        check.within(f"{at}rigid_count", 0, len(file[f"{at}mode_kind"]))
        for part, table in _PARTS.items():
            if part in file[at]:
                check.table(f"{at}{part}/", table, mine)
        if "floating_frame" in file[at]:
            check.frame(f"{at}floating_frame/", mine, interfaces)


class _Check:
    def __init__(self, path: Path, file: Any) -> None:
        self.path, self.file = path, file

    def refuse(self, name: str, what: str, wanted: str) -> InputError:
        return InputError(f"{self.path}: /{name} {what}; expected {wanted}; the file is damaged, write it again")

    def table(self, at: str, table: Table, sizes: dict[str, tuple[int, str]]) -> None:
        """All datasets of a table below ``at``; ``sizes`` are those of the letters so far, and who gave them."""
        missing = []
        for name, (kind, shape) in table.items():
            place = at + name.rstrip("?*")
            if name.endswith("*"):
                for inner, item in self.file[place.rstrip("/")].items() if place.rstrip("/") in self.file else ():
                    self.dataset(place + inner, item, kind, shape, sizes)
                continue
            item = self.file.get(place)
            if hasattr(item, "shape"):
                self.dataset(place, item, kind, shape, sizes)
            elif not name.endswith("?"):
                missing.append(f"/{place}")
            elif item is not None:
                raise self.refuse(place, "is a group", "a dataset")
        if missing:
            raise InputError(f"{self.path} is an incomplete body file; missing: {', '.join(missing)}; write it again")

    def dataset(self, name: str, item: Any, kind: str, shape: str, sizes: dict[str, tuple[int, str]]) -> None:
        """One dataset: its shape, kind, and what it holds."""
        if item.shape is None or item.dtype.kind not in _KINDS[kind]:
            held = "nothing" if item.shape is None else f"values of type {item.dtype}"
            raise self.refuse(name, f"holds {held}", _WORDS.get(kind, "real numbers"))
        self.shape(name, item, shape.split(), sizes)
        if not item.dtype.hasobject and not item.id.get_create_plist().get_nfilters():
            held, announced = item.id.get_storage_size(), item.size * item.dtype.itemsize
            if held < announced:
                raise self.refuse(name, f"announces {announced} bytes, of which the file holds {held}", "all of them")
        if kind == "real":
            refuse_not_finite(self.path, name, item[()])
        if kind in ("text", "json"):
            self.text(name, item, kind)

    def shape(self, name: str, item: Any, wanted: Sequence[str], sizes: dict[str, tuple[int, str]]) -> None:
        bad, words, givers = len(item.shape) != len(wanted), [], []
        for given, one in zip(item.shape, wanted, strict=False):
            letter = one.lstrip("0123456789")
            factor = int(one.removesuffix(letter) or 1)
            if letter and letter != "any":
                size, giver = sizes.setdefault(letter, (given // factor, name))
                factor *= size
                if giver != name:
                    givers.append(f"/{giver}")
            words.append("any" if letter == "any" else str(factor))
            bad = bad or (letter != "any" and given != factor)
        if bad:
            words += wanted[len(words) :]
            by = f" by {' and '.join(dict.fromkeys(givers))}" if givers else ""
            raise self.refuse(name, f"has the shape {item.shape}", f"({', '.join(words)}){by}")

    def text(self, name: str, item: Any, kind: str) -> None:
        try:
            lines = [line.decode() for line in np.ravel(item[()]).tolist()]
            if kind == "json" and not isinstance(json.loads(lines[0]), dict):
                raise ValueError("not a mapping")
        except (AttributeError, ValueError) as error:
            raise self.refuse(name, f"cannot be read ({error})", "JSON" if kind == "json" else "text") from error

    def names(self, name: str) -> list[str]:
        """Names of groups."""
        return [line.decode() for line in self.file[name][()].tolist()]

    def within(self, name: str, least: int, most: int, why: str = "") -> None:
        """Integers from ``least`` to ``most``."""
        values = np.ravel(self.file[name][()])
        bad = np.flatnonzero((values < least) | (values > most))
        if len(bad):
            raise self.refuse(name, f"holds {values[bad[0]]}", f"{least} to {most}{why}")

    def positive(self, name: str) -> None:
        value = float(self.file[name][()])
        if not value > 0:
            raise self.refuse(name, f"is {value:g}", "more than zero")

    def one_of(self, name: str, known: Sequence[str]) -> None:
        """Text, one line or several, that stands in ``known``."""
        for line in np.ravel(self.file[name][()]).tolist():
            if line.decode() not in known:
                raise self.refuse(name, f"is {line.decode()!r}", f"one of {', '.join(known) or 'none'}")

    def interface(self, at: str) -> None:
        self.table(at, _INTERFACE, {})
        self.one_of(f"{at}coupling", list(COUPLINGS))
        self.within(f"{at}components", 0, 5)
        axes = np.asarray(self.file[f"{at}axes"][()], dtype=float)
        with np.errstate(all="ignore"):
            off = float(np.abs(axes @ axes.T - np.eye(3)).max())
        if not off < ORTHONORMAL or np.linalg.det(axes) < 0:
            raise self.refuse(f"{at}axes", f"is no rotation (A A' - I = {off:.1e})", "orthonormal rows, right-handed")

    def frame(self, at: str, sizes: dict[str, tuple[int, str]], interfaces: Sequence[str]) -> None:
        """A floating frame and what belongs to it."""
        self.table(at, _FRAME, sizes)
        self.one_of(f"{at}kind", list(FRAMES))
        self.positive(f"{at}integrals/mass")
        if "interfaces" in self.file[at]:
            self.one_of(f"{at}interfaces", interfaces)
        for group in ("markers", "stiffening/wrench"):
            for name in self.file[at].get(group, ()):
                if name not in interfaces:
                    raise self.refuse(f"{at}{group}", f"has {name!r}", f"interfaces of /interface_names: {interfaces}")
        for name in self.file[at].get("markers", ()):
            self.table(f"{at}markers/{name}/", _MARKER, sizes)
        if "stiffening" in self.file[at]:
            self.table(f"{at}stiffening/", _STIFFENING, sizes)


def refuse_not_finite(path: Path | str, name: str, values: NDArray[Any]) -> None:
    """Refuse numbers of the dataset ``name`` that are NaN or infinite.

    Raises:
        InputError: there are some; the place of the first one is in the message.
    """
    if values.ndim == 2:
        # A mask of a whole matrix would take much memory.
        bad = next((j for j in range(values.shape[1]) if not np.isfinite(values[:, j]).all()), None)
        if bad is not None:
            refuse_not_finite(path, f"{name}[:, {bad}]", values[:, bad])
        return
    finite = np.isfinite(values)
    if not finite.all():
        at = tuple(int(i) for i in np.unravel_index(int(np.argmin(finite)), values.shape)) if values.ndim else ()
        where = f" at {list(at)}" if at else ""
        raise InputError(
            f"{path}: /{name} holds {values[at]}{where}; expected finite numbers; the file is damaged, write it again"
        )


def check_grid(path: Path, nodes: int, points: Floats, connectivity: Ints, offsets: Ints, types: NDArray[Any]) -> None:
    """The mesh of a body file: ``points`` (nodes, 3), ``connectivity``, ``offsets`` (nc + 1,), VTK ``types`` (nc,).

    Raises:
        InputError: cells that are not on the points, or have another number of nodes than their type.
    """

    def refuse(name: str, what: str) -> InputError:
        return InputError(f"{path}: /VTKHDF/{name} {what}; the file is damaged, write it again")

    if points.shape != (nodes, 3) or points.dtype.kind != "f":
        raise refuse("Points", f"holds {points.dtype} of the shape {points.shape}; expected numbers ({nodes}, 3)")
    refuse_not_finite(path, "VTKHDF/Points", points)
    for name, values in (("Connectivity", connectivity), ("Offsets", offsets), ("Types", types)):
        if values.ndim != 1 or values.dtype.kind not in "iu":
            raise refuse(name, f"holds {values.dtype} of the shape {values.shape}; expected one row of integers")
    if len(offsets) != len(types) + 1:
        raise refuse("Offsets", f"has {len(offsets)} numbers; expected {len(types) + 1}, one more than cells")
    size = np.diff(offsets)
    if offsets[0] != 0 or offsets[-1] != len(connectivity) or (size < 0).any():
        raise refuse("Offsets", f"does not ascend from 0 to {len(connectivity)}, the length of Connectivity")
    bad = np.flatnonzero((connectivity < 0) | (connectivity >= nodes))
    if len(bad):
        raise refuse("Connectivity", f"holds {connectivity[bad[0]]} at [{bad[0]}]; expected 0 to {nodes - 1}")
    for vtk, count in {one.vtk: len(one.reference) for one in (*TYPES.values(), *FACES.values())}.items():
        bad = np.flatnonzero((types == vtk) & (size != count))
        if len(bad):
            raise refuse("Offsets", f"gives cell {bad[0]} of type {vtk} {size[bad[0]]} nodes; expected {count}")
