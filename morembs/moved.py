"""Modules by the names that they had in version 0.1: importing one warns and gives the module that took its place.

Goes with the next version.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, TypeVar

Class = TypeVar("Class")

MOVED = {
    "conversion": "importers",
    "conversion.coupled_model": "model.fe_model",
    "conversion.followers": "importers.dependent_dofs",
    "conversion.imported": "importers.imported",
    "conversion.point_masses": "importers.point_masses",
    "conversion.to_model": "importers.to_model",
    "damping": "problem.damping",
    "delivery": "body.build",
    "doctor": "diagnostics",
    "doctor.examine": "diagnostics.doctor",
    "doctor.findings": "diagnostics.findings",
    "doctor.mass": "diagnostics.mass",
    "doctor.matrices": "diagnostics.matrices",
    "doctor.modes": "diagnostics.modes",
    "doctor.parts": "diagnostics.parts",
    "doctor.rigid": "diagnostics.rigid",
    "doctor.units": "diagnostics.units",
    "elements": "model.elements",
    "examination": "diagnostics",
    "examination.delivered": "body.delivered",
    "examination.delivery_check": "body.delivery_check",
    "examination.warnings": "diagnostics.warnings",
    "fem": "model.assembly",
    "floating.geometric_stiffness": "model.geometric_stiffness",
    "linalg.amg": "linalg.sparse.amg",
    "linalg.cholmod": "linalg.sparse.cholmod",
    "linalg.cholmod_library": "linalg.sparse.cholmod_library",
    "linalg.cholmod_session": "linalg.sparse.cholmod_session",
    "linalg.conjugate_gradient": "linalg.sparse.conjugate_gradient",
    "linalg.interruptible": "linalg.sparse.interruptible",
    "linalg.mixed": "linalg.sparse.mixed",
    "linalg.mumps": "linalg.sparse.mumps",
    "linalg.mumps_instance": "linalg.sparse.mumps_instance",
    "linalg.mumps_library": "linalg.sparse.mumps_library",
    "linalg.ordering": "linalg.sparse.ordering",
    "linalg.orthogonal": "linalg.columns",
    "linalg.pardiso": "linalg.sparse.pardiso",
    "linalg.pardiso_library": "linalg.sparse.pardiso_library",
    "linalg.select": "linalg.sparse.select",
    "linalg.solver": "linalg.sparse.solver",
    "linalg.superlu": "linalg.sparse.superlu",
    "linalg.symmetric": "linalg.sparse.symmetric",
    "linalg.threads": "linalg.sparse.threads",
    "linalg.umfpack": "linalg.sparse.umfpack",
    "mass": "model.mass",
    "material": "model.material",
    "multibody.contact_impact": "multibody.contact.impact",
    "multibody.contact_law": "multibody.contact.lcp",
    "multibody.contact_patches": "multibody.contact.patches",
    "multibody.contact_result": "multibody.contact.result",
    "multibody.contact_run": "multibody.contact.run",
    "multibody.contact_start": "multibody.contact.reactions",
    "multibody.contact_step": "multibody.contact.kinematics",
    "multibody.lemke": "multibody.contact.lemke",
    "multibody.local_response": "multibody.sliding.response",
    "multibody.path_place": "multibody.sliding.path",
    "multibody.sliding_switch": "multibody.sliding.handler",
    "multibody.surfaces": "multibody.contact.surfaces",
    "multibody.switching": "multibody.sliding.body",
    "jobs.duration": "reducers.cost",
    "picture": "jobs.picture",
    "preload": "floating.preload",
    "responses.certify": "certificate.certify",
    "responses.residual": "responses.krylov_space",
    "responses.response": "certificate.response",
    "selection": "model.selection",
    "storage.body_file": "body.file",
    "storage.model_file": "importers.model_file",
    "storage.stored": "body.stored",
    "storage.stored_certificate": "body.tables",
    "storage.stored_check": "body.stored_check",
    "storage.stored_frame": "body.tables",
    "storage.stored_switching": "body.tables",
    "storage.vtkhdf": "body.vtkhdf",
    "storage.vtkhdf_series": "body.vtkhdf_series",
    "stress": "recovery",
    "stress.operator": "model.stress_operator",
    "stress.recovery": "recovery.recover",
    "stress.shapes": "body.stress_shapes",
    "stress.trajectory": "recovery.trajectory",
    "surface": "model.surface",
    "switching": "reducers.switching_tables",
}


class _KeepsFunctions(ModuleType):
    """A package with a function by the name of an old module, which the import system would put in its place."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (isinstance(value, ModuleType) and callable(vars(self).get(name))):
            super().__setattr__(name, value)


class _Moved(MetaPathFinder, Loader):
    """Finds the modules of ``MOVED``.

    Asked first: a package that took another's place has files of its own, which would be found by old names too, and
    loaded once more.
    """

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        old = name.removeprefix("morembs.")
        return ModuleSpec(name, self, is_package=True) if old != name and old in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        new = "morembs." + MOVED[spec.name.removeprefix("morembs.")]
        warnings.warn(f"{spec.name} is now {new}; the old name goes with the next version", DeprecationWarning, 2)
        module = importlib.import_module(new)
        self._spec = module.__spec__
        package, _, name = spec.name.rpartition(".")
        if callable(getattr(sys.modules[package], name, None)):
            sys.modules[package].__class__ = _KeepsFunctions
        return module

    def exec_module(self, module: ModuleType) -> None:
        # The import system has put the specification of the old name in place of its own.
        module.__spec__ = self._spec


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """``__getattr__`` of ``module``, which gives what it now calls ``names[old]`` for an old name, and warns."""

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        new = names[name]
        warnings.warn(f"{module}.{name} is now {new}; the old name goes with the next version", DeprecationWarning, 2)
        return getattr(sys.modules[module], new)

    return find


def with_old_names(**names: str) -> Callable[[type[Class]], type[Class]]:
    """Decorates a class whose fields, properties or methods had other names: ``old="new"``.

    An old name warns, as an attribute and as a keyword of the constructor.
    """

    def decorate(cls: type[Class]) -> type[Class]:
        construct = cls.__init__

        def warned(old: str) -> str:
            text = f"{old} of {cls.__name__} is now {names[old]}; the old name goes with the next version"
            warnings.warn(text, DeprecationWarning, 3)
            return names[old]

        @wraps(construct)
        def accept(self: Any, *values: Any, **keys: Any) -> None:
            for old in names.keys() & keys.keys():
                keys[warned(old)] = keys.pop(old)
            construct(self, *values, **keys)

        cls.__init__ = accept  # type: ignore[method-assign]

        def reader(old: str) -> Callable[[Any], Any]:
            return lambda self: getattr(self, warned(old))

        for name in names:
            setattr(cls, name, property(reader(name)))
        return cls

    return decorate


def accept_old_names() -> None:
    """Have the old names imported from now on."""
    if not any(isinstance(finder, _Moved) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Moved())
