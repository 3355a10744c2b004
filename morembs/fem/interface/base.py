"""An interface, and its properties by coupling kind: the table ``COUPLINGS`` holds one object for each kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from morembs.base.errors import InputError
from morembs.base.plugins import Registry
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.fem import FEModel, freeze
from morembs.storage.table import dataset

if TYPE_CHECKING:
    import scipy.sparse as sp

SIX = (0, 1, 2, 3, 4, 5)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class Interface:
    """Named interface of a model.

    ``nodes`` (ns,) rows of ``Nodes.xyz``; ``point`` (3,) origin of the frame in m; ``axes`` (3, 3) its
    axes as rows (those of the model); ``weights`` (ns,) areas in m2 where the nodes carry whole faces,
    else ones; ``components`` the degrees of freedom 0..5 (translations, rotations) that are exposed, 6 for each of the
    generalised ``forces`` ("B:NAME", "C:NAME") of ``matrix_interface``. In a body from a file ``node_ids`` (ns,) are
    labels of the nodes, and ``nodes`` rows of the nodes that the file keeps, -1 for others.

    >>> interfaces[0]
    Interface: name LEFT; coupling rigid; nodes 4; point [0.0, 0.025, 0.025]; components 0, 1, 2, 3, 4, 5
    """

    name: str
    nodes: Ints
    coupling: str = dataset(
        "text",
        doc="`rigid`, `average`, `direct`, `matrix`, or a kind that [another package](../howto/extending.md) defines",
    )
    components: tuple[int, ...] = dataset(
        "few",
        "any",
        "exposed degrees of freedom 0..5",
        default=SIX,
        doc="exposed degrees of freedom: 0, 1, 2 along x, y, z; 3, 4, 5 about them; 6 for each of `forces`",
    )
    forces: tuple[str, ...] = dataset(
        "text",
        "forces",
        "columns of the input matrix B, rows of the output matrix C of the model",
        default=(),
        write=lambda interface: interface.forces or None,
        doc="`B:NAME`, a column of the input matrix of the model, or `C:NAME`, a row of its output matrix",
        when="with coupling `matrix`",
    )
    point: Floats = dataset("real", "3", "origin of the frame", "m")
    axes: Floats = dataset(
        "real",
        "3 3",
        "axes of the frame as rows",
        default_factory=lambda: np.eye(3),
        doc="axes of the frame as rows, in the coordinates of the model",
    )
    node_ids: Ints = dataset(
        "whole",
        "s",
        "labels of the nodes",
        default_factory=lambda: np.zeros(0, dtype=np.int64),
        doc="labels of the nodes that follow the frame",
    )
    weights: Floats = dataset(
        "real",
        "s",
        "share of each node (area in m2, or 1)",
        doc="share of each node: area in m² of the whole faces between the nodes, 0 for nodes on none; 1 for all if "
        "there are no whole faces",
    )

    def __post_init__(self) -> None:
        for name in ("nodes", "point", "weights", "axes"):
            object.__setattr__(self, name, freeze(np.asarray(getattr(self, name))))

    @property
    def kind(self) -> CouplingKind:
        """What the coupling does.

        Raises:
            InputError: a coupling that is not in ``COUPLINGS``.
        """
        return coupling_kind(self.name, self.coupling)

    def _facts(self) -> dict[str, object]:
        return {
            "name": self.name,
            "coupling": self.coupling,
            "nodes": len(self.nodes),
            "point": self.point,
            "components": ", ".join(map(str, self.components)),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Elimination:
    """Nodal ``dofs`` (k,) of the model that follow ``motion`` @ z, ``motion`` (k, m).

    z are m new degrees of freedom: the ``components`` (m,) of the motion of the interface's point.
    """

    dofs: Ints
    motion: Floats
    components: tuple[int, ...] = SIX


class CouplingKind(ABC):
    """How the nodes of an interface follow its degrees of freedom z, or give them.

    A new kind is a class, most often in a file of its own, and a line in the table of ``morembs.fem.interface``. Users
    add theirs by an entry point ``morembs.couplings``, or with ``COUPLINGS[MyKind.name] = MyKind()`` before they make
    interfaces or read bodies with them.
    """

    name: ClassVar[str]
    # What other programs call it, in small letters.
    also_called: ClassVar[tuple[str, ...]] = ()
    # Its degrees of freedom are the six of a frame at the point of the interface, which takes forces and moments.
    framed: ClassVar[bool]
    # Its nodes move with the frame; their dofs are eliminated.
    carries: ClassVar[bool]
    # Its nodes belong to no other such interface, and follow no rigid or average element of the model.
    exclusive: ClassVar[bool]
    # The weights of the nodes matter.
    weighted: ClassVar[bool] = False
    # ``nonlinear.NonlinearSolid`` has its form for large rotations.
    large_rotations: ClassVar[bool] = False

    @abstractmethod
    def attach(self, model: FEModel, interface: Interface) -> Elimination | sp.csc_array:
        """The dofs that are eliminated; or, where none are, the loads (N, m) in N on the dofs of the model under unit
        forces and moments on the degrees of freedom of the interface, whose transpose gives these from the dofs.

        Raises:
            InputError: a node lacks a dof that is needed.
        """

    def available(self, model: FEModel, name: str, nodes: Ints) -> tuple[int, ...]:
        """Components that an interface ``name`` on ``nodes`` (rows) can expose, all by default.

        Raises:
            InputError: there is none.
        """
        return SIX

    def check(self, model: FEModel, interface: Interface) -> None:  # noqa: B027
        """Refuse nodes that do not determine the degrees of freedom; by default any will do.

        Raises:
            InputError: in these cases.
        """

    def columns(self, interface: Interface) -> tuple[Ints, Ints]:
        """Component 0..5 (m,), 6 of generalised forces, and node (m,) of each column of B, -1 for the point of the
        interface."""
        return np.array(interface.components), np.full(len(interface.components), -1)

    def scale(self, interface: Interface, length: float) -> Floats:
        """One for displacements and ``length`` for rotations (m,), for each column of B."""
        return np.where(self.columns(interface)[0] > 2, length, 1.0)

    def nodal_forces(self, model: FEModel, interface: Interface) -> Floats | None:
        """Forces (3 ns, 6) on the nodes under unit forces and moments on the frame.

        None where the stiffness and mass of the body decide how the nodes share these.
        """
        attached = self.attach(model, replace(interface, components=SIX))
        if isinstance(attached, Elimination):
            return None
        return np.asarray(attached.tocsr()[model.dofs.of_nodes(interface.nodes).ravel()].toarray())

    def rotation(self, model: FEModel, interface: Interface) -> tuple[Floats, Ints]:
        """Rotation (3, k) of the frame from k dofs of the model, and these dofs (k,)."""
        attached = self.attach(model, replace(interface, components=SIX))
        if isinstance(attached, Elimination):
            return np.asarray(np.linalg.pinv(attached.motion)[3:], dtype=np.float64), attached.dofs
        loads = attached.tocsr()
        dofs = np.flatnonzero(np.diff(loads.indptr))
        return np.ascontiguousarray(loads[dofs].toarray()[:, 3:].T), dofs


def _fault(name: str, entry: object) -> str:
    if not isinstance(entry, CouplingKind):
        return f"{entry!r} is no object of a subclass of morembs.fem.interface.CouplingKind"
    return "" if entry.name == name else f"its name is {entry.name!r}, expected {name!r}"


# Coupling -> its kind; ``morembs.fem.interface`` gives those that are its own.
COUPLINGS: Registry[CouplingKind] = Registry("morembs.couplings", {}, _fault)


def coupling_kind(interface: str, coupling: str) -> CouplingKind:
    """The kind ``coupling`` of the interface of that name.

    Raises:
        InputError: there is no such kind.
    """
    if coupling in COUPLINGS:
        return COUPLINGS[coupling]
    word = str(coupling).lower()
    meant = next((kind.name for kind in COUPLINGS.values() if word in kind.also_called), word)
    raise InputError(
        f"interface {interface!r}: coupling = {coupling!r} was given; {COUPLINGS.advice(meant)}",
        kind="unknown",
        keyword="coupling",
    )
