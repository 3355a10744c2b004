"""The bracket with four parameters, and a basis for them that no reduction has chosen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from morembs.base.units import parse_units
from morembs.body import make_part
from morembs.body.build import BodyOptions, build_body
from morembs.body.file import write_body
from morembs.fem.interface import make_interface
from morembs.fem.material import isotropic
from morembs.fem.selection import select_nodes
from morembs.importers import read_mesh
from morembs.parametric.model import parametric_model
from morembs.parametric.parameter import Parameter
from morembs.reducers.base import Basis, Reducer

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


def some_basis(problem, modes=8, corners=6):
    """Rigid motions of all values, modes and static responses at nominal values and some corners, M-orthonormal."""
    columns = [problem.rigid_terms.reshape(problem.K.shape[0], -1)]
    high = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1], [0, 1, 0], [0, 1, 1]], dtype=bool)
    varied = [n for n, kind in enumerate(problem.box.kinds) if kind in ("young", "morph")]
    values = np.tile(problem.box.nominal, (len(high), 1))
    values[:, varied] = np.where(high[:, : len(varied)], problem.box.high[varied], problem.box.low[varied])
    for p in (problem.box.nominal, *values[:corners]):
        with problem.at(p) as there:
            columns += [there.elastic_modes(count=modes).vectors, there.free_free.flexibility(there.B.toarray())]
    X = np.hstack(columns)
    Z = problem.rigid
    X -= Z @ (Z.T @ (problem.M @ X))
    X /= np.sqrt(np.einsum("ij,ij->j", X, problem.M @ X)).clip(1e-300)
    for _ in range(2):
        values, Q = np.linalg.eigh(X.T @ (problem.M @ X))
        keep = values > 1e-12 * values[-1]
        X = X @ (Q[:, keep] / np.sqrt(values[keep]))
    return np.hstack([Z, X])


@dataclass(frozen=True, kw_only=True)
class SomeBasis(Reducer):
    """``some_basis`` as a reduction, which nobody has searched for."""

    method: ClassVar[str] = "some-basis"
    modes: int = 4

    def _basis(self, problem):
        V = some_basis(problem, self.modes, corners=2)
        K = V.T @ (problem.K @ V)
        return Basis(V=V, kinds=("rigid",) * 6 + ("krylov",) * (V.shape[1] - 6), K=K, rigid=np.eye(V.shape[1], 6))

    def variation(self, problem, reduced):
        return parametric_model(problem, reduced.V)


def parametric_file(path, problem, options=None, nodes="all", name=None):
    """The body file of ``SomeBasis``."""
    reducer = SomeBasis()
    reduced = reducer.reduce(problem, name)
    variation = reducer.variation(problem, reduced)
    body = build_body(problem, reduced, make_part(problem, nodes), options or BodyOptions(), variation=variation)
    return write_body(path, [body])
