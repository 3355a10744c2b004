"""Regions of a mesh: elements of one material whose properties the same parameters give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.types import Ints
from morembs.fem import Mesh
from morembs.fem.material import Material, isotropic
from morembs.fem.mesh import material_of_elements
from morembs.fem.tolerances import TOL as FEM
from morembs.parametric.parameter import Parameter


def regions_of(
    mesh: Mesh, materials: Sequence[Material], parameters: Sequence[Parameter]
) -> tuple[Mesh, tuple[Material, ...], Ints, Ints]:
    """The mesh with a set for each region of one material and parameters, their materials per unit of the latter, and
    the parameters of each."""
    owner = material_of_elements(mesh, materials)
    young, density = (_owners(mesh, parameters, key) for key in ("young", "density"))
    keys = [np.stack([owner[id(b)], E, rho], axis=1) for b, E, rho in zip(mesh.blocks, young, density, strict=True)]
    unique, where = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    split = np.split(where.ravel(), np.cumsum([len(block.ids) for block in mesh.blocks])[:-1])
    sets, regions = dict(mesh.element_sets), []
    for number, (material, E, rho) in enumerate(unique.tolist()):
        given, name = materials[material], f"region {number}"
        sets[name] = tuple(np.flatnonzero(part == number) for part in split)
        regions.append(
            Material(
                set=name,
                stiffness=given.stiffness if E < 0 else given.stiffness / young_of(given, parameters[E].name),
                density=given.density if rho < 0 else 1.0,
            )
        )
    return replace(mesh, element_sets=sets), tuple(regions), unique[:, 1], unique[:, 2]


def _owners(mesh: Mesh, parameters: Sequence[Parameter], key: str) -> list[Ints]:
    """For each block the number of the parameter (-1: none) that gives the property ``key`` of each element."""
    owners = [np.full(len(block.ids), -1, dtype=np.int64) for block in mesh.blocks]
    for number, parameter in enumerate(parameters):
        if parameter.kind != key:
            continue
        for name in parameter.sets:
            for block, taken, rows in zip(mesh.blocks, owners, rows_of_set(mesh, name, parameter.name), strict=True):
                other = taken[rows]
                clash = np.flatnonzero((other >= 0) & (other != number))
                if len(clash):
                    raise InputError(
                        f"parameters {parameters[other[clash[0]]].name} and {parameter.name} both give the {key} of "
                        f"element {block.ids[rows[clash[0]]]}, of the set {name!r}; give every element one",
                        kind="conflict",
                        keyword=key,
                    )
                taken[rows] = number
    return owners


def rows_of_set(mesh: Mesh, name: str, parameter: str) -> tuple[Ints, ...]:
    """For each block the rows of the element set ``name``.

    Raises:
        InputError: no such set, or no elements in it.
    """
    if name == "all":
        return tuple(np.arange(len(block.ids)) for block in mesh.blocks)
    if name not in mesh.element_sets:
        raise InputError(
            f"parameter {parameter} names the element set {name!r}, which the mesh does not have; "
            f"{nearest(name, ['all', *mesh.element_sets])}",
            kind="unknown",
            keyword="set",
        )
    if not sum(len(rows) for rows in mesh.element_sets[name]):
        raise InputError(
            f"parameter {parameter} names the element set {name!r}, which has no elements; name another", kind="missing"
        )
    return mesh.element_sets[name]


def young_of(material: Material, parameter: str) -> float:
    """Young's modulus of an isotropic material in Pa.

    Raises:
        InputError: a material that is not isotropic.
    """
    S = np.linalg.inv(material.stiffness)
    E, nu = 1 / S[0, 0], -S[0, 1] / S[0, 0]
    alike = isotropic(set=material.set, young=E, poisson=nu, density=material.density).stiffness
    if np.abs(alike - material.stiffness).max() > FEM.isotropic * np.abs(alike).max():
        raise InputError(
            f"parameter {parameter} is the young of the set {material.set!r}, whose material is not isotropic; the "
            "modulus of an isotropic material can vary",
            kind="unsupported",
            keyword="young",
        )
    return float(E)
