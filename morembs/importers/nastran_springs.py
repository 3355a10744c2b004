"""Springs, dampers, masses by direction and multipoint constraints of Nastran bulk data."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from morembs.errors import InputError
from morembs.importers.abaqus_materials import frame_of
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement
from morembs.importers.nastran_cards import integer, real
from morembs.importers.nastran_geometry import Grids, Systems
from morembs.importers.nastran_properties import Rows, padded
from morembs.model import skew
from morembs.model.constraints import Equations, Term, solved_for_first

Floats = NDArray[np.float64]
# Cards of one value between two components: the matrix, the card of their property or none.
SCALARS = {
    "CELAS1": ("K", "PELAS"), "CELAS2": ("K", ""), "CMASS1": ("M", "PMASS"), "CMASS2": ("M", ""),
    "CDAMP1": ("D", "PDAMP"), "CDAMP2": ("D", ""),
}  # fmt: skip
# Fields of each property on one card.
_PROPERTY = {"PELAS": 4, "PMASS": 2, "PDAMP": 2}
_MPC = re.compile(r"^[ \t]*MPC[ \t]*=[ \t]*(\d+)", re.MULTILINE | re.IGNORECASE)


class Springs:
    """Reads these cards; ``scale`` is PARAM WTMASS."""

    def __init__(self, grids: Grids, systems: Systems, rows: dict[str, Rows], scale: float) -> None:
        self.grids, self.systems, self.rows, self.scale = grids, systems, rows, scale
        self.found: list[DiscreteElement] = []
        self._properties: dict[str, dict[int, list[str]]] = {}

    def part(self, row: int, component: int) -> Floats:
        """Direction (6,) in basic components of a component along the axes (CD) of a grid."""
        part = np.zeros(6)
        turn = 3 * (component // 3)
        part[turn : turn + 3] = self.axes(row)[component % 3]
        return part

    def axes(self, row: int) -> Floats:
        """The axes (3, 3) of a grid as rows."""
        return self.at(int(self.grids.cd[row]), self.grids.xyz[row])

    def at(self, system: int, x: Floats) -> Floats:
        """The axes (3, 3) of a system at a point as rows."""
        if system <= 0:
            return np.eye(3)
        kind, origin, axes = self.systems.frame(system, self.grids)
        if kind == "R":
            return axes
        local = axes @ (x - origin)
        around = np.arctan2(local[1], local[0])
        c, s = np.cos(around), np.sin(around)
        out, turning, up = np.array([c, s, 0.0]), np.array([-s, c, 0.0]), np.array([0.0, 0.0, 1.0])
        if kind == "C":
            return np.array([out, turning, up]) @ axes
        polar = np.arctan2(np.hypot(local[0], local[1]), local[2])
        p, q = np.sin(polar), np.cos(polar)
        return np.array([p * out + q * up, q * out - p * up, turning]) @ axes

    def scalar(self, name: str, row: list[str]) -> None:
        """CELAS1, CELAS2, CMASS1, CMASS2, CDAMP1 or CDAMP2."""
        what, row = f"{self.grids.file}: {name} {padded(row, 1)[0]}", padded(row, 6)
        matrix, property_ = SCALARS[name]
        if property_:
            given = self._property(property_).get(integer(row[1] or row[0], what))
            if given is None:
                raise InputError(f"{what} names the {property_} {row[1] or row[0]}, which is not there")
            value = real(given[1], what)
        else:
            value = real(row[1], what)
        ends: list[tuple[int, Floats]] = []
        for sign, label, component in ((1.0, row[2], row[3]), (-1.0, row[4], row[5])):
            if not label or label == "0":
                continue
            if component not in ("1", "2", "3", "4", "5", "6"):
                raise InputError(
                    f"{what} is on the component {component or 0} of {label}; expected 1 to 6 of a grid: scalar points "
                    "are not carried, leave it out with --skip " + name
                )
            grid = int(self.grids.rows(np.array([integer(label, what)]), what)[0])
            ends.append((grid, sign * self.part(grid, int(component) - 1)))
        if not ends:
            raise InputError(f"{what} is on no grid; expected one or two")
        self.found.append(spring(f"{name}_{row[0]}", matrix, ends, value * (self.scale if matrix == "M" else 1.0)))

    def _property(self, name: str) -> dict[int, list[str]]:
        if name not in self._properties:
            size, of = _PROPERTY[name], dict[int, list[str]]()
            for row in self.rows[name]:
                for at in range(0, len(row), size):
                    part = padded(row[at : at + size], 2)
                    if part[0]:
                        of[integer(part[0], f"{self.grids.file}: {name}")] = part
            self._properties[name] = of
        return self._properties[name]

    def bush(self, row: list[str]) -> None:
        """CBUSH: K1..K6 and B1..B6 of its PBUSH at a point between the grids, along its axes."""
        what, row = f"{self.grids.file}: CBUSH {padded(row, 1)[0]}", padded(row, 13)
        rows = [int(self.grids.rows(np.array([integer(text, what)]), what)[0]) for text in row[2:4] if text]
        if not rows:
            raise InputError(f"{what} is on no grid; expected one or two")
        a, b = rows[0], rows[-1]
        share = real(row[8], what) if row[8] else 0.5
        if row[9]:
            raise InputError(f"{what} has its place in a system (OCID = {row[9]}); expected it between its grids")
        point = self.grids.xyz[a] + share * (self.grids.xyz[b] - self.grids.xyz[a])
        values = self._bush_values(what, integer(row[1] or row[0], what))
        axes = self._bush_axes(what, row, a, b, [values[key] for key in ("K", "B")])
        T = np.kron(np.eye(2), axes)
        B = []
        for sign, node in zip((-1.0, 1.0) if len(rows) == 2 else (1.0,), rows, strict=True):
            arm = np.eye(6)
            arm[:3, 3:] = -skew(point - self.grids.xyz[node])
            B.append(sign * T @ arm)
        motion = np.hstack(B)
        nodes, components = np.repeat(rows, 6), np.tile(np.arange(6), len(rows))
        for key, matrix in (("K", "K"), ("B", "D")):
            if values[key].any():
                entries = motion.T @ (values[key][:, None] * motion)
                self.found.append(
                    DiscreteElement(
                        name=f"CBUSH_{row[0]}", matrix=matrix, nodes=nodes, components=components, values=entries
                    )
                )

    def _bush_values(self, what: str, number: int) -> dict[str, Floats]:
        given = next((row for row in self.rows["PBUSH"] if row and integer(row[0], what) == number), None)
        if given is None:
            raise InputError(f"{what} names the PBUSH {number}, which is not there")
        values, key = {"K": np.zeros(6), "B": np.zeros(6)}, ""
        for at in range(1, len(given)):
            text = given[at].upper()
            # Lines of eight fields: a word, or none where the first line has the number, and six values.
            if text in ("K", "B", "GE", "RCV", "M"):
                key, begin = text, at
            elif key in values and text and 0 < at - begin <= 6:
                values[key][at - begin - 1] = np.inf if text == "RIGID" else real(text, what)
        if not np.isfinite([*values.values()]).all():
            raise InputError(f"{what} is RIGID in some direction; expected stiffnesses (or RBE2)")
        return values

    def _bush_axes(self, what: str, row: list[str], a: int, b: int, values: list[Floats]) -> Floats:
        """Its axes as rows: of a system, or along its grids in a plane with a vector or a third grid."""
        if row[7]:
            return self.at(integer(row[7], what), self.grids.xyz[a])
        along = self.grids.xyz[b] - self.grids.xyz[a]
        if row[4] and not any(row[5:7]) and "." not in row[4]:
            other = int(self.grids.rows(np.array([integer(row[4], what)]), what)[0])
            plane = self.grids.xyz[other] - self.grids.xyz[a]
        elif any(row[4:7]):
            plane = np.array([real(text, what) for text in row[4:7]]) @ self.axes(a)
        else:
            sideways = any(v[[1, 2, 4, 5]].any() for v in values)
            alike = all(np.ptp(v[:3]) == 0 and np.ptp(v[3:]) == 0 for v in values)
            if alike or not np.linalg.norm(along) > 0:
                return np.eye(3)
            if sideways:
                raise InputError(f"{what} has stiffness across its axis and no orientation (GO, X1 to X3, CID)")
            plane = np.eye(3)[int(np.abs(along).argmin())]
        axes = frame_of(along, plane)
        if axes is None:
            raise InputError(f"{what}: its grids and its orientation give no axes; give CID")
        return axes

    def conm1(self, row: list[str]) -> None:
        """CONM1: a mass matrix of a grid by the lower triangle of its entries."""
        what, row = f"{self.grids.file}: CONM1 {padded(row, 1)[0]}", padded(row, 24)
        node = int(self.grids.rows(np.array([integer(row[1], what)]), what)[0])
        M = np.zeros((6, 6))
        M[np.tril_indices(6)] = [real(text, what) for text in row[3:24]]
        M = M + np.tril(M, -1).T
        T = np.kron(np.eye(2), self.at(integer(row[2], what), self.grids.xyz[node]))
        self.found.append(
            DiscreteElement(
                name=f"CONM1_{row[0]}", matrix="M", nodes=np.full(6, node), components=np.arange(6),
                values=self.scale * T.T @ M @ T,
            )
        )  # fmt: skip

    def mpc(self, head: str, notes: list[str]) -> Equations | None:
        """The equations of MPC that the case control asks for, all of one set where there is none."""
        rows = self.rows["MPC"]
        if not rows:
            return None
        chosen = self._chosen(head, notes)
        sums: list[tuple[str, list[Term]]] = []
        for row in rows:
            what = f"{self.grids.file}: MPC {padded(row, 1)[0]} of grid {padded(row, 2)[1]}"
            if chosen is not None and integer(padded(row, 1)[0], what) not in chosen:
                continue
            terms: list[Term] = []
            for at in [i for line in range(0, len(row), 8) for i in (line + 1, line + 4)]:
                label, component, value = padded(row[at : at + 3], 3)
                if label:
                    if component not in ("1", "2", "3", "4", "5", "6"):
                        raise InputError(f"{what} names the component {component or 0}; expected 1 to 6 of a grid")
                    grid = int(self.grids.rows(np.array([integer(label, what)]), what)[0])
                    part = real(value, what) * self.part(grid, int(component) - 1)
                    order = np.argsort(-np.abs(part), kind="stable").tolist()
                    # A first coefficient of zero is to be seen.
                    terms += [(grid, c, float(part[c])) for c in order if part[c]] or [(grid, int(component) - 1, 0.0)]
            sums.append((what, terms))
        return solved_for_first("MPC", sums) if sums else None

    def _chosen(self, head: str, notes: list[str]) -> set[int] | None:
        """Numbers of the sets that are applied, None for all."""
        asked = {int(number) for number in _MPC.findall(head)}
        if not asked and head.strip():
            notes.append("MPC: not applied, the case control asks for none.")
            return set()
        if len(asked) > 1:
            raise InputError(f"{self.grids.file}: subcases ask for the MPC sets {sorted(asked)}; expected one of them")
        what = f"{self.grids.file}: MPCADD"
        for row in self.rows["MPCADD"]:
            if row and integer(row[0], what) in asked:
                asked |= {integer(text, what) for text in row[1:] if text}
        return asked or None
