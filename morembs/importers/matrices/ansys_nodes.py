"""Coordinates for matrices of ANSYS, which hold none: from an archive or a list of nodes; matrix and nodes joined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from morembs.base.errors import InputError
from morembs.base.types import Ints
from morembs.fem import DofMap, Nodes, rigid_motion
from morembs.importers.ansys.cdb import read_ansys_archive
from morembs.importers.decks.labels import find
from morembs.importers.imported import Imported, picked_nodes
from morembs.importers.matrices.text import text_blocks
from morembs.importers.tolerances import TOL

COMPONENTS = ("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ")


def join(
    source: str,
    matrices: Mapping[str, sp.csr_array | None],
    node: Ints,
    component: Ints,
    nodes: str | Path | None,
    notes: Sequence[str],
    *,
    free: bool,
    sure: bool = True,
) -> Imported:
    """Matrices whose rows are (``node`` label, ``component``), with coordinates from the file ``nodes``.

    Rigid motion must leave the matrix K of a ``free`` model without forces. Where it does not, the model is noted as
    held, or refused unless the order of the rows is ``sure``.

    Raises:
        InputError: no ``nodes``, labels that it does not have, or an order of rows that cannot be right.
    """
    if nodes is None:
        raise InputError(
            f"{source} holds no coordinates; give nodes = the archive of the same model (CDWRITE,DB,model,cdb) or its "
            "list of nodes (NWRITE)",
            kind="missing",
            keyword="nodes",
        )
    known = read_nodes(nodes)
    order = np.argsort(known.ids)
    used = np.unique(node)
    at, there = find(known.ids[order], used)
    if len(missing := used[~there]):
        raise InputError(
            f"{source} has {len(missing)} nodes that {Path(nodes).name} lacks (first: {missing[0]}); give the archive "
            "of the same model",
            kind="unsupported",
        )
    kept = picked_nodes(known, order[at])
    dofs = DofMap(node=np.searchsorted(used, node), component=component)
    K = matrices["K"]
    lines = list(notes)
    if K is not None and free and (share := _measure_support(K, kept, dofs)) > TOL.held_share:
        if not sure:
            raise InputError(
                f"{source}: rigid motion needs forces of {share:.2g} of those in K. Either the model is held by "
                "supports, or its rows are not in the order of the table of nodes; write the mapping too (HBMAT with "
                "Mapping = YES, or *SMAT,MAP,D,IMPORT,FULL,file.full,NOD2SOLV and *EXPORT,MAP,MMF) and give it",
                kind="model",
                keyword="nodes",
            )
        lines.append(
            f"rigid motion needs forces of {share:.2g} of those in K: the model is held to the ground "
            "(eliminated supports, springs) and cannot move freely, or the coordinates are those of another model"
        )
    return Imported(
        source=source, K=K, M=matrices.get("M"), D=matrices.get("D"), nodes=kept, dofs=dofs, notes=tuple(lines)
    )


def _measure_support(K: sp.csr_array, nodes: Nodes, dofs: DofMap) -> float:
    """Largest |K R| over |K| |R| of the six rigid motions; lengths count in sizes of the model."""
    xyz = nodes.xyz - nodes.xyz.mean(axis=0)
    size = float(np.abs(xyz).max()) or 1.0
    R = rigid_motion(xyz[dofs.node] / size, dofs.component)
    # A rotation is larger than a displacement by the length that it turns.
    R[dofs.component >= 3] /= size
    scale = abs(K) @ np.abs(R)
    return float((np.abs(K @ R).max(axis=0) / np.maximum(scale.max(axis=0), np.finfo(float).tiny)).max())


def read_nodes(path: str | Path) -> Nodes:
    """Nodes of an archive (.cdb), or of lines "label x y z" (NWRITE, NLIST; a table with tabs may have decimal commas).

    Raises:
        InputError: as the reader of archives; no such lines, labels twice, or nodes with axes of their own, along
            which the dofs of a matrix would point.
    """
    path = Path(path)
    if path.suffix.lower() in (".cdb", ".dat", ".inp"):
        archive = read_ansys_archive(path)
        if len(archive.rotated):
            raise InputError(
                f"{path.name}: {len(archive.rotated)} nodes have rotated axes (first: {archive.rotated[0]}), along "
                "which the rows of the matrices point; rotate them back (NROTAT with CSYS,0) and write both again",
                kind="file",
                keyword=path.name,
            )
        return archive.nodes
    ids: list[int] = []
    xyz: list[list[float]] = []
    for block in text_blocks(path):
        for line in block.decode("latin-1").splitlines():
            words = line.replace(",", ".").split() if "\t" in line else line.split()
            if not words or not words[0].isdigit():
                continue
            try:
                numbers = [float(word) for word in words[1:4]]
                ids.append(int(words[0]))
            except ValueError as error:
                raise InputError(
                    f"{path.name}: the line {line[:60]!r} is not 'label x y z'", kind="unsupported"
                ) from error
            xyz.append(numbers + [0.0] * (3 - len(numbers)))
    if not ids or max(ids) >= 2**31 or not np.isfinite(xyz).all():
        raise InputError(
            f"{path.name} has no nodes; expected an archive (.cdb) or lines 'label x y z' (NWRITE)", kind="missing"
        )
    if len(set(ids)) < len(ids):
        raise InputError(f"{path.name} names a node twice; expected each node once", kind="conflict")
    return Nodes(ids=np.array(ids), xyz=np.array(xyz))
