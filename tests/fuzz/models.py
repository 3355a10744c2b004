"""Small models at random: solids, frameworks, beams, chains and modal coordinates, free or held in some way, in SI."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from morembs.base.types import Floats, Ints
from tests.fuzz.solids import KINDS, Solid, block

FAMILIES = ("mesh", "solid", "framework", "beams", "chain", "modal")
SHARES = (0.38, 0.14, 0.15, 0.15, 0.09, 0.09)
SUPPORTS = ("free", "clamped", "both ends", "single dofs", "springs")
# Number of dofs beyond which the truth takes longer than the program.
LARGEST = 100


@dataclass(frozen=True, kw_only=True)
class Model:
    """K, M and D (N, N) on dofs ``node``, ``component`` (N,) of nodes ``xyz`` (n, 3), labelled from 1.

    ``free``: rigid motions that nothing holds. ``solid``: of meshes. ``inputs`` (N, k): columns of B of a model in
    coordinates of its own. ``nodes``: whether the file says where nodes are, ``elements``: which elements they join.
    """

    family: str
    support: str
    K: Floats
    M: Floats
    D: Floats | None = None
    xyz: Floats
    node: Ints
    component: Ints
    free: int
    solid: Solid | None = None
    inputs: Floats | None = None
    nodes: bool = True
    elements: bool = True

    def weights(self, rows: Ints) -> Floats:
        """Shares (ns,) of nodes in an average."""
        return np.ones(len(rows)) if self.solid is None or not self.elements else self.solid.weights(rows)

    @property
    def words(self) -> str:
        """What it is."""
        kind = f" of {self.solid.kind}" if self.solid else ""
        return f"{self.family}{kind}, {self.support}, {len(self.K)} dofs" + (", own D" if self.D is not None else "")


def draw_model(rng: np.random.Generator, family: str | None = None) -> Model:
    """A model of one of ``FAMILIES``."""
    family = family or str(rng.choice(FAMILIES, p=SHARES))
    if family in ("mesh", "solid"):
        return _solid(rng, family)
    return {"framework": _framework, "beams": _beams, "chain": _chain, "modal": _modal}[family](rng)


def _solid(rng: np.random.Generator, family: str) -> Model:
    kind = str(rng.choice(KINDS, p=(0.4, 0.25, 0.2, 0.15)))
    cells = (1, 1, 1)
    while kind != "tet10":
        cells = tuple(int(k) for k in rng.integers(1, (6, 3, 3)))
        if 8 < np.prod(np.array(cells) + 1) * 1.0 <= LARGEST / 3:
            break
    length = 10 ** rng.uniform(-1.3, 0.3)
    size = length * np.array([1.0, *rng.uniform(0.1, 0.6, 2)])
    xyz, elements = block(kind, cells, size, taper=0.0 if kind == "wedge6" else float(rng.choice([0.0, 0.3])))
    solid = Solid(
        kind=kind,
        xyz=xyz,
        cells=elements,
        young=float(f"{10 ** rng.uniform(9, 11.4):.4g}"),
        poisson=float(np.round(rng.uniform(0.0, 0.42), 3)),
        density=float(f"{rng.uniform(900, 8000):.4g}"),
    )
    K, M = solid.matrices()
    node, component = np.repeat(np.arange(len(xyz)), 3), np.tile(np.arange(3), len(xyz))
    model = Model(family=family, support="free", K=K, M=M, xyz=xyz, node=node, component=component, free=6, solid=solid)
    if family == "mesh":
        return model
    shares = 10 ** rng.uniform(-6, -4, len(elements)) / np.sqrt(np.linalg.norm(K) / np.linalg.norm(M)) * 1e4
    D = solid.matrices(young=solid.young * shares)[0]
    return _held(rng, replace(model, D=D if rng.random() < 0.2 else None, elements=bool(rng.random() < 0.75)))


def _framework(rng: np.random.Generator) -> Model:
    """Point masses, each joined to those that came before by bars."""
    n = int(rng.integers(4, 16))
    xyz = np.round(rng.uniform(-1, 1, (n, 3)) * 10 ** rng.uniform(-1, 0.5), 6)
    K, D = np.zeros((2, 3 * n, 3 * n))
    stiffness = 10 ** rng.uniform(4, 7)
    for b in range(1, n):
        for a in rng.permutation(b)[: int(rng.integers(3, 6)) if b > 3 else 3]:
            way = (xyz[b] - xyz[a]) / np.linalg.norm(xyz[b] - xyz[a])
            v = np.zeros(3 * n)
            v[3 * a : 3 * a + 3], v[3 * b : 3 * b + 3] = -way, way
            bar = stiffness * rng.uniform(0.3, 3) * np.outer(v, v)
            K, D = K + bar, D + bar * 10 ** rng.uniform(-6, -4)
    M = np.diag(np.repeat(10 ** rng.uniform(-0.7, 0.7, n), 3))
    node, component = np.repeat(np.arange(n), 3), np.tile(np.arange(3), n)
    D = D if rng.random() < 0.2 else None
    return _held(
        rng, Model(family="framework", support="free", K=K, M=M, D=D, xyz=xyz, node=node, component=component, free=6)
    )


def _beams(rng: np.random.Generator) -> Model:
    """Euler and Bernoulli's beams along a straight line or a polygon, lumped masses."""
    n = int(rng.integers(2, 15))
    steps = rng.uniform(0.2, 1.0, (n - 1, 3)) * rng.choice([-1, 1, 1], (n - 1, 3))
    if rng.random() < 0.5:
        steps = np.array([[1.0, 0, 0]]) * np.full((n - 1, 1), rng.uniform(0.1, 1.0))
    xyz = np.round(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), 6)
    K, D = np.zeros((2, 6 * n, 6 * n))
    E = 10 ** rng.uniform(5, 8) * np.array([1.0, *rng.uniform(1e-3, 1e-2, 3)])
    for a in range(n - 1):
        at = np.arange(6 * a, 6 * a + 12)
        k = beam(xyz[a], xyz[a + 1], *E)
        K[np.ix_(at, at)] += k
        D[np.ix_(at, at)] += k * 10 ** rng.uniform(-6, -4)
    M = np.zeros((6 * n, 6 * n))
    for a in range(n):
        mass = 10 ** rng.uniform(-0.5, 0.5)
        M[6 * a : 6 * a + 6, 6 * a : 6 * a + 6] = mass * np.diag([1, 1, 1, 0.02, 0.03, 0.04])
    node, component = np.repeat(np.arange(n), 6), np.tile(np.arange(6), n)
    D = D if rng.random() < 0.2 else None
    return _held(
        rng, Model(family="beams", support="free", K=K, M=M, D=D, xyz=xyz, node=node, component=component, free=6)
    )


def beam(a: Floats, b: Floats, EA: float, EIy: float, EIz: float, GJ: float) -> Floats:
    """(12, 12): the stiffness of end b with a clamped, and what b moves beyond the rigid motion of a."""
    length = float(np.linalg.norm(b - a))
    x = (b - a) / length
    y = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
    y /= np.linalg.norm(y)
    S = np.zeros((6, 6))
    S[0, 0], S[3, 3] = EA / length, GJ / length
    for u, t, EI, sign in ((1, 5, EIz, -1), (2, 4, EIy, 1)):
        S[u, u], S[t, t], S[u, t], S[t, u] = 12 * EI / length**3, 4 * EI / length, *[sign * 6 * EI / length**2] * 2
    axes = np.kron(np.eye(2), np.array([x, y, np.cross(x, y)]))
    carry, d = np.eye(6), b - a
    carry[:3, 3:] = [[0, d[2], -d[1]], [-d[2], 0, d[0]], [d[1], -d[0], 0]]
    J = axes @ np.hstack([-carry, np.eye(6)])
    return np.asarray(J.T @ S @ J)


def _chain(rng: np.random.Generator) -> Model:
    """Masses and springs without any place, held to the ground."""
    n = int(rng.integers(3, 40))
    k = 10 ** rng.uniform(3, 6) * rng.uniform(0.2, 5, n + 1)
    last = rng.choice([0.0, 1.0])
    K = np.diag(k[:-1] + np.append(k[1:-1], k[-1] * last)) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    M = np.diag(10 ** rng.uniform(-1, 1, n))
    D = K * 1e-5 + np.diag(rng.uniform(0, 1e-4, n) * k[:-1] * (rng.random(n) < 0.3)) if rng.random() < 0.2 else None
    return _abstract("chain", "both ends" if last else "clamped", K, M, D)


def _modal(rng: np.random.Generator) -> Model:
    """Modal coordinates: K diagonal, M the unit matrix, loads by columns of B."""
    n = int(rng.integers(3, 60))
    K = np.diag((2 * np.pi * np.sort(10 ** rng.uniform(0, 3, n))) ** 2)
    model = _abstract("modal", "held", K, np.eye(n), None)
    return replace(model, inputs=rng.standard_normal((n, int(rng.integers(1, 4)))))


def _abstract(family: str, support: str, K: Floats, M: Floats, D: Floats | None) -> Model:
    n = len(K)
    return Model(
        family=family,
        support=support,
        K=K,
        M=M,
        D=D,
        xyz=np.zeros((n, 3)),
        node=np.arange(n),
        component=np.zeros(n, int),
        free=0,
        nodes=False,
    )


def _held(rng: np.random.Generator, model: Model) -> Model:
    """The model with a support: dofs that are taken out, or springs to the ground."""
    from tests.fuzz.truth import rigid_rows

    support = str(rng.choice(SUPPORTS))
    n, along = len(model.K), model.xyz[:, 0]
    ends = np.flatnonzero(along <= along.min() + 1e-9), np.flatnonzero(along >= along.max() - 1e-9)
    held, K, G = np.zeros(n, bool), model.K, np.zeros((0, n))
    if support in ("clamped", "both ends"):
        ends = ends[:1] if support == "clamped" else ends
        left = len(model.xyz) - len(np.unique(np.concatenate(ends)))
        if left < (1 if model.family == "beams" else 3):
            return _held(rng, model)
        held = np.isin(model.node, np.concatenate(ends))
    elif support == "single dofs":
        held[rng.choice(n, int(rng.integers(1, 8)), replace=False)] = True
    elif support == "springs":
        G = np.zeros((int(rng.integers(1, 10)), n))
        for row in G:
            a = int(rng.integers(len(model.xyz)))
            row[(model.node == a) & (model.component < 3)] = rng.standard_normal(3)
        K = K + np.median(np.diag(K)[model.component < 3]) * 10 ** rng.uniform(-2, 0.5) * G.T @ G
    G = np.vstack([G, np.eye(n)[held]])
    R = rigid_rows(model.xyz[model.node] - model.xyz.mean(axis=0), model.component)
    R[:, 3:] /= np.linalg.norm(np.ptp(model.xyz, axis=0))
    s = np.linalg.svd(np.vstack([G @ R, np.zeros((6, 6))]), compute_uv=False)
    rank = int((s > 1e-6 * max(s[0], 1e-300)).sum())
    if rank and s[rank - 1] < 2e-2 * s[0]:
        # Supports that are all but dependent are a matter of their own.
        return _held(rng, model)
    keep = np.flatnonzero(~held)
    sub = np.ix_(keep, keep)
    return replace(
        model,
        support=support,
        K=K[sub],
        M=model.M[sub],
        D=None if model.D is None else model.D[sub],
        node=model.node[keep],
        component=model.component[keep],
        free=6 - rank,
    )
