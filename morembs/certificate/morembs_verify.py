"""Prove again, from a model and a witness, that the errors of a reduced body lie below their stated limits.

    python morembs_verify.py BODY.h5 MODEL.h5 WITNESS.h5 [--at NAME=VALUE]

Nothing of morembs is imported, and nothing that its files say is believed: modes and solutions of the witness are
checked by their residuals, the modes below its shift are counted by an elimination of this program. The pages
verification*.md in docs/background of morembs have the statements, their proofs and the
treatment of round-off; their sections have the names of the lemmas. Exit codes: 0 verified, 1 not verified, 2 files
that cannot be read.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import h5py
import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order, connected_components

Array = np.ndarray[Any, Any]
LONG = np.longdouble
SIX = np.arange(6)


@dataclass(frozen=True)
class VerifierTolerances:
    """Quantities that decide, each with the line that derives it."""

    # Half the distance of 1 and the next number.
    u: float = 2.0**-53
    # The same of extended precision.
    u_long: float = float(np.finfo(LONG).eps) / 2
    # Bounds are sums and products of numbers that are not negative: their own round-off is below this part.
    up: float = 1 + 1e-9
    # Size of a dataset over what it takes in its file: that of compressed zeros (deflate).
    inflation: int = 1032
    # Asymmetry of a matrix over its largest entry: that of printed numbers.
    asymmetry: float = 1e-8
    # Part of W that the mass may lack of being semidefinite, over that by which the stiffness is lowered.
    no_mass: float = 0.01
    # Sizes of weights, between which products do not underflow.
    sizes: tuple[float, float] = (1e-120, 1e120)
    # Stands for zero in divisors.
    tiny: float = 1e-300
    # Degree of Taylor polynomials: what they leave is about 4^-17 = 6e-11 of the sum of all terms.
    degree: int = 16
    # Damping between modes of a body, over their own, that is round-off.
    uncoupled: float = 1e-12
    # Distance of the sides of a joint over the size of a part: coordinates with six digits.
    together: float = 1e-6
    # Entry of R'R - 1 of a rotation that is round-off.
    rotation: float = 1e-12
    # Ratio of pivots below which joints depend on each other: coordinates with nine digits.
    dependent: float = 1e-9
    # Relative distance of equal frequencies, whose modes share an envelope.
    equal_modes: float = 1e-6
    # Steps of the grid on a cell: between them the envelope changes by 2 / 64 * near at most.
    steps: int = 64
    # Half of a cell over the distance of the nearest root.
    near: float = 0.25
    # The same, below which nothing is left to gain: chords are right to 1e-9 there.
    narrow: float = near / 128
    # Width of a cell over its frequency where a root lies on the axis: 450 eps.
    least_width: float = 1e-13
    # Distance of ends of cells, over their frequency, that are one.
    same_end: float = 1e-9
    # By what part of the limit of the band those of single cells may lie above the stated ones, where it is less.
    cell: float = 0.01
    # Pivots that are eliminated at once, dofs that are not dissected, rows of one sum, cells evaluated at once.
    blocks: tuple[int, int, int, int] = (64, 150, 64, 32)
    # Entries of a row over their median that are those of a frame.
    frame_row: int = 10
    # Distance of eigenvalues of a body that are not corrected against each other: they are orthogonal all the same.
    close_values: float = 1e-7
    # Products up to which all vectors are taken in extended precision: seconds.
    extended_products: float = 3e8
    # Modes above the shift that are in extended precision all the same: the softest ones move most.
    softest: int = 8
    # Deviation of rigid motions from orthonormal ones, and their strain over that of the softest mode.
    rigid_motion: float = 1e-6
    # Part of W by which the stiffness is lowered for the count, at most.
    largest_drop: float = 1e-3
    # The same of the room to the next vector.
    drop: float = 0.1
    # Parts of it that are tried, where a pivot is singular at the one before.
    moved_shifts: tuple[float, ...] = (1.0, 0.83, 0.71)
    # What couplings may take of that, and of the shift.
    couplings: float = 0.9
    # Energy of a solution over its size, in roots, that is round-off: the root of eps.
    no_energy: float = 1e-8


TOL = VerifierTolerances()
U, U_LONG, UP, TINY, DEGREE, STEPS = TOL.u, TOL.u_long, TOL.up, TOL.tiny, TOL.degree, TOL.steps
PIVOTS, LEAF, ROWS, AT_ONCE = TOL.blocks
MEASURES = ("envelope", "peak", "pointwise")
NOT_CHECKED = (
    "not checked: limits of blocks (block_limit), errors at rest (static), curves, stability; of rigid motions only "
    f"inertia and coupling, to {TOL.rigid_motion:g}"
)


class NotVerifiedError(Exception):
    """The first lemma that fails, and by how much."""


def need(holds: Any, lemma: str, why: str) -> None:
    """Fail in ``lemma`` unless it ``holds``."""
    if not np.all(holds):
        raise NotVerifiedError(f"lemma {lemma} fails: {why}")


def gamma(n: float, u: float = U) -> float:
    """Relative error of n rounded operations, at most (Higham 2002, section 3.1)."""
    return n * u / (1 - n * u)


def part_of(file: Any, name: str) -> Any:
    """A group or dataset that lies in the file itself: targets of links and virtual datasets have no digest."""
    ends = [at for at, letter in enumerate(name + "/") if letter == "/"]
    if not all(isinstance(file.get(name[:end], getlink=True), h5py.HardLink) for end in ends):
        raise ValueError(f"{name!r} is not in {file.file.filename}, or a link to somewhere else")
    found = file[name]
    if isinstance(found, h5py.Dataset) and (
        found.is_virtual or found.external or found.nbytes > TOL.inflation * found.id.get_storage_size()
    ):
        raise ValueError(f"dataset {name!r} of {file.file.filename} does not lie in that file")
    return found


def read(file: Any, name: str, kinds: str = "f") -> Array:
    """A dataset of real numbers as doubles, of whole ones (``kinds`` "iu") as integers, or of texts ("SO")."""
    data = part_of(file, name)
    if (
        not isinstance(data, h5py.Dataset)
        or data.dtype.kind not in kinds
        or (data.dtype.itemsize > 8 and "S" not in kinds)
    ):
        raise ValueError(f"{name!r} of {file.file.filename} is not a dataset of the type that is expected")
    return np.asarray(data[()], dtype={"f": float, "iu": np.int64}.get(kinds))


def text(file: Any, name: str) -> str:
    """A text of a file."""
    return bytes(read(file, name, "SO")[()]).decode()


def norms(X: Array, weights: Array) -> Array:
    """(k,) norms of the columns of ``X``."""
    return np.asarray(UP * np.sqrt(weights @ (X * X)))


def gram(X: Array, Y: Array, kind: Any = np.float64) -> Array:
    """X'Y in sums of ``ROWS`` terms, as many of which are added up before they join the others."""
    total: Any = 0
    for start in range(0, len(X), ROWS * ROWS):
        parts = (slice(first, first + ROWS) for first in range(start, min(start + ROWS * ROWS, len(X)), ROWS))
        total = total + sum(X[rows].astype(kind).T @ Y[rows].astype(kind) for rows in parts)
    return np.asarray(total)


def row_sums(A: sp.csr_array, counts: Any = 0.5, d: Array | None = None) -> Array:
    """w (n,) with x'E y at most the product of the norms of x and y weighted with w, |E_ij| <= (c_i + c_j) |A_ij|."""
    d = np.sqrt(np.abs(A.diagonal())) if d is None else d
    d, c = np.where(d == 0, 1.0, d), np.broadcast_to(counts, d.shape)
    return np.asarray(UP * d * (c * (abs(A) @ (1 / d)) + abs(A) @ (c / d)))


def root_of(N: Array, error: float) -> Array:
    """R with R'R >= N, for a symmetric N of norm about one that is known but for ``error``."""
    values, Q = np.linalg.eigh(0.5 * (N + N.T))
    error += 2 * float(np.linalg.norm(0.5 * (N + N.T) - (Q * values) @ Q.T)) + len(N) ** 2 * gamma(40 * len(N))
    return np.asarray(np.sqrt(np.maximum(values, 0) + 2 * error)[:, None] * Q.T)


# Models with parameters -----------------------------------------------------------------------------------------------


class Parameters(NamedTuple):
    """Their names, kinds, and the ``values`` that are asked for."""

    names: list[str]
    kinds: list[str]
    values: list[float]

    @property
    def words(self) -> str:
        """The values, in words."""
        return ", ".join(f"{name} = {value:.12g}" for name, value in zip(self.names, self.values, strict=True))

    def displacement(self, model: Any) -> Array | float:
        """(N, 3) displacement of the nodes from nominal values."""
        away, nominal = 0.0, read(model, "terms/nominal")
        for name, kind, value, at in zip(*self, nominal, strict=True):
            if kind == "morph":
                away = away + (value - at) * read(model, f"terms/displacement/{name}")
        return away

    def coefficients(self, group: Any, matrix: str) -> Array:
        """Those of the terms of ``matrix`` "K" or "M" in a ``group``: rational numbers, rounded to extended precision
        once."""
        lemma, factors, found = "sum-of-terms", read(group, f"law/{matrix}", "iu"), list[Any]()
        need(factors.ndim == 2 and factors.shape[1] == len(self.names), lemma, "a coefficient has another law")
        points = [f"law/points_{matrix}/{name}" for name in self.names]
        grids = [[Fraction(x) for x in read(group, at).tolist()] if at in group else [] for at in points]
        for row in factors.tolist():
            theta = Fraction(1)
            for factor, value, grid in zip(row, self.values, grids, strict=True):
                need(0 <= factor < 3 + len(grid) and len(set(grid)) == len(grid), lemma, "a coefficient has no law")
                x, k = Fraction(value), factor - 3
                for j, at in enumerate(grid if k >= 0 else []):
                    theta *= Fraction(1) if j == k else (x - at) / (grid[k] - at)
                theta *= x ** max(min(factor, 2), 0) if k < 0 else 1
            near = float(theta)
            need(not theta or TOL.sizes[0] < abs(near) < TOL.sizes[1], lemma, "a coefficient is too large or too small")
            found.append(LONG(near) + LONG(float(theta - Fraction(near))))
        return np.array(found, dtype=LONG)


def parameters_of(bodies: Any, model: Any, witness: Any, asked: dict[str, float] | None) -> Parameters | None:
    """Lemma sum-of-terms: the values that are ``asked`` for, others being nominal; None for the matrices of the model
    file themselves."""
    lemma = "sum-of-terms"
    if asked is None and "at" not in witness:
        return None
    need("at" in witness, lemma, "the witness is of no values of parameters: make one by morembs certify --at")
    terms = part_of(model, "terms")
    names, kinds = ([each.decode() for each in read(terms, key, "SO")] for key in ("names", "kinds"))
    low, high, nominal = (read(terms, key) for key in ("low", "high", "nominal"))
    need([each.shape == (len(names),) for each in (low, high, nominal)], lemma, "a parameter has no range")
    need(all(map(str.isidentifier, names)) and len(set(names)) == len(names), lemma, "parameters have no names")
    unknown = sorted(set(asked or {}) - set(names))
    if unknown:
        raise ValueError(f"parameter {unknown[0]!r} was given; the model has {', '.join(names)}")
    p = [float((asked or {}).get(name, value)) for name, value in zip(names, nominal, strict=True)]
    labels = [each.decode() for each in read(witness, "at/names", "SO")]
    of_witness = dict(zip(labels, read(witness, "at/values").tolist(), strict=True))
    there = ", ".join(f"{name} = {value:.12g}" for name, value in of_witness.items())
    found = Parameters(names, kinds, p)
    need(of_witness == dict(zip(names, p, strict=True)), lemma, f"the witness is of {there}, not of {found.words}")
    for name, value, least, largest in zip(names, p, low, high, strict=True):
        need(least <= value <= largest, lemma, f"{name} = {value:.12g} lies outside [{least:.12g}, {largest:.12g}]")
    for body in part_of(witness, "certificates"):
        own = part_of(bodies, f"bodies/{body}/parametric")
        same = [[each.decode() for each in read(own, key, "SO")] for key in ("names", "kinds")] == [names, kinds]
        same = same and all(np.array_equal(read(own, f"{key}"), read(terms, key)) for key in ("low", "high", "nominal"))
        need(same, lemma, f"body {body!r} has other parameters than the model")
    return found


def sum_of_terms(model: Any, matrix: str, at: Parameters, n: int) -> tuple[sp.csr_array, sp.csr_array, int]:
    """Lemma sum-of-terms: the sum in extended precision, that of magnitudes, and how many roundings an entry has."""
    total = size = sp.csr_array((n, n))
    theta = at.coefficients(part_of(model, "terms"), matrix)
    for number, factor in enumerate(theta):
        term = matrix_of(model, f"terms/{matrix}_{number}")[0]
        total, size = total + term.astype(LONG) * factor, size + abs(term) * abs(float(factor))
    need(f"{matrix}_{len(theta)}" not in model["terms"], "sum-of-terms", "a term has no coefficient")
    return sp.csr_array(total), sp.csr_array(size), len(theta) + 4


# The model and its interfaces -----------------------------------------------------------------------------------------


def motion_of(arms: Array, component: Array) -> Array:
    """(n, 6) displacements and rotations of dofs at ``arms`` (n, 3) from a frame that moves."""
    R = np.zeros((len(component), 6))
    for c in range(3):
        at, a, b = component == c, (c + 1) % 3, (c + 2) % 3
        R[at, c], R[component == 3 + c, 3 + c] = 1.0, 1.0
        R[at, 3 + a], R[at, 3 + b] = np.broadcast_to(arms, (len(at), 3))[at][:, [b, a]].T * [[1.0], [-1.0]]
    return R


class Coupling(NamedTuple):
    """T (N, n) dofs of the model from free ones and frames, loads B (n, m), columns that turn, motions R (n, 6); rows
    of a witness that are ``kept``. The last rows of T are springs with a stiffness and a damping (s, 2)."""

    T: sp.csr_array
    B: Array
    turns: Array
    R: Array
    kept: Any = slice(None)
    springs: Array = np.zeros((0, 2))


def need_inputs(body: Any, columns: list[Array]) -> None:
    """Fail unless ``columns`` (3, m) of all interfaces, in their order, are the inputs of the body."""
    stored = [read(body, f"inputs/{each}", "iu") for each in ("interface_index", "component", "node_id")]
    same = np.array_equal(np.hstack(columns), stored) if columns else not len(stored[0])
    need(same, "interface-map", "the body has its inputs in another order")


def interface_map(body: Any, model: Any, away: Array | float = 0.0) -> Coupling:
    """Lemma interface-map: coupled dofs and loads by the interfaces of the body on the nodes of the model, which
    parameters move ``away``."""
    lemma, node, component = "interface-map", read(model, "dofs/node", "iu"), read(model, "dofs/component", "iu")
    need("couplings" not in model and "equations" not in model, lemma, "equations of the model hold dofs")
    need(set(model["matrices"]) <= {"K", "M", "D"}, lemma, "the model has matrices beside K, M and D")
    xyz, ids, dof = (
        read(model, "nodes/coordinates") + away,
        read(model, "nodes/ids", "iu").tolist(),
        np.arange(len(node)),
    )
    need((node >= 0) & (node < len(ids)) & (component >= 0) & (component < 7), lemma, "a dof has no node")
    need(
        len(set(ids)) == len(ids) and len(np.unique(7 * node + component)) == len(node), lemma, "a label is there twice"
    )
    table, row_of = np.full((len(ids), 7), -1), {label: row for row, label in enumerate(ids)}
    table[node, component] = dof
    free, middle = np.ones(len(dof), dtype=bool), xyz.mean(axis=0)
    loads, masters, turns, columns = list[Any](), list[Any](), list[Array](), list[Array]()
    for name in (name.decode() for name in read(body, "interface_names", "SO")):
        group = part_of(body, f"interfaces/{name}")
        kind, wanted, point = text(group, "coupling"), read(group, "components", "iu"), read(group, "point")
        need(np.array_equal(read(group, "axes"), np.eye(3)), lemma, f"interface {name!r} has axes of its own")
        rows = np.array([row_of.get(label, -1) for label in read(group, "node_ids", "iu").tolist()])
        need((rows >= 0) & (len(set(rows)) == len(rows)), lemma, f"nodes of interface {name!r} are not in the model")
        # Interfaces move with their nodes.
        point = point + (away[rows[0]] if isinstance(away, np.ndarray) and len(rows) else 0.0)
        need(kind in ("rigid", "average", "direct"), lemma, f"coupling {kind!r} of {name!r} is not known here")
        need(
            (wanted >= 0) & (wanted < (7 if kind == "direct" else 6)), lemma, f"{name!r} has a component beside 0 to 5"
        )
        labels = np.repeat(read(group, "node_ids", "iu"), len(wanted)) if kind == "direct" else np.full(len(wanted), -1)
        if kind == "direct":
            dofs, wanted = table[rows][:, wanted].ravel(), np.tile(wanted, len(rows))
            need(dofs >= 0, lemma, f"interface {name!r} has dofs that the model has not")
            z = np.eye(len(dofs))
        else:
            dofs = np.flatnonzero(np.isin(node, rows) & (component < (3 if kind == "average" else 6)))
            w = np.ones(len(dofs))
            if kind == "average":
                weight = np.zeros(len(ids))
                weight[rows] = read(group, "weights")
                w = weight[node[dofs]]
            # z = (R'W R)^-1 R'W u about the centre, carried to the point.
            center = w @ xyz[node[dofs]] / w.sum()
            R = motion_of(xyz[node[dofs]] - center, component[dofs])
            mean = np.linalg.solve(R.T @ (w[:, None] * R), (w[:, None] * R).T)
            z = (motion_of(point - center, SIX) @ mean)[wanted]
        if kind == "rigid" and len(rows) > 1:
            need(free[dofs], lemma, f"interface {name!r} shares nodes with another one")
            free[dofs] = False
            masters.append((dofs, motion_of(xyz[node[dofs]] - point, component[dofs]), point, len(loads), wanted))
        loads.append((dofs, z))
        turns.append((wanted > 2) & (wanted < 6))
        columns.append(np.stack([np.full(len(wanted), len(columns)), wanted, labels]))
    need_inputs(body, columns)
    kept, f = np.flatnonzero(free), int(free.sum())
    parts, motions = [(np.ones(f), kept, np.arange(f))], [motion_of(xyz[node[kept]] - middle, component[kept])]
    for at, (dofs, motion, point, _, _) in enumerate(masters):
        parts.append((motion.ravel(), np.repeat(dofs, 6), np.tile(f + 6 * at + np.arange(6), len(dofs))))
        motions.append(motion_of(point - middle, SIX))
    data, row, col = (np.concatenate(each) for each in zip(*parts, strict=True))
    T = sp.csr_array((data, (row, col)), shape=(len(dof), f + 6 * len(masters)))
    T.eliminate_zeros()
    blocks = []
    for dofs, z in loads:
        blocks.append(np.zeros((len(dof), len(z))))
        blocks[-1][dofs] = z.T
    blocks = [T.T @ block for block in blocks]
    for at, (_, _, _, place, wanted) in enumerate(masters):
        blocks[place] = np.zeros_like(blocks[place])
        blocks[place][f + 6 * at + wanted, np.arange(len(wanted))] = 1.0
    return Coupling(T, np.hstack(blocks), np.concatenate(turns), np.vstack(motions))


class Known(NamedTuple):
    """A matrix ``near`` one that is known but for row sums ``lost`` (n,), and but for ``unknown`` (n,) in extended
    precision, where it is not the same."""

    near: sp.csr_array
    lost: Array
    exact: sp.csr_array | None
    unknown: Array

    @property
    def long(self) -> sp.csr_array:
        """In extended precision."""
        return self.near.astype(LONG) if self.exact is None else self.exact


class Port(NamedTuple):
    """Motion (6, n) at the ``point`` (3,) of an interface of a part, of which the components ``has`` (6,) are there."""

    point: Array
    has: Array
    motion: sp.csr_array

    def at(self, point: Array) -> sp.csr_array:
        """Its motion at another point, where it turns."""
        return sp.csr_array(motion_of(point - self.point, SIX) @ self.motion) if self.has[3:].all() else self.motion


def parts_of(model: Any) -> list[tuple[str, Any, Any]]:
    """Name, place and interfaces, and model of each part of an assembly."""
    names = [name.decode() for name in read(model, "part_names", "SO")]
    need(len(set(names)) == len(names), "joints", "two parts have one name")
    parts = [part_of(model, f"parts/{number}") for number in range(len(names))]
    models = [part_of(model, f"models/{int(read(part, 'model', 'iu'))}") for part in parts]
    return list(zip(names, parts, models, strict=True))


def ports_of(part: Any, own: Any, B: Array, turn: Array, place: Array, first: int) -> Iterator[tuple[str, Port]]:
    """Interfaces of a ``part`` with the model ``own`` and interface motions ``B`` (n, m) of its dofs behind ``first``
    others, along the axes of the assembly."""
    xyz, ids = read(own, "nodes/coordinates"), read(own, "nodes/ids", "iu").tolist()
    keys = "interface_index", "component", "node_id"
    number, component, label = (read(part, f"inputs/{key}", "iu") for key in keys)
    for at, name in enumerate(name.decode() for name in read(part, "interface_names", "SO")):
        group = part_of(part, f"interfaces/{name}")
        for node in dict.fromkeys(label[number == at].tolist()):
            columns = np.flatnonzero((number == at) & (label == node))
            has, motion = np.isin(SIX, component[columns]), np.zeros((6, len(B)))
            whole = (has.reshape(2, 3).sum(axis=1) % 3 == 0) | np.array_equal(turn, np.eye(3))
            need(whole.all() and (component[columns] < 6).all(), "joints", f"{name!r} is turned, and lacks components")
            motion[component[columns]] = B[:, columns].T
            point = xyz[ids.index(node)] if text(group, "coupling") == "direct" else read(group, "point")
            found = sp.coo_array(np.kron(np.eye(2), turn) @ motion)
            found = sp.csr_array((found.data, (found.row, first + found.col)), shape=(6, first + len(B)))
            yield name, Port(turn @ point + place, has, found)


def joints_of(model: Any, ports: dict[str, list[Port]], size: float) -> Iterator[tuple[Any, sp.csr_array, Array]]:
    """Of each pair of ports that a joint of an assembly of this ``size`` connects its group, motions (c, n) of one side
    against the other, and their components."""
    for number in range(len(part_of(model, "couples"))):
        group, what = part_of(model, f"couples/{number}"), f"joint {number}"
        names = [name.decode() for name in read(group, "between", "SO")]
        need(len(names) == 2 and set(names) <= set(ports), "joints", f"{what} has no two interfaces of parts")
        components, (one, other) = read(group, "components", "iu"), (ports[name] for name in names)
        need(np.isin(components, SIX), "joints", f"{what} has a component beside 0 to 5")
        far = np.linalg.norm(np.array([[a.point - b.point for b in other] for a in one]), axis=2)
        match = far.argmin(axis=1)
        need(len(other) == len(one) == len(set(match)), "joints", f"{what} has two sides with other nodes")
        need(far.min(axis=1) <= TOL.together * size, "joints", f"the sides of {what} are apart")
        for a, b in zip(one, (other[at] for at in match), strict=True):
            need((a.has == b.has)[components], "joints", f"{what} has two sides with other components")
            own = components[a.has[components]]
            yield group, sp.csr_array((b.at(a.point) - a.motion)[own]), own


def hold(S: sp.csr_array, G: sp.csr_array) -> tuple[sp.csr_array, Array]:
    """S (n, n) with which G S = 0 holds too, and the dofs that follow others for that."""
    rest = sp.csr_array(G @ S)
    used, c = np.unique(rest.indices), len(rest.indptr) - 1
    A = rest[:, used].toarray()
    R, order = scipy.linalg.qr(A, mode="r", pivoting=True)
    held = c and len(used) >= c and abs(R[c - 1, c - 1]) > TOL.dependent * abs(R[0, 0])
    need(held, "joints", "a joint holds nothing, or what others hold")
    own, others = used[order[:c]], used[order[c:]]
    follow, free = -np.linalg.solve(A[:, order[:c]], A[:, order[c:]]), np.ones(S.shape[1])
    free[own] = 0.0
    places = np.repeat(own, len(others)), np.tile(others, c)
    return sp.csr_array(S @ (sp.diags_array(free) + sp.csr_array((follow.ravel(), places), shape=S.shape))), own


def joint_map(body: Any, model: Any) -> Coupling:
    """Lemma joints: parts with the joints of the file of an assembly, and the interfaces of the ``body``, as one."""
    lemma, maps, places, ports = "joints", list[Coupling](), list[tuple[Array, Array]](), dict[str, list[Port]]()
    n, size = 0, 0.0
    for name, part, own in parts_of(model):
        turn, place, xyz = read(part, "rotation"), read(part, "position"), read(own, "nodes/coordinates")
        need([turn.shape == (3, 3), place.shape == (3,)], lemma, f"the place of {name!r} has another shape")
        turned = np.abs(turn.T @ turn - np.eye(3)).max() < TOL.rotation and np.linalg.det(turn) > 0
        need(turned and np.isfinite(place).all(), lemma, f"the place of {name!r} is none")
        maps.append(interface_map(part, own))
        places.append((turn, turn @ xyz.mean(axis=0) + place))
        for key, port in ports_of(part, own, maps[-1].B, turn, place, n):
            ports.setdefault(f"{name}:{key}", []).append(port)
        n, size = n + len(maps[-1].B), max(size, np.ptp(xyz, axis=0).max())
    for port in (port for several in ports.values() for port in several):
        port.motion.resize((6, n))
    S, free, springs, values = sp.eye_array(n, format="csr"), np.ones(n, dtype=bool), list[Any](), [np.zeros((0, 2))]
    for group, G, components in joints_of(model, ports, size):
        if "stiffness" in group:
            k, d = (read(group, key) if key in group else np.zeros(6) for key in ("stiffness", "damping"))
            values.append(np.stack([k, d], axis=1)[components])
            need((values[-1] >= 0) & (values[-1] < np.inf), lemma, "a spring is negative")
            springs.append(G)
        else:
            S, own = hold(S, G)
            free[own] = False
    S, loads, columns = sp.csr_array(S[:, free]), list[Array](), list[Array]()
    names, outer = (
        [name.decode() for name in read(*each, "SO")] for each in ((body, "interface_names"), (model, "outer"))
    )
    for number, (name, key) in enumerate(zip(names, outer, strict=True)):
        group, (port,) = part_of(body, f"interfaces/{name}"), ports[key]
        wanted, point = read(group, "components", "iu"), read(group, "point")
        alone = text(group, "coupling") == "rigid" and len(read(group, "node_ids", "iu")) == 1
        need(alone and np.array_equal(read(group, "axes"), np.eye(3)), lemma, f"interface {name!r} is not one frame")
        need(np.isin(wanted, SIX[port.has]), lemma, f"{name!r} has components that {key!r} has not")
        need(np.linalg.norm(point - port.point) <= TOL.together * size, lemma, f"{name!r} is not at {key!r}")
        loads.append((port.at(point) @ S).toarray()[wanted])
        columns.append(np.stack([np.full(len(wanted), number), wanted, np.full(len(wanted), -1)]))
    need_inputs(body, columns)
    center = np.mean([middle for _, middle in places], axis=0)
    R = [
        c.R @ np.kron(np.eye(2), turn.T) @ motion_of(at - center, SIX)
        for c, (turn, at) in zip(maps, places, strict=True)
    ]
    T = sp.csr_array(sp.vstack([sp.block_diag([c.T for c in maps]), *springs]) @ S)
    return Coupling(
        T, np.vstack(loads).T, np.hstack(columns)[1] > 2, np.vstack(R)[free], np.flatnonzero(free), np.vstack(values)
    )


def matrix_of(model: Any, place: str) -> tuple[sp.csr_array, bool]:
    """A matrix of a model, and whether it is exactly symmetric."""
    lemma, group, N = "interface-map", part_of(model, place), len(read(model, "dofs/node", "iu"))
    data = read(group, "data")
    need(np.isfinite(data), lemma, "a matrix is not finite")
    need(read(group, "shape", "iu").tolist() == [N, N], lemma, f"a matrix is not one of {N} dofs")
    A = sp.csr_array((data, read(group, "indices", "iu"), read(group, "indptr", "iu")), shape=(N, N))
    A.check_format(full_check=True)
    A.sort_indices()
    # Sums of entries that are there twice would be rounded.
    need(A.has_canonical_format, lemma, "a matrix has an entry twice")
    uneven = abs(A - A.T).max()
    need(uneven <= TOL.asymmetry * abs(A).max(), lemma, f"a matrix is not symmetric, by {uneven:.1e}")
    return A, uneven == 0


def couple_sum(A: sp.csr_array, size: sp.csr_array, rounded: int, T: sp.csr_array) -> Known:
    """T'A T of a sum in extended precision, whose entries have ``rounded`` roundings of their ``size``."""
    uneven = abs(A - A.T).max()
    need(uneven <= TOL.asymmetry * abs(A).max(), "interface-map", f"a matrix is not symmetric, by {uneven:.1e}")
    if T.shape[0] != T.shape[1]:
        rounded += int(np.diff(A.indptr).max() + np.diff(sp.csc_array(T).indptr).max()) + 4
        A, size = T.T.astype(LONG) @ (A @ T.astype(LONG)), abs(T).T @ (size @ abs(T))
    exact = sp.csr_array(0.5 * (A + A.T))
    near = sp.csr_array(exact, dtype=np.float64)
    own, fine = np.sqrt(np.abs(near.diagonal())), sp.csr_array(0.5 * (size + size.T))
    lost = gamma(rounded + 2, U_LONG) * row_sums(fine, d=own)
    return Known(near, U * row_sums(near) + lost, exact, lost)


def stack(model: Any, name: str, springs: Array) -> tuple[sp.csr_array, bool] | None:
    """``matrix_of`` a model or, of the parts of an assembly and its springs, side by side; None where there is none."""
    if "parts" not in model:
        return matrix_of(model, f"matrices/{name}") if name != "D" or "D" in model["matrices"] else None
    blocks, even = list[Any](), True
    for what, part, own in parts_of(model):
        N, beta = len(read(own, "dofs/node", "iu")), float(read(part, "beta")) if name == "D" else 0.0
        need(0 <= beta < np.inf, "damping", f"the damping of {what!r} is negative")
        is_there = name != "D" or "D" in own["matrices"]
        A, same = matrix_of(own, f"matrices/{name}") if is_there else (sp.csr_array((N, N)), True)
        if beta:
            K, also = matrix_of(own, "matrices/K")
            A, same = A + LONG(beta) * K.astype(LONG), same and also
        blocks, even = [*blocks, A], even and same
    more = {"K": springs[:, 0], "D": springs[:, 1]}.get(name, np.zeros(len(springs)))
    whole = sp.block_diag([*blocks, sp.csr_array(np.diag(more))], "csr")
    return (sp.csr_array(whole), even) if whole.nnz or name != "D" else None


def couple_matrix(A: sp.csr_array, even: bool, T: sp.csr_array) -> Known:
    """T'A T, in extended precision where there are frames, and row sums of what its entries are off by."""
    square, exact = T.shape[1] == T.shape[0], even and A.dtype == np.float64
    if exact and square:
        return Known(A, np.zeros(T.shape[1]), None, np.zeros(T.shape[1]))
    C, size, slaves = A, abs(A), np.diff(sp.csc_array(T).indptr)
    slaves[T.indices[T.data != 1]] += 1
    if not square:
        C, size = T.T.astype(LONG) @ (A.astype(LONG) @ T.astype(LONG)), abs(T).T @ (size @ abs(T))
    C = sp.csr_array(0.5 * (C + C.T), dtype=np.float64)
    terms = int(np.diff(A.indptr).max() + slaves.max()) + 6
    own, lost = np.sqrt(np.abs(C.diagonal())), np.zeros(len(slaves))
    for matrix, part in ((C, U), (size, gamma(terms, U_LONG))):
        # Entries of free dofs are copied.
        X = sp.coo_array(matrix)
        summed = (slaves[X.row] > 1) | (slaves[X.col] > 1) | (not exact)
        X = sp.csr_array((X.data[summed], (X.row[summed], X.col[summed])), shape=X.shape)
        lost += part * row_sums(X, d=own)
    return Known(C, lost, None, lost)


# How many modes lie below a shift -------------------------------------------------------------------------------------


def dissect(graph: sp.csr_array, rows: Array) -> Iterator[Array]:
    """Blocks of ``rows``, each behind the blocks that it separates."""
    part = graph[rows][:, rows]
    count, group = connected_components(part, directed=False)
    if count > 1:
        for each in range(count):
            yield from dissect(graph, rows[group == each])
        return
    start, level = 0, np.zeros(len(rows), dtype=int)
    for _ in range(3 if len(rows) > LEAF else 0):
        order, before = breadth_first_order(part, start, directed=False)
        start = int(order[-1])
        for row in order[1:]:
            level[row] = level[before[row]] + 1
        level[order[0]] = 0
    middle = min(int(np.median(level)), int(level.max()) - 1)
    separates = (level == middle) & (part @ (level == middle + 1) > 0)
    if middle < 0 or not (level < middle).any():
        yield rows
        return
    yield from dissect(graph, rows[(level <= middle) & ~separates])
    yield from dissect(graph, rows[level > middle])
    yield rows[separates]


def eliminate(F: Array, own: int, rho: Array) -> int:
    """Eliminate the first ``own`` rows of a symmetric ``F``, whose lower triangle counts; the number of negative
    eigenvalues among them. ``rho`` grows by row sums of all that F would have to be changed by for that to be exact."""
    negative = 0
    for first in range(0, own, PIVOTS):
        last = min(first + PIVOTS, own)
        P, R, S = F[first:last, first:last], F[last:, first:last], F[last:, last:]
        P = np.tril(P) + np.tril(P, -1).T
        values, Q = np.linalg.eigh(P)
        D, size = Q.T @ (P @ Q), np.abs(Q)
        d = np.diag(D)
        off = np.abs(D - np.diag(d)) + gamma(2 * len(P) + 4) * (size.T @ (np.abs(P) @ size))
        need(np.abs(d) > UP * off.sum(axis=1), "sturm-count", "a pivot is too small at every shift that was tried")
        negative += int((d < 0).sum())
        X = R @ ((Q / values) @ Q.T)
        E, size, rest = R - X @ P, np.abs(X), np.abs(R)
        E = np.abs(E) + gamma(len(P) + 2) * (rest + size @ np.abs(P))
        S -= X @ R.T
        moved = np.abs(S).sum(axis=1) + np.abs(S).sum(axis=0)
        moved += 2 * (size @ rest.sum(axis=0) + rest @ size.sum(axis=0))
        across = E.sum(axis=1) + size @ E.sum(axis=0) + E @ size.sum(axis=0)
        rho[last:] += UP * (gamma(len(P) + 4) * moved + across)
        rho[first:last] += UP * E.sum(axis=0)
    return negative


def count_negative(A: sp.csr_array) -> tuple[int, float]:
    """Number of negative eigenvalues of a matrix that is no further than rho from the symmetric ``A`` in the 2-norm,
    and rho: by elimination along a nested dissection, front by front (Duff and Reid 1983)."""
    n, degree = A.shape[0], np.diff(A.indptr)
    graph = sp.csr_array((np.ones(A.nnz, dtype=np.int32), A.indices, A.indptr), shape=A.shape)
    # Frames are coupled with so many that they come last.
    long = degree > TOL.frame_row * np.median(degree)
    blocks = [*dissect(graph, np.flatnonzero(~long)), np.flatnonzero(long)]
    rho, negative, block_of, place = np.zeros(n), 0, np.empty(n, dtype=int), np.full(n, -1)
    waiting: dict[int, list[tuple[Array, Array]]] = {}
    for number, block in enumerate(blocks):
        block_of[block] = number
    for number, block in enumerate(blocks):
        rows, children = A[block], waiting.pop(number, [])
        behind = np.unique(np.concatenate([rows.indices, *(beside for beside, _ in children)]))
        behind = behind[block_of[behind] > number]
        front = np.concatenate([block, behind])
        place[front] = np.arange(len(front))
        F, later = np.zeros((len(front), len(front))), block_of[rows.indices] >= number
        at, beside = np.repeat(np.arange(len(block)), np.diff(rows.indptr))[later], place[rows.indices[later]]
        F[at, beside] = F[beside, at] = rows.data[later]
        own = np.zeros(len(front))
        for beside, S in children:
            at = place[beside]
            F[np.ix_(at, at)] += S
            own[at] += U * np.abs(F[np.ix_(at, at)]).sum(axis=1)
        negative += eliminate(F, len(block), own)
        rho[front] += own
        if len(behind):
            S = np.tril(F[len(block) :, len(block) :])
            S += np.tril(S, -1).T
            waiting.setdefault(int(block_of[behind].min()), []).append((behind, S))
    return negative, float(UP * rho.max())


def count_below(S: sp.csr_array, shift: float) -> tuple[float, int, float]:
    """The shift, or a part of it where pivots are too small at that, and ``count_negative`` of S - shift I."""
    for part in TOL.moved_shifts:
        try:
            return part * shift, *count_negative(sp.csr_array(S - part * shift * sp.eye_array(S.shape[0])))
        except NotVerifiedError as error:
            last = error
    raise last


# Responses on cells of the band ---------------------------------------------------------------------------------------


class Solved(NamedTuple):
    """Solutions y (c, j, n, m) of A y = b in powers of t on cells, sizes (c, n) of their rows and of the residuals
    b - A y; A^-1 is at most ``norm`` (c,) between loads and motions that are scaled by ``weights`` (c, n)."""

    y: Array
    sizes: Array
    left: Array
    weights: Array
    norm: Array


class Pencil(NamedTuple):
    """A(w) = (1 + i loss) K + i w D - w^2 M, diagonals (n,) or matrices (n, n), known but for ``off`` (3, n, n), entry
    by entry."""

    loss: float
    K: Array
    D: Array
    M: Array
    off: list[Array]

    def poles(self) -> Array:
        """Its poles, of which nothing but the choice of cells follows."""
        if self.K.ndim == 1:
            d = self.D / self.M
            root = np.sqrt((1 + 1j * self.loss) * self.K / self.M - d * d / 4)
            return np.concatenate([0.5j * d + root, 0.5j * d - root])
        w0, eye = float(np.sqrt(np.linalg.norm(self.K) / np.linalg.norm(self.M))), np.eye(len(self.K))
        D, K = (np.linalg.solve(self.M, A) for A in (self.D, self.K))
        return -1j * np.linalg.eigvals(np.block([[0 * eye, w0 * eye], [-(1 + 1j * self.loss) * K / w0, -D]]))

    def solve(self, m: Array, h: Array, b: Array) -> Solved:
        """Lemma response-on-cells: A y = b on cells m + h t, as a series that is checked."""
        A: Any
        near: Any
        dot: Any
        far: Any
        times: Any
        norm: Any
        n, diagonal, slack = len(b), self.K.ndim == 1, gamma(4 * len(b) + 24)
        at, wide = (each.reshape(-1, *[1] * self.K.ndim) for each in (m, h))
        # What cancels beside a resonance is rounded afterwards.
        A = [(self.K - at.astype(LONG) ** 2 * self.M).astype(float) + 1j * (self.loss * self.K + at * self.D)]
        stiff, drag, mass = (np.abs(part) for part in (self.K, self.D, self.M))
        error = 8 * U * np.abs(A[0]) + 8 * U_LONG * (stiff + at**2 * mass)
        error += 8 * U * (self.loss * stiff + (at + wide) * (drag + wide * mass))
        A += [wide * (1j * self.D - 2 * at * self.M), -(wide**2) * self.M + 0j]
        sizes = [np.abs(part) for part in A]
        if diagonal:
            G, dot = 1 / A[0], np.multiply
            weights = np.sqrt(np.abs(G))
            times = lambda X, y: X[..., None] * y  # noqa: E731
            norm = lambda X, _: np.abs(X).max(axis=1)  # noqa: E731
            near, far = norm(G * A[0] - 1, 0), 1.0
        else:
            s, dot, times = 1 / np.sqrt(np.abs(np.diag(self.K)) + TINY), np.matmul, np.matmul
            G = s[:, None] * np.linalg.inv(s[:, None] * A[0] * s) * s
            weights = np.sqrt(np.linalg.norm(G, axis=2))
            norm = lambda X, side: np.linalg.norm(X * weights[:, None] * weights[:, :, None] ** side, axis=(1, 2))  # noqa: E731
            near, far = norm(G @ A[0] - np.eye(n), -1), norm(G / weights[:, None] ** 2, -1)
        near = near + sum(norm(dot(G, part), -1) for part in A[1:])
        near = near + slack * sum(norm(dot(np.abs(G), part), -1) for part in sizes)
        w, square = m + h, weights**2
        factors = [np.full(len(w), abs(1 + 1j * self.loss)), w, w**2]
        for factor, off in zip(factors, self.off, strict=True):
            near = near + far * factor * np.sqrt(np.einsum("cp,pq,cq->c", square, off**2, square))
        near = near + far * (norm(error * square, 0) if diagonal else norm(error, 1))
        y: list[Any] = [times(G, b[None])]
        y[0] = y[0] + times(G, b - times(A[0], y[0]))
        for j in range(1, DEGREE + 1):
            y.append(-times(G, sum(times(A[i], y[j - i]) for i in range(1, min(j, 2) + 1))))
        Y = np.asarray(UP * sum(np.linalg.norm(part, axis=2) for part in y))
        left = slack * (np.linalg.norm(b, axis=1) + sum(times(part, Y[..., None])[..., 0] for part in sizes))
        left = left + times(error, Y[..., None])[..., 0]
        for j in range(DEGREE + 3):
            rho = sum(times(A[i], y[j - i]) for i in range(3) if 0 <= j - i <= DEGREE)
            left = left + np.linalg.norm(b - rho if j == 0 else rho, axis=2)
        for factor, off in zip(factors, self.off, strict=True):
            left = left + factor[:, None] * (Y @ off.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse_norm = np.where(near < 1, far / (1 - near), np.inf)
        return Solved(np.stack(y, axis=1), Y, UP * left, weights, UP * inverse_norm)


class Response(NamedTuple):
    """C'A^-1 B of a ``pencil``, C and B (n, m); ``twin`` is that of A', or None where all is symmetric."""

    pencil: Pencil
    twin: Pencil | None
    C: Array
    B: Array

    def on_cells(self, m: Array, h: Array) -> tuple[Array, Array]:
        """Its powers of t (c, j, m m), and how far it is from these (c,)."""
        right = self.pencil.solve(m, h, self.B)
        left = right if self.twin is None else self.twin.solve(m, h, self.C)
        lost = (left.sizes * right.left).sum(axis=1)
        ends = (np.linalg.norm(right.weights * each.left, axis=1) for each in (left, right))
        lost = lost + right.norm * np.prod(list(ends), axis=0)
        lost = lost + gamma(8 * DEGREE + 2 * len(self.B) + 60) * (right.sizes @ np.linalg.norm(self.C, axis=1))
        H = self.C.T @ right.y
        return H.reshape(*H.shape[:2], -1), UP * lost


class Reduced(NamedTuple):
    """Matrices of a body, each (n, n) but B, and C where it is not B'; ``off`` by which K, D and M are not known,
    ``loss`` factor, and modal damping ``ratio`` in place of a matrix D."""

    M: Array
    K: Array
    D: Array
    B: Array
    C: Array | None
    off: list[Any]
    loss: float
    ratio: float = 0.0


def body_matrices(group: Any) -> Reduced:
    """The matrices of the body in a ``group``."""
    M, K, D, B = (read(group, f"{name}_matrix") for name in ("mass", "stiffness", "damping", "input"))
    loss = float(json.loads(text(group, "recipe")).get("structural_damping", 0.0))
    return Reduced(M, K, D, B, read(group, "output_matrix") if "output_matrix" in group else None, [0.0] * 3, loss)


def body_matrices_at(group: Any, at: Parameters) -> Reduced:
    """Lemma sum-of-terms: the matrices of the body in a ``group`` at values of its parameters."""
    lemma, own, sums = "sum-of-terms", part_of(group, "parametric"), dict[str, Array]()
    need("output_matrix" not in group, lemma, "a body that is not symmetric has no terms")
    for name in ("K", "M"):
        theta, terms = at.coefficients(own, name), read(own, name)
        need(len(terms) == len(theta) > 0 and np.isfinite(terms).all(), lemma, f"terms of {name} are others")
        sums[name] = np.tensordot(theta, terms.astype(LONG), axes=1)
        size = np.tensordot(np.abs(theta), np.abs(terms).astype(LONG), axes=1)
        sums[f"{name} off"] = gamma(len(theta) + 4, U_LONG) * size
    given = json.loads(text(own, "damping"))
    given |= {kind: value for _, kind, value in zip(*at, strict=True) if kind in ("alpha", "beta")}
    steps = given.get("modal_table") or [[0.0, given.get("modal") or 0.0]]
    need(not isinstance(steps, str) and len(steps) == 1, "damping", "the ratio of the body is a table")
    alpha, beta, loss = (float(given.get(key) or 0.0) for key in ("alpha", "beta", "structural"))
    K, M, off_K, off_M = sums["K"], sums["M"], sums["K off"], sums["M off"]
    off_D = alpha * off_M + beta * off_K + 4 * U_LONG * (alpha * np.abs(M) + beta * np.abs(K))
    D = alpha * M + beta * K
    return Reduced(M, K, D, read(group, "input_matrix"), None, [off_K, off_D, off_M], loss, float(steps[0][1]))


def modal_damping(ratio: float, theta: Array, off: list[Array]) -> tuple[Array, Array]:
    """(n, n) matrix of modal damping in vectors whose stiffness and mass are near diag ``theta`` and the identity, and
    its unknown part: S with S (I + dM)^-1 S = diag(theta) + dK, times twice the ratio."""
    root = np.sqrt(theta)
    first = (off[0] + np.outer(root, root) * off[2]) / (root[:, None] + root)
    eps = float(np.linalg.norm(off[0] / np.outer(root, root)) + np.linalg.norm(off[2]))
    spread = float(root.max() / root.min())
    need(eps * spread < TOL.rigid_motion, "body-response", "its modes are not known well enough for modal damping")
    unsure = 2 * ratio * UP * (first + 4 * spread * eps**2 * np.sqrt(np.outer(root, root)))
    return np.diag(2 * ratio * root), unsure + 8 * U * np.diag(ratio * root)


def body_response(body: Reduced, loss: float, scale: Array, loads: Array, damped: bool) -> Response:
    """Lemma body-response: the elastic response of the ``body`` whose rigid motions take the ``loads``
    (r, m) as those of the model do, and are ``damped`` where a matrix of the model damps them too."""
    lemma, rigid, inertia = "body-response", len(loads), loads.T @ loads
    M, K, D, B = body.M, body.K, body.D, body.B
    n, m = len(M), len(scale)
    need([np.isfinite(A).all() for A in (M, K, D, B)], lemma, "a matrix is not finite")
    need([A.shape == (n, n) for A in (M, K, D)] + [B.shape == (n, m)], lemma, "a matrix has another shape")
    need(n > rigid, lemma, "it has no elastic mode")
    if body.C is not None:
        C = scale[:, None] * body.C
        need(C.shape == (m, n), lemma, "a matrix has another shape")
        for A in (M, K) if damped else (M, K, D):
            held = max(np.abs(A[:rigid, rigid:]).max(initial=0.0), np.abs(A[rigid:, :rigid]).max(initial=0.0))
            need(held <= TOL.rigid_motion * np.abs(A).max(), "rigid-motions", "those of the body are coupled to modes")
        moved = C[:, :rigid] @ np.linalg.solve(M[:rigid, :rigid], (B * scale)[:rigid])
        same = np.abs(moved - inertia).max() <= TOL.rigid_motion * np.abs(inertia).max()
        need(same, "rigid-motions", "the body has another inertia")
        M, K, D = (A[rigid:, rigid:] for A in (M, K, D))
        known = [np.zeros_like(K)] * 3
        twin = Pencil(loss, K.T, D.T, M.T, known)
        return Response(Pencil(loss, K, D, M, known), twin, C[:, rigid:].T, (B * scale)[rigid:])
    need(np.diag(M) > 0, lemma, "its mass is not positive")
    d = 1 / np.sqrt(np.diag(M).astype(float))
    values, X = np.linalg.eigh(d[:, None] * M.astype(float) * d)
    half = d[:, None] * X / np.sqrt(values)
    X = (half @ np.linalg.eigh(half.T @ K.astype(float) @ half)[1]).astype(LONG)
    for _ in range(3):
        # Newton's method for the couplings of eigenvectors; those that nearly coincide are made orthogonal only.
        m, k = (X.T @ A.astype(LONG) @ X for A in (M, K))
        theta = np.diag(k) / np.diag(m)
        gap = theta - theta[:, None]
        is_separate = np.abs(gap) > TOL.close_values * np.maximum(np.abs(theta), abs(theta[rigid]))
        turn = np.where(is_separate, (k - m * theta) / np.where(is_separate, gap, 1), -0.5 * m)
        X = X + X @ np.where(np.eye(len(m), dtype=bool), 0.5 * (1 - m), turn)
    R, X = X[:, :rigid], X[:, rigid:] - X[:, :rigid] @ (X[:, :rigid].T @ M.astype(LONG) @ X[:, rigid:])
    for A, size in ((K, theta[rigid]), (D, np.inf if damped else np.sqrt(theta[rigid]))):
        held = np.abs([R.T @ A @ X, R.T @ A.T @ X]).max(initial=0.0)
        need(held <= TOL.rigid_motion * size, "rigid-motions", "those of the body are coupled to modes")
    moved = R.T @ (B * scale)
    same = np.abs(moved.T @ moved - inertia).max() <= TOL.rigid_motion * np.abs(inertia).max()
    need(same, "rigid-motions", "the body has another inertia")
    need(np.abs(theta[:rigid]) <= TOL.rigid_motion * theta[rigid], "rigid-motions", "those of the body have strain")
    parts, off = list[Any](), list[Any]()
    for A, unknown in zip((K, D, M), body.off, strict=True):
        G = X.T @ A.astype(LONG) @ X
        # Both halves of a matrix that is not quite symmetric.
        uneven = 0.5 * np.abs(G - G.T)
        parts.append((0.5 * (G + G.T)).astype(float))
        error = np.abs(X).T @ (gamma(4 * len(M), U_LONG) * np.abs(A) + unknown) @ np.abs(X)
        off.append((np.abs(G - parts[-1]) + uneven + error).astype(float))
    if body.ratio:
        own = np.diag(parts[0]) / np.diag(parts[2])
        beside = [off[0] + np.abs(parts[0] - np.diag(own)), 0.0, off[2] + np.abs(parts[2] - np.eye(len(own)))]
        parts[1], off[1] = modal_damping(body.ratio, own, beside)
    beside = [np.abs(G - np.diag(np.diag(G))) for G in parts]
    if (beside[1].sum(axis=1) <= TOL.uncoupled * np.abs(np.diag(parts[1]))).all():
        off, parts = [one + two for one, two in zip(off, beside, strict=True)], [np.diag(G) for G in parts]
    b = (X.T @ (B * scale).astype(LONG)).astype(float)
    return Response(Pencil(loss, parts[0], parts[1], parts[2], off), None, b, b)


def grid_norm(P: Array, steps: int) -> tuple[Array, Array]:
    """(c, steps + 1) norms of sum_j P_j t^j on a grid of -1 <= t <= 1, for coefficients ``P`` (c, j, e), and by how
    much it leaves its chords at most (c,)."""
    j = np.arange(P.shape[1])
    bulge = np.linalg.norm(P, axis=2) @ (j * (j - 1.0)) * (2 / steps) ** 2 / 8
    return np.linalg.norm(np.linspace(-1, 1, steps + 1)[:, None] ** j @ P, axis=2), bulge


def halve_cells(low: Array, high: Array) -> tuple[Array, Array]:
    """Centres m and half widths h of cells: with any round-off of m they lie between m - h and m + h."""
    m = 0.5 * (low + high)
    return m, UP * np.maximum(high - m, m - low)


def refine_cells(low: Array, high: Array, z: Array) -> Array:
    """(c, 2) parts of cells that are far enough from all roots."""
    done = []
    while len(low):
        m, h = halve_cells(low, high)
        fine = h <= TOL.near * np.abs(m[:, None] - z.ravel()).min(axis=1, initial=np.inf)
        need(fine | (h > TOL.least_width * high), "cells-of-the-band", "an undamped resonance lies in the band")
        done.append(np.stack([low[fine], high[fine]], axis=1))
        low, high, m = low[~fine], high[~fine], m[~fine]
        low, high = np.concatenate([low, m]), np.concatenate([m, high])
    return np.concatenate(done)


# The proof ------------------------------------------------------------------------------------------------------------


class Proof:
    """Lemma by lemma, of the ``bodies`` of a file, of a model, with the numbers of a witness."""

    def __init__(self, bodies: Any, model: Any, witness: Any, asked: dict[str, float] | None = None) -> None:
        self.names, self.bodies, given = [], bodies, json.loads(text(witness, "damping"))
        self.at = parameters_of(bodies, model, witness, asked)
        # At values of parameters the witness has the limits.
        self.stated = (bodies, "bodies/{}/certificate") if self.at is None else (witness, "certificates/{}")
        for name in (name.decode() for name in read(bodies, "body_names", "SO")):
            file, place = self.stated[0], self.stated[1].format(name) + "/limits"
            limits = [read(file, f"{place}/{each}")[1] for each in MEASURES if place in file]
            self.names += [name] if np.isfinite(limits).any() else []
        need(self.names, "cells-of-the-band", "no limit is stated")
        self.alpha, self.beta, self.ratio, self.structural = (
            float(given[name]) for name in ("alpha", "beta", "modal", "structural")
        )
        numbers = np.array([self.alpha, self.beta, self.ratio, self.structural])
        need((numbers >= 0) & (numbers < np.inf), "damping", "a number is negative")
        names = "alpha", "beta", "modal", "structural"
        self.words = ", ".join(f"{name} {number:g}" for name, number in zip(names, numbers, strict=True) if number)
        of_values = [] if self.at is None else [row for row in zip(*self.at, strict=True) if row[1] in names[:2]]
        for name, kind, value in of_values:
            need(float(given[kind]) == value, "damping", f"the {kind} of the witness is not {name} = {value:g}")
        cells = [
            read(self.stated[0], self.stated[1].format(name) + "/cells_hz").max(initial=0.0) for name in self.names
        ]
        self.top, self.sigma = 2 * np.pi * float(np.max(cells)) * UP, float(read(witness, "shift"))
        self.k, names = int(read(witness, "modes_below", "iu")), ("rigid", "vectors", "solutions", "coefficients")
        need(self.top**2 < self.sigma < np.inf, "complement-bound", "the shift lies in the band")
        self.Z, self.V, self.X, self.E = (read(witness, name) for name in names)
        need([np.isfinite(A).all() for A in (self.Z, self.V, self.X, self.E)], "ritz-values", "a number is not finite")
        need(self.at is None or "parts" not in model, "sum-of-terms", "an assembly has no terms")
        away = 0.0 if self.at is None else self.at.displacement(model)
        self.coupling = joint_map(bodies, model) if "parts" in model else interface_map(bodies, model, away)
        self.couple(model)
        self.Z, self.V, self.X = (A[self.coupling.kept] for A in (self.Z, self.V, self.X))
        n, p, q = len(self.coupling.B), self.V.shape[-1], self.X.shape[-1]
        wanted = [(n, self.Z.shape[-1]), (n, p), (n, q), (q, p if self.D is None else 2 * p)]
        need(
            [self.Z.shape, self.V.shape, self.X.shape, self.E.shape] == wanted, "ritz-values", "a shape is another one"
        )
        need(0 <= self.k <= p, "sturm-count", f"of {self.k} modes below the shift {p} are there")
        self.take_modes()
        self.count_modes()
        self.take_residuals()

    def prove(self, name: str) -> str:
        """The limits of the body ``name``, in words."""
        group, lemma = part_of(self.bodies, f"bodies/{name}"), "cells-of-the-band"
        stated = part_of(self.stated[0], self.stated[1].format(name))
        floor, band, cells = float(read(stated, "damping_floor")), read(stated, "band_hz"), read(stated, "cells_hz")
        need(0 <= floor < np.inf, "damping", "the floor is negative")
        need(band.shape == (2,) and cells.ndim == 2 and cells.shape[1] == 2, lemma, "a shape is another one")
        need(0 <= band[0] < band[1] and (cells >= 0).all(), lemma, "a band or cell is empty or negative")
        need(cells[:, 0] < cells[:, 1], lemma, "a cell is empty")
        need(np.r_[band[0], cells[:, 1]] >= np.r_[cells[:, 0], band[1]], lemma, "cells leave frequencies out")
        need(int(read(group, "rigid_count", "iu")) == len(self.Z.T), "rigid-motions", f"the model has {len(self.Z.T)}")
        reduced = body_matrices(group) if self.at is None else body_matrices_at(group, self.at)
        self.body = body_response(reduced, reduced.loss + 2 * floor, self.scale, self.Z.T @ self.B, self.damped)
        self.respond(self.structural + 2 * floor)
        self.upper = np.array([read(stated, f"limits/{each}")[1] for each in MEASURES])
        own = read(stated, "cell_limit")
        need(own.shape == (len(cells), 3), lemma, "a shape is another one")
        limit = self.upper[MEASURES.index(text(stated, "measure"))]
        need(np.isfinite(limit), lemma, "the limit of its measure is no number")
        need(np.isnan(self.upper) | (self.upper > 0), lemma, "a limit is negative")
        self.limits = np.fmin(np.fmin(own + TOL.cell * self.upper, self.upper), np.inf)
        self.band = 2 * np.pi * band * [UP, 1 / UP]
        self.cells = 2 * np.pi * cells * [1 / UP, UP]
        self.found = self.prove_cells()
        limits = ", ".join(f"{each} {limit:.6g}" for each, limit in zip(MEASURES, self.upper, strict=True))
        limits += f"; damping floor {floor:g}" if floor else ""
        here = "" if self.at is None else f" at {self.at.words}"
        where = f"at every frequency from {band[0]:g} to {band[1]:g} Hz{here}"
        return f"error <= {limit:.6g} {where} (body {name!r}: {limits})"

    def matrix(self, model: Any, name: str) -> Known | None:
        """A matrix of the coupled dofs: of the model file, or the sum of its terms; None where there is none."""
        T = self.coupling.T
        if self.at is None:
            given = stack(model, name, self.coupling.springs)
            return None if given is None else couple_matrix(*given, T)
        need("D" not in model["matrices"], "sum-of-terms", "a damping matrix stands beside the terms")
        return None if name == "D" else couple_sum(*sum_of_terms(model, name, self.at, T.shape[0]), T)

    def couple(self, model: Any) -> None:
        """Matrices of the coupled dofs, weights W (n,), and what entries are off by as a part of W."""
        R, turns = self.coupling.R, self.coupling.turns
        self.known: list[Any] = [self.matrix(model, name) for name in "KMD"]
        need(not (self.ratio and self.known[2]), "damping", "a ratio of modal damping stands beside a damping matrix")
        near: list[Any] = [(None, None) if each is None else each[:2] for each in self.known]
        (self.K, self.lost_K), (self.M, self.lost_M), (self.D, self.lost_D) = near
        self.damped = False
        self.wK, self.wM, G = row_sums(self.K), row_sums(self.M), R.T @ (self.M @ R)
        size = self.wK + self.sigma * self.wM
        need((size > TOL.sizes[0]) & (size < TOL.sizes[1]), "sturm-count", "a dof has neither stiffness nor mass")
        # Powers of four, whose roots scale without round-off.
        self.W = 4.0 ** np.round(0.5 * np.log2(size))
        self.lost = float(((self.lost_K + self.sigma * self.lost_M) / self.W).max())
        self.cK, self.cM = float((self.wK / self.W).max()), float((self.wM / self.W).max())
        self.row = int(max(np.diff(A.indptr).max() for A in (self.K, self.M, self.D) if A is not None))
        # Sums of rows and of products over all dofs.
        self.terms = 2 * ROWS + len(self.W) / ROWS**2 + 10
        # Rotations count times the radius of gyration.
        mass = np.trace(G[:3, :3]) / 3
        arm = np.array([G[1, 5], G[2, 3], G[0, 4]]) / mass
        turning = np.trace(G[3:, 3:]) - 2 * mass * (arm @ arm)
        self.scale = np.where(turns, np.sqrt(turning / (2 * mass)) if turns.any() else 1.0, 1.0)
        self.B = self.coupling.B * self.scale

    def take_modes(self) -> None:
        """Lemmas rigid-motions and ritz-values: theta (p,), loads b (p, m) off by b_lost (p,), and dK, dM (p, p) by
        which V'K V is off from theta and V'M V from the identity; vectors below the shift in extended precision."""
        V, Z, k, p, r = self.V, self.Z, self.k, self.V.shape[1], self.Z.shape[1]
        fine = p if (self.K.nnz + len(V) * p) * p < TOL.extended_products else min(k + TOL.softest, p)
        G, e, u = [], [], np.full((p, p), U)
        u[:fine] = u[:, :fine] = U_LONG
        given = [(self.K, self.wK), (self.M, self.wM)] + ([] if self.D is None else [(self.D, row_sums(self.D))])
        for (A, w), known in zip(given, self.known, strict=False):
            long, size, own = known.long, norms(V, w), norms(V, known.unknown)
            rough = norms(V, known.lost)
            lost = np.outer(rough, rough)
            lost[:fine], lost[:, :fine] = np.outer(own[:fine], own), np.outer(own, own[:fine])
            # Sums of products are as long as rows.
            rows = norms(V, row_sums(A, 1.0 + np.diff(A.indptr)))
            G.append(np.zeros((p, p), dtype=LONG))
            for at in range(0, fine, 8):
                some = slice(at, min(at + 8, fine))
                G[-1][:, some] = gram(V, long @ V[:, some].astype(LONG), LONG)
            G[-1][:, fine:] = gram(V, A @ V[:, fine:])
            G[-1][:fine, fine:] = G[-1][fine:, :fine].T
            e.append(UP * u * (self.terms * np.outer(size, size) + np.outer(rows, rows)) + lost)
        self.size, self.theta, b = norms(V, self.W), np.diag(G[0]).astype(float), gram(V, self.B, LONG)
        off = np.zeros((p, p))
        self.rigid, self.KZ, size_M, astray = np.zeros(p), np.zeros(r), norms(V, self.wM), np.zeros_like(b, dtype=float)
        if r:
            MZ, KZ, size_K = self.known[1].long @ Z.astype(LONG), self.K @ Z, norms(Z, self.wK)
            unknown = np.outer(*(norms(X, self.known[1].unknown) for X in (Z, V)))
            GZ, S = gram(Z, MZ, LONG).astype(float), gram(Z, KZ)
            need(np.abs(GZ - np.eye(r)).max() < TOL.rigid_motion, "rigid-motions", "they are not orthonormal")
            need(
                np.abs(S).max() < TOL.rigid_motion * min(self.theta.min(), self.sigma),
                "rigid-motions",
                "they have strain",
            )
            held = np.linalg.inv(GZ).astype(LONG) @ gram(MZ, V, LONG)
            self.rigid = np.linalg.norm(held.astype(float), axis=0) + gamma(self.terms + self.row, U_LONG) * r * size_M
            self.rigid += UP * (1 + TOL.rigid_motion) * np.linalg.norm(unknown, axis=0)
            strain = (
                np.linalg.norm(gram(KZ, V), axis=0) + gamma(self.terms + self.row) * norms(V, self.wK) * size_K.sum()
            )
            strained = float(np.linalg.norm(S)) + gamma(self.terms + self.row) * float(size_K.sum()) ** 2
            turned = np.outer(self.rigid, strain)
            off = off + turned + turned.T + strained * np.outer(self.rigid, self.rigid)
            self.KZ = norms(KZ, 1 / self.W) + (gamma(self.row) * self.cK + self.lost) * norms(Z, self.W)
            b = b - held.T @ gram(Z, self.B, LONG)
            astray = 2 * unknown.T @ np.abs(Z.T @ self.B)
        self.b = b.astype(float)
        lost = np.abs(V).T @ np.abs(self.B) + r * np.outer(size_M, np.abs(Z).sum(axis=1) @ np.abs(self.B))
        lost = 2 * U * np.abs(self.b) + gamma(self.terms + self.row, U_LONG) * lost + astray
        self.b_lost = UP * np.linalg.norm(lost, axis=1)
        self.dK = UP * (np.abs(G[0] - np.diag(self.theta)).astype(float) + e[0] + off)
        off = 2 * np.outer(self.rigid, self.rigid)
        self.dM = UP * (np.abs(G[1] - np.eye(p)).astype(float) + e[1] + off)
        if self.D is not None:
            self.DV, DZ, slack = G[2].astype(float), self.D @ Z, gamma(self.terms + self.row)
            size_Z = float(norms(Z, given[2][1]).sum())
            strain = np.linalg.norm(gram(DZ, V), axis=0) + slack * norms(V, given[2][1]) * size_Z
            turned = np.outer(self.rigid, strain)
            # A damper to the ground couples rigid motion to modes: limits are those of the others alone.
            self.damped = bool(strain.max() > TOL.rigid_motion * np.sqrt(self.theta.min()))
            off = (
                turned + turned.T + (np.linalg.norm(gram(Z, DZ)) + slack * size_Z**2) * np.outer(self.rigid, self.rigid)
            )
            self.dD = UP * (np.abs(G[2] - self.DV).astype(float) + e[2] + off)
            self.cD = float((given[2][1] / self.W).max())
            self.rough_D = float((self.lost_D / self.W).max())
            self.DZ = norms(DZ, 1 / self.W) + (gamma(self.row) * self.cD + self.rough_D) * norms(Z, self.W)

    def count_modes(self) -> None:
        """Lemmas sturm-count and complement-bound: K >= sigma M + kappa W on the complement of k modes, and any norm in
        W is at most ``soft`` times that in K."""
        low, W, Z, theta, r = slice(self.k), self.W, self.Z, self.theta, self.Z.shape[1]
        self.KV, self.MV = self.K @ self.V, self.M @ self.V
        off = self.row + 8, self.lost, float(self.KZ.sum()) * self.rigid
        self.off = self.size * (gamma(off[0]) * (self.cK / theta + self.cM) + off[1] * (1 / theta + 1 / self.sigma))
        self.off += off[2] / theta
        star = norms(self.KV[:, low] / theta[low] - self.MV[:, low], 1 / W) + self.off[low]
        g = self.sigma - theta[low] - (self.sigma * self.dM + self.dK)[low, low].sum(axis=1)
        need(g > 0, "ritz-values", f"of {self.k} modes {int((g <= 0).sum())} are not below the shift")
        soft, z = self.size[low] ** 2, norms(Z, W)
        room = [TOL.largest_drop, 1 / max(8 * float((soft / g).sum()), TINY), self.sigma / max(8 * float(z @ z), TINY)]
        room += [TOL.drop * (theta[self.k] - self.sigma) / self.size[self.k] ** 2] if len(theta) > self.k else []
        shift, s = min(room), sp.diags_array(np.sqrt(1 / W))
        need(shift > 0, "ritz-values", f"{int((theta < self.sigma).sum())} vectors lie below the shift, not {self.k}")
        S = sp.csr_array(s @ (self.K - self.sigma * self.M) @ s)
        shift, negative, rho = count_below(S, shift)
        need(negative <= self.k + r, "sturm-count", f"{negative - r} elastic modes lie below the shift, not {self.k}")
        kappa = shift - rho - 8 * U - 2 * self.lost
        need(kappa > 0, "sturm-count", f"round-off of the elimination is {rho:.1e}, of {shift:.1e} that is allowed")
        chi = float(np.linalg.norm(self.KZ) + shift * np.linalg.norm(z)) ** 2 / (TOL.couplings * self.sigma)
        chi += float(((self.sigma * star + kappa * self.size[low]) ** 2 / g).sum())
        need(chi < TOL.couplings * kappa, "complement-bound", f"residuals of the modes take {chi:.1e} of {kappa:.1e}")
        # Mass that is negative would hide modes from the count.
        less = TOL.no_mass * shift
        mass = sp.csr_array(self.sigma * (s @ self.M @ s) + less * sp.eye_array(len(W)))
        mass.eliminate_zeros()
        negative, rho = count_negative(mass)
        less += rho + 8 * U + self.lost
        left = kappa - chi - less
        need(not negative and left > 0, "complement-bound", "the mass is not known to be semidefinite")
        self.least = theta - self.dK.sum(axis=1)
        need(self.least > 0, "ritz-values", "a mode has no stiffness")
        self.soft = UP * float(np.sqrt(1 / left + (soft / self.least[low]).sum()))

    def take_residuals(self) -> None:
        """Lemma reference-residual: of s_p / theta_p coordinates T (q, p) in the dual energy but for lost_T (p,), norms
        tau (p,), and ``start``, that of what no mode explains."""
        W, Z, theta, k, p = self.W, self.Z, self.theta, self.k, len(self.theta)
        MZ, R0, own = self.M @ Z, self.B.copy(), norms(self.B, 1 / W)
        share = np.abs(self.b / theta[:, None])
        if Z.shape[1]:
            rigid = np.linalg.solve(Z.T @ MZ, Z.T @ self.B)
            R0 -= MZ @ rigid
            own = own + 2 * self.cM * (norms(Z, W) @ np.abs(rigid))
        R0 -= self.KV @ (self.b / theta[:, None])
        start = norms(R0, 1 / W) + gamma(p + self.row + 40) * (own + self.cK * (self.size @ share))
        start += (self.lost * self.size + float(self.KZ.sum()) * self.rigid) @ share
        self.start = UP * self.soft * float(np.linalg.norm(start))
        size, KX = norms(self.X, W), self.K @ self.X
        held = norms(self.X, self.wM) * norms(Z, self.wM).max(initial=0.0) * float(self.KZ.sum())
        off = [self.off]
        if self.D is not None:
            # D V - K V D_V / theta, but for rigid motion that is held.
            across = self.DV / theta[:, None]
            rest, grown = self.D @ self.V - self.KV @ across, np.abs(across)
            held_Z = np.linalg.solve(Z.T @ MZ, Z.T @ rest)
            rest -= MZ @ held_Z
            slack = gamma(self.row + p + Z.shape[1] + 40)
            off.append((slack * self.cD + self.rough_D) * self.size + float(self.DZ.sum()) * self.rigid)
            off[1] = off[1] + ((slack * self.cK + self.lost) * self.size + float(self.KZ.sum()) * self.rigid) @ grown
            off[1] = off[1] + 2 * slack * self.cM * (norms(Z, W) @ np.abs(held_Z))
        self.KV /= theta
        self.KV -= self.MV
        rest = self.KV if self.D is None else np.hstack([self.KV, rest])
        rest -= KX @ self.E
        off = np.concatenate(off) + (size * (gamma(self.row + len(self.E) + 8) * self.cK + self.lost) + held) @ np.abs(
            self.E
        )
        energy = np.einsum("ij,ij->j", self.X, KX)
        length = np.maximum(np.sqrt(np.maximum(energy, 0.0)), TOL.no_energy * size + TINY)
        size = size / length
        error = (gamma(self.terms + self.row) * self.cK + self.lost) * float(size @ size) + 3 * float(
            (held / length) @ size
        )
        R, C = root_of(gram(self.X / length, KX / length), error), self.E * length[:, None]
        T = R @ C
        lost = self.soft * (norms(rest, 1 / W) + off)
        lost = UP * (lost + gamma(4 * len(C)) * np.linalg.norm(np.abs(R) @ np.abs(C), axis=0))
        self.T, self.T_own, self.lost_T, self.lost_own = T[:, :p], T[:, p:], lost[:p], lost[p:]
        self.tau = UP * (np.linalg.norm(self.T, axis=0) + self.lost_T)
        largest = max(1 / float(self.least[:k].min(initial=np.inf)), 1 / self.sigma) * (
            1 + float(self.dM[:k, :k].sum())
        )
        self.softest = 1 / (UP * (largest + float(np.sqrt((self.tau[:k] ** 2 / self.least[:k]).sum()))))

    def respond(self, loss: float) -> None:
        """Lemmas damping and round-off: the pencil of the vectors, and coordinates TD (q, p) of what damping leaves."""
        theta, p = self.theta, len(self.theta)
        self.loads, modal = np.linalg.norm(self.b, axis=1), 2 * self.ratio * np.sqrt(theta)
        d, offD = self.alpha + self.beta * theta + modal, self.alpha * self.dM + self.beta * self.dK
        own = self.alpha + modal
        self.TD, self.lost_TD = -self.T * own, own * self.lost_T
        # Below the shift modal damping of exact modes counts twice.
        self.tau_D = (own + modal) * self.tau
        self.d, self.square = d, self.loads**2
        parts: Any = theta, d, np.ones(p)
        if self.D is not None:
            self.d, self.square, offD = d + np.diag(self.DV), self.square.copy(), offD + self.dD
            self.TD, self.lost_TD = self.TD + self.T_own, self.lost_TD + self.lost_own
            self.tau_D = self.tau_D + np.linalg.norm(self.T_own, axis=0) + self.lost_own
            parts = np.diag(theta), np.diag(d) + self.DV, np.eye(p)
            root = np.sqrt(theta)
            for some in np.split(np.arange(p), np.flatnonzero(np.diff(root) > TOL.equal_modes * root[1:]) + 1):
                self.d[some], self.square[some] = self.d[some].mean(), self.square[some].mean()
        self.own, self.rows = np.sqrt(self.ratio * theta * np.sqrt(theta)), np.zeros((0, p))
        if self.ratio:
            # Ratios of exact modes, of which those of the vectors are off.
            root, up, low = np.sqrt(theta), slice(self.k, None), slice(self.k)
            rate = 2 * self.ratio * np.outer(theta, theta) / (root[:, None] + root)
            offD = offD + 2 * self.ratio * (self.dK / (root[:, None] + root) + np.maximum.outer(root, root) * self.dM)
            offD[low, low] += (rate * np.outer(self.tau, self.tau))[low, low]
            N = (rate * (self.T.T @ self.T))[up, up]
            scale = np.sqrt(np.maximum(np.diag(N), TINY))
            self.rows = np.zeros((p - self.k, p))
            self.rows[:, up] = root_of(N / np.outer(scale, scale), 0.0) * scale
        self.pencil = Pencil(loss, parts[0], parts[1], parts[2], [self.dK, offD, self.dM])

    def unsure(self, m: Array, h: Array, x: Solved) -> Array:
        """(c,) limits of |H - H_ref| on cells: lemmas reference-residual and round-off."""
        w, p = m + h, len(self.theta)
        low = slice(self.k) if self.D is None else slice(None)
        mass, drag = self.T @ x.y, self.TD @ x.y
        P = np.zeros((len(m), DEGREE + 3, *mass.shape[2:]), dtype=complex)
        m_, h_ = m.reshape(-1, 1, 1, 1), h.reshape(-1, 1, 1, 1)
        for j, part in enumerate((m_**2 * mass + 1j * m_ * drag, 2 * m_ * h_ * mass + 1j * h_ * drag, h_**2 * mass)):
            P[:, j : j + DEGREE + 1] += part
        at, bulge = grid_norm(P.reshape(*P.shape[:2], -1), STEPS // 4)
        slack, wide = gamma(256 + 2 * p), np.linalg.norm(self.TD, axis=0)
        t = at.max(axis=1) + bulge + self.start
        t += w**2 * (x.sizes @ (self.lost_T + slack * self.tau)) + w * (x.sizes @ (self.lost_TD + slack * wide))
        mu = x.sizes[:, : self.k] @ (self.own * self.tau)[: self.k]
        if len(self.rows):
            U_y = self.rows @ x.y
            above, bulge = grid_norm(U_y.reshape(*U_y.shape[:2], -1), STEPS // 4)
            mu = mu + above.max(axis=1) + bulge + x.sizes @ (slack * np.linalg.norm(self.rows, axis=0))
            mu = mu + (x.sizes * self.own * self.lost_T)[:, self.k :].sum(axis=1)
        mu = np.sqrt(w) * mu
        t += mu * np.sqrt(self.ratio * w / np.sqrt(self.softest))
        r = x.left + self.b_lost
        first = (x.sizes * (r + self.b_lost)).sum(axis=1)
        if self.D is None:
            t += np.linalg.norm(r[:, self.k :] / np.sqrt(self.least[self.k :]), axis=1)
            r[:, low] += ((np.sqrt(w) * mu)[:, None] * self.own * self.tau)[:, low]
        size = (w**2)[:, None] * self.tau + w[:, None] * self.tau_D
        with np.errstate(divide="ignore", invalid="ignore"):
            kap = x.norm * ((size * x.weights)[:, low] ** 2).sum(axis=1)
            rho = x.norm * ((r * x.weights)[:, low] ** 2).sum(axis=1)
            reach = 1 / (1 - w**2 / self.sigma)
            room = 1 - reach * kap
            total = first + mu**2 + rho + reach * (t + np.sqrt(kap * rho)) ** 2 / room
        return np.asarray(np.where(room > 0, UP * total, np.inf))

    def evaluate(self, low: Array, high: Array, peak: float = 0.0) -> tuple[Array, Array]:
        """(c, 3) limits of the measures on cells that are fine enough, where |H| reaches ``peak`` somewhere, and what
        |H| reaches on them at least (c,)."""
        m, h = halve_cells(low, high)
        x = self.pencil.solve(m, h, self.b)
        H = (self.b.T @ x.y).reshape(len(m), DEGREE + 1, -1)
        of_body, own = self.body.on_cells(m, h)
        rest = gamma(8 * DEGREE + 2 * len(self.b) + 60) * (x.sizes @ self.loads) + self.unsure(m, h, x)
        (at, bulge), (size_H, bulge_H) = grid_norm(H - of_body, STEPS), grid_norm(H, STEPS)
        error = np.maximum(at[:, 1:], at[:, :-1]) + (rest + own + bulge)[:, None]
        t = np.linspace(-1, 1, STEPS + 1)
        at_H = t[:, None] ** np.arange(DEGREE + 1) @ H
        # Distance of zero from the chords.
        start, way = at_H[:, :-1], np.diff(at_H, axis=1)
        along = -(way.conj() * start).real.sum(axis=2) / np.maximum((np.abs(way) ** 2).sum(axis=2), TINY)
        chord = np.linalg.norm(start + np.clip(along, 0, 1)[..., None] * way, axis=2) - (rest + bulge_H)[:, None]
        at = m[:, None] + h[:, None] * t
        # Real and imaginary parts of a_p are monotone.
        fixed = (self.theta - m[:, None].astype(LONG) ** 2).astype(float)
        real = fixed[:, None] - ((2 * m[:, None] + h[:, None] * t) * h[:, None] * t)[..., None]
        imag = self.pencil.loss * self.theta + at[..., None] * self.d
        real, imag = (np.maximum(np.abs(each[:, 1:]), np.abs(each[:, :-1])) for each in (real, imag))
        e = (1 / (np.hypot(real, imag) + 16 * U * self.theta)) @ self.square
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = error / e, error / max(peak, 0.0), np.where(chord > 0, error / np.maximum(chord, TINY), np.inf)
        upper = UP * np.nan_to_num(np.stack([part.max(axis=1) for part in parts], axis=1), nan=np.inf, posinf=np.inf)
        # What lies outside of the band is no peak of it.
        size_H = np.where((at > self.band[0]) & (at < self.band[1]), size_H, 0.0)
        return upper, (size_H - rest[:, None]).max(axis=1) / UP

    def prove_cells(self) -> Array:
        """Lemma cells-of-the-band: the largest limits (3,) that were found, none above those of the cells."""
        asked, found, work = np.isfinite(self.upper), np.zeros(3), []
        z = np.concatenate([self.pencil.poles(), self.body.pencil.poles()])
        need(np.isfinite(z), "body-response", "a pole is no number")
        for number, (low, high) in enumerate(self.cells):
            # Peaks are ends of cells.
            inner = np.sort(z.real[(z.real > low) & (z.real < high)])
            ends = np.r_[low, inner[np.diff(inner, prepend=low) > TOL.same_end * high], high]
            parts = refine_cells(ends[:-1], ends[1:], z)
            work.append(np.column_stack([np.full(len(parts), number), parts]))
        todo = np.concatenate(work)
        peak, best = 0.0, todo[0, 1:]
        for at in range(0, len(todo) if asked[1] else 0, AT_ONCE):
            reached = self.evaluate(*todo[at : at + AT_ONCE, 1:].T)[1]
            if reached.max() > peak:
                peak, best = float(reached.max()), todo[at + int(reached.argmax()), 1:]
        for _ in range(3 if peak else 0):
            edges = np.linspace(best[0], best[1], 9)
            reached = self.evaluate(edges[:-1], edges[1:])[1]
            peak, best = max(peak, float(reached.max())), edges[int(reached.argmax()) + np.arange(2)]
        while len(todo):
            some, todo = todo[:AT_ONCE], todo[AT_ONCE:]
            limits, m = self.limits[some[:, 0].astype(int)], 0.5 * (some[:, 1] + some[:, 2])
            upper = self.evaluate(some[:, 1], some[:, 2], peak)[0]
            over = np.where(asked, upper / limits, 0.0)
            good = (over <= 1).all(axis=1) & (limits > 0).all(axis=1)
            found = np.maximum(found, np.where(asked, upper[good], np.inf).max(axis=0, initial=0.0))
            narrow = some[:, 2] - some[:, 1] < TOL.narrow * np.abs(m[:, None] - z).min(axis=1)
            for row in np.flatnonzero(narrow & ~good):
                j = int(np.nan_to_num(over[row], nan=np.inf).argmax())
                what = f"the {MEASURES[j]} error at {m[row] / 2 / np.pi:,.6g} Hz is known to {over[row, j]:.6g} times"
                need(False, "cells-of-the-band", f"{what} its limit of {limits[row, j]:.6g} only")
            halves = np.repeat(some[~good], 2, axis=0)
            halves[::2, 2] = halves[1::2, 1] = m[~good]
            todo = np.concatenate([halves, todo])
        return found


def digest_of(path: str, after: int = 0) -> str:
    """SHA-256 of a file behind its first bytes."""
    total = hashlib.sha256()
    with open(path, "rb") as file:
        file.seek(after)
        while block := file.read(1 << 22):
            total.update(block)
    return total.hexdigest()


def belong(body: str, model: str, witness: str) -> list[str]:
    """Files that changed since the witness was made: it has its own digest in its user block."""
    with open(witness, "rb") as file:
        own = file.read(512)
    with h5py.File(witness, "r") as file:
        sums = {"body": digest_of(body), "model": digest_of(model)}
        names = [name for name, own_sum in sums.items() if text(file, f"{name}_sha256") != own_sum]
    return names + (["witness"] if own != digest_of(witness, 512).encode().ljust(512, b"\0") else [])


def verify(
    body: str, model: str, witness: str, found: list[Array] | None = None, asked: dict[str, float] | None = None
) -> tuple[bool, bool, str]:
    """True if the files belong to each other, whether the limits are proven, and sentences that say so; limits of
    bodies with parameters where values are ``asked`` for."""
    others = belong(body, model, witness)
    lines = ["belongs: " + (f"no, the {' and the '.join(others)} was changed" if others else "yes, as they were made")]
    with h5py.File(body, "r") as bodies, h5py.File(model, "r") as matrices, h5py.File(witness, "r") as given:
        try:
            proof = Proof(bodies, matrices, given, asked)
            modes = f"{proof.k} elastic and {len(proof.Z.T)} rigid modes below {proof.sigma**0.5 / 2 / np.pi:,.6g} Hz"
            lines.append(f"counted: {modes}; damping: {proof.words or None}")
            for name in proof.names:
                lines.append(f"verified: {proof.prove(name)}")
                if found is not None:
                    found.append(proof.found / proof.upper)
            lines.append(NOT_CHECKED)
        except NotVerifiedError as error:
            return not others, False, "\n".join([*lines, f"not verified: {error}"])
    return not others, True, "\n".join(lines)


def values_of(given: list[str]) -> dict[str, float]:
    """Values by name of texts NAME=VALUE, also several with commas between them."""
    values = dict[str, float]()
    for part in (part.strip() for text in given for part in text.split(",")):
        name, equals, value = (each.strip() for each in part.partition("="))
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if not equals or not np.isfinite(number) or name in values:
            raise ValueError(f"--at {part} was given; expected NAME=NUMBER, each name once")
        values[name] = number
    return values


def main(arguments: list[str] | None = None) -> int:
    """Verify the files of a command line; the exit code."""
    parser = argparse.ArgumentParser(prog="morembs_verify.py", description=(__doc__ or "").partition("\n")[0])
    for name in ("body", "model", "witness"):
        parser.add_argument(name, metavar=f"{name.upper()}.h5")
    parser.add_argument(
        "--at", metavar="NAME=VALUE", action="append", help="values of parameters, SI units; others are nominal"
    )
    given = parser.parse_args(arguments)
    try:
        asked = None if given.at is None else values_of(given.at)
        belongs, proven, message = verify(given.body, given.model, given.witness, None, asked)
    except (
        OSError,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        ArithmeticError,
        MemoryError,
        RuntimeError,
    ) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        sys.stderr.write(f"error: the files cannot be verified: {message}\n")
        return 2
    sys.stdout.write(message + "\n")
    return 0 if belongs and proven else 1


if __name__ == "__main__":
    sys.exit(main())
