"""``[model]`` and ``[[material]]``: the model of a job, assembled from its mesh or read from its model file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from morembs.app.jobs.equations import equations_of_motion
from morembs.app.jobs.job import Job
from morembs.app.jobs.schema import MaterialTable
from morembs.app.jobs.stages.forecast import least_memory, require_room, require_room_of_mesh
from morembs.app.jobs.stages.stage import MODEL, JobStage, Result, Work
from morembs.base.errors import InputError
from morembs.base.units import Units
from morembs.fem import FEModel, Mesh
from morembs.fem.assembly import assemble
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.importers import import_file, read_mesh
from morembs.importers.model_file import read_model
from morembs.importers.to_model import model_of

MESH: Result[Mesh] = Result("mesh")


class ReadMesh(JobStage):
    """The mesh of the job, in SI units."""

    tables = ("model", "material")
    gives = (MESH,)

    def is_asked(self, job: Job) -> bool:
        return job.tables.model.mesh is not None

    def reads(self, job: Job) -> Mapping[str, Path]:
        return {} if job.tables.model.mesh is None else {"the mesh": job.resolve(job.tables.model.mesh)}

    def run(self, work: Work) -> None:
        with work.watch.stage("read"):
            mesh = mesh_of(work.job)
        require_room_of_mesh(work.job, mesh, materials_of(work.job), work.solver, work.start, work.counts_modes)
        work.give(MESH, mesh)


class Assemble(JobStage):
    """The model of a mesh without parameters."""

    tables = ("model", "material")
    needs = (MESH,)
    gives = (MODEL,)

    def is_asked(self, job: Job) -> bool:
        return job.tables.model.mesh is not None and not job.tables.parameter

    def run(self, work: Work) -> None:
        rule = work.job.tables.model.mass_integration
        with work.watch.stage("assemble"):
            model = assemble(work[MESH], materials_of(work.job), mass_integration=rule)
        work.give(MODEL, model)


class ReadModel(JobStage):
    """The model of a model file or of a deck that an engine assembles, with what the job makes of its equations."""

    tables: ClassVar[tuple[str, ...]] = ("model", "material", "flow")
    gives = (MODEL,)

    def is_asked(self, job: Job) -> bool:
        return job.tables.model.file is not None

    def reads(self, job: Job) -> Mapping[str, Path]:
        given = job.tables
        files = {} if given.model.file is None else {"the model file": job.resolve(given.model.file)}
        tables = [flow.path for flow in given.flow if flow.path.endswith(".csv")]
        return files | {f"the path of [[flow]] {path}": job.resolve(path) for path in tables}

    def matrices(self, job: Job) -> FEModel:
        """The model as it stands in its file."""
        return model_of_file(job)

    def run(self, work: Work) -> None:
        job = work.job
        with work.watch.stage("read"):
            model = self.matrices(job)
        require_room(
            job,
            work.start,
            model.size,
            work.counts_modes,
            lambda: least_memory(job, model, work.solver, work.start, work.counts_modes),
        )
        work.give(MODEL, equations_of_motion(job, model))


def model_of_file(job: Job) -> FEModel:
    """The model that the file of the job holds, in SI units, or that the engine makes of it.

    Raises:
        InputError: no model file, or a deck that the engine does not take.
    """
    given = job.tables.model
    path = job.resolve(given.file or "")
    if given.engine is None:
        return read_model(path)
    options: dict[str, Any] = {} if given.dialect == "auto" else {"dialect": given.dialect}
    if given.allow_includes_outside:
        options["allow_includes_outside"] = True
    materials = [_material(table, Units()) for table in job.tables.material]
    imported = import_file(path, options=options, engine=given.engine, materials=materials)
    return model_of(imported, job.units, mass_integration=given.mass_integration)


def materials_of(job: Job) -> list[Material]:
    """The materials in SI units."""
    return [_material(table, job.units) for table in job.tables.material]


def _material(table: MaterialTable, units: Units) -> Material:
    density = table.density * units.density
    if isinstance(table.young, list) and isinstance(table.poisson, list) and table.shear is not None:
        E1, E2, E3 = (value * units.stress for value in table.young)
        nu12, nu13, nu23 = table.poisson
        G12, G13, G23 = (value * units.stress for value in table.shear)
        return orthotropic(
            set=table.set,
            young=(E1, E2, E3),
            poisson=(nu12, nu13, nu23),
            shear=(G12, G13, G23),
            density=density,
            axes=None if table.axes is None else np.array(table.axes),
        )
    if isinstance(table.young, list) or isinstance(table.poisson, list):
        raise InputError(f"material of set {table.set!r}: young and poisson must be one number each")
    return isotropic(set=table.set, young=table.young * units.stress, poisson=table.poisson, density=density)


def mesh_of(job: Job) -> Mesh:
    """The mesh of the job, in SI units."""
    given = job.tables.model
    return read_mesh(
        job.resolve(given.mesh or ""),
        job.units,
        dialect=given.dialect,
        allow_includes_outside=given.allow_includes_outside,
    )
