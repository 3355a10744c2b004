"""Reduction methods; the table below is the contents page."""

from __future__ import annotations

from morembs.reducers.automatic import Automatic
from morembs.reducers.base import MODE_KINDS, Basis, ReducedModel, Reducer
from morembs.reducers.craig_bampton import CraigBampton
from morembs.reducers.free_interface import FreeInterface
from morembs.reducers.guyan import Guyan
from morembs.reducers.modal import Modal

REDUCERS: dict[str, type[Reducer]] = {
    reducer.method: reducer for reducer in (Modal, Guyan, CraigBampton, FreeInterface, Automatic)
}

__all__ = [
    "MODE_KINDS", "REDUCERS", "Automatic", "Basis", "CraigBampton", "FreeInterface", "Guyan", "Modal", "ReducedModel",
    "Reducer",
]  # fmt: skip
