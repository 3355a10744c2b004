"""The offline stage of parameterised members: grids, ranges, symmetries, processes and restarts."""

import os
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest

from morembs.base.errors import InputError, OutputError
from morembs.base.progress import listening
from morembs.dynamics.gmp import AngleRange, ReducedMember, Solver, manifold, solid_member
from morembs.dynamics.gmp.symmetry import symmetries
from morembs.dynamics.nonlinear import PlanarBeam, Section
from morembs.dynamics.nonlinear.continuation import follow_equilibrium
from tests.gmp.test_gmp import LENGTH, Softening, rod
from tests.gmp.test_solid_member import LENGTH as SOLID
from tests.gmp.test_solid_member import SIDE, E, prism
from tests.support.processes import apart
from tests.support.progress import Heard
from tests.support.refusals import refusal

ROOT = Path(__file__).parents[2]


def tabulated(beam=None, **options):
    return ReducedMember(rod() if beam is None else beam, modes=2, **{"reach": 0.8, **options})


def same_bits(first, second):
    return all(
        np.array_equal(getattr(first.data, name).coefficients, getattr(second.data, name).coefficients)
        for name in ("table", "energy")
    )


def away(member, beam):
    """Largest errors of shape (per length) and energy (per largest) at points of no grid, of fresh equilibria."""
    solver, reach = Solver(beam), member.data.reach
    shape = energy = top = 0.0
    for a, b in reach * np.array([(0.93, 0.88), (0.95, -0.83), (-0.55, 0.35), (0.2, -0.97)]):
        state = solver.toward(solver.straight(), np.array([a, b]))
        d0 = float(state.X[-3])
        at = member.at(np.concatenate(([0, 0, a, d0, 0, b], np.zeros(member.modes))))
        shape = max(shape, np.abs(member.nodes(at.x) - state.X).max() / LENGTH)
        energy, top = max(energy, abs(at.V - state.W)), max(top, state.W)
    return shape, energy / top


# ---------------------------------------------------------------------------------------------------------
# Number of points


def test_points_grow_until_the_tables_are_as_good_as_asked():
    last = 0
    for tolerance in (0.1, 2e-3, 1e-9):
        member = tabulated(reach=1.0, tolerance=tolerance)
        report = member.report
        assert report.points > last
        assert max(report.errors.values()) <= tolerance
        shape, energy = away(member, rod())
        assert shape < tolerance and energy < tolerance
        last = report.points
    # The next smaller grid would not have done, and the errors are no guesses: a fresh check finds as much.
    coarse = tabulated(reach=1.0, tolerance=0.1)
    assert max(coarse.report.errors.values()) > 2e-3 and coarse.report.points == 3
    assert away(coarse, rod())[0] > 0.1 * coarse.report.errors["shapes"] * 0.5


def test_the_errors_told_are_those_at_fresh_equilibria_between_the_points():
    beam, reach = rod(), 0.9
    report, solver = tabulated(beam, reach=reach).report, Solver(beam)
    tables = manifold(beam, reach=reach, points_per_angle=5)
    assert report.points == 5
    start = solver.straight()
    worst = np.zeros(4)
    # Every second of the nine points of the next grid.
    between = reach * np.cos(np.pi * np.array([1, 3, 5, 7]) / 8)
    for t in ((a, b) for a in between for b in between):
        state = solver.toward(start, np.array(t))
        (X, X_t, _), (W, W_t, _) = tables.shape.at(np.array(t)), tables.energy.at(np.array(t))
        pairs = (X, state.X), (W, state.W), (X_t.T, state.modes), (W_t, state.moments)
        worst = np.maximum(worst, [np.abs(a - b).max() for a, b in pairs])
    size = [np.abs(part).max() for part in (tables.X - start.X, tables.W, tables.modes, tables.moments)]
    reported = [report.errors[name] for name in ("shapes", "energy", "modes", "moments")]
    assert reported[:2] == pytest.approx(worst[:2] / size[:2], rel=1e-3)
    # Derivatives are measured at the points of the tables, too, where they are worse.
    assert (reported[2:] >= 0.999 * worst[2:] / size[2:]).all()
    assert reported[2:] == pytest.approx(tables.errors(), rel=1e-3)


def test_a_tolerance_that_cannot_be_met_is_said():
    with refusal("value", "tolerance", "17", "2.8", "1e-09"):
        tabulated(reach=2.8, tolerance=1e-9)


# ---------------------------------------------------------------------------------------------------------
# Range


def test_the_range_follows_from_end_moments():
    moment, EI = 0.008, rod().section.EI
    report = tabulated(reach=AngleRange(moment=moment)).report
    # Equal and opposite moments bend the rod to an arc: the most that moments of this size can do.
    assert report.reach == pytest.approx(1.05 * moment * LENGTH / (2 * EI), rel=1e-6)
    assert report.notes == ()


def test_the_range_follows_from_a_load_across():
    load, EI = 1e-3, rod().section.EI
    report = tabulated(reach=AngleRange(load=load)).report
    assert report.reach == pytest.approx(1.05 * load * LENGTH**2 / (24 * EI), rel=1e-2)


def test_the_range_of_a_solid_follows_from_end_moments():
    solid, moment = prism(4), 1e-5
    report = solid_member(solid, modes=1, reach=AngleRange(moment=moment)).report
    # The same moments, applied to the frames of the solid with its start held.
    moments = np.zeros(solid.size)
    moments[solid.frames["end"][5]] = moment
    turned = follow_equilibrium(solid, held=solid.frames["start"], load=moments, steps=1, stable=False).x
    assert report.reach == pytest.approx(1.05 * turned[solid.frames["end"][5]] / 2, rel=1e-2)


def test_the_range_of_a_solid_follows_from_a_load_across():
    solid, load = prism(6), 1e-3
    report = solid_member(solid, modes=0, reach=AngleRange(load=load)).report
    assert report.reach == pytest.approx(1.05 * load * SOLID**2 / (24 * E * SIDE**4 / 12), rel=0.05)


def test_a_range_stops_before_a_bifurcation_and_says_so():
    beam = Softening(1e4)
    with refusal("result", "reach"):
        tabulated(beam, reach=1.2, tolerance=0.02)
    member = tabulated(beam, reach=AngleRange(angle=1.2), tolerance=0.05)
    assert 0.2 < member.data.reach < 1.2 and member.data.reach == member.report.reach
    assert any("not 1.2" in note and "cannot be followed" in note for note in member.report.notes)
    # All of the range is there, and not much was given away: the equilibria end soon behind it.
    solver, reach = Solver(beam), member.data.reach
    for corner in ((1, 1), (1, -1)):
        solver.toward(solver.straight(), reach * np.array(corner))
    with pytest.raises(InputError):
        for corner in ((1, 1), (1, -1)):
            solver.toward(solver.straight(), 1.3 * reach * np.array(corner))


def test_moments_that_are_not_borne_are_said():
    member = tabulated(Softening(1e4), reach=AngleRange(moment=0.05), tolerance=0.05)
    assert any("not borne" in note for note in member.report.notes)


# ---------------------------------------------------------------------------------------------------------
# Symmetry


def arch(rise=0.02, elements=12):
    """A shallow arc from the origin along x, whose chord is its x axis."""
    radius = (LENGTH**2 / 4 + rise**2) / (2 * rise)
    angle = np.arcsin(LENGTH / 2 / radius)
    s = np.linspace(-angle, angle, elements + 1)
    nodes = np.column_stack((radius * np.sin(s) + LENGTH / 2, radius * (np.cos(s) - np.cos(angle)), -s))
    return nodes


class Clamped:
    """A curved beam whose frames have no rotation in the reference: rotations less those of the nodes."""

    def __init__(self, nodes):
        self.beam = PlanarBeam(nodes, Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770))
        self.shift = np.zeros(self.beam.size)
        self.shift[2::3] = nodes[:, 2]
        for name in ("size", "frames", "translations", "M"):
            setattr(self, name, getattr(self.beam, name))
        self.reference = self.beam.reference - self.shift
        self.reference[np.abs(self.reference) < 1e-15] = 0.0

    def energy(self, x):
        return self.beam.energy(x + self.shift)

    def force(self, x):
        return self.beam.force(x + self.shift)

    def tangent(self, x):
        return self.beam.tangent(x + self.shift)


class Tapered:
    """A straight rod with a spring on the turn of a node near its end: only the reflection is left."""

    def __init__(self):
        self.rod = rod()
        for name in ("size", "frames", "translations", "reference", "M"):
            setattr(self, name, getattr(self.rod, name))
        self.turn = 3 * 3 + 2

    def energy(self, x):
        return self.rod.energy(x) + 0.5 * 1e-2 * x[self.turn] ** 2

    def force(self, x):
        f = self.rod.force(x)
        f[self.turn] += 1e-2 * x[self.turn]
        return f

    def tangent(self, x):
        K = self.rod.tangent(x).tolil()
        K[self.turn, self.turn] += 1e-2
        return K.tocsr()


def test_symmetries_are_found_where_they_are():
    def names(component, length=LENGTH):
        return [symmetry.name for symmetry in symmetries(component, length)]

    assert names(rod()) == ["reflection", "exchange of the ends", "half turn"]
    assert names(Clamped(arch())) == ["exchange of the ends"]
    wave = np.linspace(0, 1, 13)
    nodes = np.column_stack((LENGTH * wave, 0.005 * np.sin(2 * np.pi * wave), np.zeros(13)))
    nodes[:, 2] = np.arctan(0.005 * 2 * np.pi / LENGTH * np.cos(2 * np.pi * wave))
    assert names(Clamped(nodes)) == ["half turn"]
    assert names(prism(3), prism(3).reference[prism(3).frames["end"][0]]) == names(rod())


@pytest.mark.parametrize(
    ("component", "share"), [(rod(), 4), (Tapered(), 2), (Clamped(arch()), 2)], ids=["rod", "sprung", "arch"]
)
def test_symmetric_equilibria_are_those_that_are_solved(component, share):
    with_symmetry = tabulated(component, reach=0.4, points_per_angle=5)
    every = tabulated(component, reach=0.4, points_per_angle=5, symmetric=False)
    assert every.report.symmetries == () and every.report.solved == 24
    # Points on axes of symmetry have fewer images, and the middle is known.
    assert with_symmetry.report.solved <= 24 / share + 3 and with_symmetry.report.equilibria == 25
    for t in ((0.37, 0.1), (-0.2, 0.33), (-0.31, -0.4), (0.4, -0.4)):
        end = np.array([0.02, 0.01]) + 0.29 * np.array([np.cos(0.3), np.sin(0.3)])
        q = np.array([0.02, 0.01, t[0] + 0.3, *end, t[1] + 0.3, 1e-4, 1e-4])
        a, b = with_symmetry.at(q), every.at(q)
        assert np.abs(with_symmetry.nodes(a.x) - every.nodes(b.x)).max() < 1e-9
        assert pytest.approx(b.V, rel=1e-8) == a.V and np.allclose(a.force, b.force, rtol=1e-7, atol=1e-9)
    assert np.allclose(with_symmetry.data.errors, every.data.errors, rtol=1e-5)


def test_symmetric_equilibria_of_a_solid_are_those_that_are_solved():
    solid = prism(3)
    with_symmetry = solid_member(solid, modes=1, reach=0.15, points_per_angle=3)
    every = solid_member(solid, modes=1, reach=0.15, points_per_angle=3, symmetric=False)
    assert (with_symmetry.report.solved, every.report.solved) == (3, 8)
    q = with_symmetry.start(np.array([0, 0, 0.13, 0.15, 0, 0.05]))
    a, b = with_symmetry.at(q), every.at(q)
    assert np.abs(with_symmetry.nodes(a.x) - every.nodes(b.x)).max() < 1e-9
    assert pytest.approx(b.V, rel=1e-8) == a.V


# ---------------------------------------------------------------------------------------------------------
# Processes and restarts


def test_processes_give_the_same_bits_and_progress_is_heard():
    heard = Heard()
    serial = tabulated()
    with listening(heard):
        parallel = tabulated(workers=2)
    assert same_bits(serial, parallel) and serial.report.solved == parallel.report.solved
    assert heard.stages == ["static equilibria"] and f"equilibria: {parallel.report.solved}" in heard.news
    assert any("points per angle: error" in text for text in heard.news)
    solids = [solid_member(prism(3), modes=1, reach=0.15, points_per_angle=3, workers=n) for n in (1, 2)]
    assert same_bits(*solids)


def test_a_failure_is_the_same_for_any_number_of_processes():
    words = []
    for workers in (1, 2):
        with pytest.raises(InputError) as caught:
            tabulated(Softening(1e4), reach=1.2, workers=workers)
        words.append(str(caught.value))
    assert words[0] == words[1]


class Fatal:
    """Progress that ends the process after nine equilibria."""

    def stage(self, name):
        pass

    def update(self, text):
        if text == "equilibria: 9":
            os.kill(os.getpid(), signal.SIGKILL)


def test_a_run_that_was_killed_goes_on_and_gives_the_same(tmp_path):
    path = tmp_path / "rod.h5"

    def end() -> None:
        with listening(Fatal()):
            tabulated(tolerance=1e-5, checkpoint=path)

    ended = apart(end, tmp_path)
    assert ended.code == -signal.SIGKILL, ended.errors
    with h5py.File(path) as file:
        kept = len(file["keys"])
    # The first is written at once, the others as often as that takes little beside finding them.
    assert 1 <= kept <= 9
    straight_on = tabulated(tolerance=1e-5)
    again = tabulated(tolerance=1e-5, checkpoint=path, workers=2)
    assert same_bits(straight_on, again)
    assert again.report.restored == kept and again.report.solved == straight_on.report.solved - kept
    # What is complete costs nothing more, also to a larger tolerance; a smaller one goes on from there.
    assert tabulated(tolerance=1e-3, checkpoint=path).report.solved == 0
    finer = tabulated(tolerance=1e-9, checkpoint=path)
    assert finer.report.solved > 0 and same_bits(finer, tabulated(tolerance=1e-9))
    assert not [name for name in os.listdir(tmp_path) if name != "rod.h5"]


@pytest.mark.parametrize("name", ["X", "W", "moments", "modes", "keys"])
def test_a_checkpoint_of_other_shapes_is_named(tmp_path, name):
    path = tmp_path / "rod.h5"
    tabulated(points_per_angle=3, reach=0.3, checkpoint=path)
    with h5py.File(path, "a") as file:
        # Other writers may leave it out.
        del file["checksums"]
        value = file[name][()]
        del file[name]
        file[name] = value[..., None]
    with refusal("file", "rod.h5", name):
        tabulated(points_per_angle=3, reach=0.3, checkpoint=path)


def test_a_range_that_was_found_is_kept(tmp_path):
    path, options = tmp_path / "soft.h5", {"reach": AngleRange(angle=1.2), "tolerance": 0.05}
    first = tabulated(Softening(1e4), checkpoint=path, **options)
    again = tabulated(Softening(1e4), checkpoint=path, **options)
    assert again.report.solved == 0 and again.report.reach == first.report.reach and same_bits(first, again)
    assert again.report.notes == first.report.notes


def test_a_checkpoint_of_another_run_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "rod.h5"
    tabulated(points_per_angle=3, reach=0.3, checkpoint=path)
    before = path.read_bytes()
    with refusal("conflict", "checkpoint"):
        tabulated(rod(E=3.00001e6), points_per_angle=3, reach=0.3, checkpoint=path)
    with refusal("conflict", "checkpoint", "0.3", "0.4"):
        tabulated(points_per_angle=3, reach=0.4, checkpoint=path)
    assert path.read_bytes() == before
    for content in (before[: len(before) // 2], b"something else"):
        path.write_bytes(content)
        with refusal("file", "rod.h5"):
            tabulated(points_per_angle=3, reach=0.3, checkpoint=path)
        assert path.read_bytes() == content
    with h5py.File(path, "w") as file:
        file["other"] = 1.0
    with refusal("file", "rod.h5"):
        tabulated(points_per_angle=3, reach=0.3, checkpoint=path)
    with refusal("output", "", tmp_path / "none", by=OutputError):
        tabulated(points_per_angle=3, reach=0.3, checkpoint=tmp_path / "none" / "rod.h5")


def test_bad_plans_are_named():
    for options, words in (
        ({"workers": 0}, ("value", "workers")),
        ({"tolerance": 0.0}, ("value", "tolerance")),
        ({"reach": "far"}, ("value", "reach", "far")),
        ({"workers": "two"}, ("value", "workers", "two")),
        ({"points_per_angle": 5.5}, ("value", "points_per_angle", "5.5")),
    ):
        with refusal(*words):
            tabulated(**options)
    with refusal("value", "envelope"):
        AngleRange(angle=0.5, moment=1.0)
    with refusal("value", "moment", "-1"):
        AngleRange(moment=-1)
    with refusal("value", "angle", "3.2"):
        AngleRange(angle=3.2)
