"""Loads that slide and meshing teeth, against whole models."""

import sys
from pathlib import Path

import numpy as np
import pytest

PIPELINES = Path(__file__).parents[2] / "pipelines"
sys.path.insert(0, str(PIPELINES))

import common  # noqa: E402
import moving_load  # noqa: E402

from data import make_spur_gear  # noqa: E402
from morembs.dynamics.multibody import UnfinishedRunError  # noqa: E402
from studies import gear_teeth  # noqa: E402
from tests.support.refusals import refusal  # noqa: E402


def test_a_run_that_leaves_the_beam_stays_on_disk(tmp_path):
    file = tmp_path / "run.npz"
    beam = moving_load.reduce(common.hermite_beam(32))
    with refusal("result", "", "0.50", by=UnfinishedRunError) as error:
        moving_load.cross(beam, 2.0, 240, end=1.2, keep=file)
    with np.load(file) as kept:
        assert kept["time"][-1] == pytest.approx(0.5) and len(kept["x"]) == len(kept["time"])
        assert np.array_equal(kept["time"], error.value.result.time)


@pytest.fixture(scope="module")
def gears():
    """A coarse mesh of both gears."""
    return tuple(gear_teeth.reduce(gear, 8, gear_teeth.QUICK_CELLS) for gear in make_spur_gear.pair())


def test_flank_nodes_are_on_involutes(gears):
    for reduced in gears:
        sector, gear = reduced.sector, reduced.sector.gear
        x, y, _ = np.moveaxis(sector.model.nodes.xyz[sector.flank], -1, 0)
        radius, angle = np.hypot(x, y), np.arctan2(y, x) - np.array([-1, 0, 1])[:, None, None] * 2 * np.pi / gear.teeth
        roll = np.sqrt(radius**2 - gear.base**2)
        assert np.abs(roll - sector.roll[:, None]).max() < 1e-9
        # The tangent to the base circle at the end of a taut string is as long as the arc that it left.
        left = roll / gear.base - np.arctan2(roll, gear.base) + angle
        assert np.ptp(left) < 1e-9
        # At the pitch circle a tooth is half a pitch thick.
        at_pitch = float(gear.half_angle(np.array(gear.pitch)))
        assert at_pitch == pytest.approx(np.pi / 2 / gear.teeth)
        normal = reduced.tables.direction[reduced.candidate[:, 1:-1]]
        # Normals are those of the facets, means at corners: between radius and normal are 90 degrees less the pressure.
        away = np.arctan2(normal[..., 1], normal[..., 0]) - np.arctan2(y, x)[:, 1:-1]
        assert np.abs(away + np.arctan2(roll, gear.base)[:, 1:-1] - np.pi / 2).max() < 0.1


def test_points_lie_where_the_line_of_action_meets_the_flanks(gears):
    along = sum(reduced.sector.gear.base for reduced in gears) * np.tan(make_spur_gear.PRESSURE)
    at = gear_teeth.touch(gears, 0.3 * gear_teeth.base_pitch())
    assert sorted(set(at.pair)) == [-1, 0]
    total = np.zeros(len(at.pair))
    for reduced, some, W, sign in zip(gears, at.active, at.weights, (1, -1), strict=True):
        assert np.abs(W.sum(axis=1) - 1).max() < 1e-12
        place = np.argsort(reduced.candidate.ravel())[some]
        tooth, row, line = np.unravel_index(place, reduced.sector.flank.shape)
        total += W @ reduced.sector.roll[row]
        middle = [np.unique(tooth[w != 0]) for w in W]
        assert [list(m) for m in middle] == [[1 + sign * k] for k in at.pair]
        assert all(len(np.unique(line[w != 0])) == 1 for w in W)
    # Both tangents to the base circles make up the line of action (strips that reach over an end are cut).
    assert np.abs(total - along)[at.pair == 0].max() < 1e-12


def test_compliance_of_teeth_is_that_of_the_whole_model(gears):
    for reduced in gears:
        C, some = gear_teeth.whole_compliance(reduced), np.arange(reduced.tables.count)
        assert np.abs(reduced.compliance(some) - C).max() < 1e-8 * np.abs(C).max()
        assert np.abs(reduced.by_modes(some) - C).max() > 0.3 * np.abs(C).max()


def test_load_is_shared_as_with_the_whole_model(gears):
    whole = [gear_teeth.whole_compliance(reduced) for reduced in gears]
    places = gear_teeth.base_pitch() * np.linspace(-0.5, 0.5, 9)
    switched, full = (gear_teeth.cycle(gears, places, C) for C in (None, whole))
    assert np.abs(switched.approach - full.approach).max() < 1e-8 * full.approach.max()
    assert np.abs(switched.load - full.load).max() < 1e-7 * gear_teeth.FORCE
    assert switched.load.sum(axis=1) == pytest.approx(np.full(9, gear_teeth.FORCE))
    # One pair in the middle, two at the ends, where a pitch later the pairs are the next ones.
    assert switched.load[4] == pytest.approx([0, gear_teeth.FORCE, 0])
    assert (switched.load[0, 1:] > 0.3 * gear_teeth.FORCE).all()
    assert switched.approach[0] == pytest.approx(switched.approach[-1], rel=0.05)
    assert switched.active.max() < 0.5 * sum(reduced.tables.count for reduced in gears)
    at = gear_teeth.touch(gears, float(places[0]))
    near, f = gear_teeth.solve(at, [reduced.compliance(some) for reduced, some in zip(gears, at.active, strict=True)])
    A = sum(W @ C[np.ix_(s, s)] @ W.T for W, C, s in zip(at.weights, whole, at.active, strict=True))
    gap = at.gap + A @ f - near
    assert np.abs(np.minimum(gap / near, f / gear_teeth.FORCE)).max() < 1e-9


def test_stiffness_of_a_pair_is_near_that_of_the_standard(gears):
    (middle,) = gear_teeth.cycle(gears, np.zeros(1), None).approach
    # Coarse elements leave a part of the local compliance out.
    assert gear_teeth.FORCE / make_spur_gear.WIDTH / middle * 1e-9 == pytest.approx(gear_teeth.standard(), rel=0.3)
