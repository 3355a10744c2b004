"""Files as scenes of the viewer: what bodies, recovered motions, models, decks and jobs show."""

from __future__ import annotations

import base64
import io
import shlex
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from morembs.app.jobs.job import load_job
from morembs.app.jobs.proposals import surface_selections
from morembs.app.jobs.stages.couple import interfaces_of
from morembs.app.jobs.stages.forecast import outline_model
from morembs.app.jobs.stages.member_table import MemberTable
from morembs.app.jobs.stages.model import materials_of, mesh_of, model_of_files
from morembs.app.jobs.stages.unreduced import SubstructureTable
from morembs.app.jobs.tables import Job, ModelTable
from morembs.app.kinds import BODY, DECK, JOB, MATRIX_FILE, MODEL, PARTS, instead, kind_of
from morembs.app.report.style import STYLE
from morembs.base import progress
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.base.units import Units
from morembs.body.body import Body
from morembs.body.diagnostics.findings import Finding
from morembs.body.diagnostics.shown import groups_of_findings, mesh_findings
from morembs.body.diagnostics.warnings import diagnosis_of
from morembs.body.file import read_body
from morembs.body.recovery.recover import SERIES
from morembs.body.scenes import scene_of_bodies, scene_of_series
from morembs.body.stored import StoredBodies
from morembs.body.tolerances import TOL
from morembs.fem import FEModel, Mesh, Nodes
from morembs.fem.constraints import AverageElement, RigidElement
from morembs.fem.interface import Interface
from morembs.fem.viewer import Group, Scene
from morembs.fem.viewer.models import groups_of_model, scene_of_nodes
from morembs.importers import import_file, read_deck, read_mesh
from morembs.importers.decks.problems import DeckError
from morembs.importers.model_file import read_model

ONE_FILE = "a body, a recovered motion, a model, a mesh, a deck or a job"
NONE: Ints = np.empty(0, dtype=np.int64)


def scene_of_files(files: Sequence[Path]) -> tuple[Scene, list[Body]]:
    """What a viewer shows of one file, or of two body files, and the bodies in it.

    Raises:
        InputError: files that cannot be shown.
    """
    kinds = [kind_of(file) for file in files]
    for file, kind in zip(files, kinds, strict=True):
        if not file.exists():
            raise InputError(f"{file} is not there; check the path", kind="file")
        if file.suffix.lower() not in SERIES and kind is not BODY and (len(files) > 1 or kind not in (JOB, *PARTS)):
            what = "two body files" if len(files) > 1 else ONE_FILE
            raise InputError(f"{file}: {instead(file, what) or f'its kind cannot be shown; expected {what}'}")
    first = files[0]
    progress.stage("read")
    if first.suffix.lower() in SERIES:
        return scene_of_series(first, first.name), []
    if kinds[0] is JOB:
        return _scene_of_job(load_job(first)), []
    if kinds[0] is not BODY:
        return _scene_of_part(first), []
    stored = [read_body(file) for file in files]
    bodies = [body for each in stored for body in each.bodies.values()]
    if len(stored) == 1:
        return stored_scene(stored[0], first.name), bodies
    # The recommended body of each, first of all: these two stand beside each other.
    chosen = [_select_body(each) for each in stored]
    order = [*chosen, *(body for body in bodies if body not in chosen)]
    of_file = {id(body): file.name for file, each in zip(files, stored, strict=True) for body in each.bodies.values()}
    names = [f"{of_file[id(body)]}: {body.name}" for body in order]
    scene = scene_of_bodies(order, " and ".join(file.name for file in files), names=names)
    return _with_frames(scene, stored[0]), order


def stored_scene(stored: StoredBodies, title: str, shown: str = "", modes: int = TOL.viewed_modes) -> Scene:
    """All bodies of a file, the body named ``shown`` first with so many ``modes``.

    Raises:
        InputError: a file without nodes or faces, or one that is damaged.
    """
    if not len(stored.node_ids):
        raise InputError(
            f"{title} keeps no nodes, so there is nothing to show; write it again with nodes = 'skin'", kind="file"
        )
    first = stored.bodies[shown] if shown else _select_body(stored)
    bodies = list(stored.bodies.values())
    scene = scene_of_bodies(bodies, title, shown=bodies.index(first), modes=modes)
    return _with_frames(scene, stored)


def _with_frames(scene: Scene, stored: StoredBodies) -> Scene:
    nodes = {name: each.node_ids for name, each in stored.interfaces.items() if each.node_ids is not None}
    return replace(scene, frames=_frames(stored.interfaces.values()), frame_nodes=nodes)


def _frames(interfaces: Iterable[Interface]) -> dict[str, Floats]:
    """Origin and axes (4, 3) of interfaces by name."""
    return {each.name: np.vstack([each.point, each.axes]) for each in interfaces}


def _select_body(stored: StoredBodies) -> Body:
    """The body with the smallest error, else the first."""
    certified = [body for body in stored.bodies.values() if body.certificate is not None and body.certificate.limits]
    best = min(certified, key=lambda body: body.certificate.limit.upper if body.certificate else np.inf, default=None)
    return best if best is not None else next(iter(stored.bodies.values()))


def _scene_of_part(path: Path) -> Scene:
    """A model file in SI units; a mesh or a deck in its own."""
    if kind_of(path) is MODEL:
        model = read_model(path)
        return _scene_of_model(path.name, model, diagnosis_of(model).findings, Units())
    with suppress(DeckError):
        found = import_file(path)
        nodes = found.nodes if found.nodes is not None else found.mesh.nodes if found.mesh is not None else None
        if nodes is not None:
            nodes = _with_unused(nodes, path)
            hanging = [each.nodes for each in found.equations]
            hanging += [np.array([each.node]) for each in found.masses] + [each.nodes for each in found.discrete]
            return _scene(
                path.name, nodes, found.mesh, (*found.rigid, *found.average), hanging=hanging, warnings=found.warnings
            )
    if kind_of(path) is MATRIX_FILE:
        cure = f"morembs init {shlex.quote(str(path))} writes a job for it"
        raise InputError(f"{path} holds matrices alone, no nodes: there is nothing to show; {cure}", kind="unsupported")
    mesh = read_mesh(path)
    return _scene(path.name, mesh.nodes, mesh, warnings=mesh.warnings)


def _with_unused(nodes: Nodes, path: Path) -> Nodes:
    """The nodes with those behind them that a deck has and no element; other files give all of theirs."""
    if kind_of(path) is not DECK:
        return nodes
    with suppress(InputError):
        deck = read_deck(path)
        unused = np.flatnonzero(~np.isin(deck.ids, nodes.ids))
        ids, xyz = np.append(nodes.ids, deck.ids[unused]), np.concatenate([nodes.xyz, deck.xyz[unused]])
        return Nodes(ids=ids, xyz=xyz, sets=nodes.sets)
    return nodes


def _scene_of_model(
    title: str, model: FEModel, findings: Sequence[Finding], units: Units, interfaces: Sequence[Interface] = ()
) -> Scene:
    hanging = [each.nodes for each in model.equations] + [model.dofs.node]
    return _scene(
        title,
        model.nodes,
        model.mesh,
        (*model.rigid, *model.average),
        hanging=hanging,
        findings=findings,
        units=units,
        interfaces=interfaces,
        warnings=model.warnings,
    )


def _scene_of_job(job: Job) -> Scene:
    """The part of a job with its interfaces, in the job's numbers.

    Raises:
        InputError: a job without a mesh or a model, or whose interfaces cannot be found.
    """
    given = ModelTable.of(job)
    if given.mesh is not None:
        mesh = mesh_of(job)
        model = outline_model(job, mesh, materials_of(job))
        findings = mesh_findings(mesh)
    elif given.files:
        model = model_of_files(job)
        findings = list(diagnosis_of(model).findings)
    else:
        raise InputError(_instead_of_job(job), kind="unsupported")
    return _scene_of_model(job.path.name, model, findings, job.units, interfaces_of(job, model))


def _instead_of_job(job: Job) -> str:
    """Why a job without a mesh or a model cannot be shown, and what can."""
    member = MemberTable.of(job)
    if member is None:
        bodies = [shlex.quote(str(job.resolve(table.body))) for table in SubstructureTable.of(job)]
        return f"{job.path} couples bodies, which are viewed one by one: morembs view {bodies[0]}"
    if member.mesh is None:
        made = f"morembs reduce {shlex.quote(str(job.path))} makes it, and morembs info tells of it"
        return f"{job.path} describes a planar member, a beam without faces: there is nothing to show; {made}"
    mesh = shlex.quote(str(job.resolve(member.mesh)))
    return f"{job.path} describes a planar member, of which the mesh alone can be shown: morembs view {mesh}"


def _scene(
    title: str,
    nodes: Nodes,
    mesh: Mesh | None,
    couplings: Sequence[RigidElement | AverageElement] = (),
    *,
    hanging: Sequence[Ints] = (),
    findings: Sequence[Finding] | None = None,
    units: Units | None = None,
    interfaces: Sequence[Interface] = (),
    warnings: Sequence[str] = (),
) -> Scene:
    """``units`` are those of a job, None for the numbers of a file; coordinates are in m or in these numbers."""
    length = 1.0 if units is None else units.length
    joined = [np.append(each.others, each.center) for each in couplings]
    if findings is None:
        findings = mesh_findings(mesh) if mesh is not None else []
    groups = [
        *groups_of_findings(findings, nodes, mesh, np.concatenate([NONE, *joined, *hanging])),
        *(Group(name=each.name, kind="interface", nodes=each.nodes, about=each.coupling) for each in interfaces),
        *groups_of_model(nodes, mesh, couplings),
    ]
    features = []
    if mesh is not None and mesh.blocks:
        scaled = replace(mesh, nodes=replace(nodes, xyz=nodes.xyz / length)) if length != 1 else mesh
        features = [(one.nodes, one.about, one.rows) for one in surface_selections(scaled, units or Units())]
    return scene_of_nodes(
        title,
        nodes,
        mesh,
        groups,
        features=features,
        frames=_frames(interfaces),
        unit="" if units is None else units.name.partition("-")[0],
        length=length,
        notes=tuple(warnings),
    )


def still_picture(bodies: Sequence[Body]) -> str:
    """Four modes of the first body as the address of a small picture, for where no script runs; "" without any, and
    where they have no faces."""
    if not bodies:
        return ""
    # Not at the top: most commands draw nothing.
    from PIL import Image

    file, small = io.BytesIO(), io.BytesIO()
    try:
        figure = bodies[0].plot()
    except InputError:
        return ""
    figure.savefig(file, format="png", dpi=STYLE.still_dots)
    Image.open(file).convert("RGB").quantize(STYLE.still_colors).save(small, format="png", optimize=True)
    return "data:image/png;base64," + base64.b64encode(small.getvalue()).decode()
