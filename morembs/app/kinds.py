"""What kind of file a name on the command line is, and which command takes it."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

CAD = (".step", ".stp", ".iges", ".igs", ".brep")
SURFACES = (".stl", ".obj", ".off")
MATRICES = (".mtx", ".mtx.gz", ".mm")
MATRICES_BY_NAME = (".mat", ".npz")
HDF5 = (".h5", ".hdf5")


@dataclass(frozen=True)
class Kind:
    """A kind of file: its name in messages, and the command that takes it, with ``{}`` for the file."""

    name: str
    command: str


SYSTEM_FILE = "a system of bodies"
# The table that every system file has and no job.
SYSTEM_TABLE = "simulation"
SYSTEM = Kind(SYSTEM_FILE, "morembs simulate {}")
# What files of results are told by.
RESULT_FORMAT = "morembs-simulation"
RESULT = Kind("the result of a simulation", "morembs info {}")
JOB = Kind("a job", "morembs reduce {}")
MESH = Kind("a mesh", "morembs init {}")
DECK = Kind("a deck", "morembs init {}")
MODEL = Kind("a model file", "morembs init {}")
BODY = Kind("a body file", "morembs info {}")
MEMBER = Kind("a file of planar members", "morembs info {}")
MATRIX = Kind("a matrix", "morembs reduce K.mtx M.mtx --input B.mtx --method krylov --order 20")
MATRIX_FILE = Kind("a file of matrices", "morembs init {}")
CAD_PART = Kind("a CAD part", "morembs init {} --size 3mm")
SURFACE = Kind("a surface without volume", "")
# Kinds that ``init`` writes a job for.
PARTS = (MESH, DECK, MODEL, MATRIX_FILE, CAD_PART)
# What ``init`` expects.
PART = "a mesh, a deck or a model file"
# Formats whose files hold materials beside a mesh.
DECKS = ("abaqus", "nastran", "ansys")


def kind_of(path: Path) -> Kind | None:
    """The kind of a file by its ending, of TOML and HDF5 files by their contents; None where neither says it."""
    name = path.name.lower()
    if name.endswith(".toml"):
        return SYSTEM if _holds_system(path) else JOB
    endings_of = {CAD: CAD_PART, SURFACES: SURFACE, MATRICES: MATRIX, MATRICES_BY_NAME: MATRIX_FILE}
    for endings, kind in endings_of.items():
        if name.endswith(endings):
            return kind
    if name.endswith(HDF5):
        return _kind_of_hdf5(path)
    # Not at the top: the table of formats takes as long to load as a short command.
    from morembs.importers import IMPORTERS, READERS

    format_name = next((key for key, importer in IMPORTERS.items() if name.endswith(importer.endings or ("\0",))), "")
    if format_name in DECKS:
        return DECK
    return MESH if name.endswith((*READERS, *IMPORTERS["mesh"].endings)) else None


def _holds_system(path: Path) -> bool:
    """True if a TOML file has the table of systems, also where it is not valid TOML."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return re.search(rf"^\s*(\[\s*{SYSTEM_TABLE}\s*\]|{SYSTEM_TABLE}\s*[.=])", text, re.MULTILINE) is not None


def _kind_of_hdf5(path: Path) -> Kind:
    from morembs.importers.model_file import is_model_file
    from morembs.storage.hdf5 import MEMBERS, holds_format

    for name, kind in ((RESULT_FORMAT, RESULT), (MEMBERS, MEMBER)):
        if holds_format(path, name):
            return kind
    return MODEL if path.name.lower().endswith(".model.h5") or is_model_file(path) else BODY


def instead(path: Path, expected: str) -> str:
    """What a file is in place of ``expected``, and the command that takes it; "" for an unknown kind."""
    kind = kind_of(path)
    if kind is None:
        return ""
    sentence = f"{kind.name} was given, expected {expected}"
    if kind is SURFACE:
        return f"{sentence}: fill it with tetrahedra, as Gmsh does, and give that mesh"
    if kind in PARTS and expected == PART:
        return ""
    if kind is BODY and expected == SYSTEM_FILE:
        return f"{sentence}: morembs init {shlex.quote(str(path))} writes one for it"
    if kind is JOB and expected == SYSTEM_FILE:
        return f"{sentence}: morembs reduce {shlex.quote(str(path))} makes a body, and morembs init BODY.h5 its system"
    cure = kind.command.format(shlex.quote(str(path)))
    return f"{sentence}: {cure}{' writes one for it' if kind in PARTS and expected == 'a job' else ''}"
