"""From the files of another program to a checked model: what ``morembs import`` does."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError, SolverError
from morembs.base.progress import Progress, listening
from morembs.base.units import Units
from morembs.body.diagnostics import repaired
from morembs.body.diagnostics.findings import Diagnosis
from morembs.body.diagnostics.units import Outlook, model_outlook
from morembs.body.diagnostics.warnings import diagnosis_of, imported_warnings
from morembs.fem import DofMap, FEModel, Nodes
from morembs.fem.fe_model import Component
from morembs.fem.material import Material, isotropic
from morembs.fem.parts import parts_of
from morembs.importers import IMPORTERS, format_of, import_file
from morembs.importers.decks.problems import DeckError
from morembs.importers.imported import Imported
from morembs.importers.matrices.dof_map import read_dof_map
from morembs.importers.matrices.files import abaqus_matrices
from morembs.importers.matrices.named import square_csr
from morembs.importers.model_file import write_model
from morembs.importers.to_model import model_of, rows_of_labels
from morembs.storage.contents import keeping_ledger
from morembs.storage.safefile import check_writable

ROLES = {"K": "--stiffness", "M": "--mass", "D": "--damping", "G": "--gyroscopic", "N": "--circulatory"}
# Options that name inputs and outputs.
INPUTS = ("B", "C", "B_names", "C_names")
# Findings that only a factorisation tells from a small body that is held.
SUSPECT = ("not-this-geometry", "node-mapping")


@dataclass(frozen=True, kw_only=True)
class ImportJob:
    """What to read and what to write.

    ``file`` one file with the model, or ``matrices`` role -> file of one matrix each; ``nodes`` a mesh that gives
    nodes (and elements) to matrices, ``dofs`` a table of node and dof for each row. ``options`` of the importer;
    ``dialect`` is the program that a deck .inp was written for; ``density`` of sets ("all": of all) whose materials
    have stiffness only, what becomes of ``contact`` (refuse, skip or tie), and what to ``skip`` of a deck; ``engine``
    is the program that assembles a deck, NAME or NAME:PATH (None: own assembly; "auto": whichever takes it), with
    ``engine_options`` of its own;
    ``allow_includes_outside`` lets decks include files from beyond their folders; ``split`` writes a file for each part
    that nothing joins to others, NAME-1.model.h5 (the largest), NAME-2.model.h5 and so on.
    """

    out: Path
    file: Path | None = None
    matrices: Mapping[str, Path] = field(default_factory=dict)
    format: str | None = None
    units: Units = field(default_factory=Units)
    nodes: Path | None = None
    dofs: Path | None = None
    materials: tuple[Material, ...] = ()
    mass_integration: str = "element"
    dialect: str = "auto"
    density: Mapping[str, float] = field(default_factory=dict)
    contact: str = "refuse"
    skip: tuple[str, ...] = ()
    engine: str | None = None
    engine_options: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    allow_includes_outside: bool = False
    split: bool = False

    @property
    def sources(self) -> tuple[Path, ...]:
        """All files that are read."""
        given = (self.file, *self.matrices.values(), self.nodes, self.dofs)
        return tuple(path for path in given if path is not None)


@dataclass(frozen=True, kw_only=True, eq=False)
class ImportResult:
    """A model that was read and written; ``outlook`` says what body it is by its units, None for matrices without a
    place in space; ``diagnosis`` where it was examined, else the ``warnings`` that are to be had without; ``others``
    are further parts of what was split."""

    path: Path
    model: FEModel
    format: str
    diagnosis: Diagnosis | None = None
    outlook: Outlook | None = None
    warnings: tuple[str, ...] = ()
    others: tuple[ImportResult, ...] = ()


@keeping_ledger()
def run_import(
    job: ImportJob, *, check: bool = False, strict: bool = False, dry: bool = False, progress: Progress | None = None
) -> ImportResult:
    """Read, convert, examine where asked for, and write.

    Args:
        strict: write nothing where the examination finds errors; K is factorised where it is not clear whether it is
            that of these coordinates.
        dry: write nothing.

    Raises:
        InputError: files that cannot be used or do not fit together, or errors found with ``strict``.
        OutputError: the model cannot be written; an old file is kept.
    """
    with listening(progress):
        return _import(job, check=check, strict=strict, dry=dry)


def _import(job: ImportJob, *, check: bool, strict: bool, dry: bool) -> ImportResult:
    if not dry:
        check_writable(job.out)
    progress.stage("read")
    imported, format = _read(job)
    if imported.K is not None and imported.M is not None:
        K, M, D, done = repaired(imported.K, imported.M, imported.D)
        imported = replace(imported, K=K, M=M, D=D, notes=(*imported.notes, *(finding.sentence for finding in done)))
    units = Units() if format == "native" else job.units
    progress.stage("convert")
    model = model_of(imported, units, mass_integration=job.mass_integration)
    models = parts_of(model) if job.split else [model]
    name, dot, rest = job.out.name.partition(".")
    numbered = [job.out.with_name(f"{name}-{i}{dot}{rest}") for i in range(1, len(models) + 1)]
    paths = [job.out] if len(models) == 1 else numbered
    for path in [] if dry else paths:
        check_writable(path)
    diagnoses: list[Diagnosis | None] = [None] * len(models)
    if check or strict:
        progress.stage("examine")
        examined = [diagnosis_of(part, declared=units) for part in models]
        for part, diagnosis in zip(models, examined, strict=True) if strict else []:
            diagnosis.refuse_errors()
            _refuse_other_geometry(part, diagnosis)
        diagnoses = list(examined)
    results = [
        _finished(job, path, part, format, units, diagnosis, dry=dry)
        for path, part, diagnosis in zip(paths, models, diagnoses, strict=True)
    ]
    return replace(results[0], others=tuple(results[1:]))


def _refuse_other_geometry(model: FEModel, diagnosis: Diagnosis) -> None:
    """Factorise where the graph raises the suspicion that K and coordinates do not belong together.

    Raises:
        InputError: they do not, by the spectrum of K.
    """
    if not any(finding.code in SUSPECT for finding in diagnosis.findings):
        return
    from morembs.problem import Problem

    with suppress(SolverError), Problem(model) as problem:
        _ = problem.statics


def _finished(
    job: ImportJob, path: Path, model: FEModel, format: str, units: Units, diagnosis: Diagnosis | None, *, dry: bool
) -> ImportResult:
    """The model in its file, with what its examination found."""
    findings = () if diagnosis is None else tuple(map(str, diagnosis.findings))
    if not dry:
        write_model(path, model, files=job.sources, importer=format, units=units.name, findings=findings)
    real = not any(np.iscomplexobj(A.data) for A in (model.K, model.M))
    seen = None
    if real and np.ptp(model.nodes.xyz, axis=0).any():
        seen = model_outlook(model.K, model.M, model.nodes, model.dofs, model.materials)
    warnings = imported_warnings(model, units) if diagnosis is None else model.warnings
    return ImportResult(path=path, model=model, format=format, diagnosis=diagnosis, outlook=seen, warnings=warnings)


def _read(job: ImportJob) -> tuple[Imported, str]:
    """What the files hold together, and the name of the format."""
    if (job.file is None) == (not job.matrices):
        raise InputError("give one file with the whole model, or --stiffness FILE and --mass FILE")
    if job.engine is not None:
        return _assembled(job, job.engine)
    if job.engine_options:
        flag = next(iter(job.engine_options)).replace("_", "-").replace("timeout", "engine-timeout")
        raise InputError(f"--{flag} was given without --engine; leave it out, or name the program that assembles")
    for name, given in _given(job).items():
        if not any(_takes(name, path, job) for path in (job.file, job.nodes)):
            what = "a deck .inp of Abaqus or CalculiX" if name == "dialect" else "a deck that can take it"
            value = f" {given}" if isinstance(given, str) else ""
            raise InputError(f"--{name}{value} was given without {what}; leave it out")
    if job.file is not None:
        format = format_of(job.file, job.format)
        imported = _of_file(job, format)
    else:
        imported, format = _combined(job)
    if format == "native" and (job.units.name != "m-kg-s" or job.nodes or job.dofs):
        raise InputError(
            f"{imported.source} is a model file in SI units with its nodes; leave --units, --nodes, --dofs"
        )
    if job.materials and job.file is None:
        raise InputError(f"{imported.source} brings its own materials or matrices; leave --material out")
    if imported.K is None and job.dofs is not None:
        raise InputError("--dofs was given for a mesh; it belongs to matrices")
    return _with_geometry(imported, job), format


def _assembled(job: ImportJob, engine: str) -> tuple[Imported, str]:
    """A deck that another program assembles, or that own assembly or one of these does."""
    # Not at the top: other imports do without programs.
    from morembs.importers.engines import AUTO, engine_of

    name = engine.partition(":")[0]
    if job.file is None or job.nodes or job.dofs:
        raise InputError(f"--engine {name} takes one deck; leave --nodes, --dofs out")
    format = format_of(job.file, job.format)
    options = {**_given(job), **job.engine_options, **_outside(job), **job.options}
    if engine != AUTO:
        known = engine_of(engine)[0].options
        wrong = next((word for word in _given(job) if word not in known), None)
        if wrong:
            raise InputError(f"--{wrong} was given with --engine {name}, which has no such option; leave it out")
    return import_file(job.file, format, options, engine=engine, materials=job.materials), f"{format} ({name})"


def _of_file(job: ImportJob, format: str) -> Imported:
    """What the one file holds, with the materials that are given."""
    try:
        options = {**_of_decks(job, format), **job.options}
        return import_file(job.file or Path(), format, options, materials=job.materials)
    except DeckError as error:
        raise _with_engines(error, job, format) from None


def _with_engines(error: DeckError, job: ImportJob, format: str) -> DeckError:
    """The error, with a word about the programs that would read the deck."""
    # Not at the top: other imports do without programs.
    from morembs.importers.engines import ENGINES, engines_for

    names = engines_for(job.file or Path(), format, {**_given(job), **_outside(job), "materials": job.materials})
    if not names:
        return error
    hint = "; ".join(f"{ENGINES[name].program} would read this deck: --engine {name}" for name in names)
    return DeckError(error.source, error.problems, error.given, hint=hint)


def _takes(name: str, path: Path | None, job: ImportJob) -> bool:
    given = job.format if path is job.file else None
    return path is not None and name in IMPORTERS[format_of(path, given)].options


def _combined(job: ImportJob) -> tuple[Imported, str]:
    """Matrices of several files on the same rows."""
    formats = {role: format_of(path, job.format) for role, path in job.matrices.items()}
    if set(formats.values()) == {"abaqus-matrix"}:
        if job.options:
            raise InputError(f"matrices of Abaqus have no option {next(iter(job.options))!r}; leave --set out")
        return abaqus_matrices(dict(job.matrices)), "abaqus-matrix"
    by_role: dict[str, Imported] = {}
    for role, path in job.matrices.items():
        # Inputs and outputs belong to the model: one of its files names them.
        apart = set(ROLES) if not by_role else {*ROLES, *INPUTS}
        own = {key: value for key, value in job.options.items() if key == role or key not in apart}
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
            raise InputError(f"{both} have rows of different dofs; write them of one model")
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
        f"{imported.source} was given as {ROLES[role]}, but holds no such matrix; name it: --set {role}=NAME"
    )


def _same_rows(a: Imported, b: Imported) -> bool:
    if a.dofs is None or b.dofs is None or a.nodes is None or b.nodes is None or len(a.dofs) != len(b.dofs):
        return False
    same = np.array_equal(a.nodes.ids[a.dofs.node], b.nodes.ids[b.dofs.node])
    return same and np.array_equal(a.dofs.component, b.dofs.component)


def _with_geometry(imported: Imported, job: ImportJob) -> Imported:
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
    if job.nodes is not None:
        imported = _on_mesh(imported, job.nodes, _of_decks(job, format_of(job.nodes)))
    if job.dofs is None:
        return imported
    labels, component = read_dof_map(job.dofs)
    nodes = imported.nodes if imported.nodes is not None else (imported.mesh.nodes if imported.mesh else None)
    if nodes is None:
        raise InputError(f"--dofs {job.dofs.name} names nodes; give where they are too (--nodes MESH)")
    dofs = DofMap(node=rows_of_labels(nodes, labels, job.dofs.name), component=component)
    return replace(imported, nodes=nodes, dofs=dofs)


def _of_decks(job: ImportJob, format: str) -> dict[str, Any]:
    """The options of decks, where the format has them."""
    given = {**_given(job), **_outside(job)}
    return {name: given[name] for name in IMPORTERS[format].options if name in given}


def _outside(job: ImportJob) -> dict[str, Any]:
    return {"allow_includes_outside": True} if job.allow_includes_outside else {}


def _given(job: ImportJob) -> dict[str, Any]:
    """The options of decks that are not as they are by default."""
    given = {
        "dialect": (job.dialect, "auto"),
        "contact": (job.contact, "refuse"),
        "density": (dict(job.density), {}),
        "skip": (list(job.skip), []),
    }
    return {name: value for name, (value, default) in given.items() if value != default}


def _on_mesh(imported: Imported, path: Path, options: Mapping[str, Any]) -> Imported:
    """The matrices on the nodes of a mesh file."""
    held = import_file(path, options=options)
    nodes = held.nodes if held.nodes is not None else (held.mesh.nodes if held.mesh is not None else None)
    if nodes is None:
        raise InputError(f"--nodes {path.name} has no nodes; expected a mesh")
    if all(getattr(imported, role) is None for role in ROLES):
        raise InputError("--nodes was given, but there are no matrices; it gives nodes to matrices")
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


def list_engines() -> dict[str, str]:
    """A line for each program that may assemble decks: what it is, and where it is found."""
    from morembs.importers.engines import ENGINES

    lines = {}
    for name, engine in ENGINES.items():
        try:
            program = engine.find("")
            place = f"{program.name}{f' {program.version}' if program.version else ''} at {program.path}"
        except InputError:
            place = "not found"
        lines[name] = f"{engine.about} ({place})"
    return lines


def list_formats() -> dict[str, str]:
    """A line for each format."""
    return {
        name: importer.about + (f" ({', '.join(importer.endings)})" if importer.endings else "")
        for name, importer in IMPORTERS.items()
    }


def material_of(text: str) -> Material:
    """Material in the units of the files from "young=210e3,poisson=0.3,density=7.85e-9[,set=NAME]".

    Raises:
        InputError: unknown, missing or repeated keys, or values that make no material.
    """
    given: dict[str, str] = {}
    for part in text.split(","):
        key, equals, value = part.partition("=")
        if not equals or key.strip() in given or key.strip() not in ("young", "poisson", "density", "set"):
            raise InputError(
                f"--material {text!r} was given; expected young=...,poisson=...,density=... and for one element set "
                ",set=NAME"
            )
        given[key.strip()] = value.strip()
    try:
        numbers = {key: float(given[key]) for key in ("young", "poisson", "density")}
    except (KeyError, ValueError) as error:
        raise InputError(f"--material {text!r} was given; expected numbers young, poisson and density") from error
    return isotropic(set=given.get("set", "all"), **numbers)
