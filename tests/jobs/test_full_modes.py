"""What a job compares its bodies with: free-free frequencies of the full model, and what these cost on a disk."""

import pytest

from morembs.app.jobs.job import load_job
from morembs.app.jobs.run import run_job
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from tests.support import decks

DISK = next((kind.name for kind in (Mumps, EmbeddedMumps) if not kind.unavailable()), None)
on_disk = pytest.mark.skipif(DISK is None, reason="needs MUMPS")
# 2,160 dofs: too many for LAPACK.
FINE = decks.deck([(x, y, z) for x in range(19) for y in range(5) for z in range(5)])


def result(folder, text=None, **tables):
    folder.mkdir()
    return run_job(load_job(decks.folder(folder, tables, text)))


def reference(folder, text=None):
    """Frequencies that were solved for."""
    reduce = 'method = "modal"\nmodes = 12'
    return result(folder, text, reduce=reduce, check="full_modes = 12").bodies[0].full_frequencies_hz


def test_frequencies_to_compare_with_are_solved_for_in_memory(tmp_path):
    exact = reference(tmp_path / "modal")
    body = result(tmp_path / "cb").bodies[0]
    assert body.full_frequencies_hz == pytest.approx(exact[:16], rel=1e-9)


@on_disk
def test_a_job_on_a_disk_takes_few_passes_over_its_factor(tmp_path):
    reduce = 'method = "craig-bampton"\nmodes = 20'
    solver = f'name = "{DISK}"\nout_of_core = true'
    done = result(tmp_path / "cb", FINE, reduce=reduce, solver=solver)
    assert done.factor.out_of_core and done.bodies[0].full_frequencies_hz is None
    # The check, the interfaces with the first block, and a Krylov space with wide blocks; there were 31 with a second
    # eigensolution to compare with, and 37 with the certificate.
    assert done.factor.passes <= 12
    certified = result(tmp_path / "certified", FINE, reduce=reduce, solver=solver, certify="band_hz = [0, 8000]")
    assert certified.bodies[0].certificate.kind == "proven"
    assert certified.factor.passes <= 24


@on_disk
def test_on_a_disk_nothing_is_solved_for_only_to_compare(tmp_path):
    reduce = 'method = "krylov"\nmoments = 2\nshifts_hz = [0.0]'
    solver = f'name = "{DISK}"\nout_of_core = true'
    done = result(tmp_path / "krylov", FINE, reduce=reduce, solver=solver)
    assert done.bodies[0].full_frequencies_hz is None
    assert any("[check] full_modes = 10 asks for it" in warning for warning in done.warnings)
    asked = result(tmp_path / "asked", FINE, reduce=reduce, solver=solver, check="full_modes = 10")
    assert asked.bodies[0].full_frequencies_hz == pytest.approx(reference(tmp_path / "modal", FINE)[:16], rel=1e-9)
    assert asked.factor.passes > done.factor.passes and not asked.warnings
