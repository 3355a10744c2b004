"""Limits of random bodies with parameters at random values, proven again by ``morembs_verify``; and false ones.

    python benchmarks/verification_at.py --count 60 --tampers 60 --seed 1

Trusses with moduli (linear and squared), a thickness (cubic in K, linear in M), a density, springs to the ground, and
Rayleigh damping, of which one to four vary; one model in four is a bar of hexahedra whose length varies too. Exact
errors are dense modal sums of matrices that this program sums from the files by itself, at 20,000 frequencies of the
band and beside all poles. A false file has new digests, and its exact error exceeds the limit, or it says what is not
so: other values, ranges, cells, or modes.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp

from benchmarks.certificates import DAMPINGS, damping_of, dense_errors
from benchmarks.verification import reseal
from morembs.app.jobs.witness import problem_at_values, witness_at_values
from morembs.base.errors import InputError, MorembsError
from morembs.base.types import Floats
from morembs.body import elastic_body, make_part
from morembs.body.file import write_body
from morembs.body.parametric_parts import ParametricParts
from morembs.certificate.certify import certify
from morembs.certificate.morembs_verify import verify
from morembs.fem import DofMap, ElementBlock, FEModel, Mesh, Nodes
from morembs.fem.interface import Interface, make_interface
from morembs.fem.material import isotropic
from morembs.fem.model_terms import ModelTerms
from morembs.importers.model_file import read_model, write_model
from morembs.importers.native import import_terms
from morembs.parametric.law import LAGRANGE, LINEAR, ONE, SQUARE, Law, chebyshev_points
from morembs.parametric.model import ParametricModel
from morembs.parametric.parameter import Parameter
from morembs.parametric.stored_terms import box_of, model_at, terms_of
from morembs.parametric.varied import varied_model
from morembs.problem import Problem
from morembs.reducers.base import Basis, ReducedModel, Reducer

NAME = "some-basis"
PLACE = f"certificates/{NAME}"
TAMPERS = (
    *("limit", "mode", "cells", "term", "mass term", "law", "points", "body term", "value", "asked", "moved", "range"),
    *("new witness of terms", "new witness of a value"),
)


@dataclass(frozen=True, kw_only=True)
class OfColumns(Reducer):
    """The span of given columns, rigid motions first."""

    method = NAME
    columns: Any = None

    def _basis(self, problem: Problem) -> Basis:
        V, r = self.columns, problem.rigid.shape[1]
        return Basis(
            V=V,
            kinds=("rigid",) * r + ("krylov",) * (V.shape[1] - r),
            K=V.T @ (problem.K @ V),
            rigid=np.eye(V.shape[1], r),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Files of a body with parameters, the ``values`` that its limits are of, and the exact problem and body there."""

    words: str
    files: tuple[Path, Path, Path]
    values: dict[str, float]
    problem: Problem
    body: ReducedModel
    band: tuple[float, float]


def stiffness(rng: np.random.Generator, xyz: Floats, part: float) -> Floats:
    """Bars between near points, each with this chance but for those of the first triangles."""
    K = np.zeros((3 * len(xyz),) * 2)
    for b, back in itertools.product(range(1, len(xyz)), range(1, 6)):
        a = b - back
        if a >= 0 and rng.uniform() < part:
            v = np.zeros(len(K))
            way = (xyz[b] - xyz[a]) / np.linalg.norm(xyz[b] - xyz[a])
            v[3 * a : 3 * a + 3], v[3 * b : 3 * b + 3] = -way, way
            K += 1e6 * rng.uniform(0.3, 3) * np.outer(v, v)
    return K


def truss(rng: np.random.Generator) -> tuple[FEModel, ModelTerms, str]:
    """A model of bars at nominal values, and its terms."""
    count, held = int(rng.integers(8, 24)), bool(rng.integers(2))
    xyz = rng.uniform(0, 1, (count, 3)) * [1.0, 0.4, 0.3]
    xyz = xyz[np.argsort(xyz[:, 0])]
    n, whole, some = 3 * count, stiffness(rng, xyz, 1.0), stiffness(rng, xyz, 0.5)
    masses = [np.diag(np.repeat(10 ** rng.uniform(-0.5, 0.5, count), 3)) for _ in range(2)]
    pool = ["E", "square", "h", "rho", "alpha", "beta"] + (["k"] if held else [])
    names = sorted(rng.permutation(pool)[: int(rng.integers(1, 5))].tolist())
    if not set(names) - {"alpha", "beta"}:
        names = sorted({*names, "E"})
    kinds = {"E": "young", "square": "young", "h": "morph", "rho": "density", "k": "spring"}
    place, grids, rows_K, K, rows_M, M = {name: i for i, name in enumerate(names)}, {}, [], [], [], []

    def row(**factors: int) -> list[int]:
        return [factors.get(name, ONE) for name in names]

    def plain(name: str, power: int) -> dict[str, int]:
        return {name: power} if name in place else {}

    rows_K.append(row(**plain("E", LINEAR), **plain("square", SQUARE)))
    K.append(whole)
    grids["K"] = grids["M"] = np.zeros(0)
    if "h" in place:
        grids = {"K": chebyshev_points(0.6, 1.7, 4), "M": chebyshev_points(0.6, 1.7, 2)}
        bent = stiffness(rng, xyz, 0.7)
        for k, h in enumerate(grids["K"].tolist()):
            rows_K.append(row(h=LAGRANGE + k, **plain("E", LINEAR)))
            K.append(h * some + h**3 * bent)
        for k, h in enumerate(grids["M"].tolist()):
            rows_M.append(row(h=LAGRANGE + k, **plain("rho", LINEAR)))
            M.append(h * masses[1])
    else:
        rows_M.append(row(**plain("rho", LINEAR)))
        M.append(masses[1])
    rows_M.append(row())
    M.append(masses[0])
    if held:
        ground = np.zeros((n, n))
        ground[:9, :9] = 1e6 * np.eye(9)
        rows_K.append(row(**plain("k", LINEAR)))
        K.append(ground)
    terms = ModelTerms(
        names=tuple(names),
        kinds=tuple(kinds.get(name, name) for name in names),
        low=np.full(len(names), 0.6),
        high=np.full(len(names), 1.7),
        nominal=np.ones(len(names)),
        law_K=np.array(rows_K),
        law_M=np.array(rows_M),
        points_K={"h": grids["K"]} if "h" in place else {},
        points_M={"h": grids["M"]} if "h" in place else {},
        K=tuple(sp.csr_array(0.5 * (A + A.T)) for A in K),
        M=tuple(sp.csr_array(A) for A in M),
        displacement={"h": np.zeros_like(xyz)} if "h" in place else {},
    )
    nothing = sp.csr_array((n, n))
    dofs = DofMap(node=np.repeat(np.arange(count), 3), component=np.tile(np.arange(3), count))
    bare = FEModel(K=nothing, M=nothing, nodes=Nodes(ids=np.arange(1, count + 1), xyz=xyz), dofs=dofs)
    words = f"{'held' if held else 'free'} truss of {', '.join(names)}"
    return model_at(bare, terms, terms.nominal), terms, words


def bar(rng: np.random.Generator) -> tuple[FEModel, ModelTerms, str]:
    """A bar of hexahedra, whose length, modulus, density or damping vary."""
    n, size = int(rng.integers(2, 5)), rng.uniform([0.3, 0.02, 0.02], [0.6, 0.06, 0.06])
    corners = np.array(list(itertools.product(range(n + 1), range(2), range(2))))
    xyz = corners / [n, 1, 1] * size
    at = {tuple(place): row for row, place in enumerate(corners.tolist())}
    around = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = np.array([[at[i + a, b, c] for a, b, c in around] for i in range(n)])
    block = ElementBlock(type="hex8", nodes=cells, ids=np.arange(1, n + 1))
    mesh = Mesh(nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz), blocks=(block,))
    longer = np.zeros_like(xyz)
    longer[:, 0] = np.where(xyz[:, 0] > 0.9 * size[0], 1.0, np.where(xyz[:, 0] > 0.1 * size[0], 0.5, 0.0))
    pool = [
        Parameter(name="E", kind="young", low=1.2e11, high=2.9e11, nominal=2.1e11),
        Parameter(name="rho", kind="density", low=6000.0, high=9000.0, nominal=7850.0),
        Parameter(name="t", kind="morph", low=-0.03, high=0.03, nominal=0.0, displacement=longer),
        Parameter(name="alpha", kind="alpha", low=0.0, high=50.0, nominal=10.0),
    ]
    chosen = [pool[2], *(pool[i] for i in rng.permutation([0, 1, 3])[: int(rng.integers(0, 3))])]
    steel = isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    varied = varied_model(mesh, [steel], chosen)
    model = replace(varied.model(varied.box.nominal), mesh=None, materials=())
    return model, terms_of(varied), f"bar of {n} hexahedra of {', '.join(each.name for each in chosen)}"


def faces(rng: np.random.Generator, model: FEModel, is_bar: bool) -> list[Interface]:
    """Ends of a bar, or nodes of a truss."""
    if is_bar:
        x = model.nodes.xyz[:, 0]
        ends = (np.flatnonzero(x == x.min()), "rigid"), (np.flatnonzero(x == x.max()), "average")
        return [make_interface(model, name=f"i{k}", nodes=at, coupling=kind) for k, (at, kind) in enumerate(ends)]
    nodes = rng.permutation(len(model.nodes))[: int(rng.integers(1, 4))]
    wanted = [np.sort(rng.permutation(3)[: int(rng.integers(1, 4))]).tolist() for _ in nodes]
    return [
        make_interface(model, name=f"i{k}", nodes=np.array([node]), coupling="direct", components=own)
        for k, (node, own) in enumerate(zip(nodes, wanted, strict=True))
    ]


def basis(rng: np.random.Generator, problem: Problem, others: list[Problem], high: float) -> Floats:
    """Rigid motions, then modes and static responses at several values, M-orthonormal."""
    Z, columns = problem.rigid, list[Floats]()
    if len(problem.model.nodes) and Z.shape[1]:
        columns += [there.rigid for there in others]
    for there in (problem, *others):
        count = len(there.elastic_modes(below=(2 * np.pi * high) ** 2).eigenvalues) + int(rng.integers(0, 4))
        columns.append(there.elastic_modes(count=max(count, 2)).vectors)
        if rng.uniform() < 0.7:
            columns.append(there.free_free.flexibility(there.B.toarray()))
    X = np.hstack(columns)
    for _ in range(2):
        X = X - Z @ (Z.T @ (problem.M @ X))
        X = X / np.sqrt(np.einsum("ij,ij->j", X, problem.M @ X)).clip(1e-300)
        values, Q = np.linalg.eigh(X.T @ (problem.M @ X))
        keep = values > 1e-9 * values[-1]
        X = X @ (Q[:, keep] / np.sqrt(values[keep]))
    return np.hstack([Z, X])


def cases(seed: int, number: int, folder: Path) -> Iterator[Case]:
    """Two values of the random model ``number``, each while its files are there."""
    rng = np.random.default_rng([seed, number])
    is_bar = number % 4 == 3
    model, terms, words = bar(rng) if is_bar else truss(rng)
    box, kind = box_of(terms), str(rng.choice(DAMPINGS))
    if {"alpha", "beta"} & set(box.kinds) and kind == "modal":
        kind = "rayleigh"
    ends, files = faces(rng, model, is_bar), tuple(folder / f"{name}.h5" for name in ("body", "model", "witness"))
    with Problem(model, ends) as plain:
        omega = np.sqrt(plain.elastic_modes(count=9).eigenvalues)
    high = float(omega[int(rng.integers(3, 7))] * rng.uniform(1.01, 1.1) / (2 * np.pi))
    damping = box.damping(damping_of(rng, kind, omega), box.nominal)
    away = [model_at(model, terms, rng.uniform(box.low, box.high)) for _ in range(int(rng.integers(1, 4)))]
    with Problem(model, ends, damping=damping) as problem:
        others = [Problem(each, ends) for each in away]
        V = basis(rng, problem, others, high)
        write_files(files, problem, terms, V, (0.0, high))
    for value in rng.uniform(box.low, box.high, (2, len(box.low))):
        values = {name: float(x) for name, x in zip(box.names, value, strict=True) if rng.uniform() < 0.8}
        witness_at_values(*files, values)
        at = problem_at_values(*files[:2], values)
        with at.problem as there:
            yield Case(
                words=f"{number}: {words}, {kind}, at {values}",
                files=files,
                values=values,
                problem=there,
                body=at.bodies[0],
                band=(0.0, high),
            )


def write_files(
    files: tuple[Path, ...], problem: Problem, terms: ModelTerms, V: Floats, band: tuple[float, float]
) -> None:
    """The body of the basis ``V`` with its certificate and parameters, and the model."""
    reduced = OfColumns(columns=V).reduce(problem, NAME)
    (certificate,) = certify(problem, [reduced], band, points=10)
    box, T = box_of(terms), problem.coupling.T
    # Rigid motions of moved nodes are among the columns.
    rigid = np.zeros((V.shape[1], problem.rigid.shape[1], 1 + len(box.morphs)))
    rigid[:, :, 0] = np.eye(V.shape[1], problem.rigid.shape[1])
    for k, number in enumerate(box.morphs):
        if problem.rigid.shape[1] and terms.displacement[box.names[number]].any():
            rigid[:, :, 1 + k] = moved_rigid(problem, terms, number, V)
    laws = [
        Law(factors=factors, points=tuple(points.get(name, np.zeros(0)) for name in box.names))
        for factors, points in ((terms.law_K, terms.points_K), (terms.law_M, terms.points_M))
    ]
    TV = T @ V
    own = ParametricModel(
        box=box,
        law_K=laws[0],
        law_M=laws[1],
        K=np.array([TV.T @ (A @ TV) for A in terms.K]),
        M=np.array([TV.T @ (A @ TV) for A in terms.M]),
        B=reduced.B,
        rigid=rigid,
        damping=problem.damping,
        scale=problem.motion_scale,
    )
    part = make_part(problem)
    moves = {name: d[: len(part.nodes.ids)] for name, d in terms.displacement.items()}
    body = replace(
        elastic_body(problem, reduced, part, certificate), parameters=ParametricParts(model=own, displacement=moves)
    )
    write_body(files[0], [body])
    write_model(files[1], problem.model, terms=terms)


def moved_rigid(problem: Problem, terms: ModelTerms, number: int, V: Floats) -> Floats:
    """Coordinates (n, r) of how rigid motions change per unit of a morph."""
    p = terms.nominal.copy()
    p[number] = terms.high[number]
    there = model_at(problem.model, terms, p)
    away = (p - terms.nominal)[number] * terms.displacement[terms.names[number]]
    ends = [replace(each, point=each.point + away[each.nodes[0]]) for each in problem.interfaces]
    with Problem(there, ends) as moved:
        # The same unit motions, about one point.
        near, far = ((each.rigid, each.coupling.R) for each in (problem, moved))
        turns = np.linalg.lstsq(near[1], near[0], rcond=None)[0]
        shift = np.eye(6)
        d = problem.coupling.pole - moved.coupling.pole
        shift[:3, 3:] = [[0, -d[2], d[1]], [d[2], 0, -d[0]], [-d[1], d[0], 0]]
        change = far[1] @ shift @ turns - near[0]
    coordinates = V.T @ (problem.M @ change)
    if np.abs(V @ coordinates - change).max() > 1e-6 * np.abs(change).max():
        raise InputError("the basis does not span rigid motions of moved nodes")
    return np.asarray(coordinates / (p - terms.nominal)[number])


def sums(group: Any, name: str, values: dict[str, float], dense: bool) -> Any:
    """Sum of terms in a file, by this program."""
    names = [each.decode() for each in group["names"][()]]
    p = [values.get(each, value) for each, value in zip(names, group["nominal"][()].tolist(), strict=True)]
    total: Any = 0.0
    for q, row in enumerate(group[f"law/{name}"][()].tolist()):
        theta = 1.0
        for each, x, factor in zip(names, p, row, strict=True):
            if factor < LAGRANGE:
                theta *= x**factor
            else:
                t = group[f"law/points_{name}/{each}"][()]
                rest = np.delete(t, factor - LAGRANGE)
                theta *= np.prod((x - rest) / (t[factor - LAGRANGE] - rest))
        if dense:
            total = total + theta * group[name][q]
        else:
            own = group[f"{name}_{q}"]
            term = sp.csr_array((own["data"][()], own["indices"][()], own["indptr"][()]), shape=own["shape"][()])
            total = total + theta * term
    return total


def exact(case: Case) -> Floats:
    """Largest errors (3,) of what the files say, from dense modal sums."""
    with h5py.File(case.files[1]) as model, h5py.File(case.files[0]) as bodies:
        K, M = (sums(model["terms"], name, case.values, False) for name in ("K", "M"))
        own = bodies[f"bodies/{NAME}/parametric"]
        K_r, M_r = (sums(own, name, case.values, True) for name in ("K", "M"))
    with h5py.File(case.files[2]) as witness:
        at = [limit[()][2] for limit in witness[f"{PLACE}/limits"].values()]
    full = replace(case.problem.model, K=sp.csr_array(0.5 * (K + K.T)), M=sp.csr_array(M))
    r, damping = case.body.rigid_count, case.problem.damping
    Z = np.linalg.svd(K_r)[0][:, len(K_r) - r :]
    Z = Z @ np.linalg.inv(np.linalg.cholesky(Z.T @ M_r @ Z)).T
    body = replace(case.body, K=K_r, M=M_r, D=damping.matrix(M_r, K_r, Z))
    with Problem(full, case.problem.interfaces, damping=damping) as problem:
        return np.asarray(dense_errors(problem, body, case.band, at)[1].max(axis=0))


def _put(file: Any, name: str, value: object) -> None:
    del file[name]
    file[name] = value


def limit_of(case: Case) -> float:
    """The stated limit of the envelope error."""
    with h5py.File(case.files[2]) as file:
        return float(file[f"{PLACE}/limits/envelope"][()][1])


def tamper(case: Case, kind: str, rng: np.random.Generator) -> dict[str, float] | None:
    """Make the files of ``case`` false; the values to ask for, None where that is not possible."""
    body, model, witness = case.files
    asked, sound = case.values, [file.read_bytes() for file in case.files]
    if kind in ("limit", "mode", "cells", "value"):
        true = exact(case)[0] if kind == "limit" else 0.0
        with h5py.File(witness, "r+") as file:
            done = _change_witness(file, kind, true, rng)
        if not done:
            return None
    elif kind == "asked":
        with h5py.File(model) as file:
            j = int(rng.integers(len(file["terms/names"])))
            name, ends = file["terms/names"][j].decode(), [file[f"terms/{end}"][j] for end in ("low", "high")]
        return case.values | {name: float(rng.uniform(*ends))}
    elif kind in ("moved", "new witness of a value"):
        return _move(case, rng, kind != "moved")
    elif kind == "new witness of terms":
        return asked if _change_model(case, rng) else None
    elif kind == "range":
        if not case.values:
            return None
        name, value = next(iter(case.values.items()))
        for path, place in ((model, "terms"), (body, f"bodies/{NAME}/parametric")):
            with h5py.File(path, "r+") as file:
                j = [each.decode() for each in file[f"{place}/names"]].index(name)
                file[f"{place}/high"][j] = value - 1e-3 * abs(value)
    else:
        for size in 10 ** np.arange(-3.0, 1.0):
            for path, data in zip(case.files, sound, strict=True):
                path.write_bytes(data)
            if not _change_terms(case, kind, float(size), rng):
                return None
            try:
                if exact(case)[0] > 1.01 * limit_of(case):
                    break
            except (MorembsError, np.linalg.LinAlgError):
                continue
        else:
            return None
    reseal(*case.files)
    return asked


def _change_model(case: Case, rng: np.random.Generator) -> bool:
    """Another stiffness with a witness of its own, but for the limits, which its exact error exceeds."""
    model, terms = read_model(case.files[1]), import_terms(case.files[1])
    with h5py.File(case.files[2]) as file:
        limits = {name: file[name][()] for name in _datasets(file)}
    q, limit = int(rng.integers(len(terms.K))), limit_of(case)
    for size in 10 ** np.arange(-3.0, 1.0):
        K = tuple((1 + size * (k == q)) * A for k, A in enumerate(terms.K))
        other = replace(terms, K=K)
        write_model(case.files[1], replace(model, K=model_at(model, other, terms.nominal).K), terms=other)
        if exact(case)[0] > 1.01 * limit:
            witness_at_values(*case.files, case.values)
            _state(case.files, limits)
            return True
    return False


def _datasets(file: Any) -> list[str]:
    """Paths of the datasets of the certificate in a witness."""
    names = list[str]()
    file[PLACE].visititems(
        lambda name, item: names.append(f"{PLACE}/{name}") if isinstance(item, h5py.Dataset) else None
    )
    return names


def _state(files: tuple[Path, Path, Path], limits: dict[str, Any]) -> None:
    """Put ``limits`` into a witness."""
    with h5py.File(files[2], "r+") as file:
        for name, value in limits.items():
            _put(file, name, value)
    reseal(*files)


def _move(case: Case, rng: np.random.Generator, is_new: bool) -> dict[str, float] | None:
    """The limits of the witness as those of other values, where the exact error exceeds them, in the witness as it is
    or in one that is made for these values."""
    with h5py.File(case.files[1]) as file:
        terms = {key: file[f"terms/{key}"][()] for key in ("names", "low", "high")}
    for j in rng.permutation(len(terms["names"])):
        name = terms["names"][j].decode()
        if name in ("alpha", "beta", "t"):
            continue
        for value in (terms["low"][j], terms["high"][j]):
            asked = case.values | {name: float(value)}
            if exact(replace(case, values=asked))[0] > 1.01 * limit_of(case):
                with h5py.File(case.files[2], "r+") as file:
                    file["at/values"][j] = value
                    limits = {each: file[each][()] for each in _datasets(file)}
                if is_new:
                    witness_at_values(*case.files, asked)
                _state(case.files, limits)
                return asked
    return None


def _change_witness(file: Any, kind: str, true: float, rng: np.random.Generator) -> bool:
    if kind == "limit":
        limit, cells = file[f"{PLACE}/limits/envelope"][()], file[f"{PLACE}/cell_limit"][()]
        limit[1] = true * rng.uniform(0.5, 0.999)
        cells[:, 0] = np.minimum(cells[:, 0], limit[1])
        _put(file, f"{PLACE}/limits/envelope", limit)
        _put(file, f"{PLACE}/cell_limit", cells)
    elif kind == "mode":
        count = int(file["modes_below"][()])
        if not count:
            return False
        left = np.delete(np.arange(file["vectors"].shape[1]), rng.integers(count))
        for name in ("vectors", "coefficients"):
            _put(file, name, file[name][()][:, left])
        _put(file, "modes_below", count - 1)
    elif kind == "cells":
        hz, limits = file[f"{PLACE}/cells_hz"][()], file[f"{PLACE}/cell_limit"][()]
        if len(hz) < 2:
            return False
        left = np.delete(np.arange(len(hz)), rng.integers(len(hz)))
        _put(file, f"{PLACE}/cells_hz", hz[left])
        _put(file, f"{PLACE}/cell_limit", limits[left])
    else:
        at = int(rng.integers(len(file["at/values"])))
        file["at/values"][at] *= 1.01
    return True


def _change_terms(case: Case, kind: str, size: float, rng: np.random.Generator) -> bool:
    """Other terms or laws, by a part ``size``."""
    if kind == "body term":
        with h5py.File(case.files[0], "r+") as file:
            terms = file[f"bodies/{NAME}/parametric/{rng.choice(['K', 'M'])}"]
            terms[int(rng.integers(len(terms)))] *= 1 + size
        return True
    with h5py.File(case.files[1], "r+") as file:
        terms = file["terms"]
        if kind in ("term", "mass term"):
            name = "K" if kind == "term" else "M"
            terms[f"{name}_{rng.integers(len(terms[f'law/{name}']))}/data"][...] *= 1 + size
        elif kind == "points":
            if "points_K" not in terms["law"]:
                return False
            points = next(iter(terms["law/points_K"].values()))
            points[...] += size * np.ptp(points[()]) * rng.standard_normal(len(points))
        else:
            law = terms["law/K"][()]
            row, column = (int(rng.integers(each)) for each in law.shape)
            if law[row, column] >= LAGRANGE:
                law[[row, row - 1]] = law[[row - 1, row]]
            else:
                law[row, column] = (law[row, column] + 1) % 3
            _put(file, "terms/law/K", law)
    return True


@dataclass
class Count:
    """What was proven."""

    told: int = 0
    proven: int = 0
    above: int = 0
    tampers: int = 0
    wrong: int = 0
    largest: float = 0.0
    effectivity: float = 0.0
    seconds: float = 0.0


def answer(case: Case, asked: dict[str, float], found: list[Floats] | None = None) -> tuple[bool, str]:
    """Whether the limits are proven, and the last sentence."""
    try:
        _, proven, said = verify(*map(str, case.files), found, asked)
    except (ValueError, LookupError, ArithmeticError) as error:
        return False, f"cannot be read: {error}"
    return proven, said.splitlines()[-1]


def judge(case: Case, count: Count) -> None:
    """Prove the limits of ``case`` again, and compare the exact errors with them."""
    start, found = time.process_time(), list[Floats]()
    holds, said = answer(case, case.values, found)
    count.seconds += time.process_time() - start
    count.told, count.proven = count.told + 1, count.proven + holds
    if not holds:
        print(f"{case.words}: {said}", flush=True)
        return
    with h5py.File(case.files[2]) as file:
        stated = np.array([file[f"{PLACE}/limits/{name}"][()][1] for name in ("envelope", "peak", "pointwise")])
    ratio, true = found[0], exact(case)
    count.largest = max(count.largest, float(ratio.max()))
    limit = ratio * stated
    # One bit more or less in the entries of all matrices changes these errors by up to 2e-13 of the envelope.
    over = (true - 1e-12 * true / true[0] > limit) & np.isfinite(limit)
    count.above += bool(over.any())
    count.effectivity = max(count.effectivity, float((limit[:1] / true[:1]).max()))
    if over.any():
        print(f"ABOVE: {case.words}: {true} of {limit}", flush=True)


def main() -> None:
    """Print how many are proven, and of the false ones the lemmas that refuse them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=20, help="limits of random models at random values")
    parser.add_argument("--tampers", type=int, default=22, help="false files")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng, count, refused, tried, number, skipped = np.random.default_rng(given.seed), Count(), Counter[str](), 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        while count.told < given.count or count.tampers < given.tampers:
            try:
                for case in cases(given.seed, number, Path(folder)):
                    if not np.isfinite(limit_of(case)):
                        continue
                    if count.told < given.count:
                        judge(case, count)
                    kind = TAMPERS[tried % len(TAMPERS)]
                    tried += count.tampers < given.tampers
                    sound = [file.read_bytes() for file in case.files]
                    asked = tamper(case, kind, rng) if count.tampers < given.tampers else None
                    if asked is not None:
                        count.tampers += 1
                        holds, said = answer(case, asked)
                        count.wrong += holds
                        refused[
                            f"{kind}: {said.partition(' fails')[0].partition('not verified: ')[2] or said[:60]}"
                        ] += 1
                        if holds:
                            print(f"FALSE AND PROVEN: {case.words}, {kind}: {said}", flush=True)
                    for file, data in zip(case.files, sound, strict=True):
                        file.write_bytes(data)
            except MorembsError as error:
                skipped += 1
                print(f"{number}: no body: {error}", file=sys.stderr, flush=True)
            number += 1
    print(
        f"{count.proven} of {count.told} stated limits verified; found at most {count.largest:.3f} of the stated limit "
        f"and at most {count.effectivity:.3f} of the exact error; {count.above} exact errors above; "
        f"{count.seconds:.1f} s; {skipped} models without a body"
    )
    print(f"{count.wrong} of {count.tampers} false files proven")
    for name, times in sorted(refused.items()):
        print(f"  {times:4d} {name}")
    sys.exit(bool(count.wrong or count.above))


if __name__ == "__main__":
    main()
