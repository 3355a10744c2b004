"""Unilateral contact of points with surfaces, with friction and impacts."""

from morembs.dynamics.multibody.contact.curves import Path
from morembs.dynamics.multibody.contact.elements import ContactElement, PowerLaw, damping_factor
from morembs.dynamics.multibody.contact.kinematics import Compliant, Contact
from morembs.dynamics.multibody.contact.patches import TriangleSurface
from morembs.dynamics.multibody.contact.result import ContactError, ContactResult, Impact
from morembs.dynamics.multibody.contact.run import simulate_contact
from morembs.dynamics.multibody.contact.surfaces import GridSurface, Plane, Sphere, Surface
from morembs.dynamics.multibody.contact.table import ContactTable, Cylinder, contact_table

__all__ = [
    "Compliant",
    "Contact",
    "ContactElement",
    "ContactError",
    "ContactResult",
    "ContactTable",
    "Cylinder",
    "GridSurface",
    "Impact",
    "Path",
    "Plane",
    "PowerLaw",
    "Sphere",
    "Surface",
    "TriangleSurface",
    "contact_table",
    "damping_factor",
    "simulate_contact",
]
