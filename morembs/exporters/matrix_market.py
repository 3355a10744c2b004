"""Matrix Market files: reduced matrices, one file each."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import ClassVar

import numpy as np
from scipy.io import mmwrite

from morembs.exporters.base import Exported, Exporter, Task
from morembs.exporters.reduced import reduced_matrices
from morembs.safefile import replacing

_DIGITS = 17
_MEANING = {"M": "mass", "K": "stiffness", "D": "damping", "B": "input", "C": "output"}


@dataclass(frozen=True, kw_only=True)
class MatrixMarketExporter(Exporter):
    """Reduced matrices M, K, D, B (and C where it is not B'), in files such as conrod_M.mtx; 17 digits."""

    name: ClassVar[str] = "matrix-market"
    suffix: ClassVar[str] = ".mtx"
    about: ClassVar[str] = "Matrix Market: reduced matrices M, K, D, B, one file each"
    lossless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False

    def _write(self, task: Task) -> Exported:
        stem = task.path.name.removesuffix(task.path.suffix)
        paths = []
        for key, matrix in reduced_matrices(task.body).items():
            path = task.path.with_name(f"{stem}_{key}.mtx")
            text = BytesIO()
            square = key in ("M", "K", "D") and np.array_equal(matrix, matrix.T)
            mmwrite(
                text, matrix, comment=f" {_MEANING[key]} matrix of a reduced body, SI units{self._columns(task, key)}",
                precision=_DIGITS, symmetry="symmetric" if square else "general",
            )  # fmt: skip
            with replacing(path) as file:
                file.write(text.getvalue())
            paths.append(path)
        return Exported(paths=tuple(paths), notes=task.lost("stiffening", "stress", "certificate"))

    @staticmethod
    def _columns(task: Task, key: str) -> str:
        """Meaning of the columns of B, as comment lines."""
        if key != "B":
            return ""
        source, names = task.source, list(task.source.interfaces)
        lines: list[str] = []
        for index, component, node in zip(
            source.input_interface.tolist(), source.input_component.tolist(), source.input_node_id.tolist(), strict=True
        ):
            where = "" if node < 0 else f" node {node}"
            name = names[index].encode("ascii", "replace").decode().replace("\n", " ")
            lines.append(f"\n column {len(lines) + 1}: {name}{where} component {component + 1}")
        return "".join(lines)
