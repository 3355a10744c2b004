"""What an importer read becomes a finite-element model in SI units.

A mesh is assembled; point masses are added; rigid elements (RBE2), average elements (RBE3) and equations (MPC) make
dofs dependent, which are eliminated where the model is coupled to its interfaces. The elements are named couplings that
an interface can take over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.base.units import Units
from morembs.fem import FEModel, Mesh, Nodes
from morembs.fem.assembly import assemble
from morembs.fem.fe_model import MATRICES
from morembs.fem.handedness import right_handed
from morembs.fem.mesh import refuse_far
from morembs.fem.middle_nodes import mesh_in_order
from morembs.fem.surface import seam_faces
from morembs.importers.decks.labels import find
from morembs.importers.decks.missing_middles import LINEAR_EDGES
from morembs.importers.decks.options import DENSITY, MATERIAL
from morembs.importers.decks.problems import quote_option
from morembs.importers.dependent_dofs import dependent_dofs
from morembs.importers.discrete import si_discrete, with_discrete
from morembs.importers.imported import Imported, Ties, nodes_of, picked_nodes
from morembs.importers.in_si import equations_in_si, forces_in_si, materials_in_si, matrices_in_si
from morembs.importers.matrices.named import refuse_entries
from morembs.importers.nodes_and_dofs import nodes_and_dofs
from morembs.importers.point_masses import refuse_loose, si_mass, with_dofs, with_masses


def refuse_mass_integration(rule: str, what: str) -> None:
    """Refuse a rule other than that of the elements for what is not assembled here.

    Raises:
        InputError: in these cases.
    """
    if rule != "element":
        raise InputError(f"--mass-integration {rule} was given for {what}; leave it out", keyword="mass_integration")


def model_of(imported: Imported, units: Units | None = None, *, mass_integration: str = "element") -> FEModel:
    """Model in SI units of the data of a file in ``units`` (None: SI).

    Matrices of the file are taken as they are, real or complex, symmetric or not; without any the mesh is assembled
    with the materials. Nodes of solid elements come first, three dofs each; masters of rigid elements, references of
    average elements and nodes with point masses follow with dofs of their own.

    Peak memory: the matrices; what ``assemble`` needs for a mesh.

    Raises:
        InputError: neither K and M nor a mesh with materials, matrices that do not fit the nodes, nodes without
            coordinates, numbers that are not finite, elements that contradict each other, or ``mass_integration``
            for matrices.
    """
    units = units or Units()
    if imported.K is not None:
        refuse_mass_integration(mass_integration, f"{imported.source}, whose matrices are ready")
    imported = _complete(imported)
    touched = nodes_of(imported.ties)
    _refuse_incomplete(imported)
    if imported.K is not None:
        base = _from_matrices(imported, units)
    else:
        base = _from_mesh(imported, touched, units, mass_integration)
    model = base.model
    _refuse_missing_nodes(touched, len(base.row), imported.source)
    placed = imported.on_rows(base.row)
    rigid, average, equations = placed.rigid, placed.average, equations_in_si(placed.equations, units)
    masses = [si_mass(mass, units) for mass in placed.masses]
    _refuse_names([*(element.name for element in rigid), *(element.name for element in average)], imported.source)
    discrete = [si_discrete(element, units) for element in placed.discrete]
    ties: list[Ties] = [*rigid, *average, *equations, *masses, *discrete]
    model = with_dofs(model, ties)
    refuse_loose(model, ties)
    model, notes = with_discrete(with_masses(model, masses), discrete)
    repeated: list[str] = []
    dependent = dependent_dofs(model, rigid, average, equations, repeated)
    return FEModel(
        K=model.K,
        M=model.M,
        D=model.D,
        G=model.G,
        N=model.N,
        nodes=model.nodes,
        dofs=model.dofs,
        mesh=model.mesh,
        materials=model.materials,
        source=imported.source,
        rigid=rigid,
        average=average,
        equations=equations,
        dependent=dependent,
        inputs=forces_in_si("B", imported.inputs, imported, model.dofs, units),
        outputs=forces_in_si("C", imported.outputs, imported, model.dofs, units),
        notes=(*imported.notes, *base.notes, *notes),
        warnings=tuple(dict.fromkeys((*imported.warnings, *model.warnings, *repeated))),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Base:
    """A model, the new row of every node of the file (-1 where it is left out), and what to say about it."""

    model: FEModel
    row: Ints
    notes: tuple[str, ...] = ()


def _refuse_missing_nodes(touched: Ints, count: int, source: str) -> None:
    if len(touched) and not (touched[0] >= 0 and touched[-1] < count):
        raise InputError(
            f"{source} has an element on a node that is not there; write the file again",
            kind="file",
            keyword="elements",
        )


def _complete(imported: Imported) -> Imported:
    """With a warning for each set whose own material lacks something and that was given another one.

    Raises:
        InputError: a set without any, in a file whose matrices are not there.
    """
    given = {material.set for material in imported.materials}
    bare = {name: lack for name, lack in imported.incomplete.items() if not given & {name, "all"}}
    if bare and imported.K is None:
        stiff = all(lack.stiffness is not None for lack in bare.values())
        first = next(iter(bare))
        cure = f"a density: {quote_option(DENSITY + first) if len(bare) == 1 else '--density X'}"
        raise InputError(
            f"{imported.source}: {'; '.join(lack.sentence for lack in bare.values())}; complete the file, or give "
            f"{f'{cure}, or ' if stiff else ''}a material for {'each set' if len(bare) > 1 else 'the set'}: "
            f"{quote_option(MATERIAL + first)}",
            kind="missing",
        )
    warnings = []
    for name, lack in imported.incomplete.items():
        what = "its elements have none here" if name in bare else "the material that was given took its place"
        warnings.append(f"{lack.sentence}; {what}")
    return replace(imported, warnings=(*imported.warnings, *warnings), incomplete={})


def _refuse_incomplete(imported: Imported) -> None:
    source, given = imported.source, [name for name in MATRICES if getattr(imported, name) is not None]
    if imported.K is None and imported.mesh is None:
        raise InputError(
            f"{source} has {'no stiffness matrix' if given else 'neither matrices nor a mesh'}; expected K and M, or a "
            "mesh with materials",
            kind="missing",
            keyword="K",
        )
    if imported.K is not None and imported.M is None:
        raise InputError(f"{source} has K but no M; give the mass matrix too", kind="missing", keyword="M")
    if imported.K is None and given:
        raise InputError(
            f"{source} has {' and '.join(given)} but no K; give the stiffness matrix too", kind="missing", keyword="K"
        )
    if imported.K is None and not imported.materials:
        raise InputError(
            f"{source} has a mesh but no materials; give them: --material young=..,poisson=..,density=.. at the "
            "import, materials in Python",
            kind="missing",
        )
    for name in given:
        refuse_entries(source, name, getattr(imported, name))


def _refuse_names(names: Sequence[str], source: str) -> None:
    for name in names:
        if list(names).count(name) > 1:
            raise InputError(
                f"{source} has two rigid or average elements named {name!r}; give each its own name",
                kind="conflict",
                keyword="name",
            )


def _from_matrices(imported: Imported, units: Units) -> _Base:
    if imported.K is None:
        raise InputError(f"{imported.source} has no stiffness matrix", kind="missing")
    source, size = imported.source, imported.K.shape[0]
    for name in MATRICES:
        matrix = getattr(imported, name)
        if matrix is not None and matrix.shape != (size, size):
            raise InputError(
                f"{source}: {name} has the shape {matrix.shape}, K has {imported.K.shape}; expected equal shapes",
                kind="conflict",
                keyword=name,
            )
    nodes, dofs, notes = nodes_and_dofs(imported, size)
    nodes = _with_surfaces(replace(nodes, xyz=nodes.xyz * units.length), imported)
    mesh = None if imported.mesh is None else replace(_mesh_on(imported.mesh, nodes, units), warnings=())
    if mesh is not None:
        # Formulations of its elements do not matter beside matrices, the places of its nodes do.
        mesh = mesh_in_order(mesh)
    K, M, D, G, N = matrices_in_si(imported, dofs, units)
    model = FEModel(
        K=K,
        M=M,
        D=D,
        G=G,
        N=N,
        nodes=nodes,
        dofs=dofs,
        mesh=mesh,
        source=source,
        materials=materials_in_si(imported.materials, units),
        warnings=() if mesh is None else mesh.warnings,
    )
    bare = len(nodes) - len(np.unique(dofs.node))
    if bare:
        notes = (*notes, f"{bare} nodes have no dof in the matrices (they are held, or carry nothing)")
    return _Base(model=model, row=np.arange(len(nodes)), notes=notes)


def _from_mesh(imported: Imported, touched: Ints, units: Units, mass_integration: str) -> _Base:
    """The assembled mesh, nodes of elements first, then those ``touched`` by rigid and average elements and masses."""
    mesh = imported.mesh
    if mesh is None:
        raise InputError(f"{imported.source} has no mesh", kind="missing")
    nodes = imported.nodes if imported.nodes is not None else mesh.nodes
    if not np.isfinite(nodes.xyz).all():
        raise InputError(
            f"{imported.source} has nodes whose coordinates are not finite; write the file again", kind="file"
        )
    refuse_far(nodes, imported.source)
    blocks = _mesh_on(mesh, nodes, Units()).blocks
    used = np.zeros(len(nodes), dtype=bool)
    for block in blocks:
        used[block.nodes] = True
    extra = np.zeros(len(nodes), dtype=bool)
    _refuse_missing_nodes(touched, len(nodes), imported.source)
    extra[touched] = True
    order = np.concatenate([np.flatnonzero(used), np.flatnonzero(extra & ~used)])
    row = np.full(len(nodes), -1, dtype=np.int64)
    row[order] = np.arange(len(order))
    count = int(used.sum())

    def in_si(own: Nodes) -> Nodes:
        return replace(own, xyz=own.xyz * units.length)

    every = in_si(picked_nodes(_with_surfaces(nodes, imported), order))
    solid = in_si(picked_nodes(nodes, order[:count]))
    part = Mesh(
        nodes=solid,
        blocks=tuple(replace(block, nodes=row[block.nodes]) for block in blocks),
        element_sets=mesh.element_sets,
        source=mesh.source,
        warnings=mesh.warnings,
    )
    part = right_handed(part)
    part = replace(part, warnings=(*part.warnings, *_seams(imported, part, row)))
    model = assemble(
        part, materials_in_si(imported.materials, units), mass_integration=mass_integration, seams=imported.seams
    )
    for name in ("K", "M"):
        refuse_entries(imported.source, name, getattr(model, name))
    dropped = int((row < 0).sum())
    notes = (f"{dropped} nodes belong to no element and were left out",) if dropped else ()
    if count < len(order):
        model = replace(model, nodes=every)
    else:
        model = replace(model, nodes=every, mesh=replace(part, nodes=every))
    return _Base(model=model, row=row, notes=notes)


def _seams(imported: Imported, mesh: Mesh, row: Ints) -> list[str]:
    """A warning of faces that differ where elements meet, in a file of a program that takes them."""
    if not imported.seams or len(mesh.blocks) < 2:
        return []
    linear = np.zeros(len(mesh.nodes), dtype=bool)
    for equations in imported.equations:
        if equations.name == LINEAR_EDGES:
            linear[row[equations.nodes]] = True
    count = seam_faces(mesh, linear)
    return (
        [
            f"elements of different types meet at {count} faces whose nodes do not match (a quadratic next to a linear "
            "face, or a quadrilateral next to two triangles): the mesh may open there, as it may in the program of the "
            "deck [faces-differ]"
        ]
        if count
        else []
    )


def _with_surfaces(nodes: Nodes, imported: Imported) -> Nodes:
    """Surfaces of the file as node sets."""
    taken = {
        (f"surface:{name}" if name in nodes.sets else name): np.unique(rows) for name, rows in imported.surfaces.items()
    }
    return replace(nodes, sets={**nodes.sets, **taken}) if taken else nodes


def _mesh_on(mesh: Mesh, nodes: Nodes, units: Units) -> Mesh:
    """The mesh with its nodes as rows of ``nodes``, joined by labels; ``nodes`` are in SI already."""
    first = nodes.ids[: len(mesh.nodes)]
    if len(first) == len(mesh.nodes) and np.array_equal(first, mesh.nodes.ids):
        if len(first) == len(nodes):
            return replace(mesh, nodes=nodes)
        return replace(mesh, nodes=replace(mesh.nodes, xyz=nodes.xyz[: len(first)]))
    row = rows_of_labels(nodes, mesh.nodes.ids, mesh.source or "the mesh")
    blocks = tuple(replace(b, nodes=row[b.nodes]) for b in mesh.blocks)
    return replace(mesh, nodes=nodes, blocks=blocks)


def rows_of_labels(nodes: Nodes, labels: Ints, source: str) -> Ints:
    """Rows of ``nodes`` that have these labels.

    Raises:
        InputError: a label that does not exist, or one that two nodes have.
    """
    order = np.argsort(nodes.ids, kind="stable")
    known = nodes.ids[order]
    twice = known[1:][known[1:] == known[:-1]]
    if len(twice):
        raise InputError(
            f"two nodes have the label {twice[0]}; labels must be unique to be joined with {source}", kind="conflict"
        )
    at, there = find(known, np.asarray(labels))
    if not there.all():
        raise InputError(
            f"{source} names node {np.asarray(labels)[~there][0]}, which does not exist; check that the files belong "
            "together",
            kind="unknown",
        )
    return np.asarray(order[at], dtype=np.int64)
