"""Springs, dampers and masses by direction of Nastran bulk data."""

from __future__ import annotations

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.fem import skew
from morembs.importers.decks.algebra import frame_of
from morembs.importers.discrete import spring
from morembs.importers.imported import DiscreteElement
from morembs.importers.nastran.cards import integer, real
from morembs.importers.nastran.geometry import Grids, Systems
from morembs.importers.nastran.names import SCALARS
from morembs.importers.nastran.properties import Rows, pad

# Fields of each property on one card.
_PROPERTY = {"PELAS": 4, "PMASS": 2, "PDAMP": 2}


class Springs:
    """Reads these cards; ``scale`` is PARAM WTMASS."""

    def __init__(self, grids: Grids, systems: Systems, rows: dict[str, Rows], scale: float) -> None:
        self.grids, self.systems, self.rows, self.scale = grids, systems, rows, scale
        self.elements: list[DiscreteElement] = []
        self._properties: dict[str, dict[int, list[str]]] = {}

    def scalar(self, name: str, row: list[str]) -> None:
        """CELAS1, CELAS2, CMASS1, CMASS2, CDAMP1 or CDAMP2."""
        what, row = f"{self.grids.file}: {name} {pad(row, 1)[0]}", pad(row, 6)
        matrix, property_ = SCALARS[name]
        if property_:
            given = self._property(property_).get(integer(row[1] or row[0], what))
            if given is None:
                raise InputError(f"{what} names the {property_} {row[1] or row[0]}, which is not there", kind="unknown")
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
                    "are not carried, leave it out with --skip " + name,
                    kind="unsupported",
                )
            grid = int(self.grids.rows(np.array([integer(label, what)]), what)[0])
            ends.append((grid, sign * self.systems.direction(grid, int(component) - 1, self.grids)))
        if not ends:
            raise InputError(f"{what} is on no grid; expected one or two")
        self.elements.append(spring(f"{name}_{row[0]}", matrix, ends, value * (self.scale if matrix == "M" else 1.0)))

    def _property(self, name: str) -> dict[int, list[str]]:
        if name not in self._properties:
            size, of = _PROPERTY[name], dict[int, list[str]]()
            for row in self.rows[name]:
                for at in range(0, len(row), size):
                    part = pad(row[at : at + size], 2)
                    if part[0]:
                        of[integer(part[0], f"{self.grids.file}: {name}")] = part
            self._properties[name] = of
        return self._properties[name]

    def bush(self, row: list[str]) -> None:
        """CBUSH: K1..K6 and B1..B6 of its PBUSH at a point between the grids, along its axes."""
        what, row = f"{self.grids.file}: CBUSH {pad(row, 1)[0]}", pad(row, 13)
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
                self.elements.append(
                    DiscreteElement(
                        name=f"CBUSH_{row[0]}", matrix=matrix, nodes=nodes, components=components, values=entries
                    )
                )

    def _bush_values(self, what: str, number: int) -> dict[str, Floats]:
        given = next((row for row in self.rows["PBUSH"] if row and integer(row[0], what) == number), None)
        if given is None:
            raise InputError(f"{what} names the PBUSH {number}, which is not there", kind="unknown")
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
            return self.systems.axes(integer(row[7], what), self.grids.xyz[a], self.grids)
        along = self.grids.xyz[b] - self.grids.xyz[a]
        if row[4] and not any(row[5:7]) and "." not in row[4]:
            other = int(self.grids.rows(np.array([integer(row[4], what)]), what)[0])
            plane = self.grids.xyz[other] - self.grids.xyz[a]
        elif any(row[4:7]):
            own = self.systems.axes(int(self.grids.cd[a]), self.grids.xyz[a], self.grids)
            plane = np.array([real(text, what) for text in row[4:7]]) @ own
        else:
            sideways = any(v[[1, 2, 4, 5]].any() for v in values)
            alike = all(np.ptp(v[:3]) == 0 and np.ptp(v[3:]) == 0 for v in values)
            if alike or not np.linalg.norm(along) > 0:
                return np.eye(3)
            if sideways:
                raise InputError(
                    f"{what} has stiffness across its axis and no orientation (GO, X1 to X3, CID)", kind="unsupported"
                )
            plane = np.eye(3)[int(np.abs(along).argmin())]
        axes = frame_of(along, plane)
        if axes is None:
            raise InputError(f"{what}: its grids and its orientation give no axes; give CID", kind="unsupported")
        return axes

    def conm1(self, row: list[str]) -> None:
        """CONM1: a mass matrix of a grid by the lower triangle of its entries."""
        what, row = f"{self.grids.file}: CONM1 {pad(row, 1)[0]}", pad(row, 24)
        node = int(self.grids.rows(np.array([integer(row[1], what)]), what)[0])
        M = np.zeros((6, 6))
        M[np.tril_indices(6)] = [real(text, what) for text in row[3:24]]
        M = M + np.tril(M, -1).T
        T = np.kron(np.eye(2), self.systems.axes(integer(row[2], what), self.grids.xyz[node], self.grids))
        self.elements.append(
            DiscreteElement(
                name=f"CONM1_{row[0]}",
                matrix="M",
                nodes=np.full(6, node),
                components=np.arange(6),
                values=self.scale * T.T @ M @ T,
            )
        )
