"""The file of an assembly of unreduced parts: the models, their places, interfaces and joints, for the verifier."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from morembs.base import progress
from morembs.base.errors import InputError
from morembs.dynamics.assembly.bodies import AssembledModel
from morembs.dynamics.assembly.joints import Couple
from morembs.dynamics.assembly.parts import Substructure, rotation_matrix
from morembs.dynamics.assembly.unreduced import Unreduced
from morembs.fem.interface import Interface, Rigid
from morembs.importers.native import MODEL, ModelFile
from morembs.problem import Problem
from morembs.storage.table import table_of
from morembs.storage.writer import Writer, writing

FORMAT = "morembs-assembly"
INTERFACE = table_of(Interface)


def write_joined(path: Path, unreduced: Unreduced) -> Path:
    """Write the models, places and joints of the parts of ``unreduced``, so that a verifier can couple them again.

    Peak memory: that of the models.

    Args:
        path: of the file.
        unreduced: coupled unreduced parts.

    Raises:
        InputError: damping of a part that is no matrix of its model, or an interface that is none of a part.
        OutputError: the file cannot be written.

    >>> with Problem(bars, ends) as small, Unreduced(small) as full:
    ...     write_joined("bars.model.h5", full).name
    'bars.model.h5'
    """
    model, outer = unreduced.model, frames_of(unreduced.model, unreduced.interfaces)
    problems = {id(part.problem): part.problem for part in model.parts if part.problem is not None}
    progress.stage(f"writing {path.name}")
    with writing(path) as out:
        out.put("format", np.bytes_(FORMAT), "what kind of file this is")
        out.put("format_version", 1)
        out.put("part_names", [part.name for part in model.parts], "groups 0, 1, ... of parts")
        out.put("outer", outer, "part:INTERFACE of each interface of the body")
        for number, problem in enumerate(problems.values()):
            content = ModelFile(model=problem.model, files=(), sha256=(), importer="none", units="m-kg-s")
            out.rows(f"models/{number}/", MODEL, content)
        for number, part in enumerate(model.parts):
            _put_part(out, f"parts/{number}/", part, list(problems).index(id(part.problem)))
        out.file.require_group("couples")
        for number, couple in enumerate(model.couples):
            _put_couple(out, f"couples/{number}/", couple)
    return path


def frames_of(model: AssembledModel, interfaces: Sequence[Interface]) -> list[str]:
    """The interface "part:INTERFACE" that each of the ``interfaces`` of an assembly is, for a witness of it.

    Raises:
        InputError: one that is not one frame of a part, parts without their problem, or damping of a part that is no
            matrix of its model.

    >>> frames_of(bars, ends)
    ['a:LEFT']
    """
    for part in model.parts:
        if part.problem is None:
            raise InputError(
                "[certify] witness = true was given for an assembly of reduced parts; name the job of each "
                "[[substructure]], for a certificate against the unreduced parts, or leave witness out",
                kind="missing",
                keyword="job",
            )
        _refuse_full_damping(part, part.problem)
    names = []
    for interface in interfaces:
        same = [key for key, rows in model.nodes.sets.items() if np.array_equal(rows, interface.nodes)]
        if len(interface.nodes) != 1 or not same or interface.coupling != Rigid.name:
            raise InputError(
                f"interface {interface.name!r} is not one frame of a part, and a witness of an assembly was asked for; "
                'give it the nodes of one rigid or average interface of a part, such as "set:upper:ROOT", or leave '
                "witness out",
                kind="unsupported",
                keyword="witness",
            )
        names.append(same[0])
    return names


def _refuse_full_damping(part: Substructure, problem: Problem) -> None:
    """Refuse damping that resists the elastic motion of a part by a full matrix."""
    damping = problem.damping
    if damping.is_modal or damping.alpha:
        raise InputError(
            f"part {part.name!r} has {'modal damping' if damping.is_modal else 'alpha of rayleigh damping'}, and a "
            "witness of an assembly was asked for, which takes beta and damping matrices of parts; give [damping] to "
            "the assembly instead, or leave witness out",
            kind="unsupported",
            keyword="witness",
        )


def _put_part(out: Writer, at: str, part: Substructure, model: int) -> None:
    bodies = part.bodies
    out.put(f"{at}model", model, "group of models")
    out.put(f"{at}position", np.asarray(part.position, dtype=float), "of its origin", "m")
    out.put(f"{at}rotation", rotation_matrix(part), "its axes as columns")
    out.put(f"{at}beta", 0.0 if part.problem is None else part.problem.damping.beta, "damping over stiffness", "s")
    out.put(f"{at}interface_names", list(bodies.interfaces), "groups of interfaces")
    for name, interface in bodies.interfaces.items():
        out.rows(f"{at}interfaces/{name}/", INTERFACE, interface)
    for name in ("interface", "component", "node_id"):
        key = "interface_index" if name == "interface" else name
        out.put(f"{at}inputs/{key}", getattr(bodies, f"input_{name}"))


def _put_couple(out: Writer, at: str, couple: Couple) -> None:
    out.put(f"{at}between", list(couple.between), "part:INTERFACE of both sides")
    out.put(f"{at}components", list(couple.components), "0..2 displacements, 3..5 rotations, axes of the assembly")
    for name, units in (("stiffness", "N/m, Nm/rad"), ("damping", "Ns/m, Nms/rad")):
        values = getattr(couple, name)
        if values is not None:
            out.put(f"{at}{name}", np.asarray(values, dtype=float), "springs instead of one motion", units)
