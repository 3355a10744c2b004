"""The bodies of a job as one model, with the models that they were reduced from where their jobs are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from morembs.app.jobs.equations import equations_of_motion
from morembs.app.jobs.files import inputs_of, results_of
from morembs.app.jobs.job import load_job
from morembs.app.jobs.solver import solver_of
from morembs.app.jobs.stages.certificate import certified_band
from morembs.app.jobs.stages.couple import damping_of, interfaces_of
from morembs.app.jobs.stages.model import materials_of, mesh_of, model_of_files
from morembs.app.jobs.stages.parameters import ParameterTable
from morembs.app.jobs.stages.preload import PreloadTable
from morembs.app.jobs.stages.reduction import reducers_of
from morembs.app.jobs.stages.spin import SpinTable
from morembs.app.jobs.stages.unreduced import CoupleTable, SubstructureTable
from morembs.app.jobs.tables import Job, ModelTable
from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.body.file import StoredBodies, read_body
from morembs.body.stored import choose_body
from morembs.dynamics.assembly import AssembledModel, Couple, Substructure, assemble_bodies
from morembs.fem.assembly import assemble
from morembs.problem import Problem
from morembs.storage.safefile import one_file

# Tables that make another model of the part than its mesh or file holds.
NOT_PLAIN = (SubstructureTable, ParameterTable, PreloadTable, SpinTable)


def assembly_of(job: Job) -> AssembledModel:
    """The bodies of the job as one model, in SI units; a file that serves for several parts is read once.

    Raises:
        InputError: body files or jobs of parts that cannot be read, bodies that cannot be coupled, or couplings that
            leave a mechanism.
    """
    units = job.units
    force = units.stress * units.length**2
    linear, turning = [force / units.length] * 3, [force * units.length] * 3
    scale = np.array(linear + turning)
    tables = SubstructureTable.of(job)
    files = {table.body: read_body(job.resolve(table.body)) for table in tables}
    makers = {table.job: _Maker(job, table.job) for table in tables if table.job is not None}
    if makers and certified_band(job) is None:
        raise InputError(
            "[[substructure]] job was given, and there is no certificate to measure against the unreduced parts; add "
            "[certify], or leave job out",
            kind="unknown",
            keyword="substructure",
        )
    parts = [
        Substructure(
            name=table.name,
            bodies=_at_values(files[table.body], table),
            reduction=table.reduction,
            position=units.length * np.array(table.position),
            rotation=_read_rotation(table),
            problem=None if table.job is None else makers[table.job].problem,
            basis=None if table.job is None else makers[table.job].basis(files[table.body], table),
        )
        for table in tables
    ]
    couples = [
        Couple(
            between=(table.between[0], table.between[1]),
            components=tuple(table.components),
            stiffness=None if table.stiffness is None else (scale * table.stiffness).tolist(),
            damping=None if table.damping is None else (units.time * scale * table.damping).tolist(),
        )
        for table in CoupleTable.of(job)
    ]
    model = assemble_bodies(parts, couples, name=job.path.stem)
    if model.free_motions:
        raise InputError(
            f"the couplings leave the parts free to move against each other: {'; '.join(model.free_motions)}; a body "
            "has the six rigid motions of one free part only: couple these components too, by a [[couple]] with "
            "stiffness if they are soft, or reduce the parts one by one and join them in the simulation",
            kind="model",
        )
    return model


class _Maker:
    """The job ``path`` that made a body of the assembly ``job``, and the problem that it reduced."""

    def __init__(self, job: Job, path: str) -> None:
        self.where = f"[[substructure]] job = {path!r}"
        try:
            self.job = load_job(job.resolve(path))
            given = [kind.key() for kind in NOT_PLAIN if kind.of(self.job)]
            if given:
                raise InputError(
                    f"it has a table {given[0]!r}; certificates against unreduced parts take a mesh or a model file as "
                    "it is: leave job out"
                )
            self._refuse_overwriting(job)
            self.problem = self._problem(job)
        except InputError as error:
            raise error.restate(f"{self.where}: {error}") from error

    def _refuse_overwriting(self, job: Job) -> None:
        for name, path in results_of(replace(job, attempt="")).items():
            for what, other in inputs_of(self.job).items():
                if one_file(path, other):
                    raise InputError(
                        f"{name} = {str(path)!r} would overwrite {what} of it", kind="output", keyword=name
                    )

    def _problem(self, job: Job) -> Problem:
        own = self.job
        given = ModelTable.of(own)
        if given.brings_matrices:
            model = equations_of_motion(own, model_of_files(own))
        else:
            model = assemble(mesh_of(own), materials_of(own), mass_integration=given.mass_integration)
        # That of the part: another one may turn modes of one frequency.
        solver = solver_of(own).with_memory(solver_of(job).memory)
        return Problem(model, interfaces_of(own, model), damping=damping_of(own), solver=solver)

    def basis(self, bodies: StoredBodies, table: SubstructureTable) -> Callable[[], Floats]:
        """What reduces the problem again, for bodies whose file does not keep all displacements."""

        def again() -> Floats:
            name, reducers = choose_body(bodies, table.reduction, table.body).name, reducers_of(self.job)
            if name not in reducers:
                raise InputError(
                    f"{self.where}: it makes no body {name!r}; it has {', '.join(reducers)}", kind="unknown"
                )
            reduced = reducers[name].reduce(self.problem)
            self.problem.release()
            return reduced.V

        return again


def _at_values(bodies: StoredBodies, table: SubstructureTable) -> StoredBodies:
    """The bodies of a file, or the one of them that has parameters at the values of ``table``."""
    if not table.at:
        return bodies
    try:
        evaluated: StoredBodies = choose_body(bodies, table.reduction, table.body).parametric.at(**table.at).bodies
    except InputError as error:
        raise error.restate(f"substructure {table.name!r}: at was given: {error}") from error
    return evaluated


def _read_rotation(table: SubstructureTable) -> NDArray[np.float64]:
    if table.rotation is None:
        return np.eye(3)
    # Not at the top: few jobs turn anything.
    from scipy.spatial.transform import Rotation

    axis = np.array(table.rotation.axis)
    if not np.linalg.norm(axis) > 0:
        raise InputError(f"substructure {table.name!r}: rotation has axis = {axis.tolist()}; expected a direction")
    turn = Rotation.from_rotvec(np.radians(table.rotation.degrees) * axis / np.linalg.norm(axis))
    return np.asarray(turn.as_matrix())
