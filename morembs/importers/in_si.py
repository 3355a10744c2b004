"""What files hold, in SI units: matrices, columns of inputs and outputs, equations, materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.units import Units
from morembs.fem import DofMap, NamedColumns
from morembs.fem.constraints import Equations
from morembs.fem.fe_model import MATRICES, Component
from morembs.fem.material import Material
from morembs.importers.imported import Imported


def matrices_in_si(imported: Imported, dofs: DofMap, units: Units) -> list[sp.csr_array | None]:
    """K, M, D, G and N in N/m, kg and Ns/m; rows and columns of rotations are per rad.

    A dof in rad has the force Nm: with w = 1 for displacements (and scalars, which count as such) and w = m per
    unit of length for rotations an entry is scaled by w_i w_j times the factor of displacements.
    """
    factors = {"K": units.stiffness, "M": units.mass, "N": units.stiffness}
    weight = np.where(dofs.turning, units.length, 1.0)
    plain = units.length == 1.0 or not dofs.turning.any()
    scaled = []
    for name in MATRICES:
        matrix, factor = getattr(imported, name), factors.get(name, units.mass / units.time)
        if matrix is None or (plain and factor == 1.0):
            scaled.append(matrix)
            continue
        data = matrix.data * factor
        if not plain:
            data *= np.repeat(weight, np.diff(matrix.indptr))
            data *= weight[matrix.indices]
        scaled.append(sp.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape))
    return scaled


def forces_in_si(
    role: str, columns: NamedColumns | None, imported: Imported, dofs: DofMap, units: Units
) -> NamedColumns | None:
    """The columns on the dofs of the model, of which the dofs of elements come last.

    Generalised forces become N, and motions m: entries of displacements keep their values, those of rotations are
    lengths.
    """
    if columns is None:
        return None
    own = 0 if imported.K is None else imported.K.shape[0]
    if columns.matrix.shape[0] != own:
        raise InputError(
            f"{imported.source}: {role} is for {columns.matrix.shape[0]} dofs; expected {own}, as many as rows of K",
            kind="conflict",
        )
    matrix = columns.matrix.copy()
    matrix.resize((len(dofs), len(columns.names)))
    if units.length != 1.0 and dofs.turning.any():
        matrix = sp.csc_array(sp.diags_array(np.where(dofs.turning, units.length, 1.0)) @ matrix)
    return replace(columns, matrix=matrix)


def equations_in_si(equations: Sequence[Equations], units: Units) -> tuple[Equations, ...]:
    """Equations between displacements in m and rotations in rad."""
    if units.length == 1.0:
        return tuple(equations)

    def scale(given: Equations) -> Equations:
        both = (given.components, given.term_components)
        size, of_terms = (np.where((c > 2) & (c < Component.SCALAR), 1.0, units.length) for c in both)
        return replace(given, coefficients=given.coefficients * size[given.equation] / of_terms)

    return tuple(map(scale, equations))


def materials_in_si(materials: Sequence[Material], units: Units) -> tuple[Material, ...]:
    """Materials in Pa and kg/m3."""
    if units.stress == 1.0 and units.density == 1.0:
        return tuple(materials)
    return tuple(
        replace(material, stiffness=material.stiffness * units.stress, density=material.density * units.density)
        for material in materials
    )
