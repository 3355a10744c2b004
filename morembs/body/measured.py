"""Tables of measured frequencies and shapes, for updates of bodies with parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.parametric import ParametricBody
from morembs.parametric.tolerances import TOL as PARAMETRIC
from morembs.parametric.update import Measured
from morembs.storage.csv_table import read_table


def read_measured(path: Path, parametric: ParametricBody, shapes: Path | None = None) -> Measured:
    """Measured frequencies, and shapes where there are any.

    Raises:
        InputError: a table that cannot be read, columns that are missing, or nodes that the body file does not keep.
    """
    columns = read_table(path, ("mode", "frequency_hz"), ("sigma_hz",))
    modes, frequencies = columns["mode"], columns["frequency_hz"]
    if (modes != np.round(modes)).any():
        raise InputError(f"the table {path} has modes {modes.tolist()}; expected integers from 1")
    sigma = columns.get("sigma_hz", PARAMETRIC.measured_deviation * frequencies)
    motions, basis = _shapes(shapes, modes, parametric) if shapes is not None else (None, None)
    return Measured(
        modes=modes.astype(np.int64), frequencies_hz=frequencies, sigma_hz=sigma, shapes=motions, basis=basis
    )


def _shapes(path: Path, modes: Floats, parametric: ParametricBody) -> tuple[Floats, Floats]:
    """Shapes (k, d) in the order of ``modes``, and the basis (d, n) there."""
    columns = read_table(path, ("mode", "id", "ux", "uy", "uz"))
    ids = np.unique(columns["id"])
    kept = parametric.source.node_ids
    lost = np.setdiff1d(ids, kept)
    if len(lost):
        raise InputError(
            f"the table {path} has the node {lost[0]:.0f}, and the body file keeps {len(kept)} nodes without it; make "
            'the body with [output] nodes = "all", or leave it out'
        )
    motions = np.full((len(modes), len(ids), 3), np.nan)
    for mode, node, *motion in zip(*columns.values(), strict=True):
        if mode not in modes:
            raise InputError(f"the table {path} has a shape of mode {mode:g}, of which no frequency was measured")
        own = motions[np.flatnonzero(modes == mode)[0], np.searchsorted(ids, node)]
        if not np.isnan(own).all():
            raise InputError(
                f"the table {path} has the node {node:.0f} twice in mode {mode:g}; give it one row there",
                kind="conflict",
            )
        own[:] = motion
    if np.isnan(motions).any():
        raise InputError(f"the table {path} lacks nodes in some of its shapes; expected every mode at the same nodes")
    rows = 3 * np.flatnonzero(np.isin(kept, ids))[:, None] + np.arange(3)
    order = np.argsort(np.argsort(kept[np.isin(kept, ids)]))
    return motions[:, order].reshape(len(modes), -1), parametric.stored.basis()[rows.ravel()]
