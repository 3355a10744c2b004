"""Who hears of long work: the listener of the context, in threads, with workers, and as 0.1 gave it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from morembs import CraigBampton, Krylov, Modal, Problem, certify, full_response, make_interface
from morembs.base import progress
from morembs.base.progress import listening
from tests.support.meshes import box, steel, where
from tests.support.progress import Heard


def bar(**keys: Any) -> Problem:
    model = steel(box("hex8", (24, 4, 4), (0.4, 0.04, 0.05)))
    ends = [make_interface(model, name=name, nodes=where(model, 0, x)) for name, x in (("left", 0.0), ("right", 0.4))]
    return Problem(model, ends, **keys)


def test_listeners_nest_and_none_leaves_the_one_that_is_there() -> None:
    outer, inner = Heard(), Heard()
    progress.update("nobody")
    with listening(outer):
        progress.stage("one")
        with listening(inner), listening(None):
            progress.update("two")
        with pytest.raises(KeyError), listening(inner):
            raise KeyError
        progress.update("three")
    progress.update("nobody")
    assert outer.told == ["one", "three"] and inner.told == ["two"]


def test_a_problem_is_heard_by_who_listens_now_or_who_listened_when_it_was_made() -> None:
    made, now = Heard(), Heard()
    with listening(made):
        problem = bar()
    with problem:
        problem.elastic_modes(count=4)
        known = len(made.news)
        assert known
        with listening(now):
            problem.elastic_modes(count=20)
        assert now.news and len(made.news) == known


def test_each_thread_has_its_own_listener() -> None:
    heard = [Heard(), Heard()]

    def work(listener: Heard) -> None:
        with listening(listener), bar() as problem:
            CraigBampton(modes=4).reduce(problem)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, heard))
    assert heard[0].news and heard[0].news == heard[1].news


def test_a_thread_hears_in_a_copy_of_the_context() -> None:
    heard = Heard()
    with listening(heard), ThreadPoolExecutor(1) as pool:
        pool.submit(copy_context().run, progress.update, "news").result()
    assert heard.news == ["news"]


def test_work_of_processes_is_heard() -> None:
    heard = Heard()
    with bar(workers=2) as problem, listening(heard):
        Krylov(shifts_hz=[100.0, 400.0]).reduce(problem)
    assert any("on 2 workers" in text for text in heard.news)


def test_the_former_argument_warns_and_is_heard() -> None:
    asked = [Heard() for _ in range(4)]
    with pytest.warns(DeprecationWarning, match="progress of Problem.__init__ goes with 1.0"):
        problem = bar(progress=asked[0])
    omega = 2 * np.pi * np.array([100.0, 300.0])
    with problem:
        with pytest.warns(DeprecationWarning, match="progress of Reducer.reduce"):
            reduced = Modal(modes=3).reduce(problem, "modal", asked[1])
        assert reduced.name == "modal" and asked[1].news and not asked[0].news
        problem.elastic_modes(count=20)
        assert asked[0].news
        with pytest.warns(DeprecationWarning, match="progress of full_response"):
            full_response(problem, omega, progress=asked[2])
        with pytest.warns(DeprecationWarning, match="progress of certify"):
            certify(problem, [reduced], [0.0, 300.0], progress=asked[3])
    assert asked[2].news and asked[3].news


def test_plugins_that_take_progress_work_and_warn() -> None:
    with pytest.warns(DeprecationWarning, match="_basis of Former takes progress"):

        @dataclass(frozen=True, kw_only=True)
        class Former(Modal):
            method: ClassVar[str] = "former"

            def _basis(self, problem: Problem, told: Any) -> Any:
                told.update("former")
                return super()._basis(problem, told)

    with pytest.warns(DeprecationWarning, match="variation of Derived takes progress"):

        @dataclass(frozen=True, kw_only=True)
        class Derived(Modal):
            method: ClassVar[str] = "derived"

            def _basis(self, problem: Problem, progress: Any) -> Any:
                progress.update("derived")
                return replace(super()._basis(problem, progress))

            def variation(self, problem: Problem, reduced: Any, *, progress: Any) -> Any:
                progress.update("variation")

    @dataclass(frozen=True, kw_only=True)
    class Present(Modal):
        method: ClassVar[str] = "present"

        def _basis(self, problem: Problem) -> Any:
            progress.update("present")
            return super()._basis(problem)

    heard = Heard()
    with bar() as problem:
        expected = Modal(modes=3).reduce(problem)
        with listening(heard):
            bodies = [Former(modes=3), Derived(modes=3), Present(modes=3)]
            for reducer in bodies:
                assert np.array_equal(reducer.reduce(problem).K, expected.K)
            Derived(modes=3).variation(problem, expected)
        Former(modes=3).reduce(problem)
    assert [text for text in heard.news if " " not in text] == ["former", "derived", "present", "variation"]
