"""From files to one model: one file with a whole model, or matrices in files of their own with a mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.fem import DofMap, Nodes
from morembs.fem.fe_model import Component
from morembs.fem.material import Material
from morembs.importers import IMPORTERS, format_of, import_file
from morembs.importers.decks.problems import DeckError
from morembs.importers.imported import Imported
from morembs.importers.matrices.dof_map import read_dof_map
from morembs.importers.matrices.files import abaqus_matrices
from morembs.importers.matrices.named import square_csr
from morembs.importers.options import OF_ENGINES, ROLES, ImportOptions
from morembs.importers.to_model import refuse_mass_integration, rows_of_labels

# Options that name inputs and outputs.
INPUTS = ("B", "C", "B_names", "C_names")


def read_files(options: ImportOptions, materials: Sequence[Material] = ()) -> tuple[Imported, str]:
    """What the files of ``options`` hold together, with ``materials`` in their units, and the name of the format.

    Raises:
        DeckError: all that keeps a deck from becoming a model.
        InputError: files that cannot be used or do not fit together, or options that they do not take.
    """
    if (options.file is None) == (not options.matrices):
        raise InputError("give one file with the whole model, or --stiffness FILE and --mass FILE", kind="unsupported")
    if options.engine is not None:
        return _assemble(options, options.engine, materials)
    if options.of_engines:
        flag = next(iter(options.of_engines)).replace("_", "-")
        raise InputError(
            f"--{flag} was given without --engine; leave it out, or name the program that assembles",
            kind="conflict",
            keyword=flag,
        )
    _refuse_options_of_others(options)
    if options.file is not None:
        format = format_of(Path(options.file), options.format)
        imported = _of_file(options, format, materials)
    else:
        imported, format = _combine(options)
    if format == "native" and (options.parsed_units.name != "m-kg-s" or options.nodes or options.dofs):
        raise InputError(
            f"{imported.source} is a model file in SI units with its nodes; leave --units, --nodes, --dofs",
            kind="unsupported",
        )
    if materials and options.file is None:
        raise InputError(
            f"{imported.source} brings its own materials or matrices; leave --material out", kind="unsupported"
        )
    if imported.K is None and options.dofs is not None:
        raise InputError("--dofs was given for a mesh; it belongs to matrices", keyword="dofs")
    return _with_geometry(imported, options), format


def _refuse_options_of_others(options: ImportOptions) -> None:
    """Refuse options of decks where no file takes them.

    Raises:
        InputError: in these cases.
    """
    formats = [format_of(Path(options.file), options.format)] if options.file is not None else []
    formats += [format_of(Path(options.nodes))] if options.nodes is not None else []
    for name, given in options.of_decks.items():
        if name != "allow_includes_outside" and not any(name in IMPORTERS[format].options for format in formats):
            what = "a deck .inp of Abaqus or CalculiX" if name == "dialect" else "a deck that can take it"
            value = f" {given}" if isinstance(given, str) else ""
            raise InputError(f"--{name}{value} was given without {what}; leave it out", kind="conflict")


def _assemble(options: ImportOptions, engine: str, materials: Sequence[Material]) -> tuple[Imported, str]:
    """A deck that another program assembles, or that own assembly or one of these does."""
    # Not at the top: other imports do without programs.
    from morembs.importers.engines import AUTO, engine_of

    name = engine.partition(":")[0]
    if options.file is None or options.nodes or options.dofs:
        raise InputError(
            f"--engine {name} takes one deck; leave --nodes, --dofs out", kind="unsupported", keyword="engine"
        )
    if engine != AUTO:
        refuse_mass_integration(options.mass_integration, f"a deck whose masses are those of --engine {name}")
        known = {*engine_of(engine)[0].options, "allow_includes_outside"}
        wrong = next((word for word in options.of_decks if word not in known), None)
        if wrong:
            raise InputError(
                f"--{wrong} was given with --engine {name}, which has no such option; leave it out", kind="conflict"
            )
    format = format_of(Path(options.file), options.format)
    of_engine = {OF_ENGINES[key]: value for key, value in options.of_engines.items()}
    given = {**options.of_decks, **of_engine, **options.set}
    return import_file(options.file, format, given, engine=engine, materials=materials), f"{format} ({name})"


def _of_file(options: ImportOptions, format: str, materials: Sequence[Material]) -> Imported:
    """What the one file holds, with the materials that are given."""
    try:
        return import_file(options.file or "", format, {**_take(options, format), **options.set}, materials=materials)
    except DeckError as error:
        raise _with_engines(error, options, format, materials) from None


def _with_engines(error: DeckError, options: ImportOptions, format: str, materials: Sequence[Material]) -> DeckError:
    """The error, with a word about the programs that would read the deck."""
    # Not at the top: other imports do without programs.
    from morembs.importers.engines import ENGINES, engines_for

    names = engines_for(Path(options.file or ""), format, {**options.of_decks, "materials": materials})
    if not names:
        return error
    hints = [f"{ENGINES[name].program} would read this deck: --engine {name}" for name in names]
    return DeckError(error.source, error.problems, error.given, hint="; ".join(filter(None, [error.hint, *hints])))


def _take(options: ImportOptions, format: str) -> dict[str, Any]:
    """The options of decks that a format takes."""
    return {name: value for name, value in options.of_decks.items() if name in IMPORTERS[format].options}


def _combine(options: ImportOptions) -> tuple[Imported, str]:
    """Matrices of several files on the same rows."""
    formats = {role: format_of(path, options.format) for role, path in options.matrices.items()}
    if set(formats.values()) == {"abaqus-matrix"}:
        if options.set:
            raise InputError(
                f"matrices of Abaqus have no option {next(iter(options.set))!r}; leave --set out", kind="unsupported"
            )
        return abaqus_matrices(options.matrices), "abaqus-matrix"
    by_role: dict[str, Imported] = {}
    for role, path in options.matrices.items():
        # Inputs and outputs belong to the model: one of its files names them.
        excluded = set(ROLES) if not by_role else {*ROLES, *INPUTS}
        own = {key: value for key, value in options.set.items() if key == role or key not in excluded}
        if role in own:  # the name of the one matrix that is wanted of this file
            own = {**{key: value for key, value in own.items() if key != role}, "K": own[role]}
        by_role[role] = import_file(path, formats[role], own)
    first = next(iter(by_role.values()))
    matrices = {role: _one_matrix(role, imported) for role, imported in by_role.items()}
    for imported in by_role.values():
        if (imported.dofs is None) != (first.dofs is None) or (
            imported.dofs is not None and first.dofs is not None and not _same_rows(imported, first)
        ):
            both = f"{imported.source} and {first.source}"
            raise InputError(f"{both} have rows of different dofs; write them of one model", kind="unsupported")
    notes = tuple(note for imported in by_role.values() for note in imported.notes)
    whole: dict[str, Any] = {role: matrices.get(role) for role in ROLES}
    return replace(first, **whole, notes=notes), formats[next(iter(by_role))]


def _one_matrix(role: str, imported: Imported) -> Any:
    given = {name: A for name in ROLES if (A := getattr(imported, name)) is not None}
    if len(given) == 1:
        return next(iter(given.values()))
    if role in given:
        return given[role]
    raise InputError(
        f"{imported.source} was given as --{ROLES[role]}, but holds no such matrix; name it: --set {role}=NAME"
    )


def _same_rows(a: Imported, b: Imported) -> bool:
    if a.dofs is None or b.dofs is None or a.nodes is None or b.nodes is None or len(a.dofs) != len(b.dofs):
        return False
    same = np.array_equal(a.nodes.ids[a.dofs.node], b.nodes.ids[b.dofs.node])
    return same and np.array_equal(a.dofs.component, b.dofs.component)


def _with_geometry(imported: Imported, options: ImportOptions) -> Imported:
    """Nodes of a mesh, and dofs of a table, joined by labels."""
    if imported.K is not None:
        imported = replace(
            imported,
            **{
                name: square_csr(imported.source, name, A)
                for name in ROLES
                if (A := getattr(imported, name)) is not None
            },
        )
    if options.nodes is not None:
        mesh = Path(options.nodes)
        imported = _on_mesh(imported, mesh, _take(options, format_of(mesh)))
    if options.dofs is None:
        return imported
    table = Path(options.dofs)
    labels, component = read_dof_map(table)
    nodes = imported.nodes if imported.nodes is not None else (imported.mesh.nodes if imported.mesh else None)
    if nodes is None:
        raise InputError(
            f"--dofs {table.name} names nodes; give where they are too (--nodes MESH)",
            kind="unsupported",
            keyword="dofs",
        )
    dofs = DofMap(node=rows_of_labels(nodes, labels, table.name), component=component)
    return replace(imported, nodes=nodes, dofs=dofs)


def _on_mesh(imported: Imported, path: Path, options: Mapping[str, Any]) -> Imported:
    """The matrices on the nodes of a mesh file."""
    held = import_file(path, options=options)
    nodes = held.nodes if held.nodes is not None else (held.mesh.nodes if held.mesh is not None else None)
    if nodes is None:
        raise InputError(f"--nodes {path.name} has no nodes; expected a mesh", kind="missing", keyword="nodes")
    if all(getattr(imported, role) is None for role in ROLES):
        raise InputError("--nodes was given, but there are no matrices; it gives nodes to matrices", keyword="nodes")
    dofs = imported.dofs
    if dofs is not None and imported.nodes is not None:
        # Scalars are at nodes of no mesh, such as the scalar points of Nastran.
        bare = np.setdiff1d(imported.nodes.ids[dofs.node[dofs.component == Component.SCALAR]], nodes.ids)
        ids, xyz = np.append(nodes.ids, bare), np.vstack([nodes.xyz, np.full((len(bare), 3), np.nan)])
        nodes = Nodes(ids=ids, xyz=xyz, sets=nodes.sets)
        row = rows_of_labels(nodes, imported.nodes.ids, imported.source)
        dofs = DofMap(node=row[dofs.node], component=dofs.component)
    whole = Nodes(ids=nodes.ids, xyz=nodes.xyz, sets=nodes.sets)
    return replace(
        imported,
        nodes=whole,
        dofs=dofs,
        mesh=held.mesh,
        rigid=(),
        average=(),
        masses=(),
        surfaces=held.surfaces,
        notes=(*imported.notes, f"nodes are those of {path.name}"),
    )
