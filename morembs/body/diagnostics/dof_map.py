"""What is wrong with nodes and with the map of the dofs on them."""

from __future__ import annotations

import numpy as np

from morembs.body.diagnostics.findings import Finding, Names, list_labels
from morembs.fem import DofMap, Nodes
from morembs.fem.fe_model import Component


def map_findings(nodes: Nodes | None, dofs: DofMap | None) -> list[Finding]:
    """Mistakes in nodes and map; either may be absent."""
    findings = []
    if nodes is not None:
        bad = np.flatnonzero(~np.isfinite(nodes.xyz).all(axis=1))
        if len(bad):
            labels = Names(nodes=nodes).node_labels(bad)
            sentence = f"{list_labels(labels, len(bad), 'node')} has no finite coordinates"
            findings.append(
                Finding(code="coordinates", severity="error", sentence=sentence, cure="mend them", where=labels)
            )
        ids, count = np.unique(nodes.ids, return_counts=True)
        if (count > 1).any():
            labels = tuple(map(str, ids[count > 1][:1000].tolist()))
            sentence = f"labels are used twice: {list_labels(labels, int((count > 1).sum()), 'node')}"
            findings.append(Finding(code="labels", severity="error", sentence=sentence, cure="renumber", where=labels))
    if dofs is None or not len(dofs):
        return findings
    top = len(nodes) if nodes is not None else np.inf
    outside = (dofs.node < 0) | (dofs.node >= top) | (dofs.component < 0) | (dofs.component > Component.SCALAR)
    if outside.any():
        sentence = (
            f"{int(outside.sum())} dofs name nodes or components that do not exist (row "
            f"{np.flatnonzero(outside)[0] + 1})"
        )
        findings.append(Finding(code="dof-map", severity="error", sentence=sentence, cure="components are 0 to 6"))
        return findings
    twice = dofs.twice()
    if len(twice):
        labels = Names(nodes=nodes).node_labels(twice // 6)
        sentence = f"{len(twice)} dofs appear twice in the map, the first at node {labels[0]}"
        findings.append(
            Finding(code="dof-map", severity="error", sentence=sentence, cure="map each dof once", where=labels)
        )
    return findings
