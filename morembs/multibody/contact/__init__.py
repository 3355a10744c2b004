"""Unilateral contact of points with surfaces, with friction and impacts."""

from morembs.multibody.contact.curves import Path
from morembs.multibody.contact.elements import ContactElement, PowerLaw, damping_factor
from morembs.multibody.contact.kinematics import Compliant, Contact
from morembs.multibody.contact.patches import TriangleSurface
from morembs.multibody.contact.result import ContactError, ContactResult, Impact
from morembs.multibody.contact.run import simulate_contact
from morembs.multibody.contact.surfaces import GridSurface, Plane, Sphere, Surface
from morembs.multibody.contact.table import ContactTable, Cylinder, contact_table

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
