"""Names of 0.1.0 go on working for a version."""

from __future__ import annotations

import dataclasses
import importlib
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest

import morembs
from morembs.moved import MOVED
from morembs.reducers import Basis

# What ``from morembs import *`` gave in 0.1.0.
RELEASED = """
REDUCERS Automatic Balanced Certificate CraigBampton Damping ElasticBody Envelope FEModel FloatingFrame FreeInterface
Gramian Guyan InputError Interface Irka Krylov Material Mesh Modal MorembsError Nodes Problem ReducedModel
StaticModesSwitching Trajectory assemble available_solvers band_frequencies certify direct_response elastic_body
examined expand export_body floating_frame full_response geometric_stiffening isotropic make_interface make_part
orthotropic parse_units ranked_terms read_body read_mesh read_trajectory recover reduced_response select_nodes
select_solver stress_recovery write_body
"""


@pytest.mark.parametrize("old", MOVED)
def test_an_old_module_warns_and_gives_the_new_one(old: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [item for item in sys.modules if item.removeprefix("morembs.") in MOVED]:
        monkeypatch.delitem(sys.modules, name)
    # An imported module is an attribute of its package, where a function may have the same name.
    package, _, last = f"morembs.{old}".rpartition(".")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        holder = importlib.import_module(package)
    monkeypatch.setattr(holder, last, getattr(holder, last, None), raising=False)
    new = importlib.import_module(f"morembs.{MOVED[old]}")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        module = importlib.import_module(f"morembs.{old}")
    assert module is new and module.__name__ == f"morembs.{MOVED[old]}"
    sentences = [str(item.message) for item in caught if item.category is DeprecationWarning]
    assert f"morembs.{old} is now morembs.{MOVED[old]}; the old name goes with the next version" in sentences
    # Nothing that exists bears an old name: the warning would never be seen.
    assert old not in MOVED.values()


@pytest.mark.parametrize("module", ["multibody.local_response", "doctor.examine"])
def test_a_function_is_not_hidden_by_an_old_module_of_its_name(module: str) -> None:
    package, _, name = module.rpartition(".")
    code = (
        f"import morembs.{package} as package; function = package.{name}; import morembs.{module}; "
        f"from morembs.{module} import __name__ as new; from morembs.{package} import {name} as again; "
        f"package.other = 1; print(callable(function), function is package.{name} is again, new)"
    )
    done = subprocess.run([sys.executable, "-W", "default", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == f"True True morembs.{MOVED[module]}\n"
    assert done.stderr.count(f"morembs.{module} is now") == 1


@pytest.mark.parametrize("name", RELEASED.split())
def test_an_old_public_name_is_still_there(name: str) -> None:
    assert name in morembs.__all__ and getattr(morembs, name) is not None


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("linalg.columns", "remove", "project_out"),
        ("linalg.columns", "combine", "multiply_into"),
        ("linalg.columns", "beside", "hstack"),
        ("linalg.columns", "m_orthonormal", "orthonormal"),
        ("linalg.statics", "Restricted", "ConstrainedStatics"),
        ("linalg.statics", "solved", "map_columns"),
        ("linalg.eigen", "signed", "fix_signs"),
        ("linalg.dynamic_stiffness", "held", "constrained"),
        ("linalg.dynamic_stiffness", "sprung", "grounded"),
        ("linalg.sparse.select", "Automatic", "AutoSolver"),
        ("reducers", "Automatic", "AutoReducer"),
        ("reducers.switching_tables", "Switching", "StaticModeTables"),
        ("floating.frame", "Marker", "InterfaceMarker"),
        ("gmp", "Envelope", "AngleRange"),
        ("gmp", "Table", "ChebyshevTable"),
    ],
)
def test_an_old_name_in_a_module_warns_and_gives_the_new_one(module: str, old: str, new: str) -> None:
    home = importlib.import_module(f"morembs.{module}")
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        assert getattr(home, old) is getattr(home, new)
    with pytest.raises(AttributeError, match="has no attribute 'never_was'"):
        _ = home.never_was


def test_old_names_work_in_a_process_of_their_own() -> None:
    code = (
        "from morembs.storage.body_file import read_body; from morembs.body.file import read_body as new; "
        "print(read_body is new)"
    )
    done = subprocess.run([sys.executable, "-W", "default", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n" and "morembs.storage.body_file is now morembs.body.file" in done.stderr


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        ("body.build", "Delivery", "BodyOptions"),
        ("body.build", "deliver", "build_body"),
        ("exporters", "Task", "ExportContext"),
        ("nonlinear", "Settled", "EquilibriumPath"),
    ],
)
def test_an_old_name_warns_and_gives_the_new_one(module: str, old: str, new: str) -> None:
    holder = importlib.import_module(f"morembs.{module}")
    with pytest.warns(DeprecationWarning, match=f"morembs.{module}.{old} is now {new}"):
        assert getattr(holder, old) is getattr(holder, new)
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        getattr(holder, "Nothing")  # noqa: B009


@pytest.mark.parametrize(
    ("module", "holder", "old", "new"),
    [
        ("budget", "Budget", "rest", "release_pages"),
        ("budget", "Budget", "relax", "release_if_tight"),
        ("linalg.sparse.solver", "LinearSolver", "knowing", "with_near_null_space"),
        ("reducers", "Basis", "left", "W"),
        ("reducers", "Basis", "inertial", "V_velocity"),
        ("reducers", "ReducedModel", "left", "W"),
    ],
)
def test_an_old_attribute_warns_and_gives_the_new_one(module: str, holder: str, old: str, new: str) -> None:
    home = getattr(importlib.import_module(f"morembs.{module}"), holder)
    instance = SimpleNamespace(**{new: 2.5})
    with pytest.warns(DeprecationWarning, match=f"{old} of {holder} is now {new}; the old name goes") as caught:
        assert getattr(home, old).__get__(instance) == 2.5
    assert caught[0].filename == __file__


def test_a_basis_is_made_by_the_old_keywords() -> None:
    V, W = np.eye(3, 2), np.ones((3, 2))
    with pytest.warns(DeprecationWarning, match="left of Basis is now W") as caught:
        basis = Basis(V=V, kinds=("elastic",) * 2, K=np.eye(2), rigid=np.eye(2, 0), left=W)
    assert basis.W is W and basis.V_velocity is None and caught[0].filename == __file__
    assert dataclasses.replace(basis, V_velocity=V).V_velocity is V
    with pytest.raises(TypeError, match="right"):
        Basis(V=V, kinds=(), K=V, rigid=V, right=W)
