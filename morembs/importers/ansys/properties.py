"""Materials of ANSYS archives, from MP and MPDATA."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from morembs.base.errors import InputError
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.importers.imported import Lacking
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


def material(
    number: int, name: str, given: Mapping[str, float], turned: bool, notes: list[str], lacking: dict[str, Lacking]
) -> Material | None:
    """Material of the element set ``name``, or None where EX or DENS is missing, which goes into ``lacking``.

    What ANSYS fills in itself is filled in: EY = EZ = EX, one Poisson's ratio and shear modulus for all planes, 0.3.
    ``turned`` says that elements have a coordinate system of their own.

    Raises:
        InputError: constants that no material has, or an orthotropic material in turned elements.
    """
    missing = [key for key in ("EX", "DENS") if key not in given]
    if missing == ["DENS"]:
        like = material(number, name, {**given, "DENS": 1.0}, turned, notes, lacking)
        stiffness = None if like is None else like.stiffness
        lacking[name] = Lacking(sentence=f"material {number} has no DENS", stiffness=stiffness)
        return None
    if missing:
        lacking[name] = Lacking(sentence=f"material {number} has no {' and no '.join(missing)}")
        return None
    major, minor = ("PRXY", "PRYZ", "PRXZ"), ("NUXY", "NUYZ", "NUXZ")
    e1 = given["EX"]
    e2, e3 = given.get("EY", e1), given.get("EZ", e1)
    if any(key in given for key in major) and any(key in given for key in minor):
        raise InputError(f"material {number} has both PRXY and NUXY (or their like); expected one kind")
    if any(key in given for key in minor):
        nuxy = given.get("NUXY", TOL.ansys_poisson)
        nu = (
            tuple(
                value * ratio
                for value, ratio in zip(
                    (nuxy, given.get("NUXZ", nuxy), given.get("NUYZ", nuxy)), (e1 / e2, e1 / e3, e2 / e3), strict=True
                )
            )
            if e2 and e3
            else (nuxy,) * 3
        )
    else:
        prxy = given.get("PRXY", TOL.ansys_poisson)
        nu = prxy, given.get("PRXZ", prxy), given.get("PRYZ", prxy)
        if "PRXY" not in given:
            notes.append(f"material {number} has no Poisson's ratio; 0.3 was taken, as ANSYS does")
    one_shear = e1 / (2 * (1 + nu[0])) if nu[0] != -1 else e1
    gxy = given.get("GXY", one_shear)
    shear = gxy, given.get("GXZ", gxy), given.get("GYZ", gxy)
    rtol = TOL.same_modulus
    same = np.allclose([e2, e3], e1, rtol=rtol) and np.allclose(nu, nu[0], rtol=rtol, atol=0)
    if same and np.allclose(shear, one_shear, rtol=TOL.same_shear_modulus):
        return isotropic(set=name, young=e1, poisson=nu[0], density=given["DENS"])
    if turned:
        raise InputError(
            f"material {number} is orthotropic and its elements have a coordinate system of their own (ESYS), which is "
            "not supported; give the material with its axes in the job, or use global axes (ESYS,0)"
        )
    return orthotropic(set=name, young=(e1, e2, e3), poisson=(nu[0], nu[1], nu[2]), shear=shear, density=given["DENS"])
