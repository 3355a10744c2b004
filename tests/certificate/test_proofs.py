"""The lemmas that certificates rest on: in Python, in files, in print and in the documents."""

import json
import re
from dataclasses import asdict, replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import commands as cli
from morembs.body import elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.certificate.certify import certify
from morembs.fem.interface import make_interface
from morembs.problem import Damping, Problem
from morembs.reducers import FreeInterface
from morembs.responses.certified import certified_reference
from morembs.storage.lemma import kind_of
from tests.support.meshes import box, steel, where

RUNNER = CliRunner()
PROOFS = Path(__file__).parents[2] / "docs" / "background" / "proofs.md"
DAMPED = Damping(alpha=2.0, beta=4e-7)
BAND = [700.0, 3000.0]
CHAIN = [
    "dense-spectrum",
    "ritz-enclosures",
    "complement-bound",
    "reference-residual",
    "damping",
    "round-off",
    "cells-of-the-band",
]


def beam(damping=DAMPED, own=None, cells=(6, 1, 1)):
    model = steel(box("hex20", cells, (0.5, 0.05, 0.03)))
    if own is not None:
        model = replace(model, D=sp.csr_array(model.K * own))
    ends = [
        make_interface(model, name=name, nodes=where(model, 0, x), coupling="average")
        for name, x in (("left", 0.0), ("right", 0.5))
    ]
    return Problem(model, ends, damping=damping)


def named(certificate):
    return {lemma.name: lemma for lemma in certificate.proof}


def test_a_proven_certificate_is_a_chain_of_proven_lemmas():
    with beam() as problem:
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], BAND)
    known = named(certificate)
    assert list(known) == CHAIN and certificate.kind == "proven"
    assert {lemma.kind for lemma in certificate.proof} == {"proven"}
    assert known["dense-spectrum"].numbers["below_hz"] == pytest.approx(certificate.verified_below_hz)
    assert known["complement-bound"].numbers["least_hz"] > BAND[1]
    assert known["reference-residual"].numbers["error"] <= 1e-9
    cells = known["cells-of-the-band"].numbers
    assert [cells["low_hz"], cells["high_hz"]] == BAND and cells["envelope"] == certificate.limit.upper


@pytest.mark.parametrize(
    ("damping", "own", "which"),
    [
        (Damping(), -1e-6, {"reference-residual", "damping"}),
        (Damping(modal_table=((0.0, 0.01), (1.0, 0.02))), None, {"damping"}),
    ],
)
def test_an_estimate_names_the_lemma_that_is_one(damping, own, which):
    if damping.is_modal:
        with beam(damping) as problem:
            # The reference's own modes are known best.
            jump = float(np.sqrt(certified_reference(problem, BAND).values[2]) / (2 * np.pi))
        damping = Damping(modal_table=((0.0, 0.01), (jump, 0.02)))
    with beam(damping, own) as problem:
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], BAND)
    assert certificate.kind == kind_of(certificate.proof) == "estimate"
    assert {lemma.name for lemma in certificate.proof if lemma.kind == "estimate"} == which


def test_large_models_are_counted():
    with beam(cells=(20, 3, 2)) as problem:
        assert problem.K.shape[0] > 1500
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], BAND)
    assert list(named(certificate)) == ["sturm-count", *CHAIN[1:]]


def test_samples_prove_nothing():
    with beam() as problem:
        (certificate,) = certify(problem, [FreeInterface(modes=8).reduce(problem)], BAND, bound=False)
    assert certificate.kind == "sampled" and certificate.proof == ()


@pytest.mark.filterwarnings("error")
def test_an_infinite_limit_has_a_proof_too():
    with beam(Damping()) as problem:
        body = FreeInterface(modes=8).reduce(problem)
        (certificate,) = certify(problem, [body], BAND, damping_floor=0.0)
    assert "envelope unbounded" in named(certificate)["cells-of-the-band"].statement
    assert all(np.isfinite(list(lemma.numbers.values())).all() for lemma in certificate.proof)


def test_proofs_are_stored_printed_and_documented(tmp_path):
    path = tmp_path / "body.h5"
    with beam() as problem:
        body = FreeInterface(modes=8).reduce(problem)
        (certificate,) = certify(problem, [body], BAND)
        write_body(path, [elastic_body(problem, body, make_part(problem), certificate)])
    stored = read_body(path).bodies[body.name].certificate
    assert [lemma.name for lemma in stored.proof] == CHAIN and stored.proof == certificate.proof
    shown = RUNNER.invoke(cli.app, ["info", str(path), "--proof"])
    assert shown.exit_code == 0, shown.output
    for lemma in certificate.proof:
        assert f"{lemma.name} (proven): {lemma.statement}" in shown.stdout
    assert CHAIN[0] not in RUNNER.invoke(cli.app, ["info", str(path)]).stdout
    (document,) = json.loads(RUNNER.invoke(cli.app, ["info", str(path), "--json"]).stdout)
    assert document["bodies"][body.name]["certificate"]["proof"] == [asdict(lemma) for lemma in stored.proof]
    headings = set(re.findall(r"(?m)^### (\S+)$", PROOFS.read_text(encoding="utf-8")))
    assert {"sturm-count", *CHAIN} <= headings
    # A file of an earlier version has none.
    with h5py.File(path, "r+") as file:
        del file[f"bodies/{body.name}/certificate/proof"], file["checksums"]
    old = RUNNER.invoke(cli.app, ["info", str(path), "--proof"])
    assert old.exit_code == 0 and "certified without a proof" in old.stdout
    # JSON that is no proof, by whoever takes checksums out.
    with h5py.File(path, "r+") as file:
        file[f"bodies/{body.name}/certificate/proof"] = '{"lemmas": [{"name": "sturm-count"}]}'
    damaged = RUNNER.invoke(cli.app, ["info", str(path), "--proof"])
    assert damaged.exit_code == 2 and "the proof of a certificate cannot be read" in damaged.stderr
