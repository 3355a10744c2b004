"""Nastran DMIG: reduced matrices on grids at the interfaces and scalar points for other coordinates."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.exporters.base import ExportContext, Exported, Exporter, in_two_digits
from morembs.exporters.read_back import ReadBack
from morembs.exporters.reduced import body_transfer, on_interfaces
from morembs.importers.matrices.dmig import DmigMatrix, read_dmig
from morembs.storage.safefile import replacing

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
_NAMES = {"M": "MAAX", "K": "KAAX", "D": "BAAX"}


class LargeField:
    """Large fields of bulk data (MSC Nastran Quick Reference Guide): labels of eight digits, 16 characters a number.

    A number has at least ``FEWEST_DIGITS``, and most without an exponent from ``PLAIN_FROM`` to ``PLAIN_BELOW``.
    """

    LARGEST_LABEL = 10**8 - 1
    FEWEST_DIGITS = 11
    PLAIN_FROM = 1e-2
    PLAIN_BELOW = 1e15


def write_dmig(path: str | Path, matrices: Mapping[str, DmigMatrix], before: str = "") -> None:
    """Write DMIG entries in large fields, ``before`` in front of them.

    A field has 16 characters, so that numbers keep 11 to 15 digits, most from 0.1 to 1e15. Of a symmetric matrix
    one triangle is written.

    Raises:
        InputError: a name, label or number that the fields cannot hold.
        OutputError: the file cannot be written.
    """
    for name, matrix in matrices.items():
        _check(name, matrix)
    with replacing(Path(path)) as file:
        file.write(before.encode("ascii"))
        for name, matrix in matrices.items():
            file.doing = f"matrix {name}"
            for text in _cards(name.upper(), matrix):
                file.write(text.encode("ascii"))


def _check(name: str, given: DmigMatrix) -> None:
    if not _NAME.fullmatch(name):
        raise InputError(
            f"the matrix name {name!r} does not fit DMIG; expected a letter, then up to 7 letters or digits",
            keyword="name",
        )
    if given.matrix.shape != (len(given.rows), len(given.columns)):
        raise InputError(
            f"matrix {name!r} has the shape {given.matrix.shape} but {len(given.rows)} and {len(given.columns)} labels",
            keyword="labels",
        )
    if given.form not in (1, 2, 6, 9) or (given.form in (1, 6) and not np.array_equal(given.rows, given.columns)):
        raise InputError(
            f"matrix {name!r} has form {given.form}; expected 1 or 6 with rows labelled as columns, 2 or 9"
        )
    if given.form == 6 and (given.matrix != given.matrix.T).nnz:
        raise InputError(f"matrix {name!r} has form 6 but is not symmetric; give form 1", kind="value", keyword="form")
    labels = np.concatenate([given.rows, given.columns])
    largest = LargeField.LARGEST_LABEL
    if len(labels) and (
        labels[:, 0].min() < 1 or labels[:, 0].max() > largest or not np.isin(labels[:, 1], range(7)).all()
    ):
        raise InputError(
            f"matrix {name!r} has labels outside 1 to {largest} or components outside 0 to 6", keyword="labels"
        )
    if not given.matrix.nnz:
        raise InputError(f"matrix {name!r} has no entries; DMIG cannot hold that, leave it out", kind="unsupported")
    in_two_digits(f"matrix {name!r}", np.abs(given.matrix.data), "DMIG")


def _cards(name: str, given: DmigMatrix) -> Iterator[str]:
    complex_ = given.matrix.dtype.kind == "c"
    kind = given.type if (given.type > 2) == complex_ else 4 if complex_ else 2
    count = given.matrix.shape[1] if given.form == 9 else ""
    yield f"{'DMIG*':8}{name:16}{0:16}{given.form:16}{kind:16}\n{'*':8}{kind:16}{0:16}{'':16}{count:>16}\n"
    # The lower triangle in columns.
    A = sp.csc_array(sp.tril(given.matrix) if given.form == 6 else given.matrix)
    A.sort_indices()
    for j in range(A.shape[1]):
        part = slice(A.indptr[j], A.indptr[j + 1])
        if part.start == part.stop:
            continue
        grid, component = given.columns[j]
        lines = [f"{'DMIG*':8}{name:16}{grid:16}{component:16}\n"]
        for i, value in zip(A.indices[part], A.data[part], strict=True):
            row = f"{'*':8}{given.rows[i, 0]:16}{given.rows[i, 1]:16}{sixteen(value.real)}"
            lines.append(row + (f"{sixteen(value.imag)}\n" if complex_ else "\n"))
        yield "".join(lines)


def sixteen(value: float) -> str:
    """``value`` in 16 characters with as many digits as fit: 15 (14 below zero) from 0.1 to 1e15, else 11 to 14.

    The zero before the point and the E are left out, as Nastran allows.
    """
    size = abs(value)
    if size == 0.0:
        return f"{0.0:16.1f}"
    if LargeField.PLAIN_FROM <= size < LargeField.PLAIN_BELOW:
        room = 16 - (value < 0)
        before = len(f"{size:.0f}") if size >= 1.0 else 0
        text = f"{value:#.{max(room - 1 - before, 0)}f}".replace("0.", ".", 1 if size < 1.0 else 0)
        if len(text) <= 16:
            return f"{text:>16}"
    for digits in (12, 11, 10):
        mantissa, exponent = f"{value:.{digits}e}".split("e")
        text = f"{mantissa}{int(exponent):+d}"
        if len(text) <= 16:
            return f"{text:>16}"
    return f"{value:16.9e}"


@dataclass(frozen=True, kw_only=True)
class DmigExporter(Exporter):
    """Reduced matrices MAAX, KAAX, BAAX on GRIDs of the interfaces and SPOINTs of the other coordinates.

    The coordinates are changed so that interface degrees of freedom are among them (exactly, all coordinates are
    kept). ``first_label`` is the label of the first GRID; by default behind the labels of the model.
    """

    name: ClassVar[str] = "dmig"
    suffix: ClassVar[str] = ".dmig.bdf"
    about: ClassVar[str] = "Nastran DMIG: reduced matrices on interface grids and scalar points"
    takes_massless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping"})

    first_label: int | None = None

    def _write(self, context: ExportContext) -> Exported:
        body = on_interfaces(context, self.first_label, component_of_rest=0, largest_label=LargeField.LARGEST_LABEL)
        labels = np.stack([body.node, body.dof], axis=1)
        order = np.lexsort((labels[:, 1], labels[:, 0]))
        lines = [
            f"$ Elastic body {_ascii(context.body.name)} in SI units, {len(labels)} coordinates.",
            "$ Case control: M2GG = MAAX, K2GG = KAAX" + (", B2GG = BAAX" if "D" in body.matrices else ""),
        ]
        for label, name, point in body.grids:
            lines.append(f"$ interface {_ascii(name)}")
            fields = "".join(sixteen(x) for x in point)
            lines.append(f"{'GRID*':8}{label:16}{'':16}{fields[:32]}\n{'*':8}{fields[32:]}")
        if body.rest:
            lines.append(
                f"{'SPOINT':8}{body.rest[0]:8}{'THRU':>8}{body.rest[-1]:8}"
                if len(body.rest) > 1
                else f"{'SPOINT':8}{body.rest[0]:8}"
            )
        matrices = {
            _NAMES[key]: DmigMatrix(
                matrix=sp.csr_array(A[np.ix_(order, order)]), rows=labels[order], columns=labels[order], form=6
            )
            for key, A in body.matrices.items()
        }
        write_dmig(context.path, matrices, "\n".join(lines) + "\n")
        return Exported(
            paths=(context.path,),
            notes=("numbers have 11 digits or more, as fields of 16 characters hold", *body.notes),
        )

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        body = on_interfaces(context, self.first_label, component_of_rest=0, largest_label=LargeField.LARGEST_LABEL)
        read = read_dmig(files[context.path])
        found = {key: (read[name].matrix, *read[name].rows.T) for key, name in _NAMES.items() if name in read}
        return ReadBack(
            found=body.transfer(found),
            expected=body_transfer(context.body),
            digits=LargeField.FEWEST_DIGITS,
            changed=True,
        )


def _ascii(name: str) -> str:
    return name.encode("ascii", "replace").decode("ascii")
