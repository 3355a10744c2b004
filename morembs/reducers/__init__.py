"""Reduction methods; the table below is the contents page."""

from __future__ import annotations

from morembs.base.arguments import explain_misfit
from morembs.base.plugins import Registry, subclass_fault
from morembs.reducers.automatic import AutoReducer
from morembs.reducers.balanced import BalancedTruncation
from morembs.reducers.base import MODE_KINDS, Basis, ReducedModel, Reducer
from morembs.reducers.craig_bampton import CraigBampton
from morembs.reducers.free_interface import FreeInterface
from morembs.reducers.gramian import Gramian
from morembs.reducers.guyan import Guyan
from morembs.reducers.improved_reduced_system import ImprovedReducedSystem
from morembs.reducers.irka import Irka
from morembs.reducers.krylov import Krylov
from morembs.reducers.modal import Modal
from morembs.reducers.parametric import ParametricReducer
from morembs.reducers.problem_summary import ProblemSummary
from morembs.reducers.static_modes_switching import StaticModesSwitching

# One line for each method.
_OWN: tuple[type[Reducer], ...] = (
    AutoReducer,
    Modal,
    Guyan,
    ImprovedReducedSystem,
    CraigBampton,
    FreeInterface,
    Krylov,
    Gramian,
    BalancedTruncation,
    Irka,
    StaticModesSwitching,
    ParametricReducer,
)
REDUCERS: Registry[type[Reducer]] = Registry(
    "morembs.reducers", {reducer.method: reducer for reducer in _OWN}, subclass_fault(Reducer, "method")
)

_MEMBERS = "it reduces planar members: give the job a table [member] in place of a mesh (docs/howto/gmp.md)"
REDUCERS.nicknames = {
    "gmp": _MEMBERS,
    "global-modal-parameterisation": _MEMBERS,
    "global-modal-parameterization": _MEMBERS,
    "bt": "balanced-truncation",
    "balanced": "balanced-truncation",
    "cb": "craig-bampton",
    "cms": "craig-bampton",
    "hurty": "craig-bampton",
    "rubin": "free-interface",
    "macneal": "free-interface",
    "static-condensation": "guyan",
    "moment-matching": "krylov",
    "pod": "gramian",
    "sms": "static-modes-switching",
    "eigenmodes": "modal",
}
for _reducer in _OWN:
    explain_misfit(_reducer)

__all__ = [
    "MODE_KINDS",
    "REDUCERS",
    "AutoReducer",
    "BalancedTruncation",
    "Basis",
    "CraigBampton",
    "FreeInterface",
    "Gramian",
    "Guyan",
    "ImprovedReducedSystem",
    "Irka",
    "Krylov",
    "Modal",
    "ParametricReducer",
    "ProblemSummary",
    "ReducedModel",
    "Reducer",
    "StaticModesSwitching",
]
