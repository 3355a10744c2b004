"""Members between held frames: arcs of circles, a heavy test of forces by differences, and the verb ``evaluate``."""

import csv
import json

import numpy as np
import pytest

from morembs.base.errors import SolverError
from morembs.dynamics.gmp import ReducedMember, configuration
from morembs.dynamics.gmp.configuration import FRAME_COORDINATES
from morembs.dynamics.gmp.stored import write_members
from morembs.dynamics.nonlinear import PlanarBeam, Section
from tests.support.processes import morembs
from tests.support.refusals import refusal

LENGTH, EI = 0.304, 3e6 * 4.909e-10


@pytest.fixture(scope="module")
def member():
    beam = PlanarBeam.straight(LENGTH, 12, Section.of(E=3e6, A=7.854e-5, I=4.909e-10, density=2770))
    return ReducedMember(beam, modes=3, formulation="membrane", reach=0.85, points_per_angle=9)


def arc(angle, turn=0.0, at=(0.0, 0.0)):
    """Frames of an arc of a circle whose ends are turned by ``angle`` from the chord, on which nothing pulls."""
    chord = LENGTH * np.sin(angle) / angle
    end = np.array(at) + chord * np.array([np.cos(turn), np.sin(turn)])
    values = (*at, turn - angle, *end, turn + angle)
    return dict(zip(FRAME_COORDINATES, map(float, values), strict=True))


@pytest.mark.parametrize(("turn", "at"), [(0.0, (0.0, 0.0)), (2.0, (0.3, -0.1))])
def test_a_member_between_the_ends_of_an_arc_is_the_arc(member, turn, at):
    angle = 0.5
    found = configuration(member, arc(angle, turn, at))
    assert found.ends == pytest.approx([-angle, angle], abs=1e-12)
    assert found.energy == pytest.approx(0.5 * EI * (2 * angle) ** 2 / LENGTH, rel=1e-4)
    moment = EI * 2 * angle / LENGTH
    assert found.loads == pytest.approx([0, 0, -moment, 0, 0, moment], abs=1e-3 * moment / LENGTH)
    center = np.array(at) + LENGTH / (2 * angle) * np.array([-np.sin(turn - angle), np.cos(turn - angle)])
    radii = np.linalg.norm(found.places - center, axis=1)
    assert radii == pytest.approx(np.full(13, LENGTH / (2 * angle)), rel=1e-4)
    assert found.rotations[[0, -1]] == pytest.approx([turn - angle, turn + angle], abs=1e-9)


def test_loads_are_the_slope_of_the_energy(member):
    """With amplitudes that answer; these do no work in equilibrium."""
    at = arc(0.4) | {"end.y": 0.03, "end.x": 0.98 * LENGTH, "start.angle": -0.1}
    found, h = configuration(member, at), 1e-6
    assert np.abs(found.eta).max() > 0
    for k, name in enumerate(FRAME_COORDINATES):
        ahead, behind = (configuration(member, at | {name: at[name] + step}).energy for step in (h, -h))
        assert (ahead - behind) / (2 * h) == pytest.approx(found.loads[k], abs=1e-5 * np.abs(found.loads).max())


def test_what_has_no_configuration_is_named(member):
    for at, words in (
        ({"end.angle": 0.9}, ("value", "at")),
        ({"end.angel": 0.1}, ("unknown", "at", "end.angle")),
        ({"end.x": 0.0}, ("value", "at")),
    ):
        with refusal(*words):
            configuration(member, at)
    with refusal("result", "at", by=SolverError):
        configuration(member, {"end.x": 0.9 * LENGTH})


def test_the_command_line_evaluates_members(member, tmp_path):
    write_members(tmp_path / "two.h5", {"a": member.data, "b": member.data})
    at = ",".join(f"{name}={value!r}" for name, value in arc(0.5).items())
    done = morembs("evaluate", "two.h5", "--body", "b", "--at", at, "--out", "arc.csv", folder=tmp_path)
    assert done.code == 0 and "end angles to its chord: -0.5 and 0.5 rad" in done.output and "arc.csv" in done.output
    expected = configuration(member, arc(0.5))
    rows = list(csv.reader((tmp_path / "arc.csv").open()))
    assert rows[0] == ["x_m", "y_m", "rotation_rad"]
    assert np.array(rows[1:], dtype=float)[:, :2] == pytest.approx(expected.places, abs=1e-15)
    told = json.loads(morembs("evaluate", "two.h5", "--body", "a", "--json", folder=tmp_path).output)[0]
    assert told["energy_j"] == pytest.approx(0, abs=1e-12) and told["at"]["end.x"] == pytest.approx(LENGTH)
    for arguments, words in (
        (("--at", at), "holds the members a, b; name one"),
        (("--body", "c"), "has no member 'c'"),
        (("--body", "a", "--sensitivity"), "which take --at start.angle=0.2"),
        (("--body", "a", "--out", "x.h5"), "ends in .csv"),
    ):
        refused = morembs("evaluate", "two.h5", *arguments, folder=tmp_path)
        assert refused.code == 2 and words in refused.errors, refused.errors
