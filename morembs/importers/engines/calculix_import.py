"""A deck that CalculiX assembled as a model: its matrices on nodes, and how dependent dofs follow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from morembs.errors import InputError, nearest
from morembs.importers.abaqus_assembly import Assembly
from morembs.importers.abaqus_mesh import mesh_of
from morembs.importers.calculix_matrices import CalculixMatrices
from morembs.importers.deck_options import DeckOptions, deck_options
from morembs.importers.engines.calculix import Ccx, find_ccx
from morembs.importers.engines.calculix_flat import Choices, Flat, flat_deck
from morembs.importers.engines.calculix_read import EngineDeck, read_for_engine
from morembs.importers.engines.calculix_rows import STRAINED, Expanded, RowMap, map_rows, strain
from morembs.importers.imported import Imported, nodes_of, on_rows
from morembs.model import DofMap, Mesh, Nodes
from morembs.model.constraints import Equations
from morembs.model.fe_model import SCALAR

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
FOLLOWS = "constraints of CalculiX"
BOUNDARY = ("drop", "keep")
# Sums below this part of their terms are round-off; CalculiX writes 14 digits.
_ROUNDED = 1e-12
# Above all internal numbers of nodes.
_MADE = 1 << 40


def import_with_calculix(
    path: str | Path, *, executable: str = "", density: float | dict[str, float] | None = None,
    contact: str = "refuse", skip: list[str] | str = "", boundary: str = "drop", preload: int = 0,
    timeout: float = 600.0, keep_files: str = "", allow_includes_outside: bool = False,
) -> Imported:  # fmt: skip
    """A deck as CalculiX assembles it, in the deck's own units.

    Args:
        executable: the path of ccx; "" looks for it.
        density: of materials with *ELASTIC and without *DENSITY, or set -> density, "all" standing for all.
        contact: "refuse" contact pairs, "skip" them, or "tie" them: glue their surfaces.
        skip: keywords and element types to leave out, although stiffness or mass may depend on them.
        boundary: "drop" what *BOUNDARY holds, for a free body, or "keep" it.
        preload: steps that run first; the matrices are those of small motions after them.
        timeout: seconds for each run of ccx.
        keep_files: a folder for what ccx read and wrote.
        allow_includes_outside: includes may name files beyond the folder of the deck.

    Peak memory: that of the matrices several times, and of ccx itself.

    Raises:
        DeckError: all that keeps the deck from becoming a model.
        InputError: no ccx, options that are not known, or a run that fails.
    """
    program = find_ccx(executable)
    choices = _choices(deck_options(density, contact, skip), boundary, preload, timeout)
    deck, assembly, flat = _flat(Path(path), choices, outside=allow_includes_outside)
    keep = Path(keep_files) if keep_files else None
    with Ccx(program=program, flat=flat.deck, seconds=timeout, keep=keep) as ccx:
        read = ccx.export()
        model = _Model(deck, assembly, flat, read, ccx.expansion(), held=choices.keep)
        return model.imported(ccx, choices)


def readable_by_calculix(
    path: Path, *, density: dict[str, float] | None = None, contact: str = "refuse", skip: list[str] | str = "",
    allow_includes_outside: bool = False,
) -> None:  # fmt: skip
    """Whether a deck can be written for CalculiX; it is not run.

    Raises:
        InputError: it cannot.
    """
    _flat(path, Choices(options=deck_options(density, contact, skip)), outside=allow_includes_outside)


def _flat(path: Path, choices: Choices, *, outside: bool) -> tuple[EngineDeck, Assembly, Flat]:
    deck = read_for_engine(path, choices.options, outside=outside)
    with deck.problems.ending():
        assembly = Assembly(deck)
        return deck, assembly, flat_deck(deck, assembly, choices)


def _choices(options: DeckOptions, boundary: str, preload: int, timeout: float) -> Choices:
    if boundary not in BOUNDARY:
        raise InputError(f"--boundary {boundary} was given; {nearest(boundary, BOUNDARY)}")
    if preload < 0 or not timeout > 0:
        raise InputError(f"--preload {preload}, --engine-timeout {timeout:g} were given; expected no negative numbers")
    if preload and boundary == "drop":
        raise InputError(
            f"--preload {preload} was given with --boundary drop, but supports carry the load; give --boundary keep, "
            "or [preload] in the job"
        )
    return Choices(options=options, keep=boundary == "keep", preload=preload)


class _Model:
    """Rows of an export on nodes of the deck and of expanded elements."""

    def __init__(
        self, deck: EngineDeck, assembly: Assembly, flat: Flat, read: CalculixMatrices, expanded: Expanded | None,
        *, held: bool,
    ) -> None:  # fmt: skip
        self.deck, self.assembly, self.flat, self.expanded = deck, assembly, flat, expanded
        self.plain = self.read = read
        self.solid = np.zeros(len(assembly.ids), dtype=bool)
        for block in assembly.blocks:
            self.solid[block.nodes] = True
        used = self.solid.copy()
        for _, _, nodes in assembly.others:
            used[nodes] = True
        for element in assembly.discrete:
            used[element.nodes] |= element.code not in ("DCOUP3D", "ROTARYI", "MASS")
        self.used = used
        bodies = [*flat.bodies, *flat.turning.values()]
        placed = used.copy()
        placed[np.array(bodies, dtype=np.int64) - 1] = True
        unplaced = np.flatnonzero(~placed) + 1
        self.map = map_rows(
            read.K, read.node, read.dof, assembly.xyz, expanded=expanded, turning=flat.turning, unplaced=unplaced,
            bodies=len(flat.bodies), held=held,
        )
        self.T = self.map.change
        if self.T is not None:
            K, M = (_changed(A, self.T) for A in (read.K, read.M))
            self.read = replace(read, K=K, M=M)
        self.strain = strain(self.read.K, self.map)

    def imported(self, ccx: Ccx, choices: Choices) -> Imported:
        """The whole model."""
        mapped = self._with_rotations(self.map)
        node, direction = self._missing(mapped)
        S = None
        if len(node):
            # What the boundary holds in global axes follows nothing; springs tell the rest.
            held = self.flat.deck.held[node - 1, direction - 1] & ~np.isin(node - 1, list(self.flat.turned))
            probed = np.flatnonzero(~held)
            S = sp.csr_array((len(node), len(self.plain.node)))
            if len(probed):
                found = ccx.probe(self.plain, node[probed], direction[probed])
                into = sp.csr_array((np.ones(len(probed)), (probed, np.arange(len(probed)))), (len(node), len(probed)))
                S = sp.csr_array(into @ found)
            S = S if self.T is None else sp.csr_array(S @ self.T)
        return self._joined(mapped, node, direction, S, choices)

    def _with_rotations(self, mapped: RowMap) -> RowMap:
        """Rotations of rigid bodies at their reference nodes, where each has its own three."""
        turns = (mapped.component > 2) & (mapped.component < SCALAR) & (mapped.owner == 0)
        groups = np.unique(mapped.group[turns])
        bodies = [*self.flat.bodies, *([] if self.expanded is None else self.expanded.knots.tolist())]
        if not len(groups) or len(groups) != len(bodies) or len(set(bodies)) < len(bodies):
            return mapped
        owner, place = mapped.owner.copy(), mapped.place.copy()
        owner[turns] = np.array(bodies)[np.searchsorted(groups, mapped.group[turns])]
        place[turns] = self.assembly.xyz[owner[turns] - 1]
        return replace(mapped, owner=owner, place=place)

    def _missing(self, mapped: RowMap) -> tuple[Ints, Ints]:
        """Label and direction 1..3 of dofs of solids and reference nodes that have no row."""
        wanted = self.solid.copy()
        wanted[np.array([*self.flat.bodies, *self.flat.turning.values()], dtype=np.int64) - 1] = True
        if self.expanded is not None:
            # A node of a shell or beam is not in the model; those that it became are.
            wanted[self.expanded.parent - 1] &= self.solid[self.expanded.parent - 1]
        have = np.zeros((len(wanted), 3), dtype=bool)
        own = (mapped.owner > 0) & (mapped.component < 3)
        have[mapped.owner[own] - 1, mapped.component[own]] = True
        node, axis = np.nonzero(wanted[:, None] & ~have)
        return node + 1, axis + 1

    def _joined(
        self, mapped: RowMap, node: Ints, direction: Ints, S: sp.csr_array | None, choices: Choices
    ) -> Imported:
        """Rows in the order of the model: x, y, z of the mesh's nodes first, then all others."""
        flat, assembly = self.flat, self.assembly
        notes, warnings = [*flat.notes], [*flat.warnings]
        averaged = [nodes_of([*flat.average, *flat.masses])]
        extra = np.unique(np.concatenate([
            np.flatnonzero(np.isin(np.arange(len(assembly.ids)) + 1, mapped.owner)), node - 1, *averaged,
        ]).astype(np.int64))  # fmt: skip
        named = {
            name: assembly.members("node", placed, own) for name, (placed, own) in assembly.named("node").items()
        }
        mesh: Mesh | None = None
        if assembly.blocks:
            mesh, nodes, row = mesh_of(assembly, extra)
            self.deck.problems.refuse()
        else:
            row = np.full(len(assembly.ids), -1, dtype=np.int64)
            row[extra] = np.arange(len(extra))
            nodes = Nodes(ids=assembly.ids[extra], xyz=assembly.xyz[extra])
        named_by = np.zeros(len(mapped.owner), dtype=bool)
        if S is not None:
            named_by[S.indices] = True
        nodes, at = self._with_own_nodes(nodes, row, mapped, named, named_by)
        solid = 0 if mesh is None else len(mesh.nodes)
        dof_node, dof_component = at, mapped.component
        dependent = row[node - 1], direction - 1
        order, K, M, dofs = _ordered(self.read, dof_node, dof_component, dependent, solid)
        equations = () if S is None else (_equations(S, dependent, dof_node, dof_component),)
        del order
        average, masses = on_rows(flat.average, row), on_rows(flat.masses, row)
        surfaces = {name: np.sort(row[rows][row[rows] >= 0]) for name, rows in flat.constraints.surfaces.nodes.items()}
        if self.strain > STRAINED and not choices.keep:
            warnings.append(
                f"rigid motion strains the stiffness that CalculiX wrote by {self.strain:.1e} of its terms: springs to "
                "the ground, equations that hold the body, or elements C3D8R that are distorted, whose hourglass "
                "stiffness resists rotation there; own assembly has not that defect [engine-rotation]"
            )
        if self.deck.dialects == {"abaqus"}:
            warnings.append(
                "the deck is one of Abaqus, and CalculiX has other formulations and consistent masses: its frequencies "
                "are those of CalculiX [formulation-differs]"
            )
        for (code, plain), count in self.deck.replaced.items():
            warnings.append(f"{count} elements {code} are assembled as {plain} [hybrid-as-plain]")
        notes += _notes(self.deck, choices)
        return Imported(
            source=self.deck.name, K=K, M=M, nodes=nodes, dofs=dofs, mesh=mesh, average=average,
            equations=equations, masses=masses, surfaces={name: rows for name, rows in surfaces.items() if len(rows)},
            notes=(*notes, *assembly.notes), warnings=tuple(dict.fromkeys(warnings)),
        )  # fmt: skip

    def _with_own_nodes(
        self, nodes: Nodes, row: Ints, mapped: RowMap, named: dict[str, Ints], named_by: NDArray[np.bool_]
    ) -> tuple[Nodes, Ints]:
        """Nodes with those that CalculiX made, and the node row (N,) of each row of the export.

        Expanded nodes get labels beyond the deck and are in the sets of their parents; modes inside elements belong
        to the first node that K couples them to, those that equations name (``named_by``) have a node of their own.
        """
        first = 10 ** len(str(int(self.assembly.ids.max())))
        at = np.full(len(mapped.owner), -1, dtype=np.int64)
        deck = mapped.owner > 0
        at[deck] = row[mapped.owner[deck] - 1]
        ids, xyz, sets = [nodes.ids], [nodes.xyz], {name: rows for name, rows in nodes.sets.items()}
        # What has neither a node of the deck nor is a mode: expanded nodes, and rotations of bodies without a name.
        scalar = mapped.component == SCALAR
        own = (mapped.owner < 0) | ((mapped.owner == 0) & (~scalar | named_by))
        if own.any():
            made = _MADE + 5 * mapped.group + scalar * (1 + self.read.dof)
            key = np.where(mapped.owner < 0, -mapped.owner, made)
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
        assert_known = self.expanded
        if assert_known is None:
            return sets
        which = np.searchsorted(assert_known.nodes, keys)
        inside = (keys < _MADE) & (which < len(assert_known.nodes))
        parent = np.where(inside, assert_known.parent[np.minimum(which, len(assert_known.nodes) - 1)], 0)
        result = dict(sets)
        for name, rows in named.items():
            members = start + np.flatnonzero(np.isin(parent, rows + 1))
            kept = row[rows][row[rows] >= 0]
            if len(members) or len(kept):
                result[name] = np.unique(np.concatenate([kept, members]))
        return result


def _changed(A: sp.csr_array, T: sp.csr_array) -> sp.csr_array:
    """T' A T, symmetric, without what is round-off of its terms: a truss has no stiffness across its axis."""
    product, terms = sp.csr_array(T.T @ A @ T), abs(T).T @ abs(A) @ abs(T)
    product = sp.csr_array(0.5 * (product + product.T))
    left = sp.csr_array(product.multiply(abs(product) > _ROUNDED * 0.5 * (terms + terms.T)))
    # Both are semidefinite: a diagonal that is zero has nothing beside it.
    kept = sp.diags_array((left.diagonal() > 0).astype(float))
    left = sp.csr_array(kept @ left @ kept)
    left.eliminate_zeros()
    return left


def _ordered(
    read: CalculixMatrices, node: Ints, component: Ints, dependent: tuple[Ints, Ints], solid: int
) -> tuple[Ints, sp.csr_array, sp.csr_array, DofMap]:
    """K and M with empty rows for dependent dofs, those of the first ``solid`` nodes in front, node by node."""
    size = len(node)
    nodes, components = np.concatenate([node, dependent[0]]), np.concatenate([component, dependent[1]])
    behind = (nodes >= solid) | (components > 2)
    order = np.lexsort((components, nodes, behind))
    grown = [sp.csr_array((A.data, A.indices, np.concatenate([A.indptr, np.full(len(nodes) - size, A.indptr[-1])])),
                          shape=(len(nodes),) * 2) for A in (read.K, read.M)]  # fmt: skip
    K, M = (sp.csr_array(A[order][:, order]) for A in grown)
    return order, K, M, DofMap(node=nodes[order], component=components[order])


def _equations(S: sp.csr_array, dependent: tuple[Ints, Ints], node: Ints, component: Ints) -> Equations:
    """Rows of S as equations."""
    return Equations(
        name=FOLLOWS, nodes=dependent[0], components=dependent[1], offsets=S.indptr, term_nodes=node[S.indices],
        term_components=component[S.indices], coefficients=S.data,
    )  # fmt: skip


def _notes(deck: EngineDeck, choices: Choices) -> list[str]:
    """What was left out, a sentence each."""
    notes = ["The matrices are those of CalculiX."]
    for word in deck.noted:
        reason = "is not applied; the body is free" if word == "BOUNDARY" else "is not carried over"
        notes.append(f"*{word} {reason}.")
    if deck.steps:
        held = " but for what the first holds" if choices.keep and not choices.preload else ""
        held = f" beyond step {choices.preload}" if choices.preload else held
        notes.append(f"Steps are not applied{held}.")
    return notes
