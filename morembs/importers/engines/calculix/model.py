"""What CalculiX exported as a model: its matrices on nodes, and how dependent dofs follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import DofMap, Nodes
from morembs.fem.constraints import AverageElement, Equations
from morembs.fem.fe_model import Component
from morembs.importers.decks.flat import Choices, FlatDeck
from morembs.importers.decks.join import join
from morembs.importers.decks.labels import in_ranges
from morembs.importers.decks.model import Deck
from morembs.importers.engines.calculix.program import Ccx
from morembs.importers.engines.calculix.rows import Expanded, RowMap, map_rows, strain
from morembs.importers.imported import Imported, nodes_of, on_rows, sets_on
from morembs.importers.matrices.calculix import CalculixMatrices
from morembs.importers.tolerances import TOL

FOLLOWS = "constraints of CalculiX"


class Exported:
    """Rows of an export on nodes of the deck and of expanded elements."""

    def __init__(
        self, deck: Deck, flat: FlatDeck, read: CalculixMatrices, expanded: Expanded | None, *, held: bool
    ) -> None:
        self.deck, self.flat, self.expanded = deck, flat, expanded
        self.plain = self.read = read
        self.solid = flat.in_solids
        bodies = [*flat.bodies, *flat.turning.values()]
        placed = flat.in_elements.copy()
        placed[np.array(bodies, dtype=np.int64) - 1] = True
        unplaced = np.flatnonzero(~placed) + 1
        self.map = map_rows(
            read.K,
            read.node,
            read.dof,
            flat.xyz,
            expanded=expanded,
            turning=flat.turning,
            unplaced=unplaced,
            bodies=len(flat.bodies),
            held=held,
        )
        self.T = self.map.change
        if self.T is not None:
            K, M = (_transform(A, self.T) for A in (read.K, read.M))
            self.read = replace(read, K=K, M=M)
        self.strain = strain(self.read.K, self.map)

    def convert(self, ccx: Ccx, choices: Choices) -> Imported:
        """The whole model."""
        mapped = self._with_rotations(self.map)
        try:
            node, direction, S = self._followers(ccx, mapped, outside=True)
        except InputError:
            # A spring on a node without elements may bring its other dofs to life; such nodes are left out then.
            node, direction, S = self._followers(ccx, mapped, outside=False)
        return self._join(mapped, node, direction, S, choices)

    def _followers(self, ccx: Ccx, mapped: RowMap, *, outside: bool) -> tuple[Ints, Ints, sp.csr_array | None]:
        """Label and direction of dofs without rows, and S (k, N), how they follow dofs that have one."""
        node, direction = self._missing(mapped, outside=outside)
        if not len(node):
            return node, direction, None
        # What the boundary holds in global axes follows nothing; springs tell the rest.
        held = self.flat.held[node - 1, direction - 1] & ~np.isin(node - 1, list(self.flat.turned))
        probed = np.flatnonzero(~held)
        S = sp.csr_array((len(node), len(self.plain.node)))
        if len(probed):
            probes = ccx.probe(self.plain, node[probed], direction[probed])
            into = sp.csr_array((np.ones(len(probed)), (probed, np.arange(len(probed)))), (len(node), len(probed)))
            S = sp.csr_array(into @ probes)
        return node, direction, S if self.T is None else sp.csr_array(S @ self.T)

    def _with_rotations(self, mapped: RowMap) -> RowMap:
        """Rotations of rigid bodies at their reference nodes, where each has its own three."""
        turns = (mapped.component > 2) & (mapped.component < Component.SCALAR) & (mapped.owner == 0)
        groups = np.unique(mapped.group[turns])
        bodies = [*self.flat.bodies, *([] if self.expanded is None else self.expanded.knots.tolist())]
        if not len(groups) or len(groups) != len(bodies) or len(set(bodies)) < len(bodies):
            return mapped
        owner, place = mapped.owner.copy(), mapped.place.copy()
        owner[turns] = np.array(bodies)[np.searchsorted(groups, mapped.group[turns])]
        place[turns] = self.flat.xyz[owner[turns] - 1]
        return replace(mapped, owner=owner, place=place)

    def _missing(self, mapped: RowMap, *, outside: bool) -> tuple[Ints, Ints]:
        """Label and direction 1..3 of dofs of solids and reference nodes that have no row, of nodes ``outside`` of
        elements too that follow others."""
        wanted = self.solid.copy()
        wanted[list(self.flat.followers if outside else [])] = True
        wanted[np.array([*self.flat.bodies, *self.flat.turning.values()], dtype=np.int64) - 1] = True
        if self.expanded is not None:
            # A node of a shell or beam is not in the model; those that it became are.
            wanted[self.expanded.parent - 1] &= self.solid[self.expanded.parent - 1]
        have = np.zeros((len(wanted), 3), dtype=bool)
        own = (mapped.owner > 0) & (mapped.component < 3)
        have[mapped.owner[own] - 1, mapped.component[own]] = True
        node, axis = np.nonzero(wanted[:, None] & ~have)
        return node + 1, axis + 1

    def _join(self, mapped: RowMap, node: Ints, direction: Ints, S: sp.csr_array | None, choices: Choices) -> Imported:
        """Rows in the order of the model: x, y, z of the mesh's nodes first, then all others."""
        deck, flat = self.deck, self.flat
        own, others = mapped.owner[mapped.owner > 0] - 1, nodes_of([*flat.average, *flat.masses])
        extra = np.unique(np.concatenate([own, node - 1, others]).astype(np.int64))
        named = {name: np.flatnonzero(in_ranges(deck.ids, ranges)) for name, ranges in deck.node_sets.items()}
        solids = join(deck, deck.ids[extra])
        mesh, nodes, row = solids.mesh, solids.nodes, solids.row
        named_by = np.zeros(len(mapped.owner), dtype=bool)
        if S is not None:
            named_by[S.indices] = True
        nodes, at = self._with_own_nodes(nodes, row, mapped, named, named_by)
        solid = 0 if mesh is None else len(mesh.nodes)
        dependent = row[node - 1], direction - 1
        K, M, dofs = _order(self.read, at, mapped.component, dependent, solid)
        equations = () if S is None else (_equations(S, dependent, at, mapped.component),)
        average = tuple(self._on_expanded(item, row, at, mapped) for item in flat.average)
        masses = on_rows(flat.masses, row)
        return Imported(
            source=deck.name,
            K=K,
            M=M,
            nodes=nodes,
            dofs=dofs,
            mesh=mesh,
            average=average,
            equations=equations,
            masses=masses,
            surfaces=sets_on(flat.surfaces, row),
            # Nodes of shells and beams became others, so that nothing is left out with them.
            notes=(*flat.notes, *deck.notes, *(solids.notes if mesh is not None else ())),
            warnings=tuple(
                dict.fromkeys([*flat.warnings, *self._matrix_warnings(mapped, choices), *deck.options.idle])
            ),
        )

    def _matrix_warnings(self, mapped: RowMap, choices: Choices) -> list[str]:
        """What matrices are that a free body has not, a sentence each."""
        warnings = list[str]()
        moves = (mapped.component[:, None] == np.arange(3)).astype(float)
        along = np.einsum("ia,ia->a", moves, self.read.M @ moves)
        if np.ptp(along) > TOL.uneven_mass * along.max() and not choices.keep:
            warnings.append(
                f"the mass of what CalculiX wrote is {along[0]:.6g}, {along[1]:.6g}, {along[2]:.6g} along x, y and z: "
                "equations that hold some of it, or rows that went to wrong nodes; then please report it [engine-map]"
            )
        if self.strain > TOL.rigid_strain and not choices.keep:
            warnings.append(
                f"rigid motion strains the stiffness that CalculiX wrote by {self.strain:.1e} of its terms: springs to "
                "the ground, equations that hold the body, or elements C3D8R that are distorted, whose hourglass "
                "stiffness resists rotation there; own assembly has not that defect [engine-rotation]"
            )
        return warnings

    def _on_expanded(self, item: AverageElement, row: Ints, at: Ints, mapped: RowMap) -> AverageElement:
        """The element on rows of the model; nodes of shells and beams share weights among their expanded nodes."""
        if self.expanded is None:
            return on_rows([item], row)[0]
        nodes, weights = [], []
        mine = np.flatnonzero((mapped.owner < 0) & (mapped.component == 0))
        parent = self.expanded.parent[np.searchsorted(self.expanded.nodes, -mapped.owner[mine])]
        for node, weight in zip(item.nodes.tolist(), item.weights.tolist(), strict=True):
            became = at[mine[parent == node + 1]]
            own = became if len(became) and not self.solid[node] else row[[node]]
            nodes.append(own)
            weights.append(np.full(len(own), weight / len(own)))
        return replace(
            item, reference=int(row[item.reference]), nodes=np.concatenate(nodes), weights=np.concatenate(weights)
        )

    def _with_own_nodes(
        self, nodes: Nodes, row: Ints, mapped: RowMap, named: dict[str, Ints], named_by: NDArray[np.bool_]
    ) -> tuple[Nodes, Ints]:
        """Nodes, with new ones of CalculiX, and the node row (N,) of each row of the export.

        Expanded nodes get labels beyond the deck and are in the sets of their parents; modes inside elements belong
        to the first node that K couples them to, modes that equations name (``named_by``) have a node of their own.
        """
        first = 10 ** len(str(int(self.flat.ids.max())))
        at = np.full(len(mapped.owner), -1, dtype=np.int64)
        deck = mapped.owner > 0
        at[deck] = row[mapped.owner[deck] - 1]
        ids, xyz, sets = [nodes.ids], [nodes.xyz], {name: rows for name, rows in nodes.sets.items()}
        # What has neither a node of the deck nor is a mode: expanded nodes, and rotations of bodies without a name.
        scalar = mapped.component == Component.SCALAR
        own = (mapped.owner < 0) | ((mapped.owner == 0) & (~scalar | named_by))
        if own.any():
            group_key = TOL.made_label + 5 * mapped.group + scalar * (1 + self.read.dof)
            key = np.where(mapped.owner < 0, -mapped.owner, group_key)
            keys, where, inverse = np.unique(key[own], return_index=True, return_inverse=True)
            at[own] = len(nodes) + inverse
            places = mapped.place[own][where]
            lost = ~np.isfinite(places).all(axis=1)
            places[lost] = nodes.xyz.mean(axis=0) if len(nodes) else 0.0
            ids.append(first + np.arange(1, len(keys) + 1))
            xyz.append(places)
            if self.expanded is not None:
                sets = self._expanded_sets(sets, keys, len(nodes), row, named)
        K, none = self.read.K, np.iinfo(np.int64).max
        full = np.flatnonzero(np.diff(K.indptr))
        coupled = np.full(len(at), none)
        coupled[full] = np.minimum.reduceat(np.where(at < 0, none, at)[K.indices], K.indptr[full])
        at[at < 0] = np.where(coupled == none, 0, coupled)[at < 0]
        whole = Nodes(ids=np.concatenate(ids), xyz=np.vstack(xyz), sets=sets)
        return whole, at

    def _expanded_sets(
        self, sets: dict[str, Ints], keys: Ints, start: int, row: Ints, named: dict[str, Ints]
    ) -> dict[str, Ints]:
        """Sets with the expanded nodes, which are at the rows from ``start`` on, of the nodes that they hold."""
        expanded = self.expanded
        if expanded is None:
            return sets
        which = np.minimum(np.searchsorted(expanded.nodes, keys), len(expanded.nodes) - 1)
        parent = np.where(expanded.nodes[which] == keys, expanded.parent[which], 0)
        result = dict(sets)
        for name, rows in named.items():
            members = start + np.flatnonzero(np.isin(parent, rows + 1))
            kept = row[rows][row[rows] >= 0]
            if len(members) or len(kept):
                result[name] = np.unique(np.concatenate([kept, members]))
        return result


def _transform(A: sp.csr_array, T: sp.csr_array) -> sp.csr_array:
    """T' A T, symmetric, without what is round-off of its terms: a truss has no stiffness across its axis."""
    product, terms = sp.csr_array(T.T @ A @ T), abs(T).T @ abs(A) @ abs(T)
    product = sp.csr_array(0.5 * (product + product.T))
    left = sp.csr_array(product.multiply(abs(product) > TOL.cancelled_sum * 0.5 * (terms + terms.T)))
    # Both are semidefinite: a diagonal that is zero has nothing beside it.
    kept = sp.diags_array((left.diagonal() > 0).astype(float))
    left = sp.csr_array(kept @ left @ kept)
    left.eliminate_zeros()
    return left


def _order(
    read: CalculixMatrices, node: Ints, component: Ints, dependent: tuple[Ints, Ints], solid: int
) -> tuple[sp.csr_array, sp.csr_array, DofMap]:
    """K and M with empty rows for dependent dofs, those of the first ``solid`` nodes in front, node by node."""
    size = len(node)
    nodes, components = np.concatenate([node, dependent[0]]), np.concatenate([component, dependent[1]])
    behind = (nodes >= solid) | (components > 2)
    order = np.lexsort((components, nodes, behind))
    grown = [
        sp.csr_array(
            (A.data, A.indices, np.concatenate([A.indptr, np.full(len(nodes) - size, A.indptr[-1])])),
            shape=(len(nodes),) * 2,
        )
        for A in (read.K, read.M)
    ]
    K, M = (sp.csr_array(A[order][:, order]) for A in grown)
    return K, M, DofMap(node=nodes[order], component=components[order])


def _equations(S: sp.csr_array, dependent: tuple[Ints, Ints], node: Ints, component: Ints) -> Equations:
    """Rows of S as equations."""
    return Equations(
        name=FOLLOWS,
        nodes=dependent[0],
        components=dependent[1],
        offsets=S.indptr,
        term_nodes=node[S.indices],
        term_components=component[S.indices],
        coefficients=S.data,
    )
