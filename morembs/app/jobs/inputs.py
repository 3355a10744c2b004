"""The tables of a job as the objects that a run works with, in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from morembs.app.jobs.job import Job
from morembs.app.jobs.schema import MaterialTable
from morembs.base.arguments import refuse_out_of_range
from morembs.base.budget import Budget
from morembs.base.errors import InputError
from morembs.base.units import Units, parse_units
from morembs.body.build import BodyOptions, StressOptions
from morembs.body.floating.preload import Preload
from morembs.body.floating.spinning import Rotation
from morembs.body.floating.stiffening import Envelope
from morembs.fem import FEModel, Mesh
from morembs.fem.interface import Interface, make_interface, matrix_interface
from morembs.fem.material import Material, isotropic, orthotropic
from morembs.fem.selection import select_nodes
from morembs.importers import read_mesh
from morembs.importers.dependent_dofs import interface_of_coupling
from morembs.linalg.sparse.mumps_ranks import RankedMumps
from morembs.linalg.sparse.select import SOLVERS, select_solver
from morembs.linalg.sparse.solver import LinearSolver
from morembs.problem import Damping
from morembs.reducers import Facts, Reducer
from morembs.responses.direct import why_no_response
from morembs.storage.contents import promise
from morembs.storage.safefile import check_writable, one_file

# How many interface degrees of freedom make sense where the responses to all of them are followed at once.
MOST_INTERFACE_DOFS = 500


def units_of(job: Job) -> Units:
    """The declared units."""
    given = job.tables.model.units
    return parse_units(given if isinstance(given, str) else given.values())


def materials_of(job: Job) -> list[Material]:
    """The materials in SI units."""
    units = units_of(job)
    return [_material(table, units) for table in job.tables.material]


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


def reducers_of(job: Job) -> dict[str, Reducer]:
    """Name -> reducer, selections of nodes in the declared units."""
    length = units_of(job).length
    return {name: reducer.in_units(length) for name, reducer in job.reducers.items()}


def interfaces_of(job: Job, model: FEModel) -> list[Interface]:
    """The interfaces on the nodes of ``model``."""
    length = units_of(job).length
    interfaces = []
    for table in job.tables.interface:
        point = None if table.point is None else [length * value for value in table.point]
        if table.matrix is not None:
            interfaces.append(matrix_interface(model, name=table.name, matrix=table.matrix))
            continue
        # Without a matrix there are nodes: the schema sees to it.
        nodes = table.nodes or ""
        if nodes.startswith("coupling:"):
            coupling = table.coupling if "coupling" in table.given else None
            interfaces.append(
                interface_of_coupling(
                    model, nodes, name=table.name, coupling=coupling, point=point, components=table.components
                )
            )
            continue
        try:
            rows = select_nodes(model, nodes, length=length)
        except InputError as error:
            raise InputError(f"interface {table.name!r}: {error}") from error
        interfaces.append(
            make_interface(
                model, name=table.name, nodes=rows, coupling=table.coupling, point=point, components=table.components
            )
        )
    return interfaces


def damping_of(job: Job) -> Damping:
    """The damping with alpha in 1/s and beta in s; the frequencies of a table are in Hz whatever the unit of time."""
    given, time = job.tables.damping, units_of(job).time
    structural = given.structural or 0.0
    if given.rayleigh is not None:
        alpha, beta = given.rayleigh.alpha / time, given.rayleigh.beta * time
        return Damping(alpha=alpha, beta=beta, structural=structural)
    if isinstance(given.modal, str | list):
        return Damping(modal_table=given.modal, structural=structural)
    return Damping(modal=given.modal or 0.0, structural=structural)


def body_options(job: Job) -> BodyOptions:
    """What every body of the job carries, in SI units."""
    units, tables = units_of(job), job.tables
    given, origin = tables.envelope, tables.frame.origin
    envelope = None
    if given is not None:
        force = units.mass * units.length / units.time**2
        scale = {
            "acceleration": units.length / units.time**2,
            "angular_acceleration": units.time**-2,
            "speed": 1 / units.time,
            "force": force,
            "moment": force * units.length,
        }
        values = given.values(without_none=True)
        envelope = Envelope(**{name: value * scale[name] for name, value in values.items()})
    stiffened = tables.stiffening
    stress = tables.stress
    return BodyOptions(
        kind=tables.frame.kind,
        interfaces=tuple(tables.frame.interfaces),
        envelope=envelope,
        origin=None if origin == "center-of-mass" else [units.length * float(x) for x in origin or (0, 0, 0)],
        stiffening=None if stiffened is None else replace(envelope or Envelope(), share=stiffened.share),
        stress=None
        if stress is None
        else StressOptions(
            nodes=stress.nodes,
            single=stress.single,
            correction=stress.correction,
            jump=stress.jump,
            length=units.length,
        ),
    )


def preload_of(job: Job) -> Preload | None:
    """The preload in SI units, None without one."""
    given, units = job.tables.preload, units_of(job)
    if given is None:
        return None
    force, acceleration = units.mass * units.length / units.time**2, units.length / units.time**2
    scale = [force] * 3 + [force * units.length] * 3
    return Preload(
        wrench={name: [value * s for value, s in zip(f, scale, strict=True)] for name, f in given.wrench.items()},
        speed=given.speed / units.time,
        axis=given.axis,
        point=[units.length * value for value in given.point],
        acceleration=[acceleration * value for value in given.acceleration],
        held=tuple(given.held),
        follows=tuple(given.follows),
    )


def rotation_of(job: Job) -> tuple[Rotation, list[float]] | None:
    """The axis of [spin] and the speeds in rad/s, None without."""
    given, units = job.tables.spin, units_of(job)
    if given is None:
        return None
    rotation = Rotation(
        axis=given.axis,
        point=[units.length * value for value in given.point],
        held=tuple(given.held),
        stress=given.stress,
    )
    speeds = [speed / units.time for speed in given.speed]
    refuse_out_of_range("[spin]: speed", speeds)
    return rotation, speeds


def solver_of(job: Job) -> LinearSolver:
    """The solver with its budget and scratch folder."""
    given = job.tables.solver
    scratch = None if given.scratch is None else job.resolve(given.scratch)
    if scratch is not None and not scratch.is_dir():
        raise InputError(f"[solver]: scratch = {given.scratch!r} is not a folder; make it, or leave the key out")
    name = given.name if given.ranks is None else RankedMumps.name
    solver = select_solver(name, memory=job.memory, scratch=scratch)
    if given.ranks is not None:
        solver = replace(solver, ranks=given.ranks)  # type: ignore[call-arg]
    if not given.out_of_core:
        return solver
    able = {name: kind for name, kind in SOLVERS.items() if any(field.name == "out_of_core" for field in fields(kind))}
    if name not in able:
        raise InputError(f"[solver]: out_of_core = true needs a solver that can; name one: {', '.join(able)}")
    return replace(solver, out_of_core=True)  # type: ignore[call-arg]


def budget_of(job: Job, solver: LinearSolver) -> Budget:
    """The memory for the arrays of the job; none stays there where all is to be out of core."""
    return Budget(solver.memory, solver.scratch, in_memory=0 if job.tables.solver.out_of_core else None)


def prepare_output(job: Job) -> None:
    """Check before any work that the results can be written, and say that they will be: none is read from then on."""
    inputs, finals = inputs_of(job), replace(job, attempt="").results
    for name, path in job.results.items():
        for other, taken in inputs.items():
            if one_file(finals[name], taken):
                raise InputError(f"{name} = {str(path)!r} would overwrite {other}; give it a name of its own")
        promise(finals[name])
        check_writable(path)
        inputs[name] = finals[name]


def inputs_of(job: Job) -> dict[str, Path]:
    """The files that the job reads by the words for each: itself, and what its model comes from."""
    moves = {
        f"the morph of {t.name}": job.resolve(t.mesh or t.displacement or "")
        for t in job.tables.parameter
        if t.mesh or t.displacement
    }
    what = "the mesh" if job.tables.model.mesh else "the model file" if job.tables.model.file else "a body"
    files = {what if not number else f"{what} {number + 1}": file for number, file in enumerate(sources_of(job))}
    tables = {f"the path of [[flow]] {t.path}": job.resolve(t.path) for t in job.tables.flow if t.path.endswith(".csv")}
    makers = {f"the job of part {t.name}": job.resolve(t.job) for t in job.tables.substructure if t.job}
    return {"the job file": job.path, **files, **moves, **tables, **makers}


def refuse_reductions_that_do_not_fit(job: Job, facts: Facts) -> None:
    """Ask every reduction and comparison whether it can be made.

    Raises:
        InputError: one cannot.
    """
    inputs = facts.inputs
    if not inputs and job.tables.certify is not None:
        raise InputError(
            "[certify] compares interface degrees of freedom, and there are none; add at least one [[interface]]"
        )
    compared = [key for key in ("certify", "response") if getattr(job.tables, key) is not None]
    if compared and inputs > MOST_INTERFACE_DOFS:
        raise InputError(
            f"[{compared[0]}] compares the responses of all interface degrees of freedom, {inputs} x {inputs} at each "
            f"frequency, and at most {MOST_INTERFACE_DOFS} fit; leave [{compared[0]}] out, or take rigid or average "
            "couplings"
        )
    for name, reducer in reducers_of(job).items():
        if inputs > MOST_INTERFACE_DOFS and reducer.follows_responses:
            raise InputError(
                f"[[reduce]] {name!r}: method = {reducer.method!r} follows the responses to each of {inputs} interface "
                f"degrees of freedom, and at most {MOST_INTERFACE_DOFS} fit; take craig-bampton with "
                "interface_up_to_hz, or rigid or average couplings"
            )
        reason = reducer.why_not(facts)
        if reason:
            raise InputError(f"[[reduce]] {name!r}: {reason}")
    reason = why_no_response(facts.damping, facts.own_damping, facts.size)
    if compared and reason:
        raise InputError(f"[{compared[0]}]: {reason}")


def sources_of(job: Job) -> list[Path]:
    """The mesh or model file, or the body files of an assembly, each once."""
    given = job.tables.model
    names = [given.file or given.mesh] if given.file or given.mesh else [t.body for t in job.tables.substructure]
    return [job.resolve(name) for name in dict.fromkeys(names) if name]


def mesh_of(job: Job) -> Mesh:
    """The mesh of the job, in SI units."""
    given = job.tables.model
    return read_mesh(
        sources_of(job)[0], units_of(job), dialect=given.dialect, allow_includes_outside=given.allow_includes_outside
    )


def certified_band(job: Job) -> Sequence[float] | None:
    """The band of [certify], or the widest that a reduction was made for with a tolerance."""
    if job.tables.certify is not None:
        return job.tables.certify.band_hz
    bands = [band for reducer in job.reducers.values() if (band := reducer.certified_band) is not None]
    return (min(band[0] for band in bands), max(band[1] for band in bands)) if bands else None


def wants_modes(job: Job) -> bool:
    """Whether any modes are computed, and so counted."""
    wanted = bool(job.tables.check.full_modes) or job.tables.certify is not None
    return wanted or any(reducer.computes_modes for reducer in job.reducers.values())
