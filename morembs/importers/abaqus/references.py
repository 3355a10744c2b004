"""References of distributing couplings, whose motion Abaqus and CalculiX take for different things.

Abaqus ties the reference to the mean motion of the coupled nodes (Analysis User's Guide, "Coupling constraints").
CalculiX writes no equation for *COUPLING with *DISTRIBUTING (CrunchiX User's Manual, "Kinematic and Distributing
Coupling": it distributes forces only), and for *DISTRIBUTING COUPLING the mean displacement without a rotation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from morembs.fem.constraints import AverageElement
from morembs.importers.decks.problems import Problem
from morembs.importers.tolerances import TOL

_IN_CALCULIX = {
    "COUPLING": "CalculiX leaves it loose",
    "DISTRIBUTING COUPLING": "CalculiX moves it by their mean displacement, without their rotation",
}
_LEFT_OUT = {"EQUATION": "--skip EQUATION", "MPC": "--skip MPC", "BOUNDARY": "--boundary drop"}


def problems_of_references(
    deck: str,
    named: Iterable[tuple[str, int, bool]],
    average: Sequence[AverageElement],
    kinds: dict[int, str],
    ids: NDArray[np.int64],
    xyz: NDArray[np.float64],
    *,
    cure: str,
) -> list[Problem]:
    """What is wrong with equations and supports that name references of distributing couplings.

    Args:
        named: keyword and node of the terms of equations, or of supports, and whether the node is refused also as the
            reference of a *DISTRIBUTING COUPLING at the mean place of its nodes, where both programs agree.
        average: the couplings; ``kinds`` are their keywords by reference.
        ids, xyz: labels (n,) and places (n, 3) of all nodes.
        cure: how to get the meaning of Abaqus.
    """
    by_reference = {element.reference: element for element in average}
    found: list[Problem] = []
    for keyword, node, always in sorted(set(named)):
        element = by_reference.get(node)
        if element is None or (not always and kinds[node] == "DISTRIBUTING COUPLING" and not _has_arm(element, xyz)):
            continue
        what = (
            f"{deck}: *{keyword} names node {ids[node]}, the reference of the distributing coupling {element.name!r}, "
            f"on which programs differ: Abaqus moves it with the mean motion of the coupled nodes, "
            f"{_IN_CALCULIX[kinds[node]]}; {cure} takes the former, {_LEFT_OUT[keyword]} leaves *{keyword} out"
        )
        found.append(Problem(what=what, file=deck, keyword=keyword, flags=(_LEFT_OUT[keyword],)))
    return found


def _has_arm(element: AverageElement, xyz: NDArray[np.float64]) -> bool:
    """True if the reference is away from the mean place of the nodes, so that their rotation moves it."""
    places = xyz[element.nodes]
    arm = xyz[element.reference] - np.average(places, axis=0, weights=element.weights)
    return float(np.linalg.norm(arm)) > TOL.no_arm * float(np.ptp(places, axis=0).max())
