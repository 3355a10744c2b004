"""Matrix Market files: reduced matrices, one file each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.io import mmwrite

from morembs.exporters.base import ExportContext, Exported, Exporter
from morembs.exporters.read_back import ReadBack
from morembs.exporters.reduced import reduced_matrices, second_order
from morembs.exporters.tolerances import TOL
from morembs.fem.fe_model import Component
from morembs.importers.matrices.matrix_market import read_matrix_market
from morembs.storage.safefile import replacing_all

_MEANING = {"M": "mass", "K": "stiffness", "D": "damping", "B": "input", "C": "output"}


@dataclass(frozen=True, kw_only=True)
class MatrixMarketExporter(Exporter):
    """Reduced matrices M, K, D, B (and C where it is not B'), in files such as conrod_M.mtx; 17 digits."""

    name: ClassVar[str] = "matrix-market"
    suffix: ClassVar[str] = ".mtx"
    about: ClassVar[str] = "Matrix Market: reduced matrices M, K, D, B, one file each"
    takes_massless: ClassVar[bool] = True
    needs_frame: ClassVar[bool] = False
    holds: ClassVar[frozenset[str]] = frozenset({"damping", "forces"})

    def _write(self, context: ExportContext) -> Exported:
        matrices = reduced_matrices(context.body)
        paths = {key: context.beside(f"_{key}.mtx") for key in matrices}
        with replacing_all(list(paths.values())) as files:
            for (key, matrix), file in zip(matrices.items(), files, strict=True):
                text = BytesIO()
                square = key in ("M", "K", "D") and np.array_equal(matrix, matrix.T)
                comment = f" {_MEANING[key]} matrix of a reduced body, SI units{self._columns(context, key)}"
                kind = "symmetric" if square else "general"
                mmwrite(text, matrix, comment=comment, precision=TOL.double_digits, symmetry=kind)
                file.doing = f"matrix {key}"
                file.write(text.getvalue())
                file.check()
        stale = context.left_from_before([context.beside(f"_{key}.mtx") for key in _MEANING if key not in paths])
        return Exported(paths=tuple(paths.values()), notes=stale)

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack:
        names = {context.beside(f"_{key}.mtx"): key for key in _MEANING}
        found = second_order({names[path]: read_matrix_market(file) for path, file in files.items()})
        return ReadBack(found=found, expected=second_order(reduced_matrices(context.body)), digits=TOL.double_digits)

    @staticmethod
    def _columns(context: ExportContext, key: str) -> str:
        """Meaning of the columns of B, as comment lines."""
        if key != "B":
            return ""
        source, names = context.source, list(context.source.interfaces)
        lines: list[str] = []
        for index, component, node in zip(
            source.input_interface.tolist(), source.input_component.tolist(), source.input_node_id.tolist(), strict=True
        ):
            where = "" if node < 0 else f" node {node}"
            name = names[index].encode("ascii", "replace").decode().replace("\n", " ")
            motion = "generalised force" if component == Component.SCALAR else f"component {component + 1}"
            lines.append(f"\n column {len(lines) + 1}: {name}{where} {motion}")
        return "".join(lines)
