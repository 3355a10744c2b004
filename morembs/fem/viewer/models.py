"""Meshes and models as scenes of the viewer: sets, rigid and average elements, and whatever else has nodes to mark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from morembs.base.types import Floats, Ints
from morembs.fem.constraints import AverageElement, RigidElement
from morembs.fem.mesh import Mesh, Nodes
from morembs.fem.surface import seen_faces
from morembs.fem.tolerances import TOL
from morembs.fem.viewer.page import Scene
from morembs.fem.viewer.scene import Feature, Group, Surface
from morembs.fem.viewer.skin import drawn_surface


def scene_of_nodes(
    title: str,
    nodes: Nodes,
    mesh: Mesh | None,
    groups: Sequence[Group] = (),
    *,
    features: Iterable[tuple[str, str, Ints]] = (),
    frames: Mapping[str, Floats] | None = None,
    unit: str = "m",
    length: float = 1.0,
    notes: tuple[str, ...] = (),
) -> Scene:
    """The skin of ``mesh`` with its groups; without elements the nodes alone.

    Args:
        groups: with rows of ``nodes`` in ``nodes`` and ``lines``; those of the kind "elements" are the triangles
            between their nodes.
        features: selection, words and rows of the nodes of faces and holes that a click means.
        frames: points (3,) m of interfaces by name.
        unit, length: of the numbers of a job, and m in it.
    """
    unknown = np.flatnonzero(np.isnan(nodes.xyz).any(axis=1))
    if len(unknown):
        notes = (*notes, f"{len(unknown)} nodes without coordinates are drawn at the origin")
        xyz = nodes.xyz.copy()
        xyz[unknown] = 0.0
        nodes = replace(nodes, xyz=xyz)
    faces = seen_faces(mesh) if mesh is not None and mesh.blocks else {}
    left_out = len(groups) - TOL.drawn_groups
    chosen = groups[: TOL.drawn_groups]
    marked = [np.concatenate([_marks(group), group.lines.ravel()]) for group in chosen if group.kind != "elements"]
    if not faces:
        marked.append(np.arange(min(len(nodes), TOL.drawn_points)))
        chosen = [Group(name="all nodes", kind="note", nodes=marked[-1], about="no elements: nodes alone"), *chosen]
    also = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *marked]))
    surface, rows = drawn_surface(nodes.xyz, nodes.ids, faces, middles=True, also=also)
    place = np.full(len(nodes), -1, dtype=np.int64)
    place[rows] = np.arange(len(rows))
    more = (f"{left_out} of {len(groups)} sets are left out",) if left_out > 0 else ()
    return Scene(
        title=title,
        surfaces=(surface,),
        groups=tuple(_place(group, surface, place) for group in chosen),
        features=tuple(_feature(surface, place, *feature) for feature in features),
        frames=frames or {},
        view=_view_from_corner(),
        picks=True,
        unit=unit,
        length=length,
        notes=(*notes, *more),
    )


def groups_of_model(
    nodes: Nodes, mesh: Mesh | None, couplings: Iterable[RigidElement | AverageElement] = ()
) -> list[Group]:
    """Rigid and average elements, node sets and element sets, with the selections of a job that mean them."""
    groups = []
    for element in couplings:
        lines = np.column_stack([np.full(len(element.others), element.center), element.others])[: TOL.drawn_points]
        groups.append(
            Group(
                name=f"{element.name}, {'rigid' if isinstance(element, RigidElement) else 'average'} element",
                kind="coupling",
                nodes=np.append(element.others, element.center),
                lines=lines,
                count=len(element.others),
                select=f"coupling:{element.name}",
            )
        )
    for name, rows in nodes.sets.items():
        groups.append(Group(name=name, kind="nodes", nodes=rows, count=len(rows), select=f"set:{name}"))
    for name, parts in (mesh.element_sets if mesh is not None else {}).items():
        picked = [block.nodes[rows].ravel() for block, rows in zip(mesh.blocks, parts, strict=True)] if mesh else []
        own = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *picked]))
        count = sum(len(rows) for rows in parts)
        select = "" if name in nodes.sets else f"set:{name}"
        groups.append(Group(name=name, kind="elements", nodes=own, count=count, select=select))
    return groups


def _marks(group: Group) -> Ints:
    """Rows of the nodes that are drawn as points."""
    return group.nodes[:: max(1, -(-len(group.nodes) // TOL.drawn_points))]


def _place(group: Group, surface: Surface, place: Ints) -> Group:
    """The group on the points of the surface."""
    triangles = _between(surface, place, group.nodes)
    count = group.count or len(group.nodes)
    if group.kind == "elements":
        return replace(group, nodes=group.nodes[:0], triangles=triangles, count=count)
    flat = triangles if group.kind in ("interface", "nodes") else triangles[:0]
    return replace(group, nodes=place[_marks(group)], lines=place[group.lines], triangles=flat, count=count)


def _between(surface: Surface, place: Ints, rows: Ints) -> Ints:
    """Triangles all of whose corners are among some nodes."""
    inside = np.zeros(len(surface.points) + 1, dtype=bool)
    inside[place[rows]] = True
    inside[-1] = False  # of nodes that are not drawn
    return np.flatnonzero(inside[surface.triangles].all(axis=1))


def _feature(surface: Surface, place: Ints, select: str, about: str, rows: Ints) -> Feature:
    return Feature(select=select, about=about, triangles=_between(surface, place, rows))


def _view_from_corner() -> Floats:
    """Rows to the right, upwards and to the viewer, from above the corner where x is to the right and z upwards."""
    about_z, up = np.radians(TOL.view_turn), np.radians(TOL.view_tilt)
    c, s, d, e = np.cos(about_z), np.sin(about_z), np.cos(up), np.sin(up)
    return np.array([[c, s, 0.0], [-s * e, c * e, d], [s * d, -c * d, e]])
