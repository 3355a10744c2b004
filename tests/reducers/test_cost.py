"""What reductions are forecast to take, by counts of what they solve for."""

from dataclasses import replace

import pytest

from morembs.problem import Damping, Problem
from morembs.reducers import AutoReducer, ParametricReducer, ProblemSummary
from morembs.reducers.cost import box_seconds, reference_columns, search_seconds
from tests.certificate.test_certify import BODIES

AUTO = AutoReducer(band_hz=[0.0, 3000.0], tolerance=1e-3)
ENTRIES = 1_000_000


@pytest.mark.parametrize("name", ["beam average", "square beam"])
@pytest.mark.parametrize(("damping", "error"), [(Damping(modal=0.01), 1e-13), (Damping(alpha=5.0, beta=1e-6), 1e-10)])
def test_columns_of_the_reference_are_forecast(name: str, damping: Damping, error: float) -> None:
    model, interfaces = BODIES[name]()
    with Problem(model, interfaces, damping=damping) as problem:
        facts = ProblemSummary.of(problem)
        columns = AUTO.reduce(problem).recipe["reference_order"]
    told = reference_columns(facts.size, facts.inputs, error)
    assert columns / 2 <= told <= 2 * columns


def test_auto_takes_longer_where_it_solves_more() -> None:
    model, interfaces = BODIES["beam average"]()
    with Problem(model, interfaces, damping=Damping(alpha=5.0, beta=1e-6)) as problem:
        facts = ProblemSummary.of(problem)
    modal = replace(facts, damping=Damping(modal=0.01))
    sharp = AutoReducer(band_hz=[0.0, 3000.0], tolerance=1e-8)
    one, two, three = (AUTO.seconds(facts, n * ENTRIES) for n in (1, 2, 3))
    assert one is not None and two is not None and three is not None
    # Each column of the space is solved for once.
    assert 0 < two - one == pytest.approx(three - two, rel=1e-6)
    assert AUTO.seconds(modal, ENTRIES) > one < sharp.seconds(facts, ENTRIES)
    times = [search_seconds(size, inputs, ENTRIES, 1e-13) for size, inputs in ((6000, 6), (6000, 12), (20_000, 12))]
    assert times == sorted(times) and times[2] > 2 * times[0]


def test_a_parametric_basis_takes_the_time_of_its_bounds() -> None:
    model, interfaces = BODIES["beam average"]()
    with Problem(model, interfaces, damping=Damping(modal=0.01)) as problem:
        facts = ProblemSummary.of(problem)
    few, more, most = (
        ParametricReducer(band_hz=[0.0, 3000.0], training=n).seconds(facts, ENTRIES) for n in (128, 256, 384)
    )
    assert few is not None and more is not None and most is not None
    assert 0 < more - few == pytest.approx(most - more, rel=1e-6)
    assert few == box_seconds(facts.size, facts.inputs, ENTRIES, 128, 200)
    shorter = ParametricReducer(band_hz=[0.0, 3000.0], training=128, order_limit=50)
    assert shorter.seconds(facts, ENTRIES) < few
