"""Two equal parts with all their modes, joined at their ends by one motion or by springs, as one model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.fuzz.files import write_mesh
from tests.fuzz.models import Model
from tests.fuzz.solids import Solid, block
from tests.fuzz.truth import Damping, Port, Truth

Long = np.longdouble
# Those that ask nothing of nodes.
METHODS = ("auto", "modal", "guyan", "craig-bampton", "free-interface", "krylov", "gramian", "balanced-truncation")
PART = """
[[interface]]
name = "root"
nodes = "ids:{root}"
[[interface]]
name = "end"
nodes = "ids:{end}"
[[reduce]]
method = "craig-bampton"
modes = {modes}
[output]
path = "part.h5"
"""


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """The model of the coupled parts, its interfaces, and the tables of a job that couples them."""

    model: Model
    ports: tuple[Port, ...]
    text: str
    stiffness: tuple[float, ...]
    K: np.ndarray
    M: np.ndarray
    B: np.ndarray
    R: np.ndarray

    def truth(self, damping: Damping) -> Truth:
        """In the coordinates of the coupled parts."""
        truth = Truth.__new__(Truth)
        truth.model, truth.ports, truth.damping, truth.D = self.model, self.ports, damping, None
        truth.K, truth.M, truth.B, truth.R = self.K, self.M, self.B, self.R
        truth.T = np.eye(len(self.K), dtype=Long)
        return truth


def draw(rng: np.random.Generator, folder: Path) -> Assembly:
    """Write the part, and couple two of it along x, the second turned about x."""
    cells = (int(rng.integers(2, 4)), 1, 1)
    size = 10 ** rng.uniform(-1, 0.3) * np.array([1.0, *rng.uniform(0.1, 0.4, 2)])
    xyz, elements = block("hex8", cells, size)
    solid = Solid(kind="hex8", xyz=xyz, cells=elements, young=7e10, poisson=0.33, density=2700.0)
    K, M = solid.matrices()
    node, component = np.repeat(np.arange(len(xyz)), 3), np.tile(np.arange(3), len(xyz))
    model = Model(family="mesh", support="free", K=K, M=M, xyz=xyz, node=node, component=component, free=6, solid=solid)
    length = float(xyz[:, 0].max())
    ends = [np.flatnonzero(np.abs(xyz[:, 0] - x) < 1e-9) for x in (0.0, length)]
    ports = tuple(
        Port(name=name, nodes=rows, coupling="rigid", point=xyz[rows].mean(axis=0), components=tuple(range(6)))
        for name, rows in zip(("root", "end"), ends, strict=True)
    )
    part = Truth(model, ports, Damping())
    labels = [",".join(str(n + 1) for n in rows) for rows in ends]
    tables = PART.format(root=labels[0], end=labels[1], modes=len(part.K) - 12)
    (folder / "part.toml").write_text(write_mesh(folder, model, "part.vtk", "m-kg-s") + tables)
    degrees = float(rng.choice([0.0, 90.0, 37.5]))
    stiffness: tuple[float, ...] = ()
    if rng.random() < 0.4:
        k = float(np.abs(K).max()) * 10 ** rng.uniform(-4, -1)
        stiffness = tuple(float(f"{x:.4g}") for x in [k, k, k, *[k * size[1] ** 2] * 3])
    return _coupled(part, length, degrees, stiffness)


def _coupled(part: Truth, length: float, degrees: float, stiffness: tuple[float, ...]) -> Assembly:
    n = len(part.K)
    c, s = np.cos(np.deg2rad(Long(degrees))), np.sin(np.deg2rad(Long(degrees)))
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]], dtype=Long)
    Q = np.kron(np.eye(n // 3), turn)
    K, M, R = np.zeros((2 * n, 2 * n), dtype=Long), np.zeros((2 * n, 2 * n), dtype=Long), part.R
    K[:n, :n], M[:n, :n] = part.K, part.M
    K[n:, n:], M[n:, n:] = Q @ part.K @ Q.T, Q @ part.M @ Q.T
    # Motions of the second part: turned axes, then about an origin that is a length away.
    away = np.eye(6, dtype=Long)
    away[:3, 3:] = [[0, 0, 0], [0, 0, length], [0, -length, 0]]
    other = Q @ R @ np.kron(np.eye(2), turn).T
    R = np.vstack([R, other @ away])
    joint, root = np.arange(n - 6, n), np.arange(2 * n - 12, 2 * n - 6)
    lines = ['[[couple]]\nbetween = ["a:end", "b:root"]']
    if stiffness:
        G = np.zeros((6, 2 * n), dtype=Long)
        G[np.arange(6), joint], G[np.arange(6), root] = 1, -1
        K = K + G.T @ (np.array(stiffness)[:, None] * G)
        keep = np.eye(2 * n, dtype=Long)
        lines.append(f"stiffness = {list(stiffness)}")
    else:
        keep = np.eye(2 * n, dtype=Long)
        keep[root, joint] = 1
        keep = np.delete(keep, root, axis=1)
    K, M = keep.T @ K @ keep, keep.T @ M @ keep
    B = keep.T @ np.eye(2 * n, dtype=Long)[:, [*range(n - 12, n - 6), *range(2 * n - 6, 2 * n)]]
    R = np.linalg.pinv(keep.astype(float)).astype(Long) @ R
    turned = f"\nrotation = {{ axis = [1, 0, 0], degrees = {degrees} }}" if degrees else ""
    text = "\n".join(
        [
            '[[substructure]]\nname = "a"\nbody = "part.h5"',
            f'[[substructure]]\nname = "b"\nbody = "part.h5"\nposition = [{length!r}, 0.0, 0.0]{turned}',
            *lines,
            '[[interface]]\nname = "base"\nnodes = "set:a:root"\n[[interface]]\nname = "tip"\nnodes = "set:b:end"',
        ]
    )
    model = Model(
        family="mesh",
        support="assembly",
        K=K.astype(float),
        M=M.astype(float),
        xyz=part.model.xyz,
        node=np.zeros(len(K), int),
        component=np.zeros(len(K), int),
        free=6,
    )
    ports = tuple(
        Port(name=name, nodes=np.array([0]), coupling="rigid", point=np.zeros(3), components=tuple(range(6)))
        for name in ("base", "tip")
    )
    return Assembly(model=model, ports=ports, text=text, stiffness=stiffness, K=K, M=M, B=B, R=R)
