"""Materials of ANSYS archives, from MP and MPDATA."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.fem.material import isotropic, orthotropic
from morembs.importers.decks.tables import ElasticMaterial, Section
from morembs.importers.tolerances import TOL

ELASTIC = {"EX", "EY", "EZ", "NUXY", "NUYZ", "NUXZ", "PRXY", "PRYZ", "PRXZ", "GXY", "GYZ", "GXZ", "DENS"}
# Damping and temperature: said, not kept. Conductivity and the like say nothing about a structure and are passed over.
SAID = {
    "ALPD": "mass damping",
    "BETD": "stiffness damping",
    "DAMP": "stiffness damping",
    "DMPR": "damping ratio",
    "DMPS": "damping ratio",
}


def section(
    number: int, given: Mapping[str, float], table: str, notes: list[str], is_turned: bool
) -> tuple[ElasticMaterial, Section]:
    """Material of a number and the section of its solids, the set "material n".

    Args:
        given: constants by label; what ANSYS fills in itself is filled in.
        table: the elastic one that the material has, which is not read, "" without.
        is_turned: whether elements have a coordinate system of their own.

    Raises:
        InputError: constants that no material has, or an orthotropic material in turned elements.
    """
    name, missing = f"material {number}", [key for key in ("EX", "DENS") if key not in given]
    lacks = f"{name} has no {' and no '.join(missing)}" if missing else ""
    if table and "EX" in missing:
        lacks += f", but a table TB,{table}, which is not read"
    stiffness = None if "EX" in missing else _stiffness(name, given, is_turned, notes)
    density = given.get("DENS")
    material = ElasticMaterial(name=name, stiffness=stiffness, density=density, constants=dict(given))
    code = f"MAT {number}"
    return material, Section(set=name, code=code, material=name, stiffness=stiffness, density=density, lacks=lacks)


def _stiffness(name: str, given: Mapping[str, float], is_turned: bool, notes: list[str]) -> Floats:
    """Stiffness (6, 6): EY = EZ = EX, one Poisson's ratio and shear modulus for all planes, 0.3, unless given."""
    e1 = given["EX"]
    e2, e3 = given.get("EY", e1), given.get("EZ", e1)
    kinds = [kind for kind in ("PR", "NU") if any(f"{kind}{plane}" in given for plane in ("XY", "YZ", "XZ"))]
    if len(kinds) > 1:
        raise InputError(f"{name} has both PRXY and NUXY (or their like); expected one kind")
    kind = kinds[0] if kinds else "PR"
    nuxy = given.get(f"{kind}XY", TOL.ansys_poisson)
    nu = nuxy, given.get(f"{kind}XZ", nuxy), given.get(f"{kind}YZ", nuxy)
    if kind == "NU":
        nu = (nu[0] * (e1 / e2), nu[1] * (e1 / e3), nu[2] * (e2 / e3)) if e2 and e3 else (nuxy,) * 3
    elif "PRXY" not in given:
        notes.append(f"{name} has no Poisson's ratio; 0.3 was taken, as ANSYS does")
    one_shear = e1 / (2 * (1 + nu[0])) if nu[0] != -1 else e1
    gxy = given.get("GXY", one_shear)
    shear = gxy, given.get("GXZ", gxy), given.get("GYZ", gxy)
    rtol = TOL.same_modulus
    same = np.allclose([e2, e3], e1, rtol=rtol) and np.allclose(nu, nu[0], rtol=rtol, atol=0)
    if same and np.allclose(shear, one_shear, rtol=TOL.same_shear_modulus):
        return isotropic(set=name, young=e1, poisson=nu[0], density=1.0).stiffness
    if is_turned:
        raise InputError(
            f"{name} is orthotropic and its elements have a coordinate system of their own (ESYS), which is not "
            "supported; give the material with its axes in the job, or use global axes (ESYS,0)",
            kind="unsupported",
        )
    return orthotropic(set=name, young=(e1, e2, e3), poisson=nu, shear=shear, density=1.0).stiffness
