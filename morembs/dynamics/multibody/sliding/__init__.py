"""Loads and joints that slide along a body, whose static modes are switched on and off with them."""

from morembs.dynamics.multibody.sliding.body import SwitchingBody
from morembs.dynamics.multibody.sliding.handler import Activation, SlidingSwitch, UnfinishedRunError, simulate_sliding
from morembs.dynamics.multibody.sliding.loads import MovingLoad, PathSupport, PointOnPath
from morembs.dynamics.multibody.sliding.response import LocalResponse, local_response

__all__ = [
    "Activation",
    "LocalResponse",
    "MovingLoad",
    "PathSupport",
    "PointOnPath",
    "SlidingSwitch",
    "SwitchingBody",
    "UnfinishedRunError",
    "local_response",
    "simulate_sliding",
]
