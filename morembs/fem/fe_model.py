"""The finite-element model: sparse matrices, nodes and what each degree of freedom means. SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.fem.arrays import freeze
from morembs.fem.constraints import COUPLING, COUPLINGS, AverageElement, DependentDofs, Equations, RigidElement
from morembs.fem.material import Material
from morembs.fem.mesh import Mesh, Nodes, material_of_elements, refuse_far
from morembs.fem.named_columns import NamedColumns
from morembs.fem.stored import matrix_table
from morembs.fem.tolerances import TOL
from morembs.storage.table import dataset, derived, repeat_table, table_of

if TYPE_CHECKING:
    import scipy.sparse as sp

    from morembs.fem.viewer.page import Scene

# Stiffness, mass, damping, gyroscopic and circulatory matrix.
MATRICES = ("K", "M", "D", "G", "N")
# Keys of the recipe of a body: its loss factor, and motions of interfaces that no mass follows.
STRUCTURAL, WITHOUT_MASS = "structural_damping", "without_mass"


class Component:
    """Codes of components in dof maps, and in files of models and bodies.

    0 to 2 are displacements along x, y, z and 3 to 5 rotations about them.
    """

    # No motion of a node.
    SCALAR = 6


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class DofMap:
    """Meaning of each degree of freedom: ``node`` (N,) row of ``Nodes.xyz``, ``component`` (N,) 0..6.

    Components 0, 1, 2 are displacements along x, y, z and 3, 4, 5 rotations about them. Component 6 is a scalar, such
    as the coordinate of an incompatible mode: it has neither place nor direction, rigid motion leaves it at zero, and
    its node, which may have several, only says where it belongs.

    >>> DofMap.translations(20)
    DofMap: displacements 60; rotations 0; nodes 20
    >>> model.dofs.of_nodes(np.array([0, 3]))
    array([[ 0,  1,  2],
           [ 9, 10, 11]])
    """

    node: Ints = dataset(
        "whole", "dofs", "row of /nodes, from 0, of each row of the matrices", name="dofs/node", largest="N-1"
    )
    component: Ints = dataset(
        "whole",
        "dofs",
        "0..2 displacements along x, y, z; 3..5 rotations about them; 6 scalars",
        name="dofs/component",
        largest="6",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "node", freeze(np.asarray(self.node, dtype=np.int64)))
        object.__setattr__(self, "component", freeze(np.asarray(self.component, dtype=np.int64)))

    @classmethod
    def translations(cls, n_nodes: int) -> DofMap:
        """Three displacements per node, node by node: the map of solid elements."""
        dofs = np.arange(3 * n_nodes, dtype=np.int64)
        return cls(node=dofs // 3, component=dofs % 3)

    def __len__(self) -> int:
        return len(self.node)

    def _facts(self) -> dict[str, object]:
        turns, scalars = int(self.turning.sum()), int((self.component == Component.SCALAR).sum())
        return {
            "displacements": len(self) - turns - scalars,
            "rotations": turns,
            "scalars": scalars or None,
            "nodes": len(np.unique(self.node)),
        }

    @property
    def turning(self) -> NDArray[np.bool_]:
        """(N,) which dofs are rotations."""
        return np.asarray((self.component > 2) & (self.component < Component.SCALAR))

    def table(self, nodes: int) -> Ints:
        """Dof (nodes, 7) of each node and component, -1 where there is none; of several scalars of a node the last."""
        table = np.full((nodes, Component.SCALAR + 1), -1, dtype=np.int64)
        table[self.node, self.component] = np.arange(len(self))
        return table

    def twice(self) -> Ints:
        """Codes 6 node + component of dofs that are there more than once, each once; scalars may share a node."""
        placed = self.component < Component.SCALAR
        codes = np.sort(6 * self.node[placed] + self.component[placed])
        return np.unique(codes[1:][codes[1:] == codes[:-1]])

    @cached_property
    def is_solid(self) -> bool:
        """True where the dofs are x, y, z of node 0, 1, 2, ... and nothing else."""
        return self.begins_solid(len(self) // 3) and len(self) % 3 == 0

    def begins_solid(self, nodes: int) -> bool:
        """True where the first dofs are x, y, z of the first ``nodes`` nodes; masters of couplings may follow."""
        solid = np.arange(3 * nodes, dtype=np.int64)
        first = slice(3 * nodes)
        return bool(np.array_equal(self.node[first], solid // 3) and np.array_equal(self.component[first], solid % 3))

    def of_nodes(self, rows: Ints) -> Ints:
        """Displacement dofs (len(rows), 3) of node rows, -1 where a node lacks one."""
        # Nodes behind the last dof have none.
        count = max(int(self.node.max(initial=-1)), int(np.max(rows, initial=-1))) + 1
        table = np.full((count, 3), -1, dtype=np.int64)
        translation = self.component < 3
        table[self.node[translation], self.component[translation]] = np.flatnonzero(translation)
        return table[rows]


def _place(model: FEModel) -> list[dict[str, Any]] | None:
    """Its couplings, with the place of each reference, as a file has them."""
    parts = [COUPLING.parts(element) for element in model.couplings.values()]
    return [{**part, "point": model.nodes.xyz[part["reference"]]} for part in parts] or None


@checked
@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class FEModel:
    """M u'' + (D + G) u' + (K + N) u = f of a finite-element model, in SI units.

    ``K``, ``M`` and optionally ``D`` are symmetric (N, N), kept as sparse arrays in CSR form; sparse matrices and
    arrays of any form and dense arrays are taken too. ``mesh`` is None for models that came as matrices,
    ``materials`` are those of its elements. ``G`` is gyroscopic, skew-symmetric; ``N`` is
    circulatory: its symmetric part joins K, so that it is skew-symmetric too.

    ``rigid`` and ``average`` elements and ``equations`` make dofs ``dependent`` on others, or hold them; the matrices
    cover these too, until the model is coupled to its interfaces. Masters and references are nodes with dofs of their
    own. ``inputs`` are columns of B and ``outputs`` rows of C of M u'' + D u' + K u = B q, y = C u, as columns (N, .),
    which interfaces can take. ``strained`` is the part of the terms of a row of K that round-off of what made K leaves
    in rigid motions, beyond that of the entries. ``notes`` say what the import found, ``warnings`` in what the model
    differs from its source; they go with it into every body.

    Raises:
        InputError: matrices of another shape or of something else than numbers, G that is not skew-symmetric, or
            coordinates beyond ``TOL.largest_number``.

    >>> model
    FEModel: dofs 60; nodes 20; elements 4; matrices K, M; source bar
    >>> import scipy.sparse as sp
    >>> springs = sp.csr_array(sp.diags_array([1e6] * 6))
    >>> masses = sp.csr_array(sp.diags_array([2.0] * 6))
    >>> two = Nodes(ids=np.array([1, 2]), xyz=np.array([[0.0, 0, 0], [1, 0, 0]]))
    >>> FEModel(K=springs, M=masses, nodes=two, dofs=DofMap.translations(2)).size
    6
    """

    made_by: ClassVar[str] = "import_model(path), assemble(mesh, materials) or from_matrices(K, M)"

    source: str = dataset("words", name="source/name", default="", doc="of the model")
    notes: tuple[str, ...] = dataset("words", "any", name="source/notes", default=(), doc="what was said at the import")
    warnings: tuple[str, ...] = dataset(
        "words", "any", "in what the model differs from its source", name="source/warnings", default=(), since="0.2"
    )
    K: sp.csr_array = dataset(matrix_table("N/m"), name="matrices/K", when="if")
    M: sp.csr_array = dataset(
        matrix_table("kg"), name="matrices/M", when="if", doc="as K, kg; each of them may be absent"
    )
    D: sp.csr_array | None = dataset(
        matrix_table("N s/m"), name="matrices/D", when="if", doc="as K, N s/m", default=None
    )
    G: sp.csr_array | None = dataset(
        matrix_table("N s/m"), name="matrices/G", when="if", doc="as K, N s/m; skew-symmetric", default=None
    )
    N: sp.csr_array | None = dataset(
        matrix_table("N/m"), name="matrices/N", when="if", doc="as K; skew-symmetric", default=None
    )
    nodes: Nodes = dataset(table_of(Nodes), inline=True)
    dofs: DofMap = dataset(table_of(DofMap), inline=True)
    mesh: Mesh | None = dataset(table_of(Mesh, build=dict), default=None, inline=True, when="if")
    materials: tuple[Material, ...] = dataset(
        repeat_table(table_of(Material)), default=(), when="if", write=lambda model: model.materials or None
    )

    @derived(
        "whole",
        "any",
        "place in /materials of the material of each element, counted through all blocks",
        name="elements/material",
        since="0.2",
        when="where each element has one material",
    )
    def element_materials(self) -> Ints | None:
        """(ne,) place in ``materials`` of the material of each element; None where not each has one."""
        if self.mesh is None or not self.materials:
            return None
        try:
            owner = material_of_elements(self.mesh, self.materials)
        except InputError:
            return None  # models of matrices need no materials
        return np.concatenate([owner[id(block)] for block in self.mesh.blocks])

    rigid: tuple[RigidElement, ...] = ()
    average: tuple[AverageElement, ...] = ()

    @derived(COUPLINGS, when="if", read=True, write=_place)
    def couplings(self) -> dict[str, RigidElement | AverageElement]:
        """The rigid and average elements by name; each of them can serve as an interface."""
        elements: list[RigidElement | AverageElement] = [*self.rigid, *self.average]
        return {element.name: element for element in elements}

    equations: tuple[Equations, ...] = dataset(
        repeat_table(table_of(Equations), "equations"),
        default=(),
        when="if",
        write=lambda model: model.equations or None,
    )
    dependent: DependentDofs | None = None
    inputs: NamedColumns | None = dataset(table_of(NamedColumns, build=dict), default=None, when="if")
    outputs: NamedColumns | None = dataset(
        table_of(NamedColumns, build=dict),
        default=None,
        when="if",
        doc="as `inputs`, which are columns of B; rows of C",
    )
    strained: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.dofs)
        for name in MATRICES:
            if name not in ("K", "M") and getattr(self, name) is None:
                continue
            matrix = _sparse(getattr(self, name), name)
            if matrix.shape != (n, n):
                raise InputError(
                    f"{name} has the shape {matrix.shape}; expected ({n}, {n}), one row per dof", keyword=name
                )
            object.__setattr__(self, name, matrix)
        self._make_skew()
        for name, columns in (("inputs", self.inputs), ("outputs", self.outputs)):
            if columns is not None and columns.matrix.shape[0] != n:
                raise InputError(
                    f"{name} has columns of {columns.matrix.shape[0]} rows; expected {n}, one per dof", keyword=name
                )
        refuse_far(self.nodes, self.source or "the model")

    def _make_skew(self) -> None:
        """Skew-symmetric G and N to the last bit; what else N has joins K."""
        for name in ("G", "N"):
            A = getattr(self, name)
            if A is None:
                continue
            rest, size = abs(A + A.T), float(np.abs(A.data).max(initial=0.0))
            largest = float(rest.max()) if rest.nnz else 0.0
            if largest > TOL.asymmetry * size:
                if name == "G":
                    i, j = (int(index[0]) for index in (rest == largest).nonzero())
                    raise InputError(
                        f"G of {self.source or 'the model'} is not skew-symmetric: entries ({i + 1}, {j + 1}) and "
                        f"({j + 1}, {i + 1}) sum to {float(A[i, j] + A[j, i]):.6g}; give it as D with "
                        'unsymmetric = "split"',
                        keyword="G",
                    )
                object.__setattr__(self, "K", _canonical(self.K + 0.5 * (A + A.T)))
            if largest:
                object.__setattr__(self, name, _canonical(0.5 * (A - A.T)))

    @property
    def size(self) -> int:
        """Number of degrees of freedom N."""
        return len(self.dofs)

    def view(self) -> Scene:
        """The skin with its sets, rigid and average elements, as a page that a notebook shows; a click selects nodes.

        ``view().page()`` is the text of a file .html.

        >>> [group.name for group in model.view().groups]
        ['LEFT', 'RIGHT']
        """
        # Not at the top: few models are looked at.
        from morembs.fem.viewer.models import groups_of_model, scene_of_nodes

        groups = groups_of_model(self.nodes, self.mesh, self.couplings.values())
        return scene_of_nodes(self.source or "model", self.nodes, self.mesh, groups)

    def _picture(self) -> str:
        small = self.mesh is not None and 0 < self.mesh.element_count <= TOL.shown_elements
        return self.view()._repr_html_() if small else ""

    def _facts(self) -> dict[str, object]:
        return {
            "dofs": self.size,
            "nodes": len(self.nodes),
            "elements": self.mesh and self.mesh.element_count,
            "matrices": [name for name in MATRICES if getattr(self, name) is not None],
            "couplings": list(self.couplings),
            "inputs": self.inputs and list(self.inputs.names),
            "outputs": self.outputs and list(self.outputs.names),
            "source": self.source,
            "warnings": len(self.warnings) or None,
        }


def has_places(model: FEModel) -> bool:
    """True if dofs are motions of nodes at different places; all others are abstract coordinates."""
    xyz = model.nodes.xyz[model.dofs.node[model.dofs.component < Component.SCALAR]]
    return bool(len(xyz) and np.ptp(xyz, axis=0).any())


def _sparse(A: Any, name: str) -> sp.csr_array:
    """``A`` as a sparse array of real or complex double numbers in CSR form; itself where it is one."""
    # Body files and their checks have nodes, but no sparse matrices.
    import scipy.sparse as sp

    if not sp.issparse(A):
        given = type(A).__name__
        try:
            A = np.asarray(A)
        except ValueError:
            A = np.empty(0)  # Rows of different lengths: no array of numbers.
        if A.ndim != 2 or A.dtype.kind not in "biufc":
            raise InputError(
                f"{name} was given as {given}; expected a sparse matrix or a square array of numbers", keyword=name
            )
    if A.dtype.kind not in "biufc":
        raise InputError(f"{name} holds {A.dtype}; expected numbers")
    kind = np.complex128 if A.dtype.kind == "c" else np.float64
    if isinstance(A, sp.csr_array) and A.dtype == kind:
        return A
    # Entries that were given in parts (COO) are summed up; the caller's matrix stays as it is.
    result = sp.csr_array(A, dtype=kind, copy=True)
    result.sum_duplicates()
    return result


def _canonical(A: Any) -> sp.csr_array:
    import scipy.sparse as sp

    result = sp.csr_array(A)
    result.sum_duplicates()
    return result


def split_unsymmetric(model: FEModel) -> FEModel:
    """The same model with the skew parts of its ``K`` and ``D`` in ``N`` and ``G``: both are then symmetric.

    Any real matrix is a symmetric and a skew one, in one way only: the equations of motion stay the same.

    Args:
        model: with unsymmetric K or D.

    Raises:
        InputError: M is not symmetric.

    >>> split_unsymmetric(clamped).size == clamped.size
    True
    """
    refuse_unsymmetric(model, ("M",))
    parts: dict[str, sp.csr_array] = {}
    for name, other in (("K", "N"), ("D", "G")):
        A, known = getattr(model, name), getattr(model, other)
        if A is None or not _unsymmetric(A):
            continue
        skew_part = 0.5 * (A - A.T)
        parts[other] = _canonical(skew_part if known is None else known + skew_part)
        parts[name] = _canonical(0.5 * (A + A.T))
    return replace(model, **parts)


def skew(x: Floats) -> Floats:
    """x~ (..., 3, 3) with x~ y = x × y."""
    result = np.zeros((*x.shape[:-1], 3, 3), dtype=np.result_type(x, np.float64))
    result[..., 0, 1], result[..., 0, 2] = -x[..., 2], x[..., 1]
    result[..., 1, 0], result[..., 1, 2] = x[..., 2], -x[..., 0]
    result[..., 2, 0], result[..., 2, 1] = -x[..., 1], x[..., 0]
    return result


def rigid_motion(xyz: Floats, component: Ints) -> Floats:
    """Rows (N, 6) of the geometric rigid-body modes R = [translations, rotations about the origin].

    ``xyz`` (N, 3) is the point of each dof in m. A displacement row of a point x is [I, -x~], a
    rotation row [0, I], the row of a scalar zero.
    """
    R = np.zeros((len(component), 6), dtype=np.result_type(xyz, np.float64))
    moves = component < 3
    R[moves, component[moves]] = 1.0
    R[moves, 3:] = -skew(xyz[moves])[np.arange(int(moves.sum())), component[moves]]
    turns = (component > 2) & (component < Component.SCALAR)
    R[turns, component[turns]] = 1.0
    return R


def refuse_complex(model: FEModel) -> None:
    """Refuse complex matrices, as reductions take real ones.

    Raises:
        InputError: in these cases.
    """
    for name in MATRICES:
        A = getattr(model, name)
        if A is not None and A.dtype.kind == "c":
            raise InputError(
                f"{name} of {model.source or 'the model'} is complex, and reductions take real matrices; import "
                "its real part, and give structural damping as [damping] structural",
                kind="unsupported",
                keyword=name,
            )


def refuse_unsymmetric(model: FEModel, names: Sequence[str] = ("K", "M", "D")) -> None:
    """Refuse K, M and D that are not symmetric: their skew parts belong into N and G.

    Raises:
        InputError: in these cases.
    """
    for name in names:
        A = getattr(model, name)
        part = 0.0 if A is None else _unsymmetric(A)
        if part:
            cure = (
                "leave out what makes it so"
                if name == "M"
                else 'take [model] unsymmetric = "split" (split_unsymmetric in Python), which keeps its skew part as '
                f'{"circulatory" if name == "K" else "gyroscopic"} matrix, or "symmetrise", which drops it'
            )
            raise InputError(
                f"{name} of {model.source or 'the model'} is not symmetric ({part:.1e} of its largest entry); {cure}",
                kind="unsupported",
                keyword=name,
            )


def _unsymmetric(A: sp.csr_array) -> float:
    """How far ``A`` is from its transpose against its largest entry; 0 where that is round-off.

    A z and A' z are compared for one fixed random z: vectors only, and no symmetric matrix is reported.
    """
    z = np.random.default_rng(60).standard_normal(A.shape[0])
    largest = max(abs(float(A.data.max(initial=0.0))), abs(float(A.data.min(initial=0.0))))
    difference = float(np.abs(A @ z - A.T @ z).max(initial=0.0))
    return difference / largest if difference > TOL.asymmetry * largest else 0.0
