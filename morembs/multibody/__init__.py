"""A small reference simulator for systems of rigid and elastic bodies; it proves reduced bodies.

system = System(gravity=(0, 0, -9.81))
rod = system.add(RigidBody(2.0, (0.1, 0.1, 0.01), position=(0, 0, 1), markers={"end": (0, 0, 0.5)}))
joint = system.add(RevoluteJoint(ground.marker_at((0, 0, 1.5)), rod.marker("end"), axis=(0, 1, 0)))
result = simulate(system, end=0.5, step=1e-3)
result.position(rod.marker("end")), result.reaction(joint), result.energy().total
"""

from morembs.multibody.bodies import BodyMarker, FlexibleBody, FloatingBody, RigidBody
from morembs.multibody.component import Component, Ground, Marker, Place, VectorComponent
from morembs.multibody.contact import Compliant, Contact
from morembs.multibody.contact_patches import TriangleSurface
from morembs.multibody.contact_result import ContactError, ContactResult, Impact
from morembs.multibody.contact_run import simulate_contact
from morembs.multibody.forces import Force, PointLoad, SpringDamper, TorsionSpring
from morembs.multibody.integrate import State
from morembs.multibody.joints import (
    Constraint,
    DrivenAngle,
    DrivenPosition,
    FixedJoint,
    Motion,
    PrismaticJoint,
    RevoluteJoint,
    SphericalJoint,
)
from morembs.multibody.linear_body import LinearBody
from morembs.multibody.local_response import LocalResponse, local_response
from morembs.multibody.result import Energy, Result, Segment
from morembs.multibody.rotations import rotation
from morembs.multibody.run import Restart, Switch, simulate
from morembs.multibody.sliding import MovingLoad, PathSupport, PointOnPath
from morembs.multibody.sliding_switch import Activation, SlidingSwitch, UnfinishedRunError, simulate_sliding
from morembs.multibody.surfaces import GridSurface, Path, Plane, Sphere, Surface
from morembs.multibody.switching import SwitchingBody
from morembs.multibody.system import Assembly, System

ground = Ground()

__all__ = [
    "Activation",
    "Assembly",
    "BodyMarker",
    "Compliant",
    "Component",
    "Constraint",
    "Contact",
    "ContactError",
    "ContactResult",
    "DrivenAngle",
    "DrivenPosition",
    "Energy",
    "FixedJoint",
    "FlexibleBody",
    "FloatingBody",
    "Force",
    "GridSurface",
    "Ground",
    "Impact",
    "LinearBody",
    "LocalResponse",
    "Marker",
    "Motion",
    "MovingLoad",
    "Path",
    "PathSupport",
    "Place",
    "Plane",
    "PointLoad",
    "PointOnPath",
    "PrismaticJoint",
    "Restart",
    "Result",
    "RevoluteJoint",
    "RigidBody",
    "Segment",
    "SlidingSwitch",
    "Sphere",
    "SphericalJoint",
    "SpringDamper",
    "State",
    "Surface",
    "Switch",
    "SwitchingBody",
    "System",
    "TorsionSpring",
    "TriangleSurface",
    "UnfinishedRunError",
    "VectorComponent",
    "ground",
    "local_response",
    "rotation",
    "simulate",
    "simulate_contact",
    "simulate_sliding",
]
