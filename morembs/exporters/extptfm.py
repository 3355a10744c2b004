"""OpenFAST: the superelement of an offshore foundation that the module ExtPtfm reads (format FlexASCII).

The keywords, their order and the column of the wave elevation are those of the user documentation of OpenFAST, section
ExtPtfm, "Superelement input file"; the theory is Branlard, Shields, Anderson, Damiani, Wendt, Jonkman, Musial, Foley
(2020).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.limits import Positive
from morembs.base.types import Floats
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits
from morembs.exporters.simscape import framed_rows, interfaces_first, refuse_not_symmetric
from morembs.storage.safefile import replacing


@dataclass(frozen=True, kw_only=True)
class ExtPtfm(Exporter):
    """Guyan and Craig-Bampton matrices of the ``interface`` that carries the tower, by default the first one.

    Loads are zero from 0 to ``duration`` in s. In ExtPtfm.dat, FileFormat is 1 and Red_FileName this file.
    """

    name: ClassVar[str] = "extptfm"
    suffix: ClassVar[str] = ".extptfm.dat"
    about: ClassVar[str] = "OpenFAST ExtPtfm: Craig-Bampton superelement of a foundation"
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    interface: str | None = None
    duration: Positive = 10000.0

    def _write(self, context: ExportContext) -> Exported:
        source, body, target = context.source, context.body, "ExtPtfm of OpenFAST"
        refuse_not_symmetric(body, target)
        framed = framed_rows(context, target)
        if self.interface is not None and self.interface not in framed:
            raise InputError(
                f"interface = {self.interface!r} was given; {nearest(self.interface, framed)}",
                kind="unknown",
                keyword="interface",
            )
        name = self.interface or next(iter(framed))
        K, M, D = interfaces_first(body, np.array(framed[name]))
        matrices = [("Mass", "kg,m", M), ("Stiffness", "N,m", K), ("Damping", "N,m,kg", D)]
        with replacing(context.path) as file:
            for text in _lines(matrices, self.duration):
                file.write(text.encode("ascii"))
            file.check()
        modes = len(K) - len(framed[name])
        notes = [
            f"{modes} modes with {name} at rest",
            "the loads in the file are zero: waves, current and the weight of the foundation are yours to add",
            "axes are those of the model; OpenFAST has z upwards and x downwind",
        ]
        if body.rigid_count:
            notes.append(f"nothing holds the body: it has {body.rigid_count} rigid-body motions; hold its foot")
        others = [other for other in source.interfaces if other != name]
        if others:
            notes.append(f"the tower stands on {name}, nothing can be attached to {', '.join(others)}")
        return Exported(paths=(context.path,), notes=tuple(notes))


def _lines(matrices: list[tuple[str, str, Floats]], duration: float) -> Iterator[str]:
    n = len(matrices[0][2])
    yield "!Superelement of an elastic body, SI units, written by morembs\n!Flex 5 Format\n"
    yield f"!Dimension: {n}\n!Time increment in simulation: {duration!r}\n"
    yield f"!Total simulation time in file: {duration!r}\n"
    for word, units, matrix in matrices:
        yield f"!{word} Matrix (Units ({units}))\n!Dimension: {n}\n"
        for row in in_two_digits(f"the {word.lower()} matrix", matrix, "ExtPtfm").tolist():
            yield " ".join(f"{value:.16e}" for value in row) + "\n"
    yield f"!Loading and Wave Elevation (Units (N,m))\n!Dimension: 1 time column - {n} force columns - 1 wave column\n"
    for time in (0.0, duration):
        yield f"{time!r}{' 0.0' * (n + 1)}\n"
