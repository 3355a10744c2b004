#!/usr/bin/env python3
"""Makes the small meshes in this directory and connecting_rod.msh.gz, the mesh data/make_connecting_rod.py
falls back to. Needs gmsh. Two runs give the same files; README.md beside this script says what is in them.
"""

from __future__ import annotations

import argparse
import gzip
import importlib.util
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).resolve().parent
LARGEST = 1_000_000  # bytes a file in this directory may have
TOLERANCE = 1e-6  # of the size of a model, when faces are picked by their place

Box = tuple[float, float, float, float, float, float]


def load_rod_script() -> ModuleType:
    """The connecting rod's script as a module; it is not part of a package."""
    path = HERE.parent / "make_connecting_rod.py"
    spec = importlib.util.spec_from_file_location("connecting_rod", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be loaded")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


rod_script = load_rod_script()


# ---------------------------------------------------------------------------------------------------------
# Naming and finishing


def inside(gmsh: Any, dim: int, box: Box) -> list[int]:
    """The entities of a dimension that lie wholly inside a box, up to rounding."""
    whole = gmsh.model.getBoundingBox(-1, -1)
    slack = TOLERANCE * max(high - low for low, high in zip(whole[:3], whole[3:], strict=True))
    low, high = [b - slack for b in box[:3]], [b + slack for b in box[3:]]
    return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*low, *high, dim)]


def name_groups(gmsh: Any, groups: Mapping[str, tuple[int, Sequence[int]]]) -> None:
    """Names the volumes BODY, and whatever else is given as name -> (dimension, entities)."""
    gmsh.model.addPhysicalGroup(3, [tag for _, tag in gmsh.model.getEntities(3)], 1, "BODY")
    for number, (name, (dim, tags)) in enumerate(groups.items(), start=2):
        if not tags:
            raise rod_script.MeshError(f"nothing found for {name}")
        gmsh.model.addPhysicalGroup(dim, list(tags), number, name)


def report(output: Path, summary: Any) -> None:
    """Says in one line what was made."""
    print(f"{output.name}: {summary}, volume {summary.volume:.6g}")


def finish(gmsh: Any, output: Path) -> None:
    """Meshes, checks and writes the current model."""
    gmsh.model.mesh.generate(3)
    summary = rod_script.check(gmsh)
    rod_script.write(gmsh, output)
    report(output, summary)


def grid_block(gmsh: Any, size: tuple[float, float, float], cells: tuple[int, int, int], recombine: bool) -> None:
    """A box with one corner at the origin, meshed along its edges; with hexahedra if `recombine`."""
    geo = gmsh.model.geo
    line = geo.extrude([(0, geo.addPoint(0, 0, 0))], size[0], 0, 0, [cells[0]])[1]
    face = geo.extrude([line], 0, size[1], 0, [cells[1]], recombine=recombine)[1]
    geo.extrude([face], 0, 0, size[2], [cells[2]], recombine=recombine)
    geo.synchronize()


# ---------------------------------------------------------------------------------------------------------
# The meshes


def coarse_rod(output: Path) -> None:
    """The connecting rod with ten-node tetrahedra as large as its shape allows."""
    rod = replace(rod_script.Rod(), element_size=31.0, elements_per_turn=8)
    report(output, rod_script.mesh_rod(rod, output))


def packed_rod(output: Path) -> None:
    """The connecting rod's default mesh, compressed."""
    with tempfile.TemporaryDirectory() as directory:
        mesh = Path(directory) / "connecting_rod.msh"
        summary = rod_script.mesh_rod(rod_script.Rod(), mesh)
        temporary = output.with_name(f"{output.name}.{os.getpid()}.tmp")
        temporary.write_bytes(gzip.compress(mesh.read_bytes(), compresslevel=9, mtime=0))
    os.replace(temporary, output)
    report(output, summary)


def ring_of_quads(geo: Any, half: float, radius: float, z: float) -> tuple[list[int], int]:
    """The four faces in the plane y = 0 between a square about (0, z) and a circle in it, each from a side of
    the square to the arc behind it, with 4 x 2 quadrilaterals. Returns them and the square's lower side."""
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    reach = radius / 2**0.5
    centre = geo.addPoint(0, 0, z)
    outer = [geo.addPoint(a * half, 0, z + b * half) for a, b in signs]
    inner = [geo.addPoint(a * reach, 0, z + b * reach) for a, b in signs]
    following = (1, 2, 3, 0)
    sides = [geo.addLine(outer[i], outer[j]) for i, j in enumerate(following)]
    arcs = [geo.addCircleArc(inner[i], centre, inner[j]) for i, j in enumerate(following)]
    spokes = [geo.addLine(*pair) for pair in zip(outer, inner, strict=True)]
    for curves, cells in ((sides, 4), (arcs, 4), (spokes, 2)):
        for curve in curves:
            geo.mesh.setTransfiniteCurve(curve, cells + 1)
    faces = []
    for i, j in enumerate(following):
        face = geo.addPlaneSurface([geo.addCurveLoop([sides[i], spokes[j], -arcs[i], -spokes[i]])])
        geo.mesh.setTransfiniteSurface(face)
        geo.mesh.setRecombine(2, face)
        faces.append(face)
    return faces, sides[0]


def draw_bracket(gmsh: Any) -> None:
    """The bracket: a 10 thick upright of 40 x 50 with a bore of radius 10, and a 10 thick foot of 40 x 50."""
    geo = gmsh.model.geo
    faces, lower_side = ring_of_quads(geo, 20.0, 10.0, 30.0)
    heel = geo.extrude([(1, lower_side)], 0, 0, -10.0, [2], recombine=True)[1]
    below_upright = geo.extrude([heel], 0, 10.0, 0, [2], recombine=True)[0]
    geo.extrude([(2, face) for face in faces], 0, 10.0, 0, [2], recombine=True)
    geo.extrude([below_upright], 0, 40.0, 0, [5], recombine=True)
    geo.synchronize()


def bracket(output: Path) -> None:
    """An L-shaped bracket of twenty-node hexahedra. As MSH its groups are faces; as an Abaqus input file it
    holds volume elements only, as such files mostly do, and its groups are sets of nodes."""
    with rod_script.session("bracket", order=2, incomplete=True) as gmsh:
        gmsh.option.setNumber("Mesh.SaveGroupsOfElements", -1000)  # one digit for each dimension, 3 to 0
        gmsh.option.setNumber("Mesh.SaveGroupsOfNodes", -100)
        draw_bracket(gmsh)
        bore = inside(gmsh, 2, (-10.0, 0.0, 20.0, 10.0, 10.0, 40.0))
        groups = {"FOOT": (2, inside(gmsh, 2, (-20.0, 0.0, 0.0, 20.0, 50.0, 0.0))), "TIP": (2, bore)}
        name_groups(gmsh, groups)
        finish(gmsh, output)
    if output.suffix == ".inp":
        replace_heading(output)


def replace_heading(output: Path) -> None:
    """Puts the file's own name under *Heading, where gmsh puts the path it first wrote to."""
    lines = output.read_text(encoding="ascii").splitlines(keepends=True)
    lines[1] = f" {output.stem}: L-shaped bracket, mm\n"
    temporary = output.with_name(f"{output.name}.{os.getpid()}.tmp")
    temporary.write_text("".join(lines), encoding="ascii")
    os.replace(temporary, output)


def plate(output: Path) -> None:
    """A thin plate of eight-node hexahedra, with its faces and the edges of its lower face named."""
    a, b, t = 400.0, 300.0, 4.0
    faces: dict[str, Box] = {
        "LEFT": (0, 0, 0, 0, b, t),
        "RIGHT": (a, 0, 0, a, b, t),
        "FRONT": (0, 0, 0, a, 0, t),
        "BACK": (0, b, 0, a, b, t),
        "BOTTOM": (0, 0, 0, a, b, 0),
        "TOP": (0, 0, t, a, b, t),
    }
    edges: dict[str, Box] = {
        "EDGE_LEFT": (0, 0, 0, 0, b, 0),
        "EDGE_RIGHT": (a, 0, 0, a, b, 0),
        "EDGE_FRONT": (0, 0, 0, a, 0, 0),
        "EDGE_BACK": (0, b, 0, a, b, 0),
    }
    with rod_script.session("plate") as gmsh:
        grid_block(gmsh, (a, b, t), (24, 18, 2), recombine=True)
        groups = {name: (2, inside(gmsh, 2, box)) for name, box in faces.items()}
        groups |= {name: (1, inside(gmsh, 1, box)) for name, box in edges.items()}
        name_groups(gmsh, groups)
        finish(gmsh, output)


def ends(gmsh: Any, length: float, width: float, height: float) -> dict[str, tuple[int, Sequence[int]]]:
    """ROOT at x = 0 and TIP at x = length."""
    return {
        "ROOT": (2, inside(gmsh, 2, (0, 0, 0, 0, width, height))),
        "TIP": (2, inside(gmsh, 2, (length, 0, 0, length, width, height))),
    }


def beam(output: Path) -> None:
    """A slender bar of twenty-node hexahedra, in metres."""
    size = (0.5, 0.05, 0.03)
    with rod_script.session("beam", order=2, incomplete=True) as gmsh:
        grid_block(gmsh, size, (20, 2, 2), recombine=True)
        name_groups(gmsh, ends(gmsh, *size))
        finish(gmsh, output)


def block(output: Path) -> None:
    """A block of four-node tetrahedra."""
    size = (30.0, 20.0, 10.0)
    with rod_script.session("block") as gmsh:
        grid_block(gmsh, size, (6, 4, 2), recombine=False)
        name_groups(gmsh, ends(gmsh, *size))
        finish(gmsh, output)


def wedge_beam(order: int) -> Callable[[Path], None]:
    """Makes a maker of a bar of prisms of the given order: a triangulated end face, drawn out along x."""

    def make(output: Path) -> None:
        """Makes the bar."""
        length, width, height = 60.0, 10.0, 6.0
        with rod_script.session(output.stem, order=order, incomplete=True) as gmsh:
            geo = gmsh.model.geo
            edge = geo.extrude([(0, geo.addPoint(0, 0, 0))], 0, width, 0, [2])[1]
            face = geo.extrude([edge], 0, 0, height, [1])[1]
            geo.extrude([face], length, 0, 0, [6], recombine=True)
            geo.synchronize()
            name_groups(gmsh, ends(gmsh, length, width, height))
            finish(gmsh, output)

    return make


MAKERS: dict[str, Callable[[Path], None]] = {
    "connecting_rod.msh.gz": packed_rod,
    "conrod.msh": coarse_rod,
    "bracket.msh": bracket,
    "bracket.inp": bracket,
    "plate.msh": plate,
    "beam.msh": beam,
    "wedge.msh": wedge_beam(1),
    "wedge15.msh": wedge_beam(2),
    "block.msh": block,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Makes the meshes. Returns the exit code."""
    parser = argparse.ArgumentParser(description="Makes the small meshes with gmsh.")
    parser.add_argument("--directory", type=Path, default=HERE, help="where to write them (default: here)")
    directory: Path = parser.parse_args(arguments).directory
    try:
        rod_script.load_gmsh()
    except (ImportError, OSError) as reason:
        print(f"gmsh cannot be loaded ({reason}): pip install gmsh, {rod_script.LIBRARIES}", file=sys.stderr)
        return 2
    directory.mkdir(parents=True, exist_ok=True)
    for name, make in MAKERS.items():
        output = directory / name
        try:
            make(output)
        except rod_script.MeshError as error:
            print(f"{name}: {error}", file=sys.stderr)
            return 1
        if output.stat().st_size >= LARGEST:
            print(f"{name}: {output.stat().st_size} bytes, {LARGEST} are too many", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
