"""The witness of the certificates in a body file, from that file and its model file alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.units import parse_units
from morembs.body.file import read_body
from morembs.body.stored import StoredBodies
from morembs.certificate.limits import error_limits
from morembs.certificate.witness import LimitsAtValues, write_witness
from morembs.fem import FEModel
from morembs.fem.interface import Interface
from morembs.importers.model_file import read_model
from morembs.importers.native import import_terms
from morembs.parametric.stored_terms import box_of, displacement_at, model_at
from morembs.problem import Damping, Problem
from morembs.reducers.base import ReducedModel
from morembs.responses.certified import certified_reference


def witness_of_file(body: Path, model: Path, witness: Path) -> Path:
    """Write the ``witness`` of all certificates in the file ``body``, whose model is in the file ``model``.

    Raises:
        InputError: files that do not fit together, bodies without certificates that hold on all of one band, or a file
            that does not say its damping.
        OutputError: the file cannot be written.
    """
    stored, full = read_body(body), read_model(model)
    band, floor, _ = _band_of(stored.bodies, body)
    with Problem(full, interfaces_on(full, stored, body), damping=_damping(stored.recipe, body)) as problem:
        return write_witness(witness, problem, band, body=body, model=model, damping_floor=floor)


@dataclass(frozen=True, kw_only=True, eq=False)
class AtValues:
    """The full ``problem`` at ``values`` of all parameters, the reduced ``bodies`` of a file there, and what their
    certificates at nominal values are of: ``band_hz``, ``damping_floor`` and ``measure``.

    >>> with problem_at_values(Path("part.h5"), Path("part.model.h5"), {"t": 1.5}).problem as problem:
    ...     problem.size
    """

    problem: Problem
    bodies: tuple[ReducedModel, ...]
    values: Mapping[str, float]
    band_hz: tuple[float, float]
    damping_floor: float
    measure: str


def problem_at_values(body: Path, model: Path, values: Mapping[str, float]) -> AtValues:
    """The problem and the bodies of files at ``values`` of their parameters; omitted ones are nominal.

    Raises:
        InputError: no body with parameters, one without a certificate, a model file without terms or of another body,
            or a value outside its range.
    """
    stored, full = read_body(body), read_model(model)
    varied = {name: each for name, each in stored.bodies.items() if each.has_parameters}
    if not varied:
        raise InputError(
            f"{body} has no body with parameters, but --at was given; leave it out", kind="missing", keyword="at"
        )
    band, floor, measure = _band_of(varied, body)
    evaluated = {name: each.parametric.at(**values) for name, each in varied.items()}
    at, terms = next(iter(evaluated.values())), import_terms(model)
    if box_of(terms).names != at.model.box.names:
        raise InputError(
            f"{body} has the parameters {', '.join(at.model.box.names)}, {model} has {', '.join(terms.names)}; give "
            "the model file of the body",
            kind="conflict",
            keyword="model",
        )
    interfaces, away = interfaces_on(full, stored, body), displacement_at(terms, at.p)
    if away is not None:
        interfaces = [replace(each, point=each.point + away[each.nodes[0]]) for each in interfaces]
    return AtValues(
        problem=Problem(model_at(full, terms, at.p), interfaces, damping=at.damping),
        bodies=tuple(_make_reduced(name, each) for name, each in evaluated.items()),
        values=at.values,
        band_hz=band,
        damping_floor=floor,
        measure=measure,
    )


def witness_at_values(body: Path, model: Path, witness: Path, values: Mapping[str, float]) -> Path:
    """Write the ``witness`` of the bodies with parameters in the file ``body`` at ``values``; omitted ones are nominal.

    The limits there are computed, over the band and with the damping floor of the certificate of nominal values.

    Raises:
        InputError: as ``problem_at_values`` and ``write_witness``.
        OutputError: the file cannot be written.
    """
    at = problem_at_values(body, model, values)
    floor, band = at.damping_floor, at.band_hz
    with at.problem as problem:
        reference = certified_reference(problem, band, damping_floor=floor)
        limits = {each.name: error_limits(reference, each) for each in at.bodies}
        stated = LimitsAtValues(values=at.values, limits=limits, measure=at.measure)
        return write_witness(witness, problem, band, body=body, model=model, damping_floor=floor, stated=stated)


def _make_reduced(name: str, at: Any) -> ReducedModel:
    """The body of a value, without its basis."""
    return ReducedModel(
        name=name,
        M=at.M,
        K=at.K,
        D=at.D,
        B=at.B,
        C=at.B.T,
        V=np.zeros((0, len(at.K))),
        mode_kind=("foreign",) * len(at.K),
        rigid_count=at.rigid.shape[1],
        structural=at.damping.structural,
    )


def _band_of(bodies: Mapping[str, Any], body: Path) -> tuple[tuple[float, float], float, str]:
    """The band and the damping floor of the certificates of ``bodies`` of a file, and the measure of the first.

    Raises:
        InputError: there are none, or several.
    """
    certificates = [each.certificate for each in bodies.values() if each.certificate is not None]
    bands = {(each.band_hz, each.damping_floor) for each in certificates if each.limits}
    if len(bands) != 1:
        raise InputError(
            f"{body} has certificates of {len(bands)} bands and dampings; expected one: run its job with a table "
            "[certify]"
        )
    [(band, floor)] = bands
    return band, floor, certificates[0].measure


def interfaces_on(model: FEModel, stored: StoredBodies, body: Path) -> list[Interface]:
    """The interfaces of a body file on the nodes of its ``model``.

    Raises:
        InputError: the model lacks nodes of one.
    """
    rows = {label: row for row, label in enumerate(model.nodes.ids.tolist())}
    placed = []
    for name, interface in stored.interfaces.items():
        labels = [] if interface.node_ids is None else interface.node_ids.tolist()
        if not all(label in rows for label in labels):
            raise InputError(
                f"interface {name!r} of {body} has nodes that the model lacks; give the model that the body was "
                "made from"
            )
        placed.append(replace(interface, nodes=np.array([rows[label] for label in labels])))
    return placed


def _damping(recipe: Mapping[str, Any], body: Path) -> Damping:
    """The damping that the job of a body file gave its model."""
    if "damping" not in recipe:
        raise InputError(
            f"{body} has no record of the damping of its model; run its job with witness = true under [certify], or "
            "call morembs.certificate.witness.write_witness"
        )
    given, structural = recipe["damping"], recipe["damping"].get("structural") or 0.0
    time = parse_units(recipe.get("model", {}).get("units", "m-kg-s")).time
    modal, rayleigh = given.get("modal"), given.get("rayleigh")
    if rayleigh is not None:
        return Damping(alpha=rayleigh["alpha"] / time, beta=rayleigh["beta"] * time, structural=structural)
    if isinstance(modal, str | list):
        return Damping(modal_table=modal, structural=structural)
    return Damping(modal=modal or 0.0, structural=structural)
