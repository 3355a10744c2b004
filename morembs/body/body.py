"""Reduced model -> elastic body: what a multibody simulator or a person needs of it. SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.summary import hertz, kinds_words, summarised
from morembs.base.types import Floats, Ints
from morembs.body.floating.frame import FloatingFrame, floating_frame, why_not_floating
from morembs.body.floating.ranking import RankedTerm
from morembs.body.floating.spin import ReducedSpin
from morembs.body.stress_shapes import Recovery
from morembs.body.view import Viewed, refuse_no_modes
from morembs.body.vtkhdf import VTK_VERTEX, Cells
from morembs.body.vtkhdf_series import Grid, View
from morembs.fem import FEModel, Nodes
from morembs.fem.elements import FACES, TYPES
from morembs.fem.interface import Interface
from morembs.fem.surface import outer_faces
from morembs.problem import Problem
from morembs.reducers.base import ReducedModel
from morembs.reducers.pymor import to_pymor
from morembs.reducers.switching_tables import StaticModeTables

if TYPE_CHECKING:
    from morembs.body.parametric_parts import ParametricParts
    from morembs.certificate.certify import Certificate

NODE_CHOICES = ("all", "skin", "interfaces")


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """What all reductions of one model share.

    ``mass`` kg; ``center_of_mass`` (3,) m; ``inertia`` (3, 3) kg m2 about the centre of mass along the
    model's axes. ``nodes`` are the chosen nodes, ``cells`` the mesh between them, ``transformation``
    (3 n, Nc) gives their displacements (x, y, z of the first node, of the second, ...) from the coupled
    dofs. ``interfaces`` keep rows of the full model; ``node_ids`` its labels of all nodes, ``warnings`` what it
    differs in from its source.
    """

    mass: float
    center_of_mass: Floats
    inertia: Floats
    nodes: Nodes
    cells: tuple[Cells, ...]
    transformation: sp.csr_array
    interfaces: tuple[Interface, ...]
    columns: Mapping[str, slice]
    node_ids: Ints
    source: str = ""
    warnings: tuple[str, ...] = ()

    def _facts(self) -> dict[str, object]:
        return {
            "mass": f"{self.mass:.4g} kg",
            "centre of mass": self.center_of_mass,
            "nodes": len(self.nodes),
            "interfaces": [each.name for each in self.interfaces],
            "source": self.source,
        }

    def grid(self) -> Grid:
        """The cells as VTK keeps them."""
        sizes = [np.full(len(cells.connectivity), cells.connectivity.shape[1]) for cells in self.cells]
        types = [np.full(len(cells.connectivity), cells.vtk, dtype=np.uint8) for cells in self.cells]
        links = [cells.connectivity.ravel() for cells in self.cells]
        return Grid(
            points=self.nodes.xyz,
            connectivity=np.concatenate([np.zeros(0, dtype=np.int64), *links]),
            offsets=np.cumsum(np.concatenate([[0], *sizes]), dtype=np.int64),
            types=np.concatenate([np.zeros(0, dtype=np.uint8), *types]),
        )


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticBody(Viewed):
    """One reduced model as a body.

    ``frequencies_hz`` (n,) eigenfrequencies of the reduced pencil in ascending order, rigid ones zero;
    ``full_frequencies_hz`` those of the full coupled model where they were computed, rigid ones zero;
    ``certificate`` says how wrong the body is, if that was asked for; ``floating`` is what a simulator with large
    rotations needs, None for a body that is held or not symmetric; ``ranking`` says which of its terms matter,
    ``recovery`` gives stresses, where these were asked for; ``switching`` holds the static modes of candidate loads,
    ``parametric`` what gives the body at other values of parameters, ``spin`` the matrices of a frame that turns with
    the body.

    >>> body.reduced.order, body.floating.kind
    (18, 'mean-axes')
    >>> body
    ElasticBody: name craig-bampton; order 18; elastic frequencies ...
    """

    part: Part
    reduced: ReducedModel
    frequencies_hz: Floats
    full_frequencies_hz: Floats | None = None
    certificate: Certificate | None = None
    floating: FloatingFrame | None = None
    ranking: tuple[RankedTerm, ...] = ()
    recovery: Recovery | None = None
    switching: StaticModeTables | None = None
    parametric: ParametricParts | None = None
    spin: ReducedSpin | None = None
    recipe: Mapping[str, object] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the reduction."""
        return self.reduced.name

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats]:
        """M, K, D (n, n), at rest where the body may spin."""
        return self.reduced.M, self.reduced.K, self.reduced.D

    def _facts(self) -> dict[str, object]:
        certificate, floating = self.certificate, self.floating
        return {
            "name": self.name,
            "order": self.reduced.order,
            "elastic frequencies": hertz(self.frequencies_hz[self.reduced.rigid_count :]),
            "error": "not certified" if certificate is None else certificate.words,
            "coordinates": kinds_words(self.reduced.mode_kind),
            "mass": f"{self.part.mass:.4g} kg",
            "frame": None if floating is None else floating.kind,
        }

    def basis(self, columns: slice = slice(None)) -> Floats:
        """Displacements (3 n, k) of the chosen nodes for some coordinates; allocates only these."""
        return np.asarray(self.part.transformation @ self.reduced.V[:, columns])

    def modes(self, count: int) -> Floats:
        """Shapes (k, n, 3) of the first elastic modes at the chosen nodes, at most ``count``, of unit modal mass."""
        refuse_no_modes(count)
        first = self.reduced.rigid_count
        Y = self.reduced.modes()[1][:, first : first + count]
        shapes = self.part.transformation @ (self.reduced.V @ Y)
        return np.asarray(shapes).T.reshape(Y.shape[1], -1, 3)

    def view(self, modes: int) -> View:
        """The first elastic ``modes`` on the cells of the part, for ``plot`` and ``to_pyvista``.

        Raises:
            InputError: no positive count was asked for, or the body keeps no nodes.
        """
        part, first = self.part, self.reduced.rigid_count
        if not part.cells:
            raise InputError(f'{self.name} keeps no nodes; keep nodes = "all", "skin" or "interfaces"')
        motion = self.modes(modes)
        return View(
            body=self.name,
            grid=part.grid(),
            node_ids=part.nodes.ids,
            motion=motion,
            frequencies_hz=self.frequencies_hz[first : first + len(motion)],
            interfaces={interface.name: interface.point for interface in part.interfaces},
        )

    def to_pymor(self) -> Any:
        """The reduced model as a ``pymor.models.iosys.SecondOrderModel``; see ``morembs.to_pymor``."""
        return to_pymor(self.reduced)


def input_columns(
    interfaces: Sequence[Interface], columns: Mapping[str, slice], node_ids: Ints
) -> tuple[Ints, Ints, Ints]:
    """Of each column of an input matrix (m,) the position of its interface, its motion 0..5 (6: of a generalised force)
    and the label of its node (-1: a frame, or none), from the ``columns`` of each interface and all labels."""
    count = sum(some.stop - some.start for some in columns.values())
    index, component, node = (np.full(count, -1, dtype=np.int64) for _ in range(3))
    for number, interface in enumerate(interfaces):
        some, (exposed, rows) = columns[interface.name], interface.kind.columns(interface)
        index[some], component[some] = number, exposed
        node[some] = np.where(rows < 0, -1, node_ids[rows])
    return index, component, node


def make_part(problem: Problem, nodes: str = "all") -> Part:
    """What all bodies of ``problem`` share, displacements kept at ``nodes``: all, skin or interfaces.

    Raises:
        InputError: unknown choice, or skin of a model without elements.

    >>> make_part(problem, "skin")
    Part: mass 7.85 kg; centre of mass [0.2, 0.025, 0.025]; nodes 20; interfaces LEFT, RIGHT; source bar
    """
    model = problem.model
    rows, cells = _chosen(model, problem.interfaces, nodes)
    dofs = model.dofs.of_nodes(rows).ravel()
    held = sp.csr_array(problem.coupling.T)
    picked = held[np.maximum(dofs, 0)]
    if (dofs < 0).any():
        # A node without some displacement (a matrix model) stays still along it.
        picked = sp.csr_array(sp.diags_array((dofs >= 0).astype(float)) @ picked)
    mass, center, inertia = problem.mass_properties
    chosen = Nodes(ids=model.nodes.ids[rows], xyz=model.nodes.xyz[rows])
    return Part(
        mass=mass,
        center_of_mass=center,
        inertia=inertia,
        nodes=chosen,
        cells=cells,
        transformation=picked,
        interfaces=problem.interfaces,
        columns=problem.coupling.columns,
        node_ids=model.nodes.ids,
        source=model.source,
        warnings=model.warnings,
    )


def _chosen(model: FEModel, interfaces: Sequence[Interface], nodes: str) -> tuple[Ints, tuple[Cells, ...]]:
    """Rows of the chosen nodes and the cells between them, renumbered."""
    if nodes not in NODE_CHOICES:
        raise InputError(f"nodes = {nodes!r} was given; expected one of {', '.join(NODE_CHOICES)}")
    touched = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(i.nodes for i in interfaces)]))
    if nodes == "interfaces" or model.mesh is None:
        if nodes == "skin":
            raise InputError('nodes = "skin" needs elements; this model has matrices only, take "all" or "interfaces"')
        rows = touched if nodes == "interfaces" else np.arange(len(model.nodes))
        points = Cells(vtk=VTK_VERTEX, connectivity=np.arange(len(rows))[:, None])
        return rows, (points,) if len(rows) else ()
    if nodes == "skin":
        faces = {kind: f for kind, f in outer_faces(model.mesh).items() if len(f)}
        rows = np.unique(np.concatenate([touched, *(f.ravel() for f in faces.values())]))
        typed = [(FACES[kind].vtk, f) for kind, f in faces.items()]
    else:
        rows = np.arange(len(model.nodes))
        typed = [(TYPES[block.type].vtk, block.nodes) for block in model.mesh.blocks]
    local = np.full(len(model.nodes), -1, dtype=np.int64)
    local[rows] = np.arange(len(rows))
    return rows, tuple(Cells(vtk=vtk, connectivity=local[c]) for vtk, c in typed)


def elastic_body(
    problem: Problem,
    reduced: ReducedModel,
    part: Part,
    certificate: Certificate | None = None,
    floating: FloatingFrame | None = None,
) -> ElasticBody:
    """Body of a reduced model: its frequencies and what it shares with others of the same part.

    ``floating`` by default has mean axes.

    >>> elastic_body(problem, reduced, make_part(problem)).frequencies_hz.shape
    (18,)
    """
    if floating is None and not why_not_floating(problem, reduced):
        floating = floating_frame(problem, reduced)
    eigenvalues, _ = reduced.modes()
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    omega[: reduced.rigid_count] = 0.0
    return ElasticBody(
        part=part,
        reduced=reduced,
        frequencies_hz=omega / (2 * np.pi),
        certificate=certificate,
        floating=floating,
        full_frequencies_hz=problem.known_frequencies_hz(),
        recipe=reduced.recipe,
    )
