"""Chains of pieces in floating frames: against exact beams in space, beam theory, and themselves moved."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import morembs
from morembs.dynamics.multibody import (
    FixedJoint,
    PointLoad,
    System,
    divided_body,
    divided_mesh,
    equilibrium,
    ground,
    largest_turn,
    rotation,
    simulate,
)
from morembs.dynamics.nonlinear import BeamBody, SpatialBeam, SpatialSection, beam_pieces
from tests.support.meshes import box
from tests.support.refusals import refusal

# The bend of Bathe and Bolourchi (1979), with a mass.
BEND = SpatialSection(
    EA=1e7, GA2=0.5e7, GA3=0.5e7, GJ=1e7 / 12, EI2=1e7 / 12, EI3=1e7 / 12, mass=1.0, rotary=(1 / 6, 1 / 12, 1 / 12)
)
LENGTH = 100 * np.pi / 4


def helix(turns, elements, radius=0.02, pitch=0.015):
    """A spring of square wire along x."""
    a, c = np.linspace(0, 2 * np.pi * turns, elements + 1), pitch / (2 * np.pi)
    nodes = np.column_stack((c * a, radius * np.cos(a) - radius, radius * np.sin(a)))
    along = np.column_stack((c + 0 * a, -radius * np.sin(a), radius * np.cos(a))) / np.hypot(radius, c)
    across = np.column_stack((0 * a, -np.cos(a), -np.sin(a)))
    frames = np.stack((along, across, np.cross(along, across)), axis=2)
    return SpatialBeam(nodes, frames, SpatialSection.rectangle(0.003, 0.003, E=2e7, nu=0.4, density=1100.0))


def strip(cells=12, length=0.3):
    mesh = box("hex20", (cells, 1, 1), (length, 0.012, 0.006), lambda x: x - np.array([0, 0.006, 0.003]))
    x = mesh.nodes.xyz[:, 0]
    sets = {"ROOT": np.flatnonzero(x < 1e-9), "TIP": np.flatnonzero(x > length - 1e-9)}
    return replace(mesh, nodes=replace(mesh.nodes, sets=sets))


RUBBER = [morembs.isotropic(set="all", young=1e7, poisson=0.3, density=1100.0)]
LINE = [[0, 0, 0], [0.3, 0, 0]]


def test_a_swinging_bend_follows_the_exact_beam():
    beam = SpatialBeam.arc(100.0, np.pi / 4, 4, BEND)
    system, body = System(gravity=(0, 0, -9.81)), BeamBody(beam)
    system.add(body)
    system.add(FixedJoint(ground.marker_at(), body.marker("start")))
    exact = simulate(system, end=2.5, step=0.05).position(body.marker("end"))
    assert exact[-1, 2] < -20
    errors = []
    for pieces, modes in ((2, 2), (4, 0)):
        divided = divided_body(beam_pieces(beam, pieces), modes=modes)
        assert divided.reductions <= 3
        system = System(gravity=(0, 0, -9.81))
        bodies = divided.add(system, name="bend")
        system.add(FixedJoint(ground.marker_at(divided.start), bodies[0].marker("start")))
        result = simulate(system, end=2.5, step=0.05)
        path = result.position(bodies[-1].marker("end"))
        errors.append(np.sqrt(np.mean(np.sum((path - exact) ** 2, axis=1))) / LENGTH)
    assert 0.1 < largest_turn(result, bodies) < 0.6
    assert errors[0] < 1.5e-3 and errors[1] < 8e-4


def test_pieces_of_a_helix_are_one_reduction_and_may_be_moved():
    beam = helix(1, 8)
    divided = divided_body(beam_pieces(beam, 4), modes=1)
    assert divided.reductions == 1
    assert sum(frame.integrals.mass for frame in divided.frames) == pytest.approx(
        beam.section.mass * np.linalg.norm(np.diff(beam.nodes, axis=0), axis=1).sum(), rel=0.03
    )
    Q, at, paths = rotation((1, 2, 3), 1.1), np.array([0.1, -0.2, 0.3]), []
    for turn, step in ((np.eye(3), np.zeros(3)), (Q, at)):
        system = System(gravity=turn @ np.array([0, 0, -9.81]))
        bodies = divided.add(system, name="spring", position=step, rotation=turn)
        system.add(FixedJoint(ground.marker_at(turn @ divided.start + step), bodies[0].marker("start")))
        path = simulate(system, end=0.05, step=5e-3).position(bodies[-1].marker("end"))
        paths.append((path - step) @ turn)
    assert paths[0][0] == pytest.approx(beam.nodes[-1], abs=1e-12)
    assert np.linalg.norm(paths[0][-1] - paths[0][0]) > 2e-3
    assert np.abs(paths[1] - paths[0]).max() < 1e-8


def test_a_solid_strip_in_pieces_is_as_flexible_as_a_beam():
    divided = divided_body(divided_mesh(strip(), RUBBER, LINE, 3, start="ROOT", end="TIP"), modes=1)
    assert divided.reductions == 1
    assert divided.end == pytest.approx([0.3, 0, 0], abs=1e-12)
    assert sum(frame.integrals.mass for frame in divided.frames) == pytest.approx(1100 * 0.3 * 0.012 * 0.006)
    system = System()
    bodies = divided.add(system, name="strip")
    system.add(FixedJoint(ground.marker_at(divided.start), bodies[0].marker("start")))
    end = bodies[-1].marker("end")
    system.add(PointLoad(end, force=(0, 1e-3, -1e-3)))
    sag = equilibrium(system).result.position(end)[0]
    for axis, height, width, sign in ((1, 0.012, 0.006, 1), (2, 0.006, 0.012, -1)):
        exact = 1e-3 * 0.3**3 / (3 * 1e7 * width * height**3 / 12)
        # Rigid ends and cuts keep the section from contracting.
        assert 0.95 < sign * sag[axis] / exact < 1.0


def test_the_example_of_the_document(capsys):
    text = (Path(__file__).parents[2] / "docs" / "howto" / "multibody.md").read_text()
    (code,) = re.findall(r"```python divided\n(.*?)```", text, re.DOTALL)
    exec(compile(code, "multibody.md", "exec"), {})
    assert capsys.readouterr().out.startswith("1 [")


def test_materials_and_sets_go_with_their_elements():
    mesh = replace(strip(), element_sets={"first": (np.arange(6),), "second": (np.arange(6, 12),)})
    light, heavy = (replace(RUBBER[0], set=name, density=rho) for name, rho in (("first", 1100.0), ("second", 2200.0)))
    models = divided_mesh(mesh, [light, heavy], LINE, 3, start="ROOT", end="TIP")
    assert [len(model.nodes.sets["END"]) for model in models] == [8, 8, 8]
    masses = [model.M.sum() / 3 for model in models]
    assert masses == pytest.approx(1100 * 0.1 * 0.012 * 0.006 * np.array([1, 1.5, 2]))
    assert divided_body(models, modes=1).reductions == 3
    with refusal("unknown", "set"):
        divided_mesh(mesh, [light, heavy, replace(light, set="third")], LINE, 3, start="ROOT", end="TIP")


def test_divisions_that_cannot_be_are_refused():
    mesh = strip()
    with refusal("unknown", "set", "FOOT"):
        divided_mesh(mesh, RUBBER, LINE, 2, start="FOOT", end="TIP")
    with refusal("value", "pieces"):
        divided_mesh(mesh, RUBBER, LINE, 30, start="ROOT", end="TIP")
    with refusal("value", "points"):
        divided_mesh(mesh, RUBBER, [[0, 0, 0]], 2, start="ROOT", end="TIP")
    with refusal("value", "pieces"):
        divided_mesh(mesh, RUBBER, [[0.1, 0, 0], [0.3, 0, 0], [0, 0, 0]], 3, start="ROOT", end="TIP")
    with refusal("value", "pieces", "2.5"):
        divided_mesh(mesh, RUBBER, LINE, 2.5, start="ROOT", end="TIP")
    with refusal("value", "set", "8", "TIP"):
        divided_mesh(mesh, RUBBER, LINE, 3, start="TIP", end="ROOT")
    long = replace(mesh, nodes=replace(mesh.nodes, sets={**mesh.nodes.sets, "LONG": np.arange(len(mesh.nodes))}))
    with refusal("value", "set", "LONG"):
        divided_mesh(long, RUBBER, LINE, 2, start="ROOT", end="LONG")
    models = divided_mesh(mesh, RUBBER, LINE, 3, start="ROOT", end="TIP")
    with refusal("value", "models"):
        divided_body([models[0], models[2]], modes=1)
    with refusal("missing", "models"):
        divided_body([], modes=1)
    bare = replace(models[0], nodes=replace(models[0].nodes, sets={}))
    with refusal("unknown", "set", "START"):
        divided_body([bare], modes=1)
    with refusal("value", "pieces", "7", "6"):
        beam_pieces(SpatialBeam.arc(100.0, np.pi / 4, 6, BEND), 7)
