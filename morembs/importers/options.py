"""Options of an import, each declared once.

Flags of ``morembs import``, keys of ``[model]`` in jobs, keyword arguments of ``morembs.import_model`` and the table of
docs/reference/formats.md are made from the fields of ``ImportOptions``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

from morembs.base.arguments import hints_of
from morembs.base.key_tables import Table, declare_key, read_table
from morembs.base.limits import Count, Positive, one_of, text
from morembs.base.units import Units, parse_units
from morembs.importers.decks.formulations import DIALECTS
from morembs.importers.decks.options import Boundary, Contact, Pretension
from morembs.importers.tolerances import TOL

FilePath = Annotated[str, text("the path of a file")]
FolderPath = Annotated[str, text("the path of a folder")]
ROLES = {"K": "stiffness", "M": "mass", "D": "damping", "G": "gyroscopic", "N": "circulatory"}
OF_MATRICES = (*ROLES.values(), "nodes", "dofs")
# Names of the options in the functions of importers and engines, where they differ.
OF_DECKS = ("dialect", "density", "contact", "skip", "pretension", "allow_includes_outside")
OF_ENGINES = {"boundary": "boundary", "preload": "preload", "engine_timeout": "timeout", "keep_files": "keep_files"}


def option(meaning: str, default: Any = None, *, expected: str = "") -> Any:
    """A field with its meaning for help pages and docs, and words of its own for what is expected."""
    kept = {"meaning": meaning} | ({"expected": expected} if expected else {})
    if isinstance(default, list | dict):
        return field(default_factory=default.copy, metadata=kept)
    return field(default=default, metadata=kept)


@dataclass(frozen=True, kw_only=True)
class UnitsTable(Table):
    """Units by name."""

    length: str = declare_key('a unit of length such as "mm"')
    mass: str = declare_key('a unit of mass such as "t"')
    time: str = declare_key('a unit of time such as "s"')


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Table):
    """How files of other programs become a model."""

    file: FilePath | None = option(
        "the file of the model: a model file, a deck, or matrices",
        expected='the path of a model file, deck or file of matrices such as "conrod.model.h5" or "part.inp"',
    )
    format: str | None = option("the format, one that `morembs import --list` names; the ending of the file tells it")
    units: str | UnitsTable = option(
        "length, mass and time of the files",
        "m-kg-s",
        expected='"length-mass-time" such as "mm-t-s", or a table with length, mass and time',
    )
    stiffness: FilePath | None = option("a file with K alone")
    mass: FilePath | None = option("a file with M alone")
    damping: FilePath | None = option("a file with D alone")
    gyroscopic: FilePath | None = option("a file with G alone, skew-symmetric")
    circulatory: FilePath | None = option("a file with N alone, skew-symmetric, which joins K")
    nodes: FilePath | None = option("a mesh that gives nodes, sets and elements to matrices, joined by labels")
    dofs: FilePath | None = option("a table (.csv) with the columns node and dof, a line for each row of the matrices")
    mass_integration: Annotated[str, one_of("element", "exact", "reduced")] = option(
        "of meshes: the mass as the elements of the deck have it, exact, or at the points of the stiffness", "element"
    )
    dialect: Annotated[str, one_of(*DIALECTS)] = option(
        "of decks .inp: the program whose element types are meant; the deck tells it otherwise", "auto"
    )
    density: Positive | dict[str, Positive] | None = option(
        "of materials with stiffness only, in units of the deck, of all or by element set",
        expected="a positive number, or a table { SET = number }",
    )
    contact: Contact = option("contact of a deck: refused, skipped, or its surfaces tied (glued)", "refuse")
    skip: list[str] | str = option(
        "keywords, cards or element types to leave out, although stiffness or mass may depend on them",
        [],
        expected='words such as ["CONTACT PAIR", "S4"]',
    )
    pretension: Pretension = option(
        "bolts with `*PRE-TENSION SECTION`: locked, as one piece, or cut, so that the faces part along the normal by "
        "one dof; by default own assembly refuses them and CalculiX cuts them",
        "auto",
    )
    engine: str | None = option(
        "who assembles a deck: calculix or mystran (NAME:PATH with a path of its own), or auto: the first that takes it"
    )
    boundary: Boundary = option("with an engine: drop what the deck holds, or keep it", "drop")
    preload: Count = option("with an engine: the steps up to this one run first", 0)
    engine_timeout: Positive = option("with an engine: seconds for each run of it", TOL.engine_seconds)
    keep_files: FolderPath | None = option("with an engine: a folder for the files that it read and wrote")
    set: dict[str, Any] = option(
        "options of the format: K = NAME names a matrix of the file, M = identity",
        {},
        expected='a table such as { K = "Kfull" }',
    )
    allow_includes_outside: bool = option("decks may include files from beyond their folders", False)

    @property
    def matrices(self) -> dict[str, Path]:
        """Role -> file of one matrix."""
        named = {role: getattr(self, name) for role, name in ROLES.items()}
        return {role: Path(path) for role, path in named.items() if path is not None}

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that are read."""
        given = (self.file, *self.matrices.values(), self.nodes, self.dofs)
        return tuple(Path(path) for path in given if path is not None)

    @property
    def has_plain_file(self) -> bool:
        """True if there is nothing but one file and its units."""
        return all(
            not getattr(self, entry.name) or getattr(self, entry.name) == default_of(entry)
            for entry in fields(ImportOptions)
            if entry.name not in ("file", "units")
        )

    @property
    def parsed_units(self) -> Units:
        """The units of the files."""
        return parse_units(self.units if isinstance(self.units, str) else self.units.values())

    @property
    def of_decks(self) -> dict[str, Any]:
        """Options of decks that differ from their defaults, as importers and engines take them."""
        changed = self._changed_options(OF_DECKS)
        if "density" in changed and not isinstance(self.density, Mapping):
            changed["density"] = {"all": self.density}
        return changed

    @property
    def of_engines(self) -> dict[str, Any]:
        """Options of engines that differ from their defaults, by the names of the fields."""
        return self._changed_options(OF_ENGINES)

    def _changed_options(self, names: Any) -> dict[str, Any]:
        defaults = {entry.name: default_of(entry) for entry in fields(ImportOptions)}
        return {name: value for name in names if (value := getattr(self, name)) != defaults[name]}

    def with_paths(self, resolve: Callable[[str], Path]) -> ImportOptions:
        """The same options with each path as ``resolve`` gives it."""
        given = {name: path for name in PATHS if (path := getattr(self, name)) is not None}
        placed: dict[str, Any] = {name: str(resolve(path)) for name, path in given.items()}
        return replace(self, **placed)


def default_of(entry: Field[Any]) -> Any:
    """The default of a field."""
    return entry.default if entry.default_factory is MISSING else entry.default_factory()


# Fields that are numbers.
OF_NUMBERS = ("density", "preload", "engine_timeout")
# Fields that are paths, which a job sees from its folder.
PATHS = tuple(name for name, hint in hints_of(ImportOptions).items() if hint in (FilePath | None, FolderPath | None))


def read_import_options(*, besides: Collection[str] = (), **given: Any) -> ImportOptions:
    """The options of keyword arguments; names ``besides`` are arguments that are taken elsewhere, for advice.

    Raises:
        InputError: unknown names or wrong values, one line for each.
    """
    plain = {name: str(value) if isinstance(value, Path) else value for name, value in given.items()}
    kept = {name: value for name, value in plain.items() if value is not None}
    return read_table(ImportOptions, kept, besides=besides)
