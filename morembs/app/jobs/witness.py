"""The witness of the certificates in a body file, from that file and its model file alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from morembs.base.errors import InputError
from morembs.base.units import parse_units
from morembs.body.file import read_body
from morembs.body.stored import StoredBodies
from morembs.certificate.witness import write_witness
from morembs.fem import FEModel
from morembs.fem.interface import Interface
from morembs.importers.model_file import read_model
from morembs.problem import Damping, Problem


def witness_of_file(body: Path, model: Path, witness: Path) -> Path:
    """Write the ``witness`` of all certificates in the file ``body``, whose model is in the file ``model``.

    Raises:
        InputError: files that do not fit together, bodies without certificates that hold on all of one band, or a file
            that does not say its damping.
        OutputError: the file cannot be written.
    """
    stored, full = read_body(body), read_model(model)
    certificates = [each.certificate for each in stored.bodies.values() if each.certificate is not None]
    bands = {(each.band_hz, each.damping_floor) for each in certificates if each.limits}
    if len(bands) != 1:
        raise InputError(
            f"{body} has certificates of {len(bands)} bands and dampings; expected one: run its job with a table "
            "[certify]"
        )
    [(band, floor)] = bands
    with Problem(full, interfaces_on(full, stored, body), damping=_damping(stored.recipe, body)) as problem:
        return write_witness(witness, problem, band, body=body, model=model, damping_floor=floor)


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
