"""``[model]`` and ``[[material]]``: the model of a job, assembled from its mesh or read from its model file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from morembs.app.jobs.equations import FlowTable, equations_of_motion
from morembs.app.jobs.import_job import read_files_model
from morembs.app.jobs.stages.forecast import least_memory, require_room, require_room_of_mesh
from morembs.app.jobs.stages.stage import MODEL, JobStage, Result, Work
from morembs.app.jobs.tables import Job, JobTable, JobTables, ModelTable, RepeatedTable, Three
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import Finite, Positive, length
from morembs.base.units import Units
from morembs.fem import FEModel, Mesh
from morembs.fem.assembly import assemble
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.importers import read_mesh
from morembs.importers.advice import JOB, advising
from morembs.importers.model_file import is_model_file, read_model

MESH: Result[Mesh] = Result("mesh")


@dataclass(frozen=True, kw_only=True)
class MaterialTable(RepeatedTable):
    """``[[material]]``: elastic constants and density of an element set, isotropic or orthotropic."""

    expected: ClassVar[str] = "at least one table [[material]]"
    set: str = declare_key('the name of an element set, or "all"', "all")
    young: Positive | Three = declare_key("one positive number, or [E1, E2, E3] for an orthotropic material")
    poisson: Finite | Three = declare_key("one number, or [nu12, nu13, nu23] for an orthotropic material")
    density: Positive
    shear: Three | None = declare_key("[G12, G13, G23]", None)
    axes: Annotated[list[Three], length("three rows", 3)] | None = declare_key(
        "three rows, the material directions 1, 2, 3 in the frame of the mesh", None
    )

    def refuse_conflicts(self) -> None:
        lists = [isinstance(self.young, list), isinstance(self.poisson, list), self.shear is not None]
        if any(lists) and not all(lists):
            raise InputError(
                "an orthotropic material needs young = [E1, E2, E3], poisson = [nu12, nu13, nu23] and "
                "shear = [G12, G13, G23]; an isotropic one needs one young, one poisson and no shear",
                kind="missing",
                keyword="young",
            )
        if self.axes is not None and not all(lists):
            raise InputError("axes was given for an isotropic material; leave it out", keyword="axes")


class ReadMesh(JobStage):
    """The mesh of the job, in SI units."""

    tables = (ModelTable, MaterialTable)
    gives = (MESH,)
    step = "read"

    def refuse_conflicts(self, tables: JobTables) -> None:
        model, materials = ModelTable.of(tables), MaterialTable.of(tables)
        if model.mesh is not None and not materials:
            raise InputError(
                "material is missing; expected at least one table [[material]]", kind="missing", keyword="material"
            )
        if materials and model.mesh is None and not model.files:
            raise InputError(
                "[[material]] was given for bodies, whose matrices are ready; leave it out", keyword="material"
            )

    def is_asked(self, job: Job) -> bool:
        return ModelTable.of(job).mesh is not None

    def prepare(self, job: Job) -> None:
        materials_of(job)

    def reads(self, job: Job) -> Mapping[str, Path]:
        return {"the mesh": job.resolve(ModelTable.of(job).mesh or "")}

    def run(self, work: Work) -> None:
        mesh = mesh_of(work.job)
        require_room_of_mesh(work.job, mesh, materials_of(work.job), work.solver, work.start, work.counts_modes)
        work.give(MESH, mesh)


class Assemble(JobStage):
    """The model of a mesh."""

    tables = (ModelTable, MaterialTable)
    needs = (MESH,)
    gives = (MODEL,)
    step = "assemble"

    def is_asked(self, job: Job) -> bool:
        return ModelTable.of(job).mesh is not None

    def run(self, work: Work) -> None:
        rule = ModelTable.of(work.job).mass_integration
        work.give(MODEL, assemble(work[MESH], materials_of(work.job), mass_integration=rule))


class ReadModel(JobStage):
    """The model of files of a whole model, with what the job makes of its equations."""

    tables: ClassVar[tuple[type[JobTable], ...]] = (ModelTable, MaterialTable, FlowTable)
    gives = (MODEL,)
    step = "read"

    def refuse_conflicts(self, tables: JobTables) -> None:
        if FlowTable.of(tables) and not ModelTable.of(tables).brings_matrices:
            raise InputError(
                "[[flow]] was given without a model file; a mesh of solids has no tubes of beam elements",
                kind="conflict",
                keyword="flow",
            )

    def is_asked(self, job: Job) -> bool:
        return ModelTable.of(job).brings_matrices

    def prepare(self, job: Job) -> None:
        materials_of(job)

    def reads(self, job: Job) -> Mapping[str, Path]:
        tables = [flow.path for flow in FlowTable.of(job) if flow.path.endswith(".csv")]
        files = {f"the path of [[flow]] {path}": job.resolve(path) for path in tables}
        model = ModelTable.of(job)
        own = model.with_paths(job.resolve).files if model.brings_matrices else ()
        return {"the model file" if path.suffix == ".h5" else f"the file {path.name}": path for path in own} | files

    def matrices(self, job: Job) -> FEModel:
        """The model of its files, as they have it."""
        return model_of_files(job)

    def run(self, work: Work) -> None:
        job = work.job
        model = self.matrices(job)
        require_room(
            job,
            work.start,
            model.size,
            work.counts_modes,
            lambda: least_memory(job, model, work.solver, work.start, work.counts_modes),
        )
        work.give(MODEL, equations_of_motion(job, model))


def model_of_files(job: Job) -> FEModel:
    """The model of the files that ``[model]`` names, in SI units.

    Raises:
        InputError: files that cannot be used, or options that they do not take.
    """
    options = ModelTable.of(job).with_paths(job.resolve)
    if options.file is not None and is_model_file(Path(options.file)):
        rule = ["mass_integration"] if "mass_integration" in ModelTable.of(job).given else []
        for name in ["[[material]]"] if MaterialTable.of(job) else rule:
            raise InputError(f"{name} was given for a model file, whose matrices are ready; leave it out", keyword=name)
        if options.has_plain_file:
            # Its units are SI; those of the job are of the numbers in the job.
            return read_model(options.file)
    return read_files_model(options, [_material(table, Units()) for table in MaterialTable.of(job)], JOB)


def materials_of(job: Job) -> list[Material]:
    """The materials in SI units."""
    return [_material(table, job.units) for table in MaterialTable.of(job)]


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
    given = ModelTable.of(job)
    with advising(JOB):
        return read_mesh(
            job.resolve(given.mesh or ""),
            job.units,
            dialect=given.dialect,
            allow_includes_outside=given.allow_includes_outside,
        )
