# What ``import morembs`` offers, and where each name lives.
from . import examples
from .app.batches.run import batch
from .app.jobs.import_job import import_model
from .app.matrices import ReducedSystem, reduce
from .base.errors import InputError, MorembsError
from .base.units import parse_units
from .body import Body, ElasticBody, elastic_body, make_part
from .body.diagnostics import list_warnings
from .body.file import read_body, write_body
from .body.floating.frame import FloatingFrame, floating_frame
from .body.floating.ranking import ranked_terms
from .body.floating.spin import campbell
from .body.floating.spinning import Rotation, assemble_spin
from .body.floating.spinning_modes import spinning_modes
from .body.floating.stiffening import Envelope
from .body.floating.stiffening_terms import geometric_stiffening
from .body.recovery.recover import expand, recover
from .body.recovery.trajectory import Trajectory, read_trajectory
from .body.stress_shapes import stress_recovery
from .certificate.certify import certify
from .certificate.limits import error_limits
from .certificate.record import Certificate, ErrorLimits
from .certificate.response import full_response, reduced_response, to_xarray
from .dynamics.assembly import Couple, Substructure, Unreduced, assemble_bodies
from .exporters import export_body
from .exporters.state_space import StateSpace, state_space
from .fem import DofMap, ElementBlock, FEModel, Mesh, NamedColumns, Nodes
from .fem.assembly import assemble
from .fem.fe_model import split_unsymmetric
from .fem.interface import Interface, make_interface, matrix_interface
from .fem.material import Material, isotropic, orthotropic
from .fem.selection import select_nodes
from .fem.tubes import Flow, Tube, add_flow, tube_model
from .importers import read_deck, read_mesh
from .importers.decks.model import Deck
from .importers.matrices.from_matrices import from_matrices
from .importers.model_file import read_model, write_model
from .linalg.sparse.select import available_solvers, select_solver
from .problem import Damping, Problem
from .reducers import (
    REDUCERS,
    AutoReducer,
    BalancedTruncation,
    CraigBampton,
    FreeInterface,
    Gramian,
    Guyan,
    ImprovedReducedSystem,
    Irka,
    Krylov,
    Modal,
    ReducedModel,
    StaticModesSwitching,
)
from .reducers.pymor import from_pymor, to_pymor
from .responses.band import band_frequencies
from .responses.certified import certified_reference
from .responses.certified_reference import CertifiedReference
from .responses.direct import direct_response
from .responses.measures import Limit

__version__: str

__all__ = [
    "REDUCERS",
    "AutoReducer",
    "BalancedTruncation",
    "Body",
    "Certificate",
    "CertifiedReference",
    "Couple",
    "CraigBampton",
    "Damping",
    "Deck",
    "DofMap",
    "ElasticBody",
    "ElementBlock",
    "Envelope",
    "ErrorLimits",
    "FEModel",
    "FloatingFrame",
    "Flow",
    "FreeInterface",
    "Gramian",
    "Guyan",
    "ImprovedReducedSystem",
    "InputError",
    "Interface",
    "Irka",
    "Krylov",
    "Limit",
    "Material",
    "Mesh",
    "Modal",
    "MorembsError",
    "NamedColumns",
    "Nodes",
    "Problem",
    "ReducedModel",
    "ReducedSystem",
    "Rotation",
    "StateSpace",
    "StaticModesSwitching",
    "Substructure",
    "Trajectory",
    "Tube",
    "Unreduced",
    "add_flow",
    "assemble",
    "assemble_bodies",
    "assemble_spin",
    "available_solvers",
    "band_frequencies",
    "batch",
    "campbell",
    "certified_reference",
    "certify",
    "direct_response",
    "elastic_body",
    "error_limits",
    "examples",
    "expand",
    "export_body",
    "floating_frame",
    "from_matrices",
    "from_pymor",
    "full_response",
    "geometric_stiffening",
    "import_model",
    "isotropic",
    "list_warnings",
    "make_interface",
    "make_part",
    "matrix_interface",
    "orthotropic",
    "parse_units",
    "ranked_terms",
    "read_body",
    "read_deck",
    "read_mesh",
    "read_model",
    "read_trajectory",
    "recover",
    "reduce",
    "reduced_response",
    "select_nodes",
    "select_solver",
    "spinning_modes",
    "split_unsymmetric",
    "state_space",
    "stress_recovery",
    "to_pymor",
    "to_xarray",
    "tube_model",
    "write_body",
    "write_model",
]
