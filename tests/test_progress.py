"""Who hears of long work: the listener of the context, in threads, with workers, and as 0.1 gave it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any

import pytest

from morembs import CraigBampton, Krylov, Problem, make_interface
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
