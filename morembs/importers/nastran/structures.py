"""Shells, shear panels, bars and rods of Nastran bulk data: own assembly has none of them, programs do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.abaqus.keywords import Card
from morembs.importers.decks.labels import ranges_of
from morembs.importers.decks.tables import Elements, Section
from morembs.importers.nastran.bulk import Bulk
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.properties import Materials, by_number, pad
from morembs.importers.nastran.sections import SECTIONS, section_of
from morembs.importers.tolerances import TOL

# For each card: its kind and shape, and the cards of its properties (CONROD: none, it is its own).
STRUCTURES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "CQUAD4": ("shell", "quad4", ("PSHELL", "PCOMP", "PCOMPG")),
    "CTRIA3": ("shell", "tri3", ("PSHELL", "PCOMP", "PCOMPG")),
    "CQUADR": ("shell", "quad4", ("PSHELL", "PCOMP", "PCOMPG")),
    "CTRIAR": ("shell", "tri3", ("PSHELL", "PCOMP", "PCOMPG")),
    "CQUAD8": ("shell", "quad8", ("PSHELL", "PCOMP", "PCOMPG")),
    "CTRIA6": ("shell", "tri6", ("PSHELL", "PCOMP", "PCOMPG")),
    "CSHEAR": ("shear", "quad4", ("PSHEAR",)),
    "CBAR": ("beam", "line2", ("PBAR", "PBARL")),
    "CBEAM": ("beam", "line2", ("PBEAM", "PBEAML")),
    "CROD": ("truss", "line2", ("PROD",)),
    "CTUBE": ("truss", "line2", ("PTUBE",)),
    "CONROD": ("truss", "line2", ()),
}
# Cards with default fields of others.
_DEFAULTS = {"CBAR": "BAROR", "CBEAM": "BEAMOR"}
_NODES = {"quad4": 4, "tri3": 3, "quad8": 8, "tri6": 6, "line2": 2}
# Where angle, offset, flag and thicknesses of a shell stand.
_SHELLS = {"quad4": (6, 7, 9, 10), "tri3": (5, 6, 9, 10), "quad8": (14, 15, 16, 10), "tri6": (8, 9, 13, 10)}
_Values = dict[str, Floats]


class Structures:
    """The elements ``parts`` by card, and their ``sections`` and ``sets`` by name; what is wrong with a card is a
    problem of the bulk data."""

    def __init__(self, bulk: Bulk, materials: Materials) -> None:
        self.bulk, self.materials = bulk, materials
        self.parts: list[Elements] = []
        self.sections: list[Section] = []
        # By set: the card of the elements, that of their property with its fields, labels.
        self._owned: dict[str, tuple[str, str, list[str], list[int]]] = {}
        self._properties = {name: by_number(bulk.file, name, bulk.rows[name]) for name in SECTIONS if name in bulk.rows}
        for name in STRUCTURES:
            self._read(name)
        for set_, (name, card, row, _) in self._owned.items():
            with bulk.problems.collected(Card(name, {}, bulk.file, 0)):
                self.sections.append(section_of(card, set_, pad(row, 64), bulk.file, materials))
        self.sets = {set_: ranges_of(np.array(labels)) for set_, (*_, labels) in self._owned.items()}

    def _read(self, name: str) -> None:
        kind, shape, _ = STRUCTURES[name]
        default = self._default(_DEFAULTS.get(name, ""))
        ids, nodes, values = list[int](), list[Ints](), list[_Values]()
        for row, where in self.bulk.cards(name):
            with self.bulk.problems.collected(where, (f"--skip {name}",)):
                words = pad(row, 26)
                label = integer(words[0], f"{self.bulk.file}: {name}")
                what = f"{self.bulk.file}: {name} {label}"
                at, count = 1 if name == "CONROD" else 2, _NODES[shape]
                own = np.array([integer(text, what) for text in words[at : at + count]])
                rows = self.bulk.grids.rows(own, what)
                if len(set(own.tolist())) < count:
                    raise InputError(f"{what} names a grid twice; expected {count} grids", kind="conflict")
                set_, property_, fields = self._property(name, words, default, what)
                given = self._shell(what, words, shape) if kind == "shell" else {}
                if kind == "beam":
                    given = self._beam(what, _with_default(words, default), rows)
                self._owned.setdefault(set_, (name, property_, fields, []))[3].append(label)
                ids.append(label)
                nodes.append(own)
                values.append(given)
        if self.bulk.rows[name]:
            self.parts.append(
                Elements(
                    code=name,
                    kind=kind,
                    shape=shape,
                    ids=np.array(ids, dtype=np.int64),
                    nodes=np.array(nodes, dtype=np.int64).reshape(-1, _NODES[shape]),
                    values=_join(values),
                    problem=self.bulk.refusal(name, len(self.bulk.rows[name])),
                )
            )

    def _default(self, name: str) -> list[str]:
        rows = self.bulk.rows[name] if name else []
        if len(rows) > 1:
            raise InputError(f"{self.bulk.file} has {len(rows)} cards {name}; expected one")
        return pad(rows[0], 8) if rows else [""] * 8

    def _property(self, name: str, words: list[str], default: list[str], what: str) -> tuple[str, str, list[str]]:
        """The set of the elements with the property of one, and the card of that with its fields."""
        cards = STRUCTURES[name][2]
        if not cards:
            return f"{name}_{words[0]}", name, [words[0], *words[3:8]]
        pid = integer(words[1] or default[1] or words[0], what)
        matches = [card for card in cards if pid in self._properties[card]]
        if len(matches) != 1:
            raise InputError(f"{what} names the property {pid}; expected one {' or '.join(cards)} with that number")
        return f"{matches[0]}_{pid}", matches[0], self._properties[matches[0]][pid]

    def _shell(self, what: str, words: list[str], shape: str) -> _Values:
        """The direction or angle of its first material axis, offset, thicknesses at the corners."""
        at = _SHELLS[shape]
        angle, offset, flag = (words[i] for i in at[:3])
        corners = 3 if shape.startswith("tri") else 4
        given: _Values = {}
        if "." in angle:
            given["angle"] = np.array(real(angle, what))
        elif angle:
            number = integer(angle, what)
            given["direction"] = self.bulk.systems.frame(number, self.bulk.grids)[2][0]
        if offset:
            given["offset"] = np.array(real(offset, what))
        if flag not in ("", "0"):
            raise InputError(
                f"{what} gives its thicknesses as fractions (TFLAG); give them in units of length", kind="unsupported"
            )
        thick = words[at[3] : at[3] + corners]
        if any(thick) and not all(thick):
            raise InputError(f"{what} gives thicknesses at some corners only; expected all or none")
        if any(thick):
            given["thickness"] = np.array([real(text, what) for text in thick])
        return given

    def _beam(self, what: str, words: list[str], grids: Ints) -> _Values:
        """Orientation, pins and offsets along basic axes."""
        a, b = grids.tolist()
        options = (words[7] or "GGG").upper()
        if options in ("1", "2"):
            # COSMIC NASTRAN says there whether a vector (1) or a grid (2) stands before (User's Manual, CBAR, BAROR).
            if (options == "2") == any(words[5:7]):
                raise InputError(
                    f"{what} has the flag F = {options} and an orientation of the other kind; mend it", kind="file"
                )
            options = "GGG"
        offsets = np.array([real(text, what) for text in words[10:16]]).reshape(2, 3)
        if "." in options or len(options) != 3 or options[0] not in "GB" or (offsets.any() and options[1:] != "GG"):
            raise InputError(f"{what} gives its orientation or offsets along {options!r}; expected GGG or BGG")
        if words[16] or words[17]:
            raise InputError(
                f"{what} has points that warp (SA, SB), which are not read; leave them blank", kind="unsupported"
            )
        if not any(words[4:7]):
            raise InputError(f"{what} has no orientation; expected X1, X2, X3 or G0", kind="missing")
        xyz = self.bulk.grids.xyz
        if not any(words[5:7]) and "." not in words[4]:
            other = self.bulk.grids.rows(np.array([integer(words[4], what)]), what)[0]
            vector = xyz[other] - xyz[a]
        else:
            axes = np.eye(3) if options[0] == "B" else self._axes(a)
            vector = np.array([real(text, what) for text in words[4:7]]) @ axes
        offset = np.array([offsets[0] @ self._axes(a), offsets[1] @ self._axes(b)])
        along = xyz[b] + offset[1] - xyz[a] - offset[0]
        least = TOL.parallel_orientation * np.linalg.norm(along) * np.linalg.norm(vector)
        if not np.linalg.norm(np.cross(along, vector)) > least:
            raise InputError(f"{what} has no length, or its orientation lies along it; mend it", kind="file")
        given: _Values = {"direction": vector}
        if offset.any():
            given["offset"] = offset
        pins = [integer(text, what) for text in words[8:10]]
        if any(pins):
            given["released"] = np.array([[str(c) in str(pin) for c in range(1, 7)] for pin in pins], dtype=np.float64)
        return given

    def _axes(self, grid: int) -> Floats:
        """The axes (3, 3) of a grid as rows."""
        grids = self.bulk.grids
        return self.bulk.systems.axes(int(grids.cd[grid]), grids.xyz[grid], grids)


def _with_default(words: list[str], default: list[str]) -> list[str]:
    vector = words[4:7] if any(words[4:7]) else default[4:7]
    return [*words[:4], *vector, words[7] or default[7], *words[8:]]


def _join(values: Sequence[_Values]) -> dict[str, Floats]:
    """Values of elements as arrays, NaN where one has none."""
    joined = {}
    for name in dict.fromkeys(key for own in values for key in own):
        like = next(own[name] for own in values if name in own)
        joined[name] = np.array([own.get(name, np.full(like.shape, np.nan)) for own in values])
    return joined
