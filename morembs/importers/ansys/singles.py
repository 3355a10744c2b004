"""Nodes and elements of ANSYS archives that commands define one by one, as HyperMesh writes them: N, EN, EMORE."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.importers.ansys.elements import Rows


@dataclass
class Singles:
    """Nodes and elements in the words of the Mechanical APDL Command Reference.

    ``nodes``: label, x, y, z and three angles; ``elements``: their attributes, label and nodes; the ``current``
    attributes are those of the next element, and CSYS is the system of the next node.
    """

    # Of an element, at most.
    NODES = 20

    nodes: list[list[float]] = field(default_factory=list)
    elements: list[tuple[dict[str, int], list[int]]] = field(default_factory=list)
    current: dict[str, int] = field(
        default_factory=lambda: {"TYPE": 1, "MAT": 1, "REAL": 1, "SECNUM": 1, "ESYS": 0, "CSYS": 0}
    )

    def take(self, command: str, fields: list[str], where: str) -> None:
        """N, node, x, y, z, angles; EN, element and its first eight nodes; EMORE, eight further ones (Mechanical APDL
        Command Reference).

        Raises:
            InputError: elements without a label, axes other than the global ones, or what CDWRITE writes UNBLOCKED.
        """
        if command == "E" or fields[1].upper().startswith("R5") or (command == "N" and self.current["CSYS"]):
            raise InputError(
                f"{where}: {command} defines a node or element in a way that is not read; write the archive in blocks "
                "(CDWRITE,DB,model,cdb without UNBLOCKED)",
                kind="unsupported",
            )
        if command == "N":
            values = [float(word or 0) for word in fields[2:8]]
            if not all(map(math.isfinite, values)):
                raise InputError(f"{where}: N gives a node coordinates that are not finite")
            self.nodes.append([float(int(fields[1])), *values, *[0.0] * (6 - len(values))])
            return
        numbers = [int(word) for word in fields[1:] if word]
        if command == "EN":
            self.elements.append((dict(self.current), numbers))
        else:
            self.elements[-1][1].extend(numbers)
        if len(self.elements[-1][1]) > 1 + Singles.NODES:
            raise InputError(f"{where}: {command} gives an element more than {Singles.NODES} nodes", kind="unsupported")

    def node_tables(self) -> tuple[Ints, Floats, Floats]:
        """Labels (k,), coordinates (k, 3) and angles (k, 3)."""
        table = np.array(self.nodes)
        return table[:, 0].astype(np.int64), table[:, 1:4], table[:, 4:7]

    def element_tables(self) -> Iterator[tuple[int, Rows]]:
        """Type and elements of each type."""
        for kind in dict.fromkeys(given["TYPE"] for given, _ in self.elements):
            own = [(given, numbers) for given, numbers in self.elements if given["TYPE"] == kind]
            rows = np.array([numbers + [0] * (1 + Singles.NODES - len(numbers)) for _, numbers in own], dtype=np.int64)
            material, real, system, section = (
                np.array([given[key] for given, _ in own]) for key in ("MAT", "REAL", "ESYS", "SECNUM")
            )
            yield (
                kind,
                Rows(ids=rows[:, 0], nodes=rows[:, 1:], material=material, real=real, system=system, section=section),
            )
