#!/usr/bin/env python3
"""Makes the mesh of a connecting rod, pipelines/connecting_rod.msh, from a handful of measures.

Units are mm (with t and s, hence N and MPa). The big bore is centred at the origin, the small one on the
+x axis, and both bores run along z. Physical groups: volume BODY, surfaces BIGEND and SMALLEND (the bores).

gmsh draws the rod and meshes it. Where gmsh cannot be loaded, the same mesh is unpacked from
data/small_meshes instead; that archive is written by data/small_meshes/make_small_meshes.py.
"""

from __future__ import annotations

import argparse
import gzip
import math
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parent / "pipelines"
DEFAULT_OUTPUT = FOLDER / "connecting_rod.msh"
ARCHIVE = HERE / "small_meshes" / "connecting_rod.msh.gz"

STEEL_DENSITY = 7.85e-9  # t/mm^3
WORST_SCALED_JACOBIAN = 0.05
# Coordinates are rounded to this fraction of a mm: 0.06 nm, far below the geometry, and they compress well.
GRID = 2.0**-24

LIBRARIES = "sudo apt-get install libglu1-mesa libxcursor1 libxft2 libxinerama1 libxrender1 libgl1"

Point = tuple[float, float]
Entity = tuple[int, int]


class MeshError(RuntimeError):
    """The mesh could not be made, or is not fit for use."""


@dataclass(frozen=True)
class Rod:
    """The measures of the rod in mm. Half widths of the shank are those of its straight edges, extended to
    the two bore centres; thicknesses run along z and are symmetric about z = 0."""

    centre_distance: float = 150.0
    big_bore: float = 25.0  # radius
    big_outer: float = 34.0  # radius
    big_thickness: float = 24.0
    small_bore: float = 11.0  # radius
    small_outer: float = 18.0  # radius
    small_thickness: float = 22.0
    shank_thickness: float = 16.0
    shank_half_width_big: float = 15.0
    shank_half_width_small: float = 10.0
    shank_fillet_big: float = 34.0
    shank_fillet_small: float = 22.0
    pocket_start: float = 46.0  # x
    pocket_end: float = 122.0  # x
    pocket_corner: float = 4.0  # radius
    flange: float = 4.5  # width of the two flanges beside the pockets
    web: float = 5.0  # thickness left between the pockets
    boss_half_length: float = 19.0  # along x
    boss_half_width: float = 46.0  # along y
    boss_thickness: float = 19.0
    boss_corner: float = 3.5  # radius
    bolt_hole: float = 4.5  # radius
    bolt_offset: float = 35.5  # |y| of the bolt axes
    element_size: float = 5.5
    elements_per_turn: int = 12  # on curved faces
    order: int = 2


@dataclass(frozen=True)
class Summary:
    """What a finished mesh amounts to. Volume in cubic units of the mesh."""

    nodes: int
    elements: int
    volume: float
    worst_scaled_jacobian: float
    worst_shape: float

    def __str__(self) -> str:
        """One line without the volume, whose unit the mesh does not say."""
        return (
            f"{self.nodes} nodes, {self.elements} elements, "
            f"scaled Jacobian >= {self.worst_scaled_jacobian:.3f}, SICN >= {self.worst_shape:.3f}"
        )


# ---------------------------------------------------------------------------------------------------------
# gmsh: starting, checking, writing


def load_gmsh() -> Any:
    """The gmsh module. Raises ImportError (no module) or OSError (a shared library of gmsh is missing)."""
    import gmsh

    return gmsh


@contextmanager
def session(name: str, order: int = 1, incomplete: bool = False) -> Iterator[Any]:
    """Runs gmsh on one empty model, quietly and so that two runs give the same mesh."""
    gmsh = load_gmsh()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        options = {
            "General.Terminal": 0,
            "General.NumThreads": 1,
            "Mesh.RandomSeed": 1,
            "Mesh.ElementOrder": order,
            "Mesh.SecondOrderIncomplete": int(incomplete),
            "Mesh.MshFileVersion": 4.1,
            "Mesh.Binary": 1,
        }
        for option, value in options.items():
            gmsh.option.setNumber(option, value)
        gmsh.model.add(name)
        yield gmsh
    finally:
        gmsh.finalize()


def volume(gmsh: Any) -> float:
    """The volume of the elements by integration, curved edges included."""
    mesh, total = gmsh.model.mesh, 0.0
    for kind in mesh.getElementTypes(3):
        points, weights = mesh.getIntegrationPoints(kind, "Gauss6")
        _, determinants, _ = mesh.getJacobians(kind, points)
        total += float((determinants.reshape(-1, len(weights)) @ weights).sum())
    return total


def check(gmsh: Any) -> Summary:
    """Measures the volume elements; raises MeshError if there are none or one of them is badly shaped."""
    _, tags, connectivity = gmsh.model.mesh.getElements(3)
    elements = [tag for block in tags for tag in block]
    if not elements:
        raise MeshError("gmsh made no volume elements")
    quality = gmsh.model.mesh.getElementQualities
    jacobian, scaled = quality(elements, "minDetJac"), quality(elements, "minSJ")
    broken = int((jacobian <= 0).sum())
    if broken:
        raise MeshError(
            f"{broken} of {len(elements)} elements have a Jacobian that is not positive "
            f"(worst {jacobian.min():.3g}); try another element size"
        )
    if scaled.min() < WORST_SCALED_JACOBIAN:
        raise MeshError(
            f"the smallest scaled Jacobian is {scaled.min():.3f}, below {WORST_SCALED_JACOBIAN}; "
            "try another element size"
        )
    return Summary(
        nodes=len({int(node) for block in connectivity for node in block}),
        elements=len(elements),
        volume=volume(gmsh),
        worst_scaled_jacobian=float(scaled.min()),
        worst_shape=float(quality(elements, "minSICN").min()),
    )


def write(gmsh: Any, output: Path) -> None:
    """Writes the current mesh so that `output` is either the whole mesh or what it was before."""
    temporary = output.with_name(f"{output.stem}.{os.getpid()}.tmp{output.suffix}")
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        gmsh.write(str(temporary))
        os.replace(temporary, output)
    finally:
        temporary.unlink(missing_ok=True)


def round_coordinates(gmsh: Any, grid: float) -> None:
    """Moves every node to the nearest multiple of `grid`."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    for tag, point in zip(tags, coordinates.reshape(-1, 3), strict=True):
        gmsh.model.mesh.setNode(tag, (point / grid).round() * grid + 0.0, [])


# ---------------------------------------------------------------------------------------------------------
# Drawing the rod


def slab(occ: Any, loop: Sequence[int], low: float, high: float) -> Entity:
    """The solid between z = low and z = high over a closed loop of curves drawn at z = low."""
    face = occ.addPlaneSurface([occ.addCurveLoop(loop)])
    (solid,) = (tag for dim, tag in occ.extrude([(2, face)], 0, 0, high - low) if dim == 3)
    return (3, solid)


def disc(occ: Any, x: float, radius: float, thickness: float) -> Entity:
    """A cylinder along z about (x, 0), symmetric about z = 0."""
    return (3, occ.addCylinder(x, 0, -thickness / 2, 0, 0, thickness, radius))


def rounded_polygon(occ: Any, corners: Sequence[Point], radius: float, z: float) -> list[int]:
    """The curves of a convex polygon whose corners are rounded off."""
    arcs = []
    for i, corner in enumerate(corners):
        neighbours = (corners[i - 1], corners[(i + 1) % len(corners)])
        ways = [(p[0] - corner[0], p[1] - corner[1]) for p in neighbours]
        a, b = ((u / math.hypot(u, v), v / math.hypot(u, v)) for u, v in ways)
        half = math.acos(a[0] * b[0] + a[1] * b[1]) / 2
        middle = (a[0] + b[0], a[1] + b[1])
        reach = radius / math.sin(half) / math.hypot(*middle)
        centre = occ.addPoint(corner[0] + reach * middle[0], corner[1] + reach * middle[1], z)
        cut = radius / math.tan(half)
        ends = [occ.addPoint(corner[0] + cut * w[0], corner[1] + cut * w[1], z) for w in (a, b)]
        arcs.append((ends[0], occ.addCircleArc(ends[0], centre, ends[1]), ends[1]))
    curves = []
    for i, (_, arc, end) in enumerate(arcs):
        curves += [arc, occ.addLine(end, arcs[(i + 1) % len(arcs)][0])]
    return curves


def shank_edge(rod: Rod) -> tuple[float, float]:
    """Height at x = 0 and slope of the shank's straight upper edge."""
    slope = (rod.shank_half_width_small - rod.shank_half_width_big) / rod.centre_distance
    return rod.shank_half_width_big, slope


def flare(rod: Rod, x: float, inner: float, fillet: float, side: int) -> tuple[Point, Point, Point]:
    """The arc that widens the shank's upper edge towards the ring about (x, 0): its end on a circle of radius
    `inner` about the ring's centre, its centre, and its end on the edge. `side` is +1 if the shank lies
    towards +x of the ring, else -1."""
    height, slope = shank_edge(rod)
    along = (1 / math.hypot(1, slope), slope / math.hypot(1, slope))
    normal = (-along[1], along[0])
    across = fillet + (height + slope * x) * normal[1]
    distance = inner + fillet
    if across >= distance:
        raise MeshError("the shank is too wide for its fillets")
    run = side * math.sqrt(distance**2 - across**2)
    centre = (x + across * normal[0] + run * along[0], across * normal[1] + run * along[1])
    share = inner / distance
    on_ring = (x + share * (centre[0] - x), share * centre[1])
    return on_ring, centre, (centre[0] - fillet * normal[0], centre[1] - fillet * normal[1])


def draw_shank(occ: Any, rod: Rod) -> Entity:
    """The shank without its pockets. Its flares run a little way into the rings, so that they meet the
    rings' outer faces at an angle which can be meshed rather than touching them tangentially."""
    depth = 0.35
    inner_big = rod.big_outer - depth * (rod.big_outer - rod.big_bore)
    inner_small = rod.small_outer - depth * (rod.small_outer - rod.small_bore)
    big = flare(rod, 0.0, inner_big, rod.shank_fillet_big, 1)
    small = flare(rod, rod.centre_distance, inner_small, rod.shank_fillet_small, -1)
    low = -rod.shank_thickness / 2
    sides = []
    for sign in (1, -1):
        b = [occ.addPoint(x, sign * y, low) for x, y in big]
        s = [occ.addPoint(x, sign * y, low) for x, y in small]
        curves = [occ.addCircleArc(b[0], b[1], b[2]), occ.addLine(b[2], s[2]), occ.addCircleArc(s[2], s[1], s[0])]
        sides.append((b[0], curves, s[0]))
    (top_start, top, top_end), (bottom_start, bottom, bottom_end) = sides
    loop = [*top, occ.addLine(top_end, bottom_end), *reversed(bottom), occ.addLine(bottom_start, top_start)]
    return slab(occ, loop, low, -low)


def draw_pockets(occ: Any, rod: Rod) -> list[Entity]:
    """The two solids that are cut out of the shank to leave an I section."""
    height, slope = shank_edge(rod)
    upper = [(x, height + slope * x - rod.flange) for x in (rod.pocket_start, rod.pocket_end)]
    corners = [(upper[0][0], -upper[0][1]), (upper[1][0], -upper[1][1]), upper[1], upper[0]]
    beyond = rod.shank_thickness  # the cut leaves the shank on the outside
    return [
        slab(occ, rounded_polygon(occ, corners, rod.pocket_corner, low), low, high)
        for low, high in ((-beyond, -rod.web / 2), (rod.web / 2, beyond))
    ]


def draw_bosses(occ: Any, rod: Rod) -> tuple[Entity, list[Entity]]:
    """The block across the big end that takes the bolts of the bearing cap, and the bolts' holes."""
    x, y, low = rod.boss_half_length, rod.boss_half_width, -rod.boss_thickness / 2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    block = slab(occ, rounded_polygon(occ, corners, rod.boss_corner, low), low, -low)
    offsets = (rod.bolt_offset, -rod.bolt_offset)
    return block, [(3, occ.addCylinder(-2 * x, y, 0, 4 * x, 0, 0, rod.bolt_hole)) for y in offsets]


def draw_rod(occ: Any, rod: Rod) -> None:
    """Draws the rod as one solid."""
    big = disc(occ, 0.0, rod.big_outer, rod.big_thickness)
    small = disc(occ, rod.centre_distance, rod.small_outer, rod.small_thickness)
    block, holes = draw_bosses(occ, rod)
    body, _ = occ.fuse([big], [small, draw_shank(occ, rod), block])
    bores = [
        disc(occ, 0.0, rod.big_bore, 2 * rod.big_thickness),
        disc(occ, rod.centre_distance, rod.small_bore, 2 * rod.small_thickness),
    ]
    body, _ = occ.cut(body, [*bores, *draw_pockets(occ, rod), *holes])
    occ.synchronize()
    if len(body) != 1:
        raise MeshError(f"the measures give {len(body)} separate solids instead of one rod")


def bore_faces(gmsh: Any, x: float, radius: float, thickness: float) -> list[int]:
    """The cylindrical faces of the bore about (x, 0); raises MeshError unless they are the whole bore."""
    occ, tags, area = gmsh.model.occ, [], 0.0
    wanted = (x - radius, -radius, -thickness / 2, x + radius, radius, thickness / 2)
    for dim, tag in gmsh.model.getEntities(2):
        box = gmsh.model.getBoundingBox(dim, tag)
        fits = all(abs(b - w) < 1e-3 * radius for b, w in zip(box, wanted, strict=True))
        if fits and gmsh.model.getType(dim, tag) == "Cylinder":
            tags.append(tag)
            area += occ.getMass(dim, tag)
    if abs(area - 2 * math.pi * radius * thickness) > 1e-3 * area:
        raise MeshError(f"the bore at x = {x:g} mm is not a whole cylinder; a hole or a pocket cuts into it")
    return tags


def name_groups(gmsh: Any, rod: Rod) -> None:
    """Names the body and its two bores."""
    faces = {
        "BIGEND": bore_faces(gmsh, 0.0, rod.big_bore, rod.big_thickness),
        "SMALLEND": bore_faces(gmsh, rod.centre_distance, rod.small_bore, rod.small_thickness),
    }
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1, "BODY")
    for number, (name, tags) in enumerate(faces.items(), start=2):
        gmsh.model.addPhysicalGroup(2, tags, number, name)


def mesh_rod(rod: Rod, output: Path) -> Summary:
    """Draws, meshes, checks and writes the rod."""
    with session("connecting_rod", rod.order) as gmsh:
        draw_rod(gmsh.model.occ, rod)
        name_groups(gmsh, rod)
        options = {
            "Mesh.MeshSizeMax": rod.element_size,
            "Mesh.MeshSizeMin": rod.element_size / 3,
            "Mesh.MeshSizeFromCurvature": rod.elements_per_turn,
            "Mesh.Algorithm": 6,
            "Mesh.Algorithm3D": 1,
            "Mesh.Optimize": 1,
            "Mesh.OptimizeNetgen": 1,
            "Mesh.HighOrderOptimize": 1,
        }
        for option, value in options.items():
            gmsh.option.setNumber(option, value)
        gmsh.model.mesh.generate(3)
        round_coordinates(gmsh, GRID)
        summary = check(gmsh)
        write(gmsh, output)
    return summary


# ---------------------------------------------------------------------------------------------------------
# Command line


def unpack(output: Path) -> None:
    """Writes the shipped default mesh to `output`."""
    temporary = output.with_name(f"{output.stem}.{os.getpid()}.tmp{output.suffix}")
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        temporary.write_bytes(gzip.decompress(ARCHIVE.read_bytes()))
        os.replace(temporary, output)
    finally:
        temporary.unlink(missing_ok=True)


def is_current(output: Path) -> bool:
    """Whether `output` exists and is newer than this script."""
    return output.is_file() and output.stat().st_mtime > Path(__file__).stat().st_mtime


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Reads the command line."""
    default = Rod()
    parser = argparse.ArgumentParser(description="Makes the mesh of a connecting rod (mm) with gmsh.")
    sizes = "largest element size in mm (default %(default)s)"
    orders = "element order (default %(default)s)"
    outputs = f"mesh file (default: {DEFAULT_OUTPUT.name} here, or named after the other options)"
    parser.add_argument("--size", type=float, default=default.element_size, help=sizes)
    parser.add_argument("--order", type=int, choices=(1, 2), default=default.order, help=orders)
    parser.add_argument("--output", type=Path, help=outputs)
    parser.add_argument("--force", action="store_true", help="make the mesh even if the file is up to date")
    options = parser.parse_args(arguments)
    if not 0 < options.size < math.inf:
        parser.error("--size must be a positive number")
    if options.output is not None and options.output.suffix != ".msh":
        parser.error("--output must end in .msh")
    return options


def without_gmsh(reason: Exception, is_default: bool, output: Path) -> int:
    """Falls back to the shipped mesh, if that is the mesh asked for. Returns the exit code."""
    why = f"gmsh cannot be loaded ({reason}); to get it: pip install gmsh, and {LIBRARIES}"
    if not is_default:
        print(f"{why}. Only the default mesh is shipped.", file=sys.stderr)
        return 2
    if not ARCHIVE.is_file():
        print(f"{why}. The shipped mesh {ARCHIVE} is missing too.", file=sys.stderr)
        return 2
    unpack(output)
    print(f"{output}: unpacked from {ARCHIVE.name}, since {why}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes the mesh the command line asks for. Returns the exit code."""
    options = parse(arguments)
    rod = replace(Rod(), element_size=options.size, order=options.order)
    is_default = rod == Rod()
    named = DEFAULT_OUTPUT if is_default else FOLDER / f"connecting_rod_h{options.size:g}_o{options.order}.msh"
    output = named if options.output is None else options.output
    # A name given together with other options does not say which options the file there was made with.
    known = is_default or options.output is None
    if known and not options.force and is_current(output):
        print(f"{output}: up to date (--force makes it again)")
        return 0
    try:
        load_gmsh()
    except (ImportError, OSError) as reason:
        return without_gmsh(reason, is_default, output)
    try:
        summary = mesh_rod(rod, output)
    except MeshError as error:
        print(f"{output}: not written: {error}", file=sys.stderr)
        return 1
    grams = summary.volume * STEEL_DENSITY * 1e6
    print(f"{output}: {summary}, {summary.volume:.0f} mm^3 ({grams:.0f} g of steel)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
