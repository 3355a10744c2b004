"""Arguments of wrong types: one message in place of what Python would say in the depth."""

from __future__ import annotations

import numpy as np
import pytest

import morembs
from morembs.base.arguments import checked
from morembs.dynamics import gmp, multibody, nonlinear
from tests.support.refusals import refusal

SECTION = nonlinear.Section(EA=1e6, GA=1e6, EI=1.0, mass=1.0)
LINE = np.linspace([0.0, 0, 0], [1.0, 0, 0], 9)
TUBE = {"outer": 0.02, "inner": 0.016, "young": 2e11, "density": 7800.0}
BODY = multibody.RigidBody(1.0, (1, 1, 1), markers={"top": (0, 0, 1)})
ENDS = multibody.ground.marker_at((0, 0, 1)), BODY.marker("top")
WRONG = [
    (morembs.Tube, {**TUBE, "outer": "a"}, ("value", "outer", "a")),
    (morembs.Tube, {**TUBE, "young": float("nan")}, ("value", "young")),
    (morembs.Flow, {"mass_flow": [1], "density": 1.0, "area": 1.0}, ("value", "mass_flow")),
    (morembs.tube_model, {"points": LINE, "tube": 3}, ("value", "tube")),
    (morembs.tube_model, {"points": "LINE", "tube": morembs.Tube(**TUBE)}, ("value", "points")),
    (morembs.tube_model, {"points": LINE, "tube": morembs.Tube(**TUBE), "held": "a"}, ("value", "held", "a")),
    (morembs.Nodes, {"ids": np.array([1.5]), "xyz": LINE[:1]}, ("value", "ids")),
    (morembs.Damping, {"alpha": "a"}, ("value", "alpha", "a")),
    (morembs.isotropic, {"set": "all", "young": None, "poisson": 0.3, "density": 1.0}, ("value", "young")),
    (morembs.isotropic, {"set": "all", "young": float("inf"), "poisson": 0.3, "density": 1.0}, ("value", "young")),
    (morembs.Material, {"set": "all", "stiffness": np.eye(3), "density": 1.0}, ("value", "stiffness", "6")),
    (multibody.FlexibleBody, {"frame": None}, ("value", "frame")),
    (multibody.RigidBody, {"mass": 1.0, "inertia": (1, 1, 1), "markers": [1]}, ("value", "markers")),
    (multibody.LinearBody, {"M": np.eye(1), "K": 1.0}, ("value", "K")),
    (multibody.SphericalJoint, {"first": "a", "second": ENDS[1]}, ("value", "first", "a")),
    (multibody.DrivenAngle, {"first": ENDS[0], "second": ENDS[1], "motion": 3.0}, ("value", "motion")),
    (multibody.Motion.smooth, {"change": "a", "duration": 1.0}, ("value", "change", "a")),
    (multibody.Motion.smooth, {"change": 1.0, "duration": 0.0}, ("value", "duration", "0.0")),
    (multibody.Sphere, {"center": (0, 0, 0), "radius": -1.0, "name": "ball"}, ("value", "radius", "ball", "-1.0")),
    (multibody.SpringDamper, {"first": ENDS[0], "second": ENDS[1], "stiffness": -1.0}, ("value", "stiffness")),
    (morembs.Envelope, {"speed": -1.0}, ("value", "speed", "-1.0")),
    (morembs.Rotation, {"axis": (0, 0, 0)}, ("value", "axis")),
    (multibody.PowerLaw, {"stiffness": "a"}, ("value", "stiffness", "a")),
    (multibody.ContactTable, {"penetration": [1.0, 2.0], "forces": [1.0, 2.0], "area": [1.0]}, ("value", "area")),
    (multibody.simulate, {"system": None, "end": 1.0, "step": 0.1}, ("value", "system")),
    (multibody.simulate, {"system": multibody.System(), "end": "1 s", "step": 0.1}, ("value", "end")),
    (nonlinear.PlanarBeam, {"nodes": LINE, "section": 3}, ("value", "section")),
    (nonlinear.PlanarBeam.straight, {"length": 1.0, "elements": 1.5, "section": SECTION}, ("value", "elements")),
    (nonlinear.Chain, {"links": [1]}, ("value", "links")),
    (nonlinear.follow_equilibrium, {"component": LINE, "held": np.arange(3)}, ("value", "component")),
    (gmp.Plan, {"workers": "two"}, ("value", "workers", "two")),
    (gmp.bending_modes, {"component": nonlinear.PlanarBeam(LINE, SECTION), "count": 2}, ("model", "mass")),
]


@pytest.mark.parametrize(("call", "given", "message"), WRONG)
def test_wrong_arguments_are_refused_in_one_message(call, given, message):
    with refusal(*message):
        call(**given)


def test_derivatives_of_a_flexible_body_are_frames_by_name():
    mesh = morembs.read_mesh("data/small_meshes/bracket.msh", "mm-t-s")
    steel = morembs.isotropic(set="all", young=2.1e11, poisson=0.3, density=7850.0)
    with morembs.Problem(morembs.assemble(mesh, [steel])) as problem:
        reduced = morembs.Modal(modes=2).reduce(problem)
        frame = morembs.floating_frame(problem, reduced)
    for wrong in ([frame], {"young": 3}, "young"):
        with refusal("value", "derivatives"):
            multibody.FlexibleBody(frame, derivatives=wrong)


def test_what_fits_is_handed_on_as_it_is():
    @checked
    def call(a: float, b: tuple[int, ...] = (), c: str | None = None, **more: int) -> object:
        return a, b, c, more

    numbers = np.arange(3)
    assert call(np.float32(2), numbers, c=None, d="x") == (2, numbers, None, {"d": "x"})
    with refusal("missing", "a", by=TypeError):
        call()
