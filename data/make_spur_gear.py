"""Makes the mesh of three teeth of a spur gear, with involute flanks, from a handful of measures.

20-node hexahedra, SI units, the axis along z. ``python -m studies.gear_teeth`` meshes two such gears; alone,
``python data/make_spur_gear.py OUTPUT`` writes the sector of the pinion for other programs.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import meshio
import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem import ElementBlock, FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.grid import grid_cells
from morembs.fem.material import isotropic

MODULE, PRESSURE, WIDTH = 5e-3, math.radians(20.0), 0.02  # m, rad, m
TEETH = (24, 36)
CHAMFER = 0.25e-3  # m below the tip
STEEL = {"young": 2.06e11, "poisson": 0.3, "density": 7850.0}
# Elements: across a tooth, in the fillet, along the flank, in the rim, between teeth, over the width.
CELLS = (6, 3, 8, 3, 1, 6)


@dataclass(frozen=True)
class Gear:
    """A spur gear with involute teeth; ``lowest`` (m of roll) is where its partner's tip touches it."""

    teeth: int
    lowest: float

    @property
    def pitch(self) -> float:
        """Pitch radius, m."""
        return 0.5 * MODULE * self.teeth

    @property
    def base(self) -> float:
        """Base radius, m."""
        return self.pitch * math.cos(PRESSURE)

    @property
    def root(self) -> float:
        """Root radius, m."""
        return self.pitch - 1.25 * MODULE

    @property
    def highest(self) -> float:
        """Roll, m, where the chamfer of the tip begins."""
        return highest(self.teeth)

    def radius(self, roll: Floats) -> Floats:
        """Radius (m) where the tangent to the base circle has the length ``roll``."""
        return np.hypot(self.base, roll)

    def half_angle(self, radius: Floats) -> Floats:
        """Half of the angle of a tooth, rad: involute, with a fillet below it."""
        form = float(self.radius(np.array(self.form)))
        inside = np.maximum(radius, form)
        a = np.arccos(self.base / inside)
        angle = math.pi / (2 * self.teeth) + math.tan(PRESSURE) - PRESSURE - np.tan(a) + a
        below = np.clip((form - radius) / (form - self.root), 0.0, 1.0)
        slope = self.form / self.base / form
        return np.asarray(angle + slope * (inside - radius) + self._fillet * (1 - np.sqrt(1 - (0.85 * below) ** 2)))

    @property
    def form(self) -> float:
        """Roll, m, where the involute ends."""
        return self.lowest - 0.6e-3

    @property
    def _fillet(self) -> float:
        return 0.45 * MODULE / self.root


def highest(teeth: int) -> float:
    """Roll, m, at the begin of the chamfer."""
    pitch = 0.5 * MODULE * teeth
    return math.sqrt((pitch + MODULE - CHAMFER) ** 2 - (pitch * math.cos(PRESSURE)) ** 2)


def pair() -> tuple[Gear, Gear]:
    """Both gears."""
    along = 0.5 * MODULE * sum(TEETH) * math.sin(PRESSURE)
    driving, driven = (Gear(teeth, along - highest(other)) for teeth, other in (TEETH, TEETH[::-1]))
    return driving, driven


@dataclass(frozen=True, kw_only=True, eq=False)
class Sector:
    """Mesh of three teeth; ``flank`` (3, rows, lines) places of nodes on the flanks, teeth -1, 0, 1, from the root up;
    ``roll`` (rows,) m, even; ``bore`` places of the nodes at the hub."""

    gear: Gear
    model: FEModel
    flank: Ints
    roll: Floats
    bore: Ints


def sector(gear: Gear, cells: Sequence[int] = CELLS) -> Sector:
    """Three teeth and their rim, of 20-node hexahedra."""
    across, fillet, along, rim, between, layers = cells
    roll = np.linspace(gear.form, gear.highest, 2 * along + 1)
    # Equal angles of an ellipse in the fillet.
    t = np.sin(np.linspace(math.asin(0.85), 0.0, 2 * fillet + 1))[:-1] / 0.85
    form, tip = float(gear.radius(roll[0])), gear.pitch + MODULE
    rows = np.concatenate((form - t * (form - gear.root), gear.radius(roll), [tip - CHAMFER / 2, tip]))
    u = np.linspace(-1, 1, 2 * across + 1)
    pitch = 2 * math.pi / gear.teeth
    foot = float(gear.half_angle(np.array(gear.root)))
    gap = np.linspace(foot, pitch / 2, 2 * between + 1)
    inner = gear.root - 2 * MODULE
    plane: list[Floats] = []
    for tooth in (-1, 0, 1):
        plane.append(_polar(rows[:, None], tooth * pitch + u * gear.half_angle(rows)[:, None]))
        angles = np.concatenate((-gap[::-1], foot * u[1:-1], gap))
        plane.append(_polar(np.linspace(inner, gear.root, 2 * rim + 1)[:, None], tooth * pitch + angles[None, :]))
    z = np.linspace(0.0, WIDTH, 2 * layers + 1)
    blocks = []
    for p in plane:
        flat, height = np.broadcast_arrays(p[:, :, None], z[None, None, :, None])
        points = np.concatenate((flat, height[..., :1]), axis=-1)
        blocks.append(points.reshape(-1, 3)[grid_cells(points.shape[:3])])
    corners = np.concatenate(blocks)
    _, first, numbers = np.unique(
        np.round(corners.reshape(-1, 3) / 1e-8).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    xyz, cells = corners.reshape(-1, 3)[first], numbers.reshape(corners.shape[:2])
    mesh = Mesh(
        nodes=Nodes(ids=np.arange(1, len(xyz) + 1), xyz=xyz),
        blocks=(ElementBlock(type="hex20", nodes=cells, ids=np.arange(1, len(cells) + 1)),),
    )
    model = assemble(mesh, [isotropic(set="all", **STEEL)])
    # Lines of element edges inside the width: nodes at its sides have normals that lean outwards.
    r, half = gear.radius(roll), gear.half_angle(gear.radius(roll))
    points = np.array(
        [
            [[*_polar(a, tooth * pitch + b), h] for h in z[2:-1:2]]
            for tooth in (-1, 0, 1)
            for a, b in zip(r, half, strict=True)
        ]
    ).reshape(3, len(r), -1, 3)
    flank = np.array([int(np.argmin(np.sum((xyz - p) ** 2, axis=1))) for p in points.reshape(-1, 3)])
    bore = np.flatnonzero(np.abs(np.hypot(xyz[:, 0], xyz[:, 1]) - inner) < 1e-7)
    return Sector(gear=gear, model=model, flank=flank.reshape(points.shape[:3]), roll=roll, bore=bore)


def _polar(radius: Floats, angle: Floats) -> Floats:
    return np.stack(np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle)), axis=-1)


def main(arguments: Sequence[str]) -> int:
    """Writes the sector of the pinion to the file named. Returns the exit code."""
    if len(arguments) != 1:
        print("usage: make_spur_gear.py OUTPUT (.vtu, .msh, or what else meshio writes)", file=sys.stderr)
        return 2
    mesh = sector(pair()[0]).model.mesh
    meshio.Mesh(mesh.nodes.xyz, [("hexahedron20", mesh.blocks[0].nodes)]).write(arguments[0])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
