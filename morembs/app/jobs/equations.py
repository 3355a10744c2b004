"""The equations of motion of a job: the model of its file with its skew parts and the fluid that flows through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from morembs.app.jobs.tables import Job, ModelTable, RepeatedTable
from morembs.app.jobs.tolerances import TOL
from morembs.base.errors import InputError
from morembs.base.key_tables import declare_key
from morembs.base.limits import Finite, number, text
from morembs.fem import FEModel
from morembs.fem.fe_model import split_unsymmetric
from morembs.fem.selection import select_nodes
from morembs.fem.tubes import Flow, add_flow
from morembs.importers.to_model import rows_of_labels
from morembs.problem import Problem


@dataclass(frozen=True, kw_only=True)
class FlowTable(RepeatedTable):
    """``[[flow]]``: fluid that flows through a tube of beam elements, in the declared units."""

    path: Annotated[str, text('nodes in the order of the flow: "ids:4,7,2", "set:TUBE" or the path of a .csv')]
    mass_flow: Finite = declare_key("a number (mass/time)")
    density: Annotated[float, number("a number above zero", gt=0)]
    area: Annotated[float, number("the area of the bore", gt=0)]
    outlet: Literal["held", "free"] = declare_key('"held" or "free": the last node is a nozzle', "held")


def equations_of_motion(job: Job, model: FEModel) -> FEModel:
    """The ``model`` of the file with what the job makes of its skew parts, and with the fluid that flows through it."""
    model = _without_skew_parts(model, ModelTable.of(job).unsymmetric)
    flows = flows_of(job, model)
    still = model
    for path, flow in flows:
        model = add_flow(model, path, flow)
    # Paths are checked by then.
    _refuse_loose_tubes(still, [path for path, flow in flows if flow.mass_flow])
    return model


def _refuse_loose_tubes(model: FEModel, paths: Sequence[NDArray[np.int64]]) -> None:
    """Refuse tubes that nothing keeps from turning in ``model``, which is without the flow.

    Raises:
        InputError: in these cases.
    """
    if not paths:
        return
    with Problem(model) as problem:
        rigid = np.vstack([problem.rigid, np.zeros((1, problem.rigid.shape[1]))])
    # Dofs that are not there are at rest, the last row.
    places = rigid[model.dofs.table(len(model.nodes))[:, :3]]
    for path in paths:
        turned = np.abs(np.diff(places[path], axis=0)).max(initial=0.0)
        if turned > TOL.turned_tube * np.abs(places).max(initial=0.0):
            raise InputError(
                "[[flow]]: the tube is free to rotate, and the fluid would rotate it; hold the tube in the model "
                "at one end or both",
                keyword="flow",
            )


def _without_skew_parts(model: FEModel, unsymmetric: str) -> FEModel:
    """``model`` with the skew parts of its K and D in N and G, or without them where they are to be dropped."""
    if unsymmetric == "refuse":
        return model
    parts = split_unsymmetric(model)
    return parts if unsymmetric == "split" else replace(parts, G=model.G, N=model.N)


def flows_of(job: Job, model: FEModel) -> list[tuple[NDArray[np.int64], Flow]]:
    """Rows of the nodes along each tube, in the order of its flow, and the flow in SI units."""
    units = job.units
    return [
        (
            _path_of(job, model, table.path),
            Flow(
                mass_flow=table.mass_flow * units.mass / units.time,
                density=table.density * units.density,
                area=table.area * units.length**2,
                outlet=table.outlet,
            ),
        )
        for table in FlowTable.of(job)
    ]


def _path_of(job: Job, model: FEModel, path: str) -> NDArray[np.int64]:
    labels = path.removeprefix("ids:").split(",")
    if path.endswith(".csv"):
        try:
            labels = job.resolve(path).read_text(encoding="utf-8-sig").replace(",", " ").split()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"[[flow]]: path = {path!r} cannot be read; expected a text of labels of nodes",
                kind="file",
                keyword="path",
            ) from error
    elif not path.startswith("ids:"):
        return select_nodes(model, path, length=job.units.length)
    try:
        numbers = np.array([int(label) for label in labels], dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"[[flow]]: path = {path!r} holds something else than labels of nodes ({error})", keyword="path"
        ) from error
    return rows_of_labels(model.nodes, numbers, f"[[flow]] path = {path!r}")
