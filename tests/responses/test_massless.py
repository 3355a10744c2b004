"""Interfaces that deform a body without moving mass: said by every method, by the spectrum of the static response."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from typer.testing import CliRunner

from morembs.app.cli import app
from morembs.base.errors import MorembsError
from morembs.body.file import read_body
from morembs.certificate.certify import certify
from morembs.fem import FEModel
from morembs.fem.interface import make_interface
from morembs.importers.model_file import write_model
from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, FreeInterface, Gramian, Krylov, Modal
from morembs.responses.massless import loaded_without_mass, without_mass_perhaps
from morembs.responses.tolerances import TOL
from tests.support.frames import beams, chain, clamped_beam, model_on
from tests.support.refusals import refusal

WHOLE = (0, 1, 2, 3, 4, 5)


def lumped(model: FEModel) -> FEModel:
    M = sp.diags_array(np.abs(model.M.sum(axis=1) * (model.dofs.component < 3)))
    return replace(model, M=sp.csr_array(M))


def bent(*corner: float) -> FEModel:
    """A free frame of three beams with lumped masses, plane or not."""
    xyz = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], corner])
    return lumped(model_on(*beams(xyz, chain(4)), xyz, range(6)))


def at_tip(model: FEModel, components: tuple[int, ...] = WHOLE) -> Problem:
    node = np.array([int(model.dofs.node.max())])
    tip = make_interface(model, name="tip", nodes=node, coupling="direct", components=components)
    return Problem(model, [tip], damping=Damping(beta=1e-5))


def without_inertia(problem: Problem) -> int:
    """How many loads deform dofs without mass alone, by dense algebra: those of G_e B that M does not see."""
    K, M, B, Z = problem.K.toarray(), problem.M.toarray(), problem.B.toarray(), problem.rigid
    F = B - M @ Z @ (Z.T @ B)
    X = np.linalg.lstsq(np.vstack([K, Z.T @ M]), np.vstack([F, np.zeros((Z.shape[1], F.shape[1]))]), rcond=1e-14)[0]
    heavy = np.diag(M) > 0
    whole = np.linalg.matrix_rank(X / np.linalg.norm(X, axis=0), tol=1e-8)
    moved = X[heavy] / np.linalg.norm(X, axis=0)
    return int(whole - np.linalg.matrix_rank(moved, tol=1e-8))


@pytest.mark.parametrize(
    ("model", "components", "motions"),
    [
        (lumped(clamped_beam(6)), WHOLE, ("tip rotation x",)),
        (lumped(clamped_beam(6)), (3,), ("tip rotation x",)),
        (lumped(clamped_beam(6, axis=(0.6, 0.8, 0.0))), WHOLE, ("tip rotation x with tip rotation y",)),
        (lumped(clamped_beam(6, (0, -1))), WHOLE, ("tip rotation x",)),
        (bent(2.0, 0.0, 0.0), WHOLE, ("tip rotation x", "tip rotation y")),
        (bent(2.0, 1.0, 1.0), WHOLE, ()),
        (lumped(clamped_beam(6)), (0, 1, 2, 5), ()),
        (lumped(clamped_beam(6, axis=(0.6, 0.8, 0.0))), (3,), ()),
        (clamped_beam(6), WHOLE, ()),
    ],
)
def test_every_method_names_motions_that_deform_the_body_without_mass(
    model: FEModel, components: tuple[int, ...], motions: tuple[str, ...]
) -> None:
    with at_tip(model, components) as problem:
        assert without_inertia(problem) == len(motions)
        for reducer in (Modal(modes=4), FreeInterface(modes=3), Krylov(), Gramian(band_hz=[0.0, 100.0], order=4)):
            try:
                body = reducer.reduce(problem)
            except MorembsError as error:
                # Nothing that such a load deforms has mass.
                assert "no elastic" in str(error) or "no response but a static one" in str(error)
                assert len(components) == len(motions)
                continue
            words = str(body.recipe.get("without_mass", ""))
            assert bool(words) == bool(motions)
            if motions:
                assert f"({'; '.join(motions)})" in words
        if motions:
            with refusal("unsupported", "", '"auto"', len(motions)):
                AutoReducer(band_hz=[1.0, 100.0], tolerance=1e-2).reduce(problem)


def test_responses_to_a_load_that_moves_no_mass_are_refused() -> None:
    """A search for limits of 0 / 0 would not end."""
    with at_tip(lumped(clamped_beam(6)), (3,)) as problem:
        body = Modal(modes=3).reduce(problem)
        with refusal("model", "mass"):
            certify(problem, [body], [1.0, 100.0])


def test_check_and_reduce_and_the_file_say_it(tmp_path: Path) -> None:
    model = lumped(clamped_beam(6))
    write_model(tmp_path / "beam.h5", model)
    job = tmp_path / "job.toml"
    job.write_text(
        '[model]\nfile = "beam.h5"\n[[interface]]\nname = "tip"\nnodes = "ids:6"\ncoupling = "direct"\n'
        '[[reduce]]\nname = "body"\nmethod = "free-interface"\nmodes = 3\n[output]\npath = "body.h5"\n'
    )
    checked, made = (CliRunner().invoke(app, [verb, str(job)]) for verb in ("check", "reduce"))
    assert checked.exit_code == made.exit_code == 0
    told = " ".join((checked.stdout + checked.stderr).split())
    assert "1 motions of the interfaces deform the body without moving any mass (tip rotation x)" in told
    said = " ".join((made.stdout + made.stderr).split())
    for text in (said, " ".join(read_body(tmp_path / "body.h5").warnings)):
        assert "deform the body without moving any mass (tip rotation x)" in text


def test_a_check_tells_what_a_small_model_has_and_a_large_one_may_have() -> None:
    with at_tip(lumped(clamped_beam(6)), (0, 1, 2, 4, 5)) as bending:
        assert loaded_without_mass(bending) and without_mass_perhaps(bending) == ()
    with at_tip(lumped(clamped_beam(TOL.quickly_factorised // 6 + 2))) as large:
        (told,) = without_mass_perhaps(large)
        assert "interfaces load dofs without mass (tip rotation x, tip rotation y, tip rotation z)" in told
