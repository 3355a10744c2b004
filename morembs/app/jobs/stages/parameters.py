"""``[[parameter]]``: parameters in SI units, on the mesh of the job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import scipy.sparse as sp

from morembs.app.jobs.stages.couple import VARIED, damping_of
from morembs.app.jobs.stages.model import MESH, Assemble, materials_of
from morembs.app.jobs.stages.preload import PreloadTable
from morembs.app.jobs.stages.reduction import ReduceTable
from morembs.app.jobs.stages.spin import SpinTable
from morembs.app.jobs.stages.stage import MODEL, JobStage, Work
from morembs.app.jobs.stages.write import WRITTEN
from morembs.app.jobs.tables import Job, JobTables, ModelTable, RepeatedTable, Six
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError, nearest
from morembs.base.key_tables import declare_key
from morembs.base.limits import Finite, length, text
from morembs.base.types import Floats, Ints
from morembs.fem import DofMap, FEModel, Mesh, Nodes
from morembs.fem.material import Material
from morembs.fem.mesh import material_of_elements
from morembs.fem.selection import NUMBERS, select_nodes
from morembs.importers import read_mesh
from morembs.importers.advice import JOB, advising
from morembs.parametric.parameter import NAME as PARAMETER
from morembs.parametric.parameter import PROPERTIES, Parameter, Spring
from morembs.parametric.regions import rows_of_set, young_of
from morembs.parametric.steps import clear_steps
from morembs.parametric.terms import VariedModel, varied_model
from morembs.parametric.tolerances import TOL as PARAMETRIC
from morembs.storage.csv_table import read_table

COLUMNS = ("id", "dx", "dy", "dz")


@dataclass(frozen=True, kw_only=True)
class ParameterTable(RepeatedTable):
    """``[[parameter]]``: what of the model varies, and between which values."""

    name: Annotated[str, text("a name of letters, digits and _", PARAMETER, longest=100)]
    property: str = declare_key("one of " + ", ".join(repr(name) for name in PROPERTIES))
    set: str | list[str] = declare_key(
        'an element set, a list of them, "all", or the elements in a region such as "box:0,0,0,1,1,1"', "all"
    )
    range: Annotated[list[Finite], length("[LOW, HIGH]", 2)]
    nominal: Finite | None = declare_key("a number in the range", None)
    displacement: Annotated[str, text('the path of a table id,dx,dy,dz such as "longer.csv"')] | None = None
    mesh: Annotated[str, text("the path of the mesh at the value 1")] | None = None
    interface: str | None = declare_key("the interface that a spring holds", None)
    to: str | None = declare_key("another interface that it holds to, in place of the ground", None)
    stiffness: Six | None = declare_key("six numbers, zero or more, of a spring at the value 1", None)

    def refuse_conflicts(self) -> None:
        if self.property not in PROPERTIES:
            if self.property == "speed":
                raise InputError(
                    "property = 'speed' was given; the speed of rotation is no parameter: a table [spin] gives one "
                    "body for "
                    "all speeds",
                    keyword="property",
                )
            raise InputError(
                f"property = {self.property!r} was given; {nearest(self.property, PROPERTIES)}",
                kind="unknown",
                keyword="property",
            )
        moves = [key for key in ("displacement", "mesh") if getattr(self, key) is not None]
        if self.property == "morph" and len(moves) != 1:
            raise InputError(
                f"a morph needs displacement or mesh; {' and '.join(moves) or 'neither'} was given",
                kind="missing",
                keyword="displacement",
            )
        if self.property != "morph" and moves:
            raise InputError(
                f"{moves[0]} was given beside property = {self.property!r}; it belongs to a morph",
                kind="conflict",
                keyword=moves[0],
            )
        springs = [key for key in ("interface", "stiffness") if getattr(self, key) is not None]
        if self.property == "spring" and (len(springs) != 2 or self.to == self.interface):
            raise InputError(
                "a spring needs interface and stiffness = [six numbers], and to, if it has one, another",
                kind="missing",
                keyword="stiffness",
            )
        if self.property != "spring" and (springs or self.to is not None):
            raise InputError(
                f"{(springs or ['to'])[0]} was given beside property = {self.property!r}; it belongs to a spring",
                kind="conflict",
                keyword="property",
            )
        if self.property not in ("young", "density") and "set" in self.given:
            raise InputError(
                f"set was given beside property = {self.property!r}; it belongs to young and density",
                kind="conflict",
                keyword="set",
            )


class Parameters(JobStage):
    """The model of a mesh with its parameters, and that of nominal values."""

    tables = (ParameterTable,)
    needs = (MESH,)
    gives = (MODEL, VARIED)
    instead = (Assemble,)
    step = "assemble"

    def refuse_conflicts(self, tables: JobTables) -> None:
        parameters, preload = ParameterTable.of(tables), PreloadTable.of(tables)
        varied = any(table.method == "parametric" for table in ReduceTable.of(tables))
        if varied and not parameters:
            raise InputError(
                'method = "parametric" needs parameters; add at least one table [[parameter]]',
                kind="missing",
                keyword="method",
            )
        if not parameters:
            return
        if not varied:
            raise InputError(
                '[[parameter]] was given; add a [[reduce]] with method = "parametric", or leave it out',
                kind="missing",
                keyword="parameter",
            )
        if ModelTable.of(tables).mesh is None:
            raise InputError(
                "[[parameter]] was given for a model file, whose matrices are fixed; give [model] mesh",
                kind="unsupported",
                keyword="file",
            )
        loads = [table.name for table in parameters if table.property == "preload"]
        if len(loads) != (preload is not None):
            raise InputError(
                f"{len(loads)} parameters with property = 'preload' were given {'with' if preload else 'without'} "
                "a table [preload]; expected one such parameter and the table, whose loads it multiplies",
                kind="conflict",
                keyword="preload",
            )
        if SpinTable.of(tables) is not None:
            raise InputError(
                "[spin] was given beside [[parameter]], which change its stress; leave one of them out",
                kind="conflict",
                keyword="spin",
            )

    def is_asked(self, job: Job) -> bool:
        return bool(ParameterTable.of(job))

    def reads(self, job: Job) -> Mapping[str, Path]:
        moves = {table.name: table.mesh or table.displacement for table in ParameterTable.of(job)}
        return {f"the morph of {name}": job.resolve(path) for name, path in moves.items() if path}

    def check_mesh(self, job: Job, mesh: Mesh) -> None:
        parameters_of(job, mesh)

    def run(self, work: Work) -> None:
        varied = build_varied_model(work.job, work[MESH], materials_of(work.job))
        work.give(MODEL, varied.model(varied.box.nominal))
        work.give(VARIED, varied)


class ParameterSteps(JobStage):
    """The steps of an offline stage, which are no longer needed where its body is written."""

    tables = (ParameterTable,)
    needs = (WRITTEN,)
    gives = (WRITTEN,)

    def is_asked(self, job: Job) -> bool:
        return bool(ParameterTable.of(job))

    def run(self, work: Work) -> None:
        with work.watch.more():
            clear_steps(work[WRITTEN])


def build_varied_model(job: Job, mesh: Mesh, materials: Sequence[Material]) -> VariedModel:
    """The model of the job with its parameters.

    Raises:
        InputError: parameters that do not fit the mesh.
    """
    mesh, parameters = parameters_of(job, mesh)
    tolerances = [table.options().get("tolerance", PARAMETRIC.default_tolerance) for table in ReduceTable.of(job)]
    return varied_model(
        mesh,
        materials,
        parameters,
        tolerance=min(float(x) for x in tolerances if isinstance(x, int | float)),
        mass_integration=ModelTable.of(job).mass_integration,
    )


def parameters_of(job: Job, mesh: Mesh) -> tuple[Mesh, list[Parameter]]:
    """The parameters, and the mesh with the element sets that they name.

    Raises:
        InputError: sets, tables or meshes that cannot be used, or values that do not fit together.
    """
    parameters = []
    for table in ParameterTable.of(job):
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
        raise error.restate(f"parameter {parameter}, centres of elements: {error}") from error
    ends = np.cumsum([len(block.ids) for block in mesh.blocks])
    starts = np.concatenate([[0], ends[:-1]])
    return tuple(inside[(inside >= a) & (inside < b)] - a for a, b in zip(starts, ends, strict=True))


def _displacement(job: Job, mesh: Mesh, table: ParameterTable) -> Floats:
    """Displacement (n, 3) of the nodes in m per unit."""
    units = job.units
    if table.mesh is not None:
        path = job.resolve(table.mesh)
        with advising(JOB):
            other = read_mesh(path, units, dialect=ModelTable.of(job).dialect)
        _refuse_other(mesh, other, path, job)
        order, theirs = (np.argsort(each.nodes.ids, kind="stable") for each in (mesh, other))
        moved = np.empty_like(mesh.nodes.xyz)
        moved[order] = other.nodes.xyz[theirs]
        return moved - mesh.nodes.xyz
    return units.length * read_displacements(job.resolve(table.displacement or ""), mesh.nodes, table.name)


def _refuse_other(mesh: Mesh, other: Mesh, path: Path, job: Job) -> None:
    cure = "a morph needs the same labels and elements"
    name = Path(ModelTable.of(job).mesh or "").name
    if len(other.nodes) != len(mesh.nodes):
        raise InputError(f"{path.name} has {len(other.nodes)} nodes, {name} {len(mesh.nodes)}; {cure}", kind="conflict")
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
        raise InputError(
            f"{where} {path} names the node {labels[unknown[0]]:.15g}, which the mesh does not have",
            kind="unknown",
            keyword="displacement",
        )
    if len(np.unique(at)) < len(at):
        raise InputError(
            f"{where} {path} names a node twice; give each of them one row", kind="conflict", keyword="displacement"
        )
    result = np.zeros((len(nodes), 3))
    result[at] = np.stack(motions, axis=1)
    return result
