"""Frames, rotations and directions that decks of all programs give."""

from __future__ import annotations

import numpy as np

from morembs.base.types import Floats
from morembs.fem import skew
from morembs.fem.constraints import Term
from morembs.fem.material import VOIGT
from morembs.importers.tolerances import TOL


def frame_of(first: Floats, plane: Floats) -> Floats | None:
    """Orthonormal rows: along ``first``, in its plane with ``plane``, normal to both; None if these are on a line."""
    if not (np.abs([first, plane]) < TOL.largest_number).all():
        return None
    lengths = np.linalg.norm(first), np.linalg.norm(plane)
    if not min(lengths) > 0:
        return None
    e1 = first / lengths[0]
    normal = np.cross(e1, plane / lengths[1])
    size = np.linalg.norm(normal)
    if not size > TOL.parallel:
        return None
    e3 = normal / size
    return np.array([e1, np.cross(e3, e1), e3])


def rotation_about(axis: Floats, angle: float) -> Floats:
    """Rotation (3, 3) by an angle in rad about a unit axis (Rodrigues, 1840)."""
    A = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * A + (1 - np.cos(angle)) * A @ A)


def rotate_stiffness(C: Floats, axes: Floats) -> Floats:
    """Stiffness ``C`` (6, 6) given along the rows of ``axes``, in the frame that these are written in."""
    T = np.zeros((6, 6))  # strains along the axes from those of the frame
    for q, (k, m) in enumerate(VOIGT):
        strain = np.zeros((3, 3))
        strain[k, m] = strain[m, k] = 1.0 if k == m else 0.5
        local = axes @ strain @ axes.T
        T[:, q] = [local[i, j] * (1 if i == j else 2) for i, j in VOIGT]
    return np.asarray(T.T @ C @ T)


def points_of(kind: str, xyz: Floats) -> Floats:
    """Points (n, 3) along the axes of a rectangular ("R"), cylindrical ("C": radius, degrees, height) or spherical
    system ("S": radius, degrees from the third axis, degrees about it)."""
    if kind == "C":
        angle = np.radians(xyz[:, 1])
        return np.column_stack([xyz[:, 0] * np.cos(angle), xyz[:, 0] * np.sin(angle), xyz[:, 2]])
    if kind == "S":
        polar, around = np.radians(xyz[:, 1]), np.radians(xyz[:, 2])
        out = xyz[:, 0] * np.sin(polar)
        return np.column_stack([out * np.cos(around), out * np.sin(around), xyz[:, 0] * np.cos(polar)])
    return xyz


def axes_at(kind: str, axes: Floats, x: Floats) -> Floats:
    """The directions (3, 3) of a system at the point ``x`` (3,) from its origin, as rows along the global axes.

    Args:
        axes: (3, 3) those of the system itself.
    """
    if kind == "R":
        return axes
    local = axes @ x
    around = np.arctan2(local[1], local[0])
    c, s = np.cos(around), np.sin(around)
    out, turning, up = np.array([c, s, 0.0]), np.array([-s, c, 0.0]), np.array([0.0, 0.0, 1.0])
    if kind == "C":
        return np.array([out, turning, up]) @ axes
    polar = np.arctan2(np.hypot(local[0], local[1]), local[2])
    p, q = np.sin(polar), np.cos(polar)
    return np.array([p * out + q * up, q * out - p * up, turning]) @ axes


def component(number: int) -> Floats:
    """The unit motion (6,) in a component 0 to 5."""
    return np.asarray(np.eye(6)[number])


def along(line: Floats, first: int = 0) -> Floats | None:
    """The unit motion (6,) along a ``line`` (3,), from the component ``first`` on (3: about it); None without one."""
    length = np.linalg.norm(line)
    if not length > 0:
        return None
    part = np.zeros(6)
    part[first : first + 3] = line / length
    return part


def terms_of(node: int, part: Floats, number: int) -> list[Term]:
    """Terms of an equation in the motions (6,) ``part`` of a node, with a zero for the component ``number`` where there
    are none: a first coefficient of zero is to be seen."""
    return [(node, c, float(part[c])) for c in np.flatnonzero(part).tolist()] or [(node, number, 0.0)]


def unit(vectors: Floats) -> Floats:
    """Vectors (..., n) over their lengths, those without length as they are."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0))
