"""Rooms and names of plug-ins as 0.1 had them go on working until 1.0."""

from __future__ import annotations

import dataclasses
import gzip
import importlib
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import morembs
from morembs.base.former_names import MODULES, ROOMS, WHOLE, place_now
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


@pytest.mark.parametrize("room", [*ROOMS, *WHOLE, *MODULES])
def test_a_former_room_warns_and_gives_the_new_one(room: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old = f"morembs.{room}"
    monkeypatch.delitem(sys.modules, old, raising=False)
    with pytest.warns(DeprecationWarning, match=f"{old} is now {place_now(old)}; the old name goes with 1.0"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(place_now(old)) and module.__name__ == place_now(old) != old
    # Nothing that exists bears an old name: the warning would never be seen.
    home, place = Path(morembs.__file__).parent, room.replace(".", "/")
    assert not (home / place).exists() and not (home / f"{place}.py").exists()


def test_modules_and_classes_of_a_former_room_are_those_of_the_new_one() -> None:
    code = (
        "from morembs.model.material import isotropic; from morembs.fem.material import isotropic as new; "
        "import morembs.interface.base as base; from morembs.fem.interface.base import CouplingKind; "
        "print(isotropic is new, base.CouplingKind is CouplingKind)"
    )
    done = subprocess.run([sys.executable, "-W", "default", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True True\n" and "morembs.model.material is now morembs.fem.material" in done.stderr


@pytest.mark.parametrize("name", RELEASED.split())
def test_an_old_public_name_is_still_there(name: str) -> None:
    assert name in morembs.__all__ and getattr(morembs, name) is not None


def test_a_name_of_exporters_warns_and_gives_the_new_one() -> None:
    holder = importlib.import_module("morembs.exporters")
    with pytest.warns(DeprecationWarning, match="morembs.exporters.Task is now ExportContext"):
        assert holder.Task is holder.ExportContext
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        getattr(holder, "Nothing")  # noqa: B009


@pytest.mark.parametrize(
    ("module", "holder", "old", "new"),
    [
        ("base.budget", "Budget", "rest", "release_pages"),
        ("base.budget", "Budget", "relax", "release_if_tight"),
        ("linalg.sparse.solver", "LinearSolver", "knowing", "with_near_null_space"),
        ("problem", "Problem", "elastic", "free_free"),
        ("responses.certified_reference", "CertifiedReference", "off", "error_bounds"),
        ("problem", "Problem", "internal", "fixed_interface"),
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


def test_keys_of_the_certificate_of_a_file_warn_and_give_its_datasets(tmp_path: Path) -> None:
    path = tmp_path / "body.h5"
    path.write_bytes(gzip.decompress((Path(__file__).parent / "data" / "0.1.0" / "symmetric.h5.gz").read_bytes()))
    certificate = morembs.read_body(path).bodies["rail"].certificate
    with pytest.warns(DeprecationWarning, match="keys of a Certificate are now its attributes"):
        assert certificate["error"] is certificate.error
    with pytest.warns(DeprecationWarning, match="they go with 1.0"):
        assert certificate.get("limits", 3) == 3 and "limits" not in certificate
    with pytest.warns(DeprecationWarning, match="they go with 1.0"):
        assert dict(certificate)["bound_kind"] == certificate.bound_kind == "bound"
    with pytest.warns(DeprecationWarning, match="they go with 1.0"):
        assert set(certificate.keys()) == set(dict(certificate.items())) == set(certificate.datasets)
