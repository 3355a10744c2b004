"""The tables [[parameter]] of a job as parameters in SI units, on the mesh of the job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.app.jobs.job import Job
from morembs.app.jobs.schema import ParameterTable
from morembs.app.jobs.stages.couple import VARIED, damping_of
from morembs.app.jobs.stages.model import MESH, materials_of
from morembs.app.jobs.stages.stage import MODEL, JobStage, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.body.floating.preload import Preload, Preloaded
from morembs.fem import DofMap, FEModel, Mesh, Nodes
from morembs.fem.assembly import material_of_elements
from morembs.fem.material import Material
from morembs.fem.selection import NUMBERS, select_nodes
from morembs.importers import read_mesh
from morembs.parametric.added import with_preload
from morembs.parametric.parameter import Parameter, Spring
from morembs.parametric.regions import rows_of_set, young_of
from morembs.parametric.steps import clear_steps
from morembs.parametric.terms import VariedModel, varied_model
from morembs.parametric.tolerances import TOL as PARAMETRIC
from morembs.storage.csv_table import read_table

COLUMNS = ("id", "dx", "dy", "dz")


class Parameters(JobStage):
    """The model of a mesh with its parameters, and that of nominal values."""

    tables = ("parameter", "reduce")
    needs = (MESH,)
    gives = (MODEL, VARIED)

    def is_asked(self, job: Job) -> bool:
        return bool(job.tables.parameter)

    def reads(self, job: Job) -> Mapping[str, Path]:
        moves = {table.name: table.mesh or table.displacement for table in job.tables.parameter}
        return {f"the morph of {name}": job.resolve(path) for name, path in moves.items() if path}

    def check_mesh(self, job: Job, mesh: Mesh) -> None:
        parameters_of(job, mesh)

    def run(self, work: Work) -> None:
        with work.watch.stage("assemble"):
            varied = varied_of(work.job, work[MESH], materials_of(work.job))
            work.give(MODEL, varied.model(varied.box.nominal))
        work.give(VARIED, varied)


class ParameterSteps(JobStage):
    """The steps of an offline stage, which are no longer needed where its body is written."""

    tables = ("parameter",)
    needs = (WRITTEN,)
    gives = (WRITTEN,)

    def is_asked(self, job: Job) -> bool:
        return bool(job.tables.parameter)

    def run(self, work: Work) -> None:
        with work.watch.more():
            clear_steps(work[WRITTEN])


def varied_of(job: Job, mesh: Mesh, materials: Sequence[Material]) -> VariedModel:
    """The model of the job with its parameters.

    Raises:
        InputError: parameters that do not fit the mesh.
    """
    mesh, parameters = parameters_of(job, mesh)
    tolerances = [table.options().get("tolerance", PARAMETRIC.default_tolerance) for table in job.tables.reduce]
    return varied_model(
        mesh,
        materials,
        parameters,
        tolerance=min(float(x) for x in tolerances if isinstance(x, int | float)),
        mass_integration=job.tables.model.mass_integration,
    )


def parameters_of(job: Job, mesh: Mesh) -> tuple[Mesh, list[Parameter]]:
    """The parameters, and the mesh with the element sets that they name.

    Raises:
        InputError: sets, tables or meshes that cannot be used, or values that do not fit together.
    """
    parameters = []
    for table in job.tables.parameter:
        mesh, sets = _sets(job, mesh, table)
        parameters.append(_parameter(job, mesh, table, sets))
    return mesh, parameters


def _parameter(job: Job, mesh: Mesh, table: ParameterTable, sets: tuple[str, ...]) -> Parameter:
    units = job.units
    scale = {"young": units.stress, "density": units.density, "alpha": 1 / units.time, "beta": units.time}.get(
        table.property, 1.0
    )
    nominal = scale * table.nominal if table.nominal is not None else _nominal(job, mesh, table, sets)
    return Parameter(
        name=table.name,
        kind=table.property,
        low=scale * table.range[0],
        high=scale * table.range[1],
        nominal=nominal,
        sets=sets,
        displacement=_displacement(job, mesh, table) if table.property == "morph" else None,
        spring=_spring(job, table),
    )


def _spring(job: Job, table: ParameterTable) -> Spring | None:
    if table.stiffness is None or table.interface is None:
        return None
    units = job.units
    along = units.mass / units.time**2
    scale = [along] * 3 + [along * units.length**2] * 3
    return Spring(
        interface=table.interface,
        to=table.to,
        stiffness=tuple(k * s for k, s in zip(table.stiffness, scale, strict=True)),
    )


def stressed(varied: VariedModel, bare: FEModel, preload: Preload, found: Preloaded) -> VariedModel:
    """``varied`` with the stress of its ``preload``, ``found`` for the ``bare`` model of nominal values.

    Raises:
        InputError: other parameters that change the stress, or loads beyond buckling.
    """
    inertial = preload.axis is not None or any(preload.acceleration)
    for parameter in varied.parameters if inertial else ():
        if parameter.kind == "density":
            raise InputError(
                f"parameter {parameter.name} changes the loads of a [preload] with a speed or an acceleration; leave "
                "one of them out"
            )
    return with_preload(varied, sp.csr_array(found.model.K - bare.K), found.critical_factor)


def _nominal(job: Job, mesh: Mesh, table: ParameterTable, sets: tuple[str, ...]) -> float:
    """The value that the job has without the parameter."""
    if table.property == "morph":
        return 0.0
    if table.property in ("spring", "preload"):
        return 1.0
    if table.property in ("alpha", "beta"):
        return float(getattr(damping_of(job), table.property))
    materials = materials_of(job)
    owner = material_of_elements(mesh, materials)
    used = {
        int(number)
        for name in sets
        for block, rows in zip(mesh.blocks, rows_of_set(mesh, name, table.name), strict=True)
        for number in owner[id(block)][rows]
    }
    values = [
        young_of(materials[k], table.name) if table.property == "young" else materials[k].density for k in sorted(used)
    ]
    if max(values) - min(values) > TOL.same_value * max(values):
        raise InputError(
            f"parameter {table.name}: its elements have materials with different {table.property}; give it a nominal "
            "value"
        )
    return values[0]


def _sets(job: Job, mesh: Mesh, table: ParameterTable) -> tuple[Mesh, tuple[str, ...]]:
    """Names of the element sets of a parameter, and the mesh with those of regions."""
    given = [table.set] if isinstance(table.set, str) else table.set
    sets = dict(mesh.element_sets)
    for name in given:
        if name.partition(":")[0] in NUMBERS and name not in sets:
            sets[name] = _in_region(mesh, name, job.units.length, table.name)
    same = len(sets) == len(mesh.element_sets)
    return mesh if same else replace(mesh, element_sets=sets), tuple(given)


def _in_region(mesh: Mesh, text: str, length: float, parameter: str) -> tuple[Ints, ...]:
    """For each block the elements whose centres lie in a region."""
    centres = np.concatenate([mesh.nodes.xyz[block.nodes].mean(axis=1) for block in mesh.blocks])
    empty = sp.csr_array((3 * len(centres),) * 2)
    nodes = Nodes(ids=np.arange(1, len(centres) + 1), xyz=centres)
    points = FEModel(K=empty, M=empty, nodes=nodes, dofs=DofMap.translations(len(centres)))
    try:
        inside = select_nodes(points, text, length=length)
    except InputError as error:
        raise InputError(f"parameter {parameter}, centres of elements: {error}") from error
    ends = np.cumsum([len(block.ids) for block in mesh.blocks])
    starts = np.concatenate([[0], ends[:-1]])
    return tuple(inside[(inside >= a) & (inside < b)] - a for a, b in zip(starts, ends, strict=True))


def _displacement(job: Job, mesh: Mesh, table: ParameterTable) -> Floats:
    """Displacement (n, 3) of the nodes in m per unit."""
    units = job.units
    if table.mesh is not None:
        path = job.resolve(table.mesh)
        other = read_mesh(path, units, dialect=job.tables.model.dialect)
        _refuse_other(mesh, other, path, job)
        order, theirs = (np.argsort(each.nodes.ids, kind="stable") for each in (mesh, other))
        moved = np.empty_like(mesh.nodes.xyz)
        moved[order] = other.nodes.xyz[theirs]
        return moved - mesh.nodes.xyz
    return units.length * read_displacements(job.resolve(table.displacement or ""), mesh.nodes, table.name)


def _refuse_other(mesh: Mesh, other: Mesh, path: Path, job: Job) -> None:
    cure = "a morph needs the same labels and elements"
    name = Path(job.tables.model.mesh or "").name
    if len(other.nodes) != len(mesh.nodes):
        raise InputError(f"{path.name} has {len(other.nodes)} nodes, {name} {len(mesh.nodes)}; {cure}")
    if not np.array_equal(np.sort(other.nodes.ids), np.sort(mesh.nodes.ids)):
        missing = np.setdiff1d(mesh.nodes.ids, other.nodes.ids)[0]
        raise InputError(f"{path.name} has no node {missing}, {name} has; {cure}")
    ours, theirs = (
        [(block.type, each.nodes.ids[block.nodes].tolist()) for block in each.blocks] for each in (mesh, other)
    )
    if ours != theirs:
        raise InputError(f"the elements of {path.name} are not those of {name}; {cure}")


def read_displacements(path: Path, nodes: Nodes, parameter: str) -> Floats:
    """Displacements (n, 3) of a table with the columns id, dx, dy, dz; nodes that it does not name stay.

    Raises:
        InputError: a table that cannot be read, unknown or repeated labels.
    """
    where = f"parameter {parameter}: the table"
    labels, *motions = read_table(path, COLUMNS, what=where).values()
    order = np.argsort(nodes.ids, kind="stable")
    at = order[np.minimum(np.searchsorted(nodes.ids[order], labels), len(order) - 1)]
    unknown = np.flatnonzero(nodes.ids[at] != labels)
    if len(unknown):
        raise InputError(f"{where} {path} names the node {labels[unknown[0]]:.15g}, which the mesh does not have")
    if len(np.unique(at)) < len(at):
        raise InputError(f"{where} {path} names a node twice; give each of them one row")
    result = np.zeros((len(nodes), 3))
    result[at] = np.stack(motions, axis=1)
    return result
