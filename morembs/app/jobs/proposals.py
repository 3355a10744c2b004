"""Interfaces that are proposed for a mesh whose surfaces have no names: its holes, its ends, its large plane faces."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from morembs.app.jobs.tolerances import TOL
from morembs.base.types import Floats, Ints
from morembs.base.units import Units
from morembs.fem.features import Hole, PlaneFace, Skin, plane_faces, round_holes, significant
from morembs.fem.mesh import Mesh
from morembs.fem.selection import nodes_in_region


@dataclass(frozen=True, eq=False)
class Proposal:
    """An interface for a job: its name, its selection, its description, rows of its nodes, and whether some of them
    follow other nodes; or, in place of a selection, the ``matrix`` of its forces."""

    name: str
    nodes: str
    about: str
    rows: Ints
    follows: bool = False
    matrix: str = ""

    def is_fit(self, xyz: Floats, taken: NDArray[np.bool_]) -> bool:
        """True if it can be an interface: no node of it is taken, it holds all six motions, and half of all at most."""
        rows = self.rows
        if len(rows) < 3 or len(rows) > len(xyz) // 2 or taken[rows].any():
            return False
        size = np.linalg.svd(xyz[rows] - xyz[rows].mean(axis=0), compute_uv=False)
        return bool(size[1] > TOL.points_in_line * size[0])


def propose_interfaces(mesh: Mesh, units: Units) -> tuple[list[Proposal], list[Proposal]]:
    """Interfaces that go together, and others; the numbers of ``mesh`` are in ``units``.

    Two and more holes are taken as they are; less are filled up to two with faces at the extents of the part, those
    across its long direction first, the farthest from the hole first.
    """
    skin = Skin.of(mesh)
    writer = _Writer(mesh.nodes.xyz, skin, units)
    max_count = TOL.proposed_interfaces + TOL.proposed_others
    holes = [writer.of_hole(number, hole) for number, hole in enumerate(round_holes(skin)[:max_count], start=1)]
    outer, inner = _outer_first(plane_faces(skin), skin.xyz, _place(mesh.nodes.xyz, holes))
    ends = [writer.of_face(f"end_{number}", face) for number, face in enumerate(outer[:max_count], start=1)]
    faces = [writer.of_face(f"face_{number}", face) for number, face in enumerate(inner[:max_count], start=1)]
    taken = np.zeros(len(mesh.nodes), dtype=bool)
    chosen: list[Proposal] = []
    for many, proposals in ((TOL.proposed_interfaces, holes), (TOL.template_interfaces, [*ends, *faces])):
        for one in proposals:
            if len(chosen) < many and one.is_fit(mesh.nodes.xyz, taken):
                chosen.append(one)
                taken[one.rows] = True
    return chosen, [one for one in (*holes, *ends, *faces) if one not in chosen]


def surface_selections(mesh: Mesh, units: Units) -> list[Proposal]:
    """All round holes and plane faces of the skin with the selections that mean them; numbers are in ``units``."""
    skin = Skin.of(mesh)
    if not len(skin.areas) or not skin.areas.any():
        return []
    writer = _Writer(mesh.nodes.xyz, skin, units)
    holes = [writer.of_hole(number, hole) for number, hole in enumerate(round_holes(skin), start=1)]
    return [*(writer.of_face(f"face_{number}", face) for number, face in enumerate(plane_faces(skin), start=1)), *holes]


def _place(xyz: Floats, holes: list[Proposal]) -> Floats | None:
    """The middle of the hole where there is one hole."""
    return xyz[holes[0].rows].mean(axis=0) if len(holes) == 1 else None


def _outer_first(faces: list[PlaneFace], xyz: Floats, away: Floats | None) -> tuple[list[PlaneFace], list[PlaneFace]]:
    """Faces that the whole part lies behind, and the others.

    The first are those of the largest depth of the part behind them, times the root of their area: ends of bars and
    plates come before their sides, and faces before chamfers. Of equal ones the first is the farthest from ``away``.
    """

    def order(face: PlaneFace) -> tuple[float, float, int]:
        distance = 0.0 if away is None else float(np.linalg.norm(xyz[face.nodes].mean(axis=0) - away))
        weight = float(np.ptp(xyz @ face.normal)) * face.area**0.5
        return -significant(weight), -significant(distance), int(face.nodes[0])

    outer: list[PlaneFace] = []
    inner: list[PlaneFace] = []
    for face in faces:
        height = xyz @ face.normal
        is_outer = height.max() - height[face.nodes].min() <= TOL.face_depth * np.ptp(height)
        (outer if is_outer else inner).append(face)
    return sorted(outer, key=order), inner


class _Writer:
    """Writes faces and holes as selections, with a margin that is far below the next nodes."""

    def __init__(self, xyz: Floats, skin: Skin, units: Units) -> None:
        self.xyz, self.units = xyz, units
        size = float(np.ptp(xyz, axis=0).max())
        self.margin = max(TOL.selection_margin * skin.shortest_edge(), TOL.least_margin * size)
        # Numbers are multiples of a power of ten below the margin.
        self.step = _power_of_ten(self.margin / 2)

    def of_hole(self, number: int, hole: Hole) -> Proposal:
        """A cylinder around the wall, and beyond its ends."""
        start = hole.start - self.margin * hole.axis
        vector = (hole.length + 2 * self.margin) * hole.axis
        text = f"{self.text(start)},{self.text(vector)},{self.text([hole.radius + self.margin])}"
        across = f"{2 * hole.radius * self.units.length * 1000:.3g}".replace(".", "_")
        middle = hole.start + hole.length / 2 * hole.axis
        about = f"hole about {self.words(middle)} along {_direction(hole.axis)}, {2 * hole.radius:.4g} across, "
        return self.proposal(f"hole_{number}_d{across}mm", "cylinder", text, f"{about}{hole.length:.4g} long")

    def of_face(self, name: str, face: PlaneFace) -> Proposal:
        """A flat box where the face is across an axis, else a flat cylinder."""
        at = self.xyz[face.nodes]
        low, high = at.min(axis=0), at.max(axis=0)
        middle = (low + high) / 2
        about = f"plane face about {self.words(middle)}, outwards {_direction(face.normal)}, "
        if np.abs(face.normal).max() > TOL.along_axis:
            sides = " x ".join(f"{side:.4g}" for side in np.delete(high - low, np.argmax(np.abs(face.normal))))
            text = f"{self.text(low - self.margin)},{self.text(high + self.margin)}"
            return self.proposal(name, "box", text, about + sides)
        middle = middle - ((middle - at.mean(axis=0)) @ face.normal) * face.normal
        radius = float(np.linalg.norm(at - middle, axis=1).max()) + self.margin
        # A direction that is off by its step moves the rim by a tenth of the margin.
        step = _power_of_ten(self.margin**2 / (5 * radius))
        start = self.text(middle - self.margin * face.normal, step)
        text = f"{start},{self.text(2 * self.margin * face.normal, step)},{self.text([radius])}"
        return self.proposal(name, "cylinder", text, f"{about}area {face.area:.4g}")

    def proposal(self, name: str, kind: str, text: str, about: str) -> Proposal:
        rows = nodes_in_region(self.xyz, kind, text)
        return Proposal(name, f"{kind}:{text}", f"{about}: {len(rows)} nodes", rows)

    def text(self, numbers: Floats | list[float], step: float = 0.0) -> str:
        """Numbers rounded to the step, by default that of the margin."""
        step = step or self.step
        return ",".join(f"{round(number / step) * step + 0.0:.12g}" for number in numbers)

    def words(self, point: Floats) -> str:
        """A place in the job's numbers."""
        return f"({', '.join(f'{round(x / self.step) * self.step + 0.0:.5g}' for x in point)})"


def _power_of_ten(limit: float) -> float:
    """The largest power of ten up to ``limit``."""
    return float(10.0 ** floor(log10(limit)))


def _direction(vector: Floats) -> str:
    """A direction in words: an axis, or its components."""
    largest = int(np.argmax(np.abs(vector)))
    if abs(vector[largest]) > TOL.along_axis:
        return f"{'-' if vector[largest] < 0 else ''}{'xyz'[largest]}"
    return f"({', '.join(f'{part:.4g}' for part in vector.round(6) + 0.0)})"
