"""A small reference simulator for systems of rigid and elastic bodies; it proves reduced bodies.

system = System(gravity=(0, 0, -9.81))
rod = system.add(RigidBody(2.0, (0.1, 0.1, 0.01), position=(0, 0, 1), markers={"end": (0, 0, 0.5)}))
joint = system.add(RevoluteJoint(ground.marker_at((0, 0, 1.5)), rod.marker("end"), axis=(0, 1, 0)))
result = simulate(system, end=0.5, step=1e-3)
result.position(rod.marker("end")), result.reaction(joint), result.energy().total
"""

from morembs.dynamics.multibody.bodies import FlexibleBody, RigidBody
from morembs.dynamics.multibody.component import Component, Ground, Marker, MarkerState, VectorComponent
from morembs.dynamics.multibody.contact import (
    Compliant,
    Contact,
    ContactElement,
    ContactError,
    ContactResult,
    ContactTable,
    Cylinder,
    GridSurface,
    Impact,
    Path,
    Plane,
    PowerLaw,
    Sphere,
    Surface,
    TriangleSurface,
    contact_table,
    damping_factor,
    simulate_contact,
)
from morembs.dynamics.multibody.divided import DividedBody, divided_body, divided_mesh, largest_turn
from morembs.dynamics.multibody.equilibrium import Equilibrium, equilibrium
from morembs.dynamics.multibody.floating_body import BodyMarker, FloatingBody
from morembs.dynamics.multibody.forces import Force, PointLoad, SpringDamper, TorsionSpring
from morembs.dynamics.multibody.joints import (
    Constraint,
    DrivenAngle,
    DrivenPosition,
    FixedJoint,
    Motion,
    PrismaticJoint,
    RevoluteJoint,
    SphericalJoint,
)
from morembs.dynamics.multibody.linear_body import LinearBody
from morembs.dynamics.multibody.linearise import Linearization, linearize
from morembs.dynamics.multibody.result import Energy, Result, ResultSensitivity
from morembs.dynamics.multibody.rotations import rotation
from morembs.dynamics.multibody.run import EventHandler, RestartState, simulate
from morembs.dynamics.multibody.segment import Segment
from morembs.dynamics.multibody.sliding import (
    Activation,
    LocalResponse,
    MovingLoad,
    PathSupport,
    PointOnPath,
    SlidingSwitch,
    SwitchingBody,
    UnfinishedRunError,
    local_response,
    simulate_sliding,
)
from morembs.dynamics.multibody.steady_spin import SteadySpin
from morembs.dynamics.multibody.system import Assembly, State, System

ground = Ground()


__all__ = [
    "Activation",
    "Assembly",
    "BodyMarker",
    "Compliant",
    "Component",
    "Constraint",
    "Contact",
    "ContactElement",
    "ContactError",
    "ContactResult",
    "ContactTable",
    "Cylinder",
    "DividedBody",
    "DrivenAngle",
    "DrivenPosition",
    "Energy",
    "Equilibrium",
    "EventHandler",
    "FixedJoint",
    "FlexibleBody",
    "FloatingBody",
    "Force",
    "GridSurface",
    "Ground",
    "Impact",
    "LinearBody",
    "Linearization",
    "LocalResponse",
    "Marker",
    "MarkerState",
    "Motion",
    "MovingLoad",
    "Path",
    "PathSupport",
    "Plane",
    "PointLoad",
    "PointOnPath",
    "PowerLaw",
    "PrismaticJoint",
    "RestartState",
    "Result",
    "ResultSensitivity",
    "RevoluteJoint",
    "RigidBody",
    "Segment",
    "SlidingSwitch",
    "Sphere",
    "SphericalJoint",
    "SpringDamper",
    "State",
    "SteadySpin",
    "Surface",
    "SwitchingBody",
    "System",
    "TorsionSpring",
    "TriangleSurface",
    "UnfinishedRunError",
    "VectorComponent",
    "contact_table",
    "damping_factor",
    "divided_body",
    "divided_mesh",
    "equilibrium",
    "ground",
    "largest_turn",
    "linearize",
    "local_response",
    "rotation",
    "simulate",
    "simulate_contact",
    "simulate_sliding",
]
