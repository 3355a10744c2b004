"""The bracket with four parameters, and a basis for them that no reduction has chosen."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from morembs.importers import read_mesh
from morembs.interface import make_interface
from morembs.model.material import isotropic
from morembs.model.selection import select_nodes
from morembs.parametric.parameter import Parameter
from morembs.units import parse_units

BRACKET = Path(__file__).parents[2] / "data" / "small_meshes" / "bracket.inp"
ARM = ("Volume2", "Volume3", "Volume4", "Volume5")
REST = ("Volume1", "Volume6")
STEEL = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)


def bracket():
    return read_mesh(BRACKET, parse_units("mm-kg-s"))


def parameters():
    return (
        Parameter(name="E_arm", kind="young", low=1.5e11, high=2.7e11, nominal=2.1e11, sets=ARM),
        Parameter(name="E_rest", kind="young", low=1.5e11, high=2.7e11, nominal=2.0e11, sets=REST),
        Parameter(name="rho", kind="density", low=7000.0, high=8700.0, nominal=7850.0),
        Parameter(name="alpha", kind="alpha", low=0.0, high=50.0, nominal=10.0),
    )


def longer(mesh):
    """Displacement of the arm along z per millimetre: its lower end stays."""
    xyz = 1e3 * mesh.nodes.xyz
    d = np.zeros_like(xyz)
    d[:, 2] = 1e-3 * np.where(xyz[:, 1] <= 10 + 1e-9, np.clip((xyz[:, 2] - 10) / 10, 0, 1), 0)
    return Parameter(name="t", kind="morph", low=-3.0, high=3.0, nominal=0.0, displacement=d)


def interfaces(model):
    return [make_interface(model, name=name, nodes=select_nodes(model, f"set:{name}")) for name in ("FOOT", "TIP")]


def some_basis(problem, modes=8):
    """Rigid motions of all values, modes and static responses at nominal values and some corners, M-orthonormal."""
    columns = [problem.rigid_terms.reshape(problem.K.shape[0], -1)]
    high = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1], [0, 1, 0], [0, 1, 1]], dtype=bool)
    varied = [n for n, kind in enumerate(problem.box.kinds) if kind in ("young", "morph")]
    corners = np.tile(problem.box.nominal, (len(high), 1))
    corners[:, varied] = np.where(high[:, : len(varied)], problem.box.high[varied], problem.box.low[varied])
    for p in (problem.box.nominal, *corners):
        with problem.at(p) as there:
            columns += [there.elastic_modes(count=modes).vectors, there.elastic.flexibility(there.B.toarray())]
    X = np.hstack(columns)
    Z = problem.rigid
    X -= Z @ (Z.T @ (problem.M @ X))
    X /= np.sqrt(np.einsum("ij,ij->j", X, problem.M @ X)).clip(1e-300)
    for _ in range(2):
        values, Q = np.linalg.eigh(X.T @ (problem.M @ X))
        keep = values > 1e-12 * values[-1]
        X = X @ (Q[:, keep] / np.sqrt(values[keep]))
    return np.hstack([Z, X])
