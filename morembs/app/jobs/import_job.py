"""From the files of other programs to an examined model: what ``morembs import`` and ``import_model`` do."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base import progress
from morembs.base.arguments import check_value
from morembs.base.errors import SolverError
from morembs.base.progress import Progress, listening
from morembs.base.units import Units
from morembs.body.diagnostics import complete_half_stored
from morembs.body.diagnostics.findings import Diagnosis
from morembs.body.diagnostics.units import Outlook, model_outlook
from morembs.body.diagnostics.warnings import diagnosis_of, imported_warnings
from morembs.fem import FEModel
from morembs.fem.material import Material
from morembs.fem.parts import parts_of
from morembs.importers.advice import PYTHON, advising
from morembs.importers.decks.problems import Form
from morembs.importers.from_files import read_files
from morembs.importers.model_file import save_model
from morembs.importers.options import ImportOptions, read_import_options
from morembs.importers.to_model import model_of
from morembs.storage.contents import keeping_ledger
from morembs.storage.safefile import check_writable

# Findings that only a factorisation tells from a small body that is held.
SUSPECT = ("not-this-geometry", "node-mapping")


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
    out: str | Path,
    options: ImportOptions,
    *,
    materials: Sequence[Material] = (),
    split: bool = False,
    check: bool = False,
    strict: bool = False,
    dry: bool = False,
    progress: Progress | None = None,
) -> ImportResult:
    """Read, convert, examine where asked for, and write the model file ``out``.

    Args:
        materials: of a mesh, or of sets whose materials are not complete, in the units of the files.
        split: write a file for each part that nothing joins to others, NAME-1.model.h5 (the largest), NAME-2.model.h5
            and so on.
        strict: write nothing where the examination finds errors; K is factorised where it is not clear whether it is
            that of these coordinates.
        dry: write nothing.

    Raises:
        InputError: files that cannot be used or do not fit together, or errors found with ``strict``.
        OutputError: the model cannot be written; an old file is kept.
    """
    target = Path(out)
    with listening(progress):
        if not dry:
            check_writable(target)
        model, format, units = _read_model(options, materials)
        models = parts_of(model) if split else [model]
        name, dot, rest = target.name.partition(".")
        numbered = [target.with_name(f"{name}-{i}{dot}{rest}") for i in range(1, len(models) + 1)]
        paths = [target] if len(models) == 1 else numbered
        for path in [] if dry else paths:
            check_writable(path)
        diagnoses = _examine(models, units, strict=strict) if check or strict else [None] * len(models)
        results = [
            _finish_import(options, path, part, format, units, diagnosis, dry=dry)
            for path, part, diagnosis in zip(paths, models, diagnoses, strict=True)
        ]
        return replace(results[0], others=tuple(results[1:]))


def import_model(path: str | Path | None = None, *, materials: Sequence[Material] = (), **options: Any) -> FEModel:
    """The model of files of another program, in SI units: what ``morembs import`` writes.

    Args:
        path: the file of the model; None where ``stiffness`` and ``mass`` name files of matrices.
        materials: of a mesh, or of element sets whose materials are not complete, in the units of the files.
        options: those of ``morembs import`` by their names, such as units="mm-t-s", density=7.85e-9, contact="skip",
            skip=["S4"], engine="auto"; docs/reference/formats.md has the table.

    Raises:
        DeckError: all that keeps a deck from becoming a model: an ``InputError`` with ``problems``.
        InputError: files that cannot be used or do not fit together, or unknown options.

    >>> import meshio
    >>> meshio.Mesh(nodes.xyz, [("hexahedron", cells)]).write("bar.vtk")
    >>> import_model("bar.vtk", materials=[steel])
    FEModel: dofs 60; nodes 20; elements 4; matrices K, M; source bar.vtk
    """
    check_value("materials", materials, Sequence[Material])
    given = read_import_options(file=path, besides=["materials"], **options)
    return read_files_model(given, materials, PYTHON)


def read_files_model(options: ImportOptions, materials: Sequence[Material], form: Form) -> FEModel:
    """The model that the files of ``options`` hold, in SI units; ``materials`` are in those of the files, and its
    messages have the ``form`` in which options were given.

    Raises:
        InputError: files that cannot be used or do not fit together.
    """
    with advising(form):
        model, _, _ = _read_model(options, materials)
    notes, warnings = (tuple(map(form.phrase, sentences)) for sentences in (model.notes, model.warnings))
    return replace(model, notes=notes, warnings=warnings)


def _read_model(options: ImportOptions, materials: Sequence[Material]) -> tuple[FEModel, str, Units]:
    """The model, the format and the units of the files."""
    progress.stage("read")
    imported, format = read_files(options, materials)
    if imported.K is not None and imported.M is not None:
        K, M, D, done = complete_half_stored(imported.K, imported.M, imported.D)
        imported = replace(imported, K=K, M=M, D=D, notes=(*imported.notes, *(finding.sentence for finding in done)))
    units = Units() if format == "native" else options.parsed_units
    progress.stage("convert")
    return model_of(imported, units, mass_integration=options.mass_integration), format, units


def _examine(models: Sequence[FEModel], units: Units, *, strict: bool) -> list[Diagnosis | None]:
    """What examinations find; with ``strict`` errors are refused."""
    progress.stage("examine")
    diagnoses = [diagnosis_of(part, declared=units) for part in models]
    for part, diagnosis in zip(models, diagnoses, strict=True) if strict else []:
        diagnosis.refuse_errors()
        _refuse_other_geometry(part, diagnosis)
    return list(diagnoses)


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


def _finish_import(
    options: ImportOptions,
    path: Path,
    model: FEModel,
    format: str,
    units: Units,
    diagnosis: Diagnosis | None,
    *,
    dry: bool,
) -> ImportResult:
    """The model in its file, with what its examination found."""
    findings = () if diagnosis is None else tuple(map(str, diagnosis.findings))
    if not dry:
        save_model(path, model, files=options.files, importer=format, units=units.name, findings=findings)
    real = not any(np.iscomplexobj(A.data) for A in (model.K, model.M))
    prospect = None
    if real and np.ptp(model.nodes.xyz, axis=0).any():
        prospect = model_outlook(model.K, model.M, model.nodes, model.dofs, model.materials)
    warnings = imported_warnings(model, units) if diagnosis is None else model.warnings
    return ImportResult(path=path, model=model, format=format, diagnosis=diagnosis, outlook=prospect, warnings=warnings)
