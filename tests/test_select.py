"""Which solver is taken: the one that was named, else the fastest that runs here and keeps the budget."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matrices import backward_error, brick, damped, random, shifted

from morembs.errors import BudgetError, InputError
from morembs.linalg import select as selection
from morembs.linalg.mixed import Mixed
from morembs.linalg.mumps import EmbeddedMumps, Mumps
from morembs.linalg.select import FAST, LEAN, SOLVERS, Automatic, available_solvers, select_solver
from morembs.linalg.solver import STRUCTURES, LinearSolver
from morembs.linalg.symmetric import Lower

MATRICES = {"spd": brick(4), "symmetric": shifted(brick(4), 13.7), "complex-symmetric": damped(brick(4), 1.3)}


def _gone(monkeypatch: pytest.MonkeyPatch, *kinds: type[LinearSolver]) -> None:
    for kind in kinds:
        monkeypatch.setattr(kind, "unavailable", classmethod(lambda cls: "gone; get it back"))
        if issubclass(kind, Mumps | EmbeddedMumps):
            monkeypatch.setattr(kind, "lacks", classmethod(lambda cls, precision, structure: "gone; get it back"))


def test_every_solver_is_known_by_its_name() -> None:
    assert all(kind.name == name for name, kind in SOLVERS.items())
    assert {*FAST, *LEAN} <= set(SOLVERS) and selection.AUTO not in SOLVERS
    # Every matrix finds a solver everywhere.
    assert available_solvers()["superlu"] == "" and "superlu" in FAST and list(SOLVERS)[-1] == "superlu"
    assert set(SOLVERS["superlu"].structures) == set(STRUCTURES)


def test_a_name_gives_that_solver_with_its_budget() -> None:
    for name, reason in available_solvers().items():
        if not reason:
            solver = select_solver(name, memory=5, scratch=Path("x"))
            assert (type(solver), solver.memory, solver.scratch) == (SOLVERS[name], 5, Path("x"))
    auto = select_solver(memory=5, scratch=Path("x"))
    assert (type(auto), auto.memory, auto.scratch) == (Automatic, 5, Path("x"))
    assert auto.with_memory(7).memory == 7 and auto.with_memory(7).scratch == Path("x")


@pytest.mark.parametrize(
    ("wrong", "right"), [("super-lu", "superlu"), ("atuo", "auto"), ("mumps_mixed", "mumps-mixed")]
)
def test_unknown_solver_names_the_nearest(wrong: str, right: str) -> None:
    with pytest.raises(InputError, match=f"solver = '{wrong}' is not known; did you mean '{right}'"):
        select_solver(wrong)


def test_a_solver_that_does_not_run_here_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    _gone(monkeypatch, Mumps)
    with pytest.raises(InputError, match="'mumps' cannot run here: gone; get it back, or take solver = 'auto'"):
        select_solver("mumps")
    with pytest.raises(InputError, match="'mumps' cannot run here: gone"):
        Mumps().factorize(brick(2))


@pytest.mark.parametrize("structure", STRUCTURES)
def test_without_a_budget_the_first_that_runs_is_taken(monkeypatch: pytest.MonkeyPatch, structure: str) -> None:
    """And when that is gone the next one, down to the one that is always there."""
    A, b, taken = MATRICES[structure], random(192), []
    for _ in FAST:
        with Automatic().factorize(A, structure) as factor:
            assert backward_error(A, factor.solve(b), b) < 1e-12
            assert factor.stats.backend == factor.analysis.forecast.backend
            taken.append(factor.stats.backend)
        if taken[-1] == "superlu":
            break
        _gone(monkeypatch, SOLVERS[taken[-1]])
    able = [name for name in FAST if structure in SOLVERS[name].structures]
    assert taken == [name for name in able if name in taken] and taken[-1] == "superlu"
    monkeypatch.undo()
    able = [name for name in able if not selection._lacks(SOLVERS[name], structure)]
    assert taken == able


def test_a_budget_takes_the_factor_to_disk_and_then_to_single_precision(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    if reason := Mumps.unavailable() or Mixed.unavailable():
        pytest.skip(reason)
    # The ladder of one library, as the others differ in what they need.
    monkeypatch.setattr(selection, "FAST", ("mumps",))
    monkeypatch.setattr(selection, "LEAN", ("mumps", "mumps-mixed"))
    A, b = brick(10), random(3000)
    steps = []
    for kind in (Mumps, Mixed):
        for on_disk in (False, True):
            with kind(out_of_core=on_disk, scratch=tmp_path).analyse(A) as analysis:
                steps.append((analysis.forecast.memory, kind.name, on_disk))
    in_core, disk, _, least = steps
    caplog.set_level("INFO")
    between = (in_core[0] - 1, *disk[1:]), (disk[0] - 1, *least[1:])
    for memory, name, on_disk in (in_core, disk, least, *between):
        solver = Automatic(memory=memory, scratch=tmp_path)
        caplog.clear()
        with solver.factorize(A) as factor:
            stats = factor.stats
            assert (stats.backend, stats.out_of_core) == (name, on_disk), memory
            assert factor.analysis.forecast.memory <= memory
            assert backward_error(A, factor.solve(b), b) < 1e-12
        words = caplog.messages[0]
        assert f"{name}, {'single' if 'mixed' in name else 'double'} precision" in words
        # What was refused is the reason for what was taken.
        assert ("on disk" in words) == on_disk and ("are left of the memory budget" in words) == ("mixed" in name)
    with pytest.raises(BudgetError, match=r"4\.2 MB are left .* 3000 rows.* needs 4 MB: raise the budget by") as caught:
        Automatic(memory=least[0] - 1000, scratch=tmp_path).factorize(A)
    assert caught.value.needed == least[0] and not list(tmp_path.iterdir())


@pytest.mark.xfail(strict=True, reason="SuperLU, which keeps no budget, comes before the solvers that do")
@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_no_solver_is_taken_that_needs_more_than_the_budget(structure: str, tmp_path: Path) -> None:
    for memory in (1_000_000, 5_000_000):
        try:
            with Automatic(memory=memory, scratch=tmp_path).analyse(brick(10), structure) as analysis:
                assert analysis.forecast.memory <= memory
        except BudgetError as error:
            assert error.needed > memory


def test_inertia_is_counted_by_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    A = MATRICES["symmetric"]
    count = np.count_nonzero(np.linalg.eigvalsh(A.toarray()) < 0)
    for kinds in ((), (Mumps,), (Mumps, EmbeddedMumps)):
        _gone(monkeypatch, *kinds)
        assert Automatic().negative_eigenvalues(A) == count
        assert Automatic().inertia_forecast(Lower.of(A)).size == 192


def test_motions_of_low_energy_reach_the_solver_that_uses_them() -> None:
    Z = random(192, 6)
    known = Automatic().knowing(Z)
    assert known.near_nullspace is Z and Automatic().knowing(None).near_nullspace is None
    assert Mumps(memory=3).knowing(Z) == Mumps(memory=3)
    assert Automatic() == known
