"""Readers of model files; the table below is the contents page.

An importer takes a path and returns an ``Imported`` in the units of the file; options are its keyword arguments.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from morembs.base.arguments import check_value
from morembs.base.errors import InputError
from morembs.base.options import Text, list_options, read_options
from morembs.base.plugins import Registry
from morembs.base.units import Units, parse_units
from morembs.fem import Mesh, Nodes
from morembs.fem.handedness import right_handed
from morembs.fem.material import Material
from morembs.fem.middle_nodes import mesh_in_order
from morembs.importers.abaqus.importer import read_abaqus, read_abaqus_deck
from morembs.importers.advice import PYTHON, advising
from morembs.importers.ansys.cdb import read_ansys
from morembs.importers.decks.model import Deck
from morembs.importers.decks.options import refuse_both
from morembs.importers.imported import Imported
from morembs.importers.matrices.ansys_full import import_ansys_full
from morembs.importers.matrices.ansys_text import import_ansys_matrices
from morembs.importers.matrices.exudyn import import_exudyn
from morembs.importers.matrices.files import import_abaqus_matrix, import_calculix, import_dmig, import_op4
from morembs.importers.matrices.hdf5 import import_hdf5
from morembs.importers.matrices.matlab import import_matlab
from morembs.importers.matrices.matrix_market import import_matrix_market
from morembs.importers.matrices.npz import import_npz
from morembs.importers.meshes import import_mesh, read_with_meshio
from morembs.importers.nastran.importer import read_nastran
from morembs.importers.native import import_native
from morembs.importers.tolerances import TOL
from morembs.importers.unv import read_unv
from morembs.storage.contents import keeping_ledger
from morembs.storage.hdf5 import reading

# Endings with a mesh reader of their own; every other mesh goes through meshio.
READERS: dict[str, Callable[..., Mesh | Deck]] = {
    ".inp": read_abaqus,
    ".bdf": read_nastran,
    ".nas": read_nastran,
    ".fem": read_nastran,
    ".unv": read_unv,
    ".cdb": read_ansys,
}


# Endings of compressed files, and what makes the file of one.
_UNPACK = {".gz": "gunzip -k", ".bz2": "bunzip2 -k", ".xz": "unxz -k", ".zip": "unzip", ".zst": "unzstd"}
# Parameters of importers that a user does not give.
_NO_OPTIONS = ("budget",)


@dataclass(frozen=True, kw_only=True)
class Importer:
    """A format: its line of description, the endings of its files, the function that reads one (a ``Deck`` becomes an
    ``Imported``)."""

    about: str
    endings: tuple[str, ...]
    read: Callable[..., Imported | Deck]

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options."""
        return tuple(name for name in list_options(self.read) if name not in _NO_OPTIONS)


# The first format with the ending of a file is taken; formats without endings must be named.
_OWN: dict[str, Importer] = {
    "native": Importer(about="model file of morembs", endings=(".model.h5",), read=import_native),
    "matrix-market": Importer(
        about="one matrix (Matrix Market)", endings=(".mtx.gz", ".mtx", ".mm"), read=import_matrix_market
    ),
    "abaqus-matrix": Importer(about="one matrix of Abaqus *MATRIX OUTPUT", endings=(), read=import_abaqus_matrix),
    "calculix-matrix": Importer(
        about="job.sti, job.mas and job.dof of CalculiX", endings=(".sti", ".mas", ".dof"), read=import_calculix
    ),
    "op4": Importer(about="Nastran OP4, binary or text", endings=(".op4",), read=import_op4),
    "dmig": Importer(about="Nastran DMIG entries", endings=(".pch", ".dmig"), read=import_dmig),
    "abaqus": Importer(
        about="Abaqus or CalculiX deck: mesh, materials, couplings, masses", endings=(".inp",), read=read_abaqus_deck
    ),
    "nastran": Importer(
        about="Nastran bulk data: mesh, materials, RBE2, RBE3, CONM2",
        endings=(".bdf", ".nas", ".dat", ".fem"),
        read=read_nastran,
    ),
    "ansys": Importer(about="ANSYS archive (.cdb): mesh, materials, masses", endings=(".cdb",), read=read_ansys),
    "ansys-full": Importer(about="ANSYS .full: K and M", endings=(".full",), read=import_ansys_full),
    "ansys-matrices": Importer(
        about="K of ANSYS as text (MMF, HBMAT); M, D and the mapping are options",
        endings=(),
        read=import_ansys_matrices,
    ),
    "matlab": Importer(about="MATLAB .mat, v4 to v7.3", endings=(".mat",), read=import_matlab),
    "npz": Importer(about="NumPy or SciPy .npz", endings=(".npz",), read=import_npz),
    "exudyn": Importer(about="FEMinterface of Exudyn in HDF5", endings=(), read=import_exudyn),
    "hdf5": Importer(
        about="sparse matrices in HDF5 groups (SciPy, MATLAB, Octave)", endings=(".h5", ".hdf5"), read=import_hdf5
    ),
    "unv": Importer(about="universal file of I-deas or Salome: mesh and groups", endings=(".unv",), read=read_unv),
    "mesh": Importer(
        about="solid mesh without materials, all that meshio reads",
        endings=(".msh", ".vtk", ".vtu", ".med", ".rmed", ".xdmf", ".mesh"),
        read=import_mesh,
    ),
}
IMPORTERS: Registry[Importer] = Registry(
    "morembs.importers", _OWN, lambda _, entry: "" if isinstance(entry, Importer) else f"{entry!r} is no Importer"
)


@advising(PYTHON)
def read_mesh(
    path: str | Path, units: Units | str | None = None, *, dialect: str = "auto", allow_includes_outside: bool = False
) -> Mesh:
    """Mesh with node sets and element sets, coordinates in m.

    Args:
        units: of the file, as ``parse_units`` gives them or takes them ("mm-t-s"); m-kg-s unless given.
        dialect: the program that a deck .inp was written for: "abaqus", "calculix", or "auto".
        allow_includes_outside: a deck may include files from beyond its folder.

    Raises:
        InputError: the file is missing, cannot be read, or has elements of an unsupported type or with middle nodes in
            no known order; units not known.

    >>> import meshio
    >>> meshio.Mesh(nodes.xyz, [("hexahedron", cells)]).write("bar.vtk")
    >>> read_mesh("bar.vtk")
    Mesh: nodes 20; elements 4 hex8; source bar.vtk
    """
    path, units = Path(path), parse_units(units) if isinstance(units, str) else units
    if not isinstance(units, Units | None):
        raise InputError(
            f'units = {units!r} was given; expected a text such as "mm-t-s", or what parse_units gives', keyword="units"
        )
    if path.exists() and not path.is_file():
        raise InputError(
            f"mesh {str(path)!r} is not a file; expected a mesh file such as conrod.msh", kind="file", keyword=path.name
        )
    if not path.is_file():
        raise InputError(f"mesh file {str(path)!r} does not exist; check the path", kind="file", keyword=path.name)
    refuse_compressed(path)
    reader = read_nastran if _is_bulk_data(path) else READERS.get(path.suffix.lower())
    given: dict[str, Any] = {"dialect": dialect} if dialect != "auto" else {}
    if given and reader is not read_abaqus:
        raise InputError(
            f"dialect = {dialect!r} was given for {path.name}, which is no deck .inp; leave it out", keyword="dialect"
        )
    if reader is not None and "allow_includes_outside" in list_options(reader):
        given |= {"allow_includes_outside": allow_includes_outside}
    found = read_with_meshio(path) if reader is None else reader(path, **given)
    mesh = found.mesh() if isinstance(found, Deck) else found
    if not mesh.blocks:
        raise InputError(
            f"{path.name} has no solid elements; a volume mesh is needed (tet, hex or wedge)", kind="missing"
        )
    nodes = mesh.nodes
    scaled = Nodes(ids=nodes.ids, xyz=nodes.xyz * (units or Units()).length, sets=nodes.sets)
    return right_handed(mesh_in_order(replace(mesh, nodes=scaled, source=path.name)))


def _is_bulk_data(path: Path) -> bool:
    """True if a file .dat is a Nastran deck; those of Tecplot, which meshio reads, name their variables."""
    if path.suffix.lower() != ".dat":
        return False
    with path.open("rb") as file:
        return re.search(rb"^\s*VARIABLES\s*=", file.read(TOL.head_bytes), re.MULTILINE | re.IGNORECASE) is None


def format_of(path: Path, given: str | None = None) -> str:
    """Name of the format of a file: ``given``, or what its ending (and for text and HDF5 its content) says.

    Raises:
        InputError: no such file, an unknown format, or an ending that says nothing.
    """
    if path.exists() and not path.is_file():
        raise InputError(
            f"{str(path)!r} is not a file; expected a model, matrix or mesh file", kind="file", keyword=path.name
        )
    if not path.is_file():
        raise InputError(f"the file {str(path)!r} does not exist; check the path", kind="file", keyword=path.name)
    if given is not None:
        if given not in IMPORTERS:
            raise InputError(
                f"--format {given!r} was given; {IMPORTERS.advice(given)}", kind="unknown", keyword="format"
            )
        return given
    name = path.name.lower()
    for format, importer in IMPORTERS.items():
        if name.endswith(importer.endings):
            return _by_content(path, format)
    refuse_compressed(path)
    raise InputError(
        f"the ending of {path.name!r} says nothing about its format; give --format, one of {', '.join(IMPORTERS)}",
        kind="unsupported",
    )


def refuse_compressed(path: Path) -> None:
    """Refuse a compressed file other than a matrix .mtx.gz.

    Raises:
        InputError: in these cases.
    """
    if path.suffix.lower() in _UNPACK:
        unpack = f"{_UNPACK[path.suffix.lower()]} {shlex.quote(str(path))}"
        raise InputError(f"{path.name} is compressed; expected the file itself: {unpack}", kind="conflict")


def _by_content(path: Path, format: str) -> str:
    """The format where an ending stands for several."""
    if format == "matrix-market" and not path.name.lower().endswith(".gz"):
        with path.open("rb") as file:
            return format if file.read(14).lower().startswith(b"%%matrixmarket") else "abaqus-matrix"
    if format in ("hdf5", "native"):
        return {"morembs-model": "native", "FEMinterface": "exudyn"}.get(_hdf5_kind(path), "hdf5")
    return format


def _hdf5_kind(path: Path) -> str:
    """What an HDF5 file says that it is."""
    with reading(path, "an HDF5 file with matrices", "check the file") as file:
        for key in ("format", "type"):
            item = file.get(key)
            if getattr(item, "shape", None) == ():
                value = item[()]
                return value.decode(errors="replace") if isinstance(value, bytes) else str(value)
    return ""


def _read(path: Path, format: str, options: Mapping[str, Any]) -> Imported | Deck:
    importer = IMPORTERS[format]
    given = {key: Text(value) if isinstance(value, str) else value for key, value in options.items()}
    values = read_options(
        importer.read, given, "the format", where=f"{path.name}: ", hidden=_NO_OPTIONS, cure="; give --set {key}=VALUE"
    )
    found = importer.read(path, **values)
    return replace(found, warnings=(*found.warnings, *found.options.idle)) if isinstance(found, Deck) else found


@advising(PYTHON)
def read_deck(path: str | Path, format: str | None = None, **options: Any) -> Deck:
    """A deck of Abaqus, CalculiX, Nastran or ANSYS, or a universal file, by its labels and in its units.

    Args:
        format: "abaqus", "nastran", "ansys" or "unv"; by default the ending of the file tells.
        options: of the format, as ``morembs import`` has them: ``density``, ``contact``, ``skip``, ``dialect``,
            ``allow_includes_outside``.

    Raises:
        DeckError: what ends the reading, with all problems that were found before: an ``InputError``. What keeps a deck
            that was read from becoming a model is among its ``problems``.
        InputError: the file is missing or holds no deck, or an option that its format does not have.

    >>> grids = [f"GRID,{n},,{x:.2f},{y},{z}" for n, (x, y, z) in zip(nodes.ids, nodes.xyz.tolist())]
    >>> solids = ["CHEXA,{},1,{},{},{},{},{},{}\\n,{},{}".format(i + 1, *row) for i, row in enumerate(nodes.ids[cells])]
    >>> with open("bar.bdf", "w") as file:
    ...     print(*grids, *solids, "PSOLID,1,1", "MAT1,1,2.1+11,,.3,7850.", "SET1,5,1,THRU,4", sep="\\n", file=file)
    >>> deck = read_deck("bar.bdf")
    >>> deck
    Deck: file bar.bdf; program Nastran; nodes 20; elements 4 CHEXA; sections 1; problems none
    >>> deck.node_sets["SET1_5"].tolist(), deck.materials["MAT1 1"].density
    ([[1, 4]], 7850.0)
    """
    check_value("read_deck: path", path, str | Path)
    path = Path(path)
    of_models = next((name for name in ("units", "materials", "mass_integration") if name in options), None)
    if of_models:
        raise InputError(f"{path.name}: {of_models} was given, and a deck is read as it is; give it to deck.to_model")
    name = format_of(path, format)
    with keeping_ledger() as ledger:
        deck = _read(path, name, options)
    if not isinstance(deck, Deck):
        raise InputError(
            f"{path.name} is a file of the format {name!r}, which is no deck; expected abaqus, nastran, ansys or unv"
        )
    return _for_python(replace(deck, files=tuple(ledger.names())))


def _for_python(deck: Deck) -> Deck:
    """The deck whose sentences name options as arguments."""
    return replace(
        deck,
        warnings=tuple(map(PYTHON.phrase, deck.warnings)),
        problems=tuple(problem.phrase(PYTHON) for problem in deck.problems),
        elements=tuple(
            part if part.problem is None else replace(part, problem=part.problem.phrase(PYTHON))
            for part in deck.elements
        ),
    )


def import_file(
    path: str | Path,
    format: str | None = None,
    options: Mapping[str, Any] | None = None,
    *,
    engine: str | None = None,
    materials: Sequence[Material] = (),
) -> Imported:
    """What a file holds, in its units.

    Args:
        format: a name of ``IMPORTERS``; by default the ending of the file tells.
        options: keyword arguments of the importer, or of the engine.
        engine: the program that assembles a deck, NAME or NAME:PATH with a name of ``engines.ENGINES``; "auto" takes
            own assembly where it takes the deck, else the first engine that is there and does.
        materials: of element sets of a mesh that lack one ("all": of all), in the units of the file.

    Raises:
        InputError: the file is missing or cannot be used, an option that its format does not have, or a material and
            ``density`` for one set.
    """
    refuse_both((options or {}).get("density"), materials)
    path = Path(path)
    importer = IMPORTERS[format_of(path, format)]
    # Not at the top: other imports do without programs.
    if engine == "auto":
        from morembs.importers.engines.choice import import_by_choice

        format = format_of(path, format)
        return import_by_choice(
            path,
            format,
            options or {},
            lambda given: import_file(path, format, given, materials=materials),
            importer.options,
            materials=materials,
        )
    if engine is not None:
        from morembs.importers.engines import import_with_engine

        return import_with_engine(path, format_of(path, format), engine, options or {}, materials)
    found = _read(path, format_of(path, format), options or {})
    if isinstance(found, Deck):
        return found.convert(materials)
    if materials and (found.K is not None or found.materials):
        raise InputError(
            f"{found.source} brings its own materials or matrices; leave --material out", kind="unsupported"
        )
    return replace(found, materials=(*found.materials, *materials))
