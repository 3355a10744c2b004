"""Which solver is taken: the one that was named, else the fastest that runs here and keeps the budget."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from morembs.base.errors import BudgetError, enough_megabytes
from morembs.linalg.sparse import select as selection
from morembs.linalg.sparse.mixed import Mixed
from morembs.linalg.sparse.mumps import EmbeddedMumps, Mumps
from morembs.linalg.sparse.select import FAST, LEAN, SOLVERS, AutoSolver, available_solvers, select_solver
from morembs.linalg.sparse.solver import STRUCTURES, LinearSolver
from morembs.linalg.sparse.symmetric import Lower
from tests.support.matrices import backward_error, brick, damped, random, shifted, skewed
from tests.support.refusals import refusal

MATRICES = {
    "spd": brick(4),
    "symmetric": shifted(brick(4), 13.7),
    "complex-symmetric": damped(brick(4), 1.3),
    "unsymmetric": skewed(shifted(brick(4), 13.7), 0.3),
    "complex-unsymmetric": skewed(damped(brick(4), 1.3), 0.3),
}


def _without(monkeypatch: pytest.MonkeyPatch, *kinds: type[LinearSolver]) -> None:
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
    assert (type(auto), auto.memory, auto.scratch) == (AutoSolver, 5, Path("x"))
    assert auto.with_memory(7).memory == 7 and auto.with_memory(7).scratch == Path("x")


@pytest.mark.parametrize(
    ("wrong", "right"), [("super-lu", "superlu"), ("atuo", "auto"), ("mumps_mixed", "mumps-mixed")]
)
def test_unknown_solver_names_the_nearest(wrong: str, right: str) -> None:
    with refusal("unknown", "solver", wrong, right):
        select_solver(wrong)


def test_a_solver_that_does_not_run_here_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    _without(monkeypatch, Mumps)
    with refusal("program", "solver", "mumps", "auto"):
        select_solver("mumps")
    with refusal("program", "solver", "mumps"):
        Mumps().factorize(brick(2))


@pytest.mark.parametrize("structure", STRUCTURES)
def test_without_a_budget_the_first_that_runs_is_taken(monkeypatch: pytest.MonkeyPatch, structure: str) -> None:
    """And when that is gone the next one, down to the one that is always there."""
    A, b, taken = MATRICES[structure], random(192), []
    for _ in FAST:
        with AutoSolver().factorize(A, structure) as factor:
            assert backward_error(A, factor.solve(b), b) < 1e-12
            assert factor.stats.backend == factor.analysis.forecast.backend
            taken.append(factor.stats.backend)
        if taken[-1] == "superlu":
            break
        _without(monkeypatch, SOLVERS[taken[-1]])
    able = [name for name in FAST if structure in SOLVERS[name].structures]
    assert taken == [name for name in able if name in taken] and taken[-1] == "superlu"
    monkeypatch.undo()
    able = [name for name in able if not selection.lacks(SOLVERS[name], structure)]
    assert taken == able


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_a_shrinking_budget_takes_the_factor_to_disk_and_then_to_single_precision(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, structure: str
) -> None:
    if reason := Mumps.unavailable() or Mixed.unavailable():
        pytest.skip(reason)
    # Multigrid, where it can be used, takes less or more than MUMPS as the mesh will have it.
    _without(monkeypatch, SOLVERS["amg"])
    A, b, ladder = brick(10), random(3000), []
    caplog.set_level("INFO", "morembs.linalg.sparse.select")
    for memory in np.geomspace(200e6, 1e6, 40).astype(int):
        caplog.clear()
        try:
            analysis = AutoSolver(memory=int(memory), scratch=tmp_path).analyse(A, structure)
        except BudgetError as error:
            assert error.needed > memory
            needed, words = error.needed, str(error)
            ladder.append("nothing")
            continue
        with analysis:
            plan = analysis.forecast
            assert plan.memory <= memory and plan.out_of_core == bool(list(tmp_path.iterdir()))
            step = f"{plan.precision} {'on disk' if plan.out_of_core else 'in memory'}"
            if step not in ladder:
                assert backward_error(A, analysis.factorize(A).solve(b), b) < 1e-12
            # One line says what was taken; it is kept for the report.
            assert caplog.messages[0] == analysis.choice
            assert f"{plan.backend}, {plan.precision} precision, {step.split(' ', 1)[1]}" in analysis.choice
            ladder.append(step)
    steps = list(dict.fromkeys(ladder))
    assert steps == ["double in memory", "double on disk", "single on disk", "nothing"]
    assert ladder == sorted(ladder, key=steps.index)
    assert (
        f"1.0 MB are left of the memory budget for a factorisation of 3000 rows; the leanest method needs "
        f"{needed / 1e6:.0f} MB: raise the budget by {enough_megabytes(needed - 1e6)} MB" in words
    )
    AutoSolver(memory=needed, scratch=tmp_path).analyse(A, structure).close()
    assert not list(tmp_path.iterdir())


def test_a_factor_stays_in_memory_only_where_it_leaves_room_for_a_count(tmp_path: Path) -> None:
    if reason := Mumps.unavailable():
        pytest.skip(reason)
    with Mumps().analyse(brick(10)) as analysis:
        alone = analysis.forecast.memory
    for memory, on_disk in ((alone, True), (4 * alone + 60_000_000, False)):
        with AutoSolver(memory=memory, scratch=tmp_path).analyse(brick(10)) as analysis:
            assert analysis.forecast.out_of_core == on_disk


@pytest.mark.parametrize("structure", ["spd", "symmetric"])
def test_no_solver_is_taken_that_needs_more_than_the_budget(structure: str, tmp_path: Path) -> None:
    for memory in (1_000_000, 5_000_000):
        try:
            with AutoSolver(memory=memory, scratch=tmp_path).analyse(brick(10), structure) as analysis:
                assert analysis.forecast.memory <= memory
        except BudgetError as error:
            assert error.needed > memory


def test_inertia_is_counted_by_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    A = MATRICES["symmetric"]
    count = np.count_nonzero(np.linalg.eigvalsh(A.toarray()) < 0)
    for kinds in ((), (Mumps,), (Mumps, EmbeddedMumps)):
        _without(monkeypatch, *kinds)
        assert AutoSolver().negative_eigenvalues(A) == count
        assert AutoSolver().inertia_forecast(Lower.of(A)).size == 192


def test_motions_of_low_energy_reach_the_solver_that_uses_them(monkeypatch: pytest.MonkeyPatch) -> None:
    Z = random(192, 6)
    known = AutoSolver().with_near_null_space(Z)
    assert known.near_nullspace is Z and AutoSolver().with_near_null_space(None).near_nullspace is None
    assert Mumps(memory=3).with_near_null_space(Z) == Mumps(memory=3)
    assert AutoSolver() == known
    if not SOLVERS["amg"].unavailable():
        _without(monkeypatch, *(SOLVERS[name] for name in {*FAST, *LEAN} - {"amg"}))
        with known.with_memory(10**9).analyse(MATRICES["spd"], "spd") as analysis:
            assert analysis.session.solver.near_nullspace is Z
