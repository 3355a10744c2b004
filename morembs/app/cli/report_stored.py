"""What a body file holds, for people and for scripts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from morembs.app.cli.messages import console, printing, without_nan
from morembs.app.kinds import RESULT_FORMAT
from morembs.app.report.style import STYLE
from morembs.base.errors import InputError
from morembs.body.delivery_check import refuse_unsound, stored_findings
from morembs.body.diagnostics.findings import Diagnosis
from morembs.body.file import read_unexamined
from morembs.body.stored import StoredBodies
from morembs.storage.hdf5 import MEMBERS, holds_format

if TYPE_CHECKING:
    from rich.console import Console

    from morembs.body import Body
    from morembs.storage.lemma import Lemma
PROOFS = "docs/background/proofs.md"


def show(file: str | Path, documents: list[dict[str, Any]] | None, proof: bool = False) -> None:
    """Print the contents of a body file, with the ``proof`` of its limits, or add them to the ``documents``, and say
    its faults.

    Raises:
        InputError: the file cannot be used, or contradicts itself.
        OutputError: standard output cannot be written.
    """
    try:
        stored = read_unexamined(file, whole=True)
    except InputError:
        if _show_members(Path(file), documents):
            return
        if holds_format(Path(file), RESULT_FORMAT):
            # Not at the top: most files hold bodies.
            from morembs.app.cli.simulate import show_recording

            show_recording(Path(file), documents)
            return
        _refuse_model(Path(file))
        raise
    diagnoses = stored_findings(stored)
    if documents is not None:
        documents.append(stored_json(str(file), stored, diagnoses))
        for name, body in stored.bodies.items() if proof else ():
            documents[-1]["bodies"][name]["bound_proof"] = [asdict(lemma) for lemma in bound_lemmas_of(body)]
    else:
        with printing():
            print_stored(console(), str(file), stored, diagnoses)
            if proof:
                print_proofs(console(), stored)
    refuse_unsound(str(file), diagnoses)


def _show_members(path: Path, documents: list[dict[str, Any]] | None) -> bool:
    """True if ``path`` is a file of planar members; its contents are then shown, or added to the ``documents``.

    Raises:
        InputError: the file is damaged, or of a newer version.
    """
    if not holds_format(path, MEMBERS):
        return False
    from morembs.dynamics.gmp.stored import MemberFormat, read_members

    members = read_members(path)
    if documents is not None:
        outlines = {name: data.outline() for name, data in members.items()}
        documents.append({"output": str(path), "format_version": MemberFormat.VERSION, "members": outlines})
        return True
    from morembs.app.report.text import say

    with printing():
        say(console(), f"{path}: planar members, global modal parameterisation")
        for name, data in members.items():
            outline = data.outline()
            say(
                console(),
                f"  {name}: {outline['formulation']}, {outline['modes']} bending modes and two frames, length "
                f"{outline['length']:.4g} m, end angles to {outline['reach']:.4g} rad in tables of {outline['points']} "
                f"points, largest error of their derivatives {outline['error']:.1e}",
            )
    return True


def _refuse_model(path: Path) -> None:
    """Refuse a model file: say its contents and the commands that take it.

    Raises:
        InputError: ``path`` is a model file, sound or damaged.
    """
    from morembs.importers.model_file import is_model_file, read_model

    if not is_model_file(path):
        return
    model = read_model(path)
    couplings = f", couplings {', '.join(model.couplings)}" if model.couplings else ""
    raise InputError(
        f"{path} is a model file ({model.size:,} dofs at {len(model.nodes):,} nodes{couplings}), and info shows body "
        f"files; morembs init {path} writes a job that reduces it, and morembs check says what the job needs"
    )


def stored_json(path: str, stored: StoredBodies, diagnoses: Mapping[str, Diagnosis]) -> dict[str, Any]:
    """A body file as plain values, SI units; ``diagnoses`` say what is wrong with each body."""
    first = next(iter(stored.bodies.values()))
    origin = stored.provenance
    return {
        "output": path,
        "format_version": stored.format_version,
        "source": stored.recipe.get("source"),
        "solver": origin.get("solver"),
        "factor": origin.get("factor"),
        "dofs": stored.recipe.get("dofs"),
        "stored_nodes": len(stored.node_ids),
        "mass": stored.mass,
        "center_of_mass": stored.center_of_mass.tolist(),
        "inertia": stored.inertia.tolist(),
        "frequencies_hz": first.frequencies_hz.tolist(),
        "full_frequencies_hz": None if first.full_frequencies_hz is None else first.full_frequencies_hz.tolist(),
        "interfaces": {
            name: {
                "coupling": interface.coupling,
                "components": list(interface.components),
                "point": interface.point.tolist(),
                "nodes": len(interface.node_ids),
            }
            for name, interface in stored.interfaces.items()
        },
        "bodies": {
            name: {
                "order": len(body.stiffness_matrix),
                "rigid_count": body.rigid_count,
                "frequencies_hz": body.frequencies_hz.tolist(),
                "mode_kind": list(body.mode_kind),
                "recipe": body.recipe,
                "frame": None if body.floating is None else body.floating.kind,
                "ranking": [[term.name, term.equation, term.share] for term in body.ranking],
                "stress_recovery": body.has_recovery,
                "switching": body.has_switching,
                "parameters": body.has_parameters,
                "certificate": None if body.certificate is None else without_nan(body.certificate.datasets),
                "findings": findings_json(diagnoses[name]),
            }
            for name, body in stored.bodies.items()
        },
        "warnings": list(stored.warnings),
        "seconds": dict(origin.get("seconds") or {}),
        "peak_memory_bytes": dict(origin.get("peak_memory_bytes") or {}),
    }


def findings_json(diagnosis: Diagnosis | None) -> list[dict[str, str]]:
    """Findings as plain values."""
    keys = ("severity", "code", "sentence", "cure")
    return [] if diagnosis is None else [{key: getattr(each, key) for key in keys} for each in diagnosis.findings]


def print_proofs(console: Console, stored: StoredBodies) -> None:
    """The lemmas that the limits of each body rest on, and where their proofs are."""

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True, markup=False)

    for name, body in stored.bodies.items():
        known = body.certificate
        proofs = {
            f"limits of {name}": () if known is None else known.proof,
            f"bounds of {name} at all values": bound_lemmas_of(body),
        }
        if known is None and not body.has_parameters:
            say(f"proof: {name} has no certificate")
        elif known is not None and not proofs[f"limits of {name}"]:
            say(
                f"proof: {name} is certified without a proof: by samples alone, or by an earlier version; "
                "certify it again"
            )
        for what, lemmas in proofs.items():
            if lemmas:
                say(f"proof: {what}, each lemma by its section in {PROOFS}")
            for lemma in lemmas:
                numbers = ", ".join(f"{key} = {value:.6g}" for key, value in lemma.numbers.items())
                say(f"  {lemma.name} ({lemma.kind}): {lemma.statement}\n    {numbers}".rstrip())


def bound_lemmas_of(body: Body) -> Sequence[Lemma]:
    """The lemmas that bounds of a body with parameters rest on at all values."""
    return body.parameters().model.proof if body.has_parameters else ()


def print_stored(console: Console, path: str, stored: StoredBodies, diagnoses: Mapping[str, Diagnosis]) -> None:
    """What a body file holds, and warnings of what ``diagnoses`` say is wrong with each body."""
    from rich.markup import escape

    from morembs.app.report.certificates import Certified, certificate_sections
    from morembs.app.report.text import print_sections
    from morembs.app.report.words import coordinate_words, frame_words, mass_section, ranking_words

    values = stored_json(path, stored, diagnoses)
    console.print(
        f"[bold]{path}[/]: {values['source'] or 'model'}, "
        + (f"{values['dofs']:,} degrees of freedom, " if values["dofs"] else "")
        + f"{values['stored_nodes']:,} nodes stored",
        highlight=False,
        soft_wrap=True,
    )
    for name, interface in values["interfaces"].items():
        console.print(f"  interface {name}: {interface['coupling']}, {interface['nodes']:,} nodes", highlight=False)
    for name, body in stored.bodies.items():
        console.print(f"  {name}: {coordinate_words(body.mode_kind)}", highlight=False)
        elastic = body.frequencies_hz[body.rigid_count :][: STYLE.reported_frequencies]
        listed = ", ".join(f"{f:,.1f}" for f in elastic) or "none"
        console.print(f"    elastic Hz: {listed}", highlight=False, soft_wrap=True)
        if body.floating is not None:
            console.print(f"    {frame_words(body.floating)}", highlight=False, soft_wrap=True)
        if body.ranking:
            console.print(
                f"    inertia terms: {ranking_words(values['bodies'][name]['ranking'])}",
                highlight=False,
                soft_wrap=True,
            )
        if body.has_recovery:
            console.print("    stress recovery", highlight=False)
        if body.has_switching:
            console.print("    static modes of candidate loads", highlight=False)
        if body.has_parameters:
            console.print("    parameters, shown at nominal values; `morembs evaluate` takes others", highlight=False)
        for finding in diagnoses[name].warnings:
            console.print(f"    {escape(str(finding))}", highlight=False, soft_wrap=True)
    known = [
        Certified(name=name, order=len(body.stiffness_matrix), values=body.certificate.datasets)
        for name, body in stored.bodies.items()
        if body.certificate is not None
    ]
    print_sections(console, [*certificate_sections(known, list(stored.interfaces)), mass_section(values)])
    for warning in stored.warnings:
        console.print(f"warning: {escape(warning)}", highlight=False, soft_wrap=True)
