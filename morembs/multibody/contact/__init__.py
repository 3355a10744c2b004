"""Unilateral contact of points with surfaces, with friction and impacts."""

from morembs.multibody.contact.kinematics import Compliant, Contact
from morembs.multibody.contact.patches import TriangleSurface
from morembs.multibody.contact.result import ContactError, ContactResult, Impact
from morembs.multibody.contact.run import simulate_contact
from morembs.multibody.contact.surfaces import GridSurface, Path, Plane, Sphere, Surface

__all__ = [
    "Compliant",
    "Contact",
    "ContactError",
    "ContactResult",
    "GridSurface",
    "Impact",
    "Path",
    "Plane",
    "Sphere",
    "Surface",
    "TriangleSurface",
    "simulate_contact",
]
