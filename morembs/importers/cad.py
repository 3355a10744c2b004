"""Parts of CAD files (STEP, IGES, BREP) meshed with second-order tetrahedra by Gmsh, where it is installed."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from morembs.base.errors import InputError
from morembs.base.units import LENGTH
from morembs.importers.tolerances import TOL
from morembs.storage.safefile import replacing


def parse_size(text: str) -> float:
    """The length in mm of a text such as ``3mm`` or ``0.1in``.

    Raises:
        InputError: no such text, or a length that is not above zero.

    >>> parse_size("0.3cm")
    3.0
    """
    found = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)\s*", text)
    try:
        size = float(found[1]) * LENGTH[found[2]] / LENGTH["mm"] if found else 0.0
    except (KeyError, ValueError):
        size = 0.0
    if not 0 < size < float("inf"):
        raise InputError(
            f"--size {text} was given; expected a length with its unit ({', '.join(LENGTH)}), such as 3mm",
            keyword="size",
        )
    return size


def mesh_cad(part: Path, mesh: Path, size: float | None = None) -> float:
    """Mesh the solids of ``part`` and write ``mesh``, a file of Gmsh in mm; the largest size of elements in mm.

    Tetrahedra have ten nodes, on the true surfaces; edges are straight where curved ones would turn elements inside
    out. Two runs give the same mesh. Solids that touch share their nodes; each is an element set SOLID_1, ...

    Args:
        size: largest size of elements in mm, by default a part of the longest side of the part.

    Raises:
        InputError: Gmsh is missing or cannot be loaded, or it cannot read or mesh the part.
        OutputError: ``mesh`` cannot be written.
    """
    with _session(part) as gmsh:
        try:
            solids = _solids(gmsh, part)
            low_high = gmsh.model.getBoundingBox(-1, -1)
            longest = max(high - low for low, high in zip(low_high[:3], low_high[3:], strict=True))
            size = size or float(f"{TOL.cad_element_part * longest:.2g}")
            _mesh(gmsh, solids, size)
            with tempfile.TemporaryDirectory() as folder:
                made = Path(folder) / "mesh.msh"
                gmsh.write(str(made))
                content = made.read_bytes()
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"{part} cannot be meshed by Gmsh ({error}); mend it, or try another --size", kind="unsupported"
            ) from error
    with replacing(mesh) as written:
        written.write(content)
    return size


@contextmanager
def _session(part: Path) -> Iterator[Any]:
    """Gmsh with one empty model, quiet, in one thread and from the same random numbers."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise InputError(
            f"{part} is a part that has to be meshed by Gmsh, which cannot be loaded ({error}); to get it: "
            "pip install 'morembs[mesh]', or give a mesh",
            kind="program",
        ) from error
    with _silence():
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        try:
            gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
            options = {"General.Terminal": 0, "General.NumThreads": 1, "Mesh.RandomSeed": 1, "Mesh.Binary": 1}
            for name, value in options.items():
                gmsh.option.setNumber(name, value)
            gmsh.model.add("part")
            yield gmsh
        finally:
            gmsh.finalize()


@contextmanager
def _silence() -> Iterator[None]:
    """What libraries print themselves on standard output goes nowhere: OpenCASCADE does, whatever is asked of Gmsh."""
    kept = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _solids(gmsh: Any, part: Path) -> list[int]:
    """Tags of the solids; touching ones share their faces."""
    occ = gmsh.model.occ
    found = occ.importShapes(str(part))
    if not any(dimension == 3 for dimension, _ in found):
        occ.healShapes(found)  # surfaces that close become solids
        found = occ.getEntities(3)
    solids = [entity for entity in found if entity[0] == 3]
    if not solids:
        raise InputError(
            f"{part} has no solid, so it cannot be meshed by Gmsh; close its surfaces in the CAD program",
            kind="missing",
        )
    if len(solids) > 1:
        occ.fragment(solids[:1], solids[1:])
    occ.synchronize()
    tags = [tag for _, tag in gmsh.model.getEntities(3)]
    for number, tag in enumerate(tags, start=1):
        gmsh.model.addPhysicalGroup(3, [tag], number, f"SOLID_{number}")
    return tags


def _mesh(gmsh: Any, solids: list[int], size: float) -> None:
    """Second-order tetrahedra in the solids."""
    for name, value in (
        ("Mesh.MeshSizeMax", size),
        ("Mesh.MeshSizeFromCurvature", TOL.cad_elements_per_turn),
        ("Mesh.Algorithm3D", 1),
        ("Mesh.HighOrderOptimize", 1),
    ):
        gmsh.option.setNumber(name, value)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(2)
    elements = [element for tag in solids for block in gmsh.model.mesh.getElements(3, tag)[1] for element in block]
    if gmsh.model.mesh.getElementQualities(elements, "minDetJac").min() <= 0:
        gmsh.model.mesh.setOrder(1)
        gmsh.option.setNumber("Mesh.SecondOrderLinear", 1)
        gmsh.model.mesh.setOrder(2)
