"""morembs: finite-element models to small elastic bodies for multibody simulation.

The straight line: ``read_mesh`` -> ``assemble`` -> ``make_interface`` -> ``Problem`` -> a reducer's
``reduce`` -> ``elastic_body`` -> ``write_body``. Everything inside is in SI units.
"""

# First, as it quiets the idle threads of OpenBLAS before NumPy loads its copy.
import morembs.linalg  # noqa: F401

# isort: split
from morembs.body import ElasticBody, elastic_body, make_part
from morembs.body.file import read_body, write_body
from morembs.body.stress_shapes import stress_recovery
from morembs.certificate.certify import Certificate, certify
from morembs.certificate.response import full_response, reduced_response
from morembs.diagnostics import examined
from morembs.errors import InputError, MorembsError
from morembs.exporters import export_body
from morembs.floating.frame import FloatingFrame, floating_frame
from morembs.floating.ranking import ranked_terms
from morembs.floating.stiffening import Envelope
from morembs.floating.stiffening_terms import geometric_stiffening
from morembs.importers import read_mesh
from morembs.interface import Interface, make_interface
from morembs.linalg.sparse.select import available_solvers, select_solver
from morembs.model import FEModel, Mesh, Nodes
from morembs.model.assembly import assemble
from morembs.model.material import Material, isotropic, orthotropic
from morembs.model.selection import select_nodes
from morembs.problem import Damping, Problem
from morembs.recovery.recover import expand, recover
from morembs.recovery.trajectory import Trajectory, read_trajectory
from morembs.reducers import (
    REDUCERS,
    Automatic,
    Balanced,
    CraigBampton,
    FreeInterface,
    Gramian,
    Guyan,
    Irka,
    Krylov,
    Modal,
    ReducedModel,
    StaticModesSwitching,
)
from morembs.responses.band import band_frequencies
from morembs.responses.direct import direct_response
from morembs.units import parse_units
from morembs.version import VERSION

__version__ = VERSION

__all__ = [
    "REDUCERS",
    "Automatic",
    "Balanced",
    "Certificate",
    "CraigBampton",
    "Damping",
    "ElasticBody",
    "Envelope",
    "FEModel",
    "FloatingFrame",
    "FreeInterface",
    "Gramian",
    "Guyan",
    "InputError",
    "Interface",
    "Irka",
    "Krylov",
    "Material",
    "Mesh",
    "Modal",
    "MorembsError",
    "Nodes",
    "Problem",
    "ReducedModel",
    "StaticModesSwitching",
    "Trajectory",
    "assemble",
    "available_solvers",
    "band_frequencies",
    "certify",
    "direct_response",
    "elastic_body",
    "examined",
    "expand",
    "export_body",
    "floating_frame",
    "full_response",
    "geometric_stiffening",
    "isotropic",
    "make_interface",
    "make_part",
    "orthotropic",
    "parse_units",
    "ranked_terms",
    "read_body",
    "read_mesh",
    "read_trajectory",
    "recover",
    "reduced_response",
    "select_nodes",
    "select_solver",
    "stress_recovery",
    "write_body",
]
