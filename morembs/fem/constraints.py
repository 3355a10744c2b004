"""Rigid and average elements and equations of a model, and the dofs that depend on others through them (multi-point
constraints)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from morembs.base.arguments import checked
from morembs.base.errors import InputError
from morembs.base.types import Floats, Ints
from morembs.fem.arrays import freeze
from morembs.storage.table import Row, dataset, repeat_table, variants

if TYPE_CHECKING:
    import scipy.sparse as sp

# What rigid and average elements have in common in a model file.
_NAME = "words", "couplings", "of coupling_0, coupling_1, ..."
_REFERENCE = "whole", "", "row of /nodes: the master, or the node of the mean motion"
_NODES = "whole", "followers", "rows of /nodes that follow, or whose mean is taken"
_COMPONENTS = "few", "any", "0..5: those of the nodes that follow, or of the reference"


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class RigidElement:
    """Nodes that follow ``master`` as a rigid body (RBE2, kinematic coupling, *RIGID BODY).

    ``master`` a row of the nodes, ``slaves`` (k,) rows, ``components`` those of the slaves that follow (0..5).
    """

    name: str = dataset(*_NAME, name="names", beside=True)
    master: int = dataset(*_REFERENCE, name="reference", largest="N-1")
    slaves: Ints = dataset(*_NODES, name="nodes", largest="N-1")
    components: tuple[int, ...] = dataset(*_COMPONENTS, default=(0, 1, 2, 3, 4, 5), largest="5")

    def __post_init__(self) -> None:
        object.__setattr__(self, "slaves", freeze(np.asarray(self.slaves, dtype=np.int64)))

    @property
    def center(self) -> int:
        """Row of the node that stands for all: the master."""
        return self.master

    @property
    def others(self) -> Ints:
        """(k,) rows of the nodes around it."""
        return self.slaves


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class AverageElement:
    """A ``reference`` node that follows the mean motion of ``nodes`` (k,) with ``weights`` (k,) (RBE3, distributing
    coupling); ``components`` are those of the reference that follow."""

    name: str = dataset(*_NAME, name="names", beside=True)
    reference: int = dataset(*_REFERENCE, largest="N-1")
    nodes: Ints = dataset(*_NODES, largest="N-1")
    weights: Floats = dataset("real", "followers", when="of average ones", doc="of the nodes")
    components: tuple[int, ...] = dataset(*_COMPONENTS, default=(0, 1, 2, 3, 4, 5), largest="5")

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", freeze(np.asarray(self.nodes, dtype=np.int64)))
        object.__setattr__(self, "weights", freeze(np.asarray(self.weights, dtype=np.float64)))

    @property
    def center(self) -> int:
        """Row of the node that stands for all: the reference."""
        return self.reference

    @property
    def others(self) -> Ints:
        """(k,) rows of the nodes around it."""
        return self.nodes


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Dofs that are sums of others: u[node_i, component_i] = sum over the terms of i of coefficient * u[term].

    ``nodes`` (n,) rows of the nodes and ``components`` (n,) of the dependent dofs; the terms of equation i are
    ``offsets[i]:offsets[i + 1]`` of ``term_nodes`` (t,), ``term_components`` (t,) and ``coefficients`` (t,). A dof
    without terms is held. ``name`` says where they come from (*TIE, MPC); several of one model may have the same.

    Raises:
        InputError: arrays that do not fit each other, coefficients that are not finite, or two equations for one dof.
    """

    name: str = dataset(
        "words", "origins", "origin of equations_0, equations_1, ..., such as *TIE or MPC", name="names", beside=True
    )
    nodes: Ints = dataset("whole", "equations", "rows of /nodes: the dofs that depend on others", largest="N-1")
    components: Ints = dataset("whole", "equations", "of these dofs, as in dofs/component", largest="6")
    offsets: Ints = dataset("whole", "any", "terms of equation i are `offsets[i]:offsets[i+1]`; without any it is held")
    term_nodes: Ints = dataset("whole", "terms", "rows of /nodes", largest="N-1")
    term_components: Ints = dataset("whole", "terms", "as in dofs/component", largest="6")
    coefficients: Floats = dataset("real", "terms", units="1, m or 1/m", doc="of the terms")

    def __post_init__(self) -> None:
        for name in ("nodes", "components", "offsets", "term_nodes", "term_components"):
            object.__setattr__(self, name, freeze(np.asarray(getattr(self, name), dtype=np.int64)))
        object.__setattr__(self, "coefficients", freeze(np.asarray(self.coefficients, dtype=np.float64)))
        count, terms, offsets = len(self.nodes), len(self.coefficients), self.offsets
        fits = len(self.components) == count and len(self.term_nodes) == len(self.term_components) == terms
        if not fits or len(offsets) != count + 1 or offsets[0] != 0 or offsets[-1] != terms:
            raise InputError(f"the equations {self.name!r} have arrays of different lengths", keyword="equations")
        if (np.diff(offsets) < 0).any() or not np.isfinite(self.coefficients).all():
            raise InputError(
                f"the equations {self.name!r} have coefficients that are not finite or terms out of order",
                keyword="equations",
            )

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def equation(self) -> Ints:
        """Number (t,) of the equation that each term belongs to."""
        return np.repeat(np.arange(len(self), dtype=np.int64), np.diff(self.offsets))


# As a model file holds them, which also says where each reference is.
COUPLING = variants(
    {"rigid": RigidElement, "average": AverageElement},
    Row("kind", "words", doc="`rigid` or `average`"),
    Row("point", "real", "3", units="m", doc="where the reference is", read=False),
)
COUPLINGS = repeat_table(COUPLING, "coupling")
Term = tuple[int, int, float]


def solved_for_first(name: str, sums: Iterable[tuple[str, list[Term]]]) -> Equations:
    """Equations of sums that vanish, 0 = sum of coefficient * u[node, component], each solved for its first term.

    Args:
        sums: the name of each in messages, and its terms (node, component, coefficient); terms on one dof
            are added up, zero terms are left out.

    Raises:
        InputError: no terms, a first coefficient that is zero, or coefficients that are not finite.
    """
    first: list[tuple[int, int]] = []
    offsets, rest = [0], []
    for title, terms in sums:
        total: dict[tuple[int, int], float] = {}
        for node, component, coefficient in terms:
            total[node, component] = total.get((node, component), 0.0) + coefficient
        if not np.isfinite(list(total.values())).all():
            raise InputError(
                f"{title} has coefficients that are not finite numbers; mend it", kind="value", keyword="equation"
            )
        if not terms or total[terms[0][:2]] == 0.0:
            raise InputError(
                f"the first coefficient of {title} is zero, so its first term cannot depend on the others; put a term "
                "first that may",
                kind="value",
                keyword="equation",
            )
        dof = terms[0][:2]
        scale = -total.pop(dof)
        first.append(dof)
        rest += [(node, component, value / scale) for (node, component), value in total.items() if value != 0.0]
        offsets.append(len(rest))
    return Equations(
        name=name,
        nodes=np.array([node for node, _ in first]),
        components=np.array([c for _, c in first]),
        offsets=np.array(offsets),
        term_nodes=np.array([node for node, *_ in rest]),
        term_components=np.array([c for _, c, _ in rest]),
        coefficients=np.array([value for *_, value in rest]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class DependentDofs:
    """u = S u_free: dofs that depend on others.

    ``S`` (N, N) rows of the identity for independent dofs, and for dependent ones their coefficients; columns of
    dependent dofs are empty. ``owner`` (N,) index in ``names`` of the element or equations that a dof depends on, -1
    for independent dofs.
    """

    S: sp.csr_array
    owner: Ints
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "owner", freeze(np.asarray(self.owner, dtype=np.int64)))
