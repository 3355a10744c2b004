"""Materials and point masses of ANSYS archives, from MP, MPDATA and real constants."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from morembs.errors import InputError
from morembs.importers.ansys_elements import Elements
from morembs.importers.imported import Lacking, PointMass
from morembs.model.material import Material, isotropic, orthotropic

ELASTIC = {"EX", "EY", "EZ", "NUXY", "NUYZ", "NUXZ", "PRXY", "PRYZ", "PRXZ", "GXY", "GYZ", "GXZ", "DENS"}
# Damping and temperature: said, not kept. Conductivity and the like say nothing about a structure and are passed over.
SAID = {"ALPD": "mass damping", "BETD": "stiffness damping", "DMPR": "damping ratio", "DMPS": "damping ratio"}
_DEFAULT_POISSON = 0.3


def material(
    number: int, name: str, given: Mapping[str, float], turned: bool, notes: list[str],
    lacking: dict[str, Lacking],
) -> Material | None:  # fmt: skip
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
        nuxy = given.get("NUXY", _DEFAULT_POISSON)
        nu = tuple(
            value * ratio
            for value, ratio in zip(
                (nuxy, given.get("NUXZ", nuxy), given.get("NUYZ", nuxy)), (e1 / e2, e1 / e3, e2 / e3), strict=True
            )
        ) if e2 and e3 else (nuxy,) * 3  # fmt: skip
    else:
        prxy = given.get("PRXY", _DEFAULT_POISSON)
        nu = prxy, given.get("PRXZ", prxy), given.get("PRYZ", prxy)
        if "PRXY" not in given:
            notes.append(f"material {number} has no Poisson's ratio; 0.3 was taken, as ANSYS does")
    one_shear = e1 / (2 * (1 + nu[0])) if nu[0] != -1 else e1
    gxy = given.get("GXY", one_shear)
    shear = gxy, given.get("GXZ", gxy), given.get("GYZ", gxy)
    same = np.allclose([e2, e3], e1, rtol=1e-9) and np.allclose(nu, nu[0], rtol=1e-9, atol=0)
    if same and np.allclose(shear, one_shear, rtol=1e-6):
        return isotropic(set=name, young=e1, poisson=nu[0], density=given["DENS"])
    if turned:
        raise InputError(
            f"material {number} is orthotropic and its elements have a coordinate system of their own (ESYS), which is "
            "not supported; give the material with its axes in the job, or use global axes (ESYS,0)"
        )
    return orthotropic(
        set=name, young=(e1, e2, e3), poisson=(nu[0], nu[1], nu[2]), shear=shear, density=given["DENS"]
    )  # fmt: skip


def point_masses(
    elements: Elements, options: Mapping[int, int], reals: Mapping[int, list[float]], row: Mapping[int, int], name: str
) -> list[PointMass]:  # fmt: skip
    """Point masses of MASS21 elements with their key ``options`` and real constants; ``row`` of each node label.

    Raises:
        InputError: missing constants or nodes, masses that differ by direction, or forms for plane models.
    """
    form = options.get(3, 0)
    if form not in (0, 2) or options.get(1, 0):
        raise InputError(
            f"{name}: MASS21 with KEYOPT(1) = {options.get(1, 0)}, KEYOPT(3) = {form} is not supported; expected a "
            "mass in space, KEYOPT(1) = 0 and KEYOPT(3) = 0 or 2"
        )
    masses = []
    for label, node, real, system in zip(
        elements.ids, elements.nodes[:, 0], elements.real, elements.system, strict=True
    ):
        if int(real) not in reals:
            raise InputError(f"{name}: MASS21 {label} names the real constants {real}, which are not there")
        values = [*reals[int(real)], *[0.0] * 6]
        if int(node) not in row:
            raise InputError(f"{name}: MASS21 {label} names the node {node}, which is not defined")
        x, y, z, ixx, iyy, izz = (values[0],) * 3 + (0.0,) * 3 if form == 2 else tuple(values[:6])
        if min(x, y, z, ixx, iyy, izz) < 0 or not x == y == z:
            raise InputError(
                f"{name}: MASS21 {label} has the masses {x:g}, {y:g}, {z:g} and inertias {ixx:g}, {iyy:g}, {izz:g}; "
                "expected one mass for all directions (MASSX = MASSY = MASSZ), none negative"
            )
        if not ixx == iyy == izz and (system or options.get(2, 0)):
            raise InputError(f"{name}: the inertia of MASS21 {label} is given in turned axes, which is not supported")
        masses.append(PointMass(name=f"MASS21 {label}", node=row[int(node)], mass=x, inertia=np.diag([ixx, iyy, izz])))
    return masses
