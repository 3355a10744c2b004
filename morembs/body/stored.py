"""What a body file holds, as frozen types, taken from the open HDF5 file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from morembs.body.stored_check import refuse_not_finite
from morembs.body.stored_frame import read_frame, read_ranking
from morembs.errors import InputError, nearest
from morembs.floating.frame import FloatingFrame
from morembs.floating.ranking import RankedTerm
from morembs.storage.checksums import GROUP, Checksums

if TYPE_CHECKING:
    from morembs.interface import CouplingKind
    from morembs.reducers.base import ReducedModel
    from morembs.reducers.switching_tables import Switching

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
T = TypeVar("T")
MATRICES = ("mass_matrix", "stiffness_matrix", "damping_matrix", "input_matrix")


class ByName(dict[str, T], Generic[T]):
    """Parts of a file by their names; a name that is not there is refused with those that are."""

    def __init__(self, what: str, parts: Mapping[str, T]) -> None:
        super().__init__(parts)
        self.what = what

    def __missing__(self, name: object) -> T:
        raise InputError(f"the file has no {self.what} {name!r}; {nearest(str(name), self)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredInterface:
    """Interface: ``point`` (3,) m, ``axes`` (3, 3) as rows, ``node_ids`` (ns,) labels, ``weights`` (ns,)."""

    coupling: str
    components: tuple[int, ...]
    point: Floats
    axes: Floats
    node_ids: Ints
    weights: Floats

    @property
    def kind(self) -> CouplingKind:
        """What the coupling does."""
        # Not at the top: files are shown without what couples and solves.
        from morembs.interface import COUPLINGS

        return COUPLINGS[self.coupling]


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredBody:
    """One body of a file, SI units: matrices (n, n), ``input_matrix`` (n, m), ``output_matrix`` (m, n), which is its
    transpose unless the body is not symmetric, ``frequencies_hz`` (n,); ``certificate`` maps names to values;
    ``floating`` is what a simulator with large rotations needs, None for a body that is held or not symmetric,
    ``ranking`` says which of its terms matter; ``has_recovery`` says whether the file has stress shapes,
    ``has_switching`` whether it has static modes of candidate loads.
    """

    name: str
    mass_matrix: Floats
    stiffness_matrix: Floats
    damping_matrix: Floats
    input_matrix: Floats
    output_matrix: Floats
    frequencies_hz: Floats
    mode_kind: tuple[str, ...]
    rigid_count: int
    full_frequencies_hz: Floats | None
    recipe: dict[str, Any]
    certificate: dict[str, Any] | None
    read_basis: Callable[[str, slice], Floats]
    read_switching: Callable[[str], Switching]
    floating: FloatingFrame | None = None
    ranking: tuple[RankedTerm, ...] = ()
    has_recovery: bool = False
    has_switching: bool = False

    def basis(self, columns: slice = slice(None)) -> Floats:
        """Displacements (3 n_nodes, k) of the nodes for some coordinates, read from the file at each call.

        Raises:
            InputError: the file is gone or damaged.
        """
        return self.read_basis(self.name, columns)

    def reduced(self) -> ReducedModel:
        """The matrices as a reduced model without a basis, to be certified again."""
        from morembs.problem.damping import STRUCTURAL
        from morembs.reducers.base import ReducedModel

        n = len(self.stiffness_matrix)
        symmetric = np.array_equal(self.output_matrix, self.input_matrix.T)
        return ReducedModel(
            name=self.name, M=self.mass_matrix, K=self.stiffness_matrix, D=self.damping_matrix, B=self.input_matrix,
            C=self.output_matrix, V=np.zeros((0, n)), left=None if symmetric else np.zeros((0, n)),
            mode_kind=self.mode_kind, rigid_count=self.rigid_count, recipe=self.recipe,
            structural=float(self.recipe.get(STRUCTURAL, 0.0)),
        )  # fmt: skip

    def switching(self) -> Switching:
        """Static modes of candidate loads, read from the file at each call.

        Raises:
            InputError: the body has none, or the file is gone or damaged.
        """
        if not self.has_switching:
            raise InputError(
                f"body {self.name!r} has no static modes of candidate loads; reduce with "
                'method = "static-modes-switching"'
            )
        its = self.read_switching(self.name)
        for name, values in vars(its).items():
            if isinstance(values, np.ndarray):
                refuse_not_finite(f"body {self.name!r}", f"switching/{name}", values)
        return its


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredBodies:
    """All of a body file; what is written first comes first in the mappings.

    ``mass`` kg, ``center_of_mass`` (3,) m, ``inertia`` (3, 3) kg m2 about it; ``node_ids`` (n,),
    ``coordinates`` (n, 3) m; ``input_interface``, ``input_component``, ``input_node_id`` (m,) tell for each
    column of an input matrix the position of its interface, its motion 0..5 and its node (-1: a frame). ``warnings``
    are sentences about the model and the bodies.
    """

    format_version: int
    mass: float
    center_of_mass: Floats
    inertia: Floats
    node_ids: Ints
    coordinates: Floats
    interfaces: dict[str, StoredInterface]
    input_interface: Ints
    input_component: Ints
    input_node_id: Ints
    bodies: dict[str, StoredBody]
    recipe: dict[str, Any]
    provenance: dict[str, Any]
    warnings: tuple[str, ...] = ()


def stored_bodies(
    file: Any, read_basis: Callable[[str, slice], Floats], read_switching: Callable[[str], Switching],
) -> StoredBodies:  # fmt: skip
    """Everything but the bases and the static modes of an open body file, which ``check_file`` has seen."""
    names, interfaces = _strings(file["body_names"]), _strings(file["interface_names"])
    kinds = _strings(file["mode_kinds"])
    return StoredBodies(
        format_version=int(file["format_version"][()]),
        mass=float(file["mass_properties/mass"][()]),
        center_of_mass=file["mass_properties/center_of_mass"][()],
        inertia=file["mass_properties/inertia"][()],
        node_ids=file["nodes/ids"][()],
        coordinates=file["nodes/coordinates"][()],
        interfaces=ByName("interface", {name: _interface(file[f"interfaces/{name}"]) for name in interfaces}),
        input_interface=file["inputs/interface_index"][()],
        input_component=file["inputs/component"][()],
        input_node_id=file["inputs/node_id"][()],
        bodies=ByName(
            "body", {name: _body(name, file[f"bodies/{name}"], kinds, read_basis, read_switching) for name in names}
        ),
        recipe=json.loads(file["recipe"][()]),
        provenance={name: item for name, item in _tree(file.get("provenance", {})).items() if name != GROUP},
        warnings=tuple(_strings(file["check/warnings"])) if "check/warnings" in file else (),
    )


def _tree(group: Any, array: Callable[[Any], Any] = np.ndarray.tolist) -> dict[str, Any]:
    """Nested mapping of a group; text as str, numbers as Python numbers, arrays as ``array`` makes them."""
    result: dict[str, Any] = {}
    for name, item in group.items():
        if hasattr(item, "shape"):
            value = item[()]
            if isinstance(value, bytes):
                result[name] = value.decode()
            else:
                result[name] = array(value) if item.shape else value.item()
        else:
            result[name] = _tree(item, array)
    return result


def basis_columns(data: Any, columns: slice) -> Floats:
    """Columns of a basis dataset, one by one: each lies in one piece, and several at once take far longer.

    Raises:
        InputError: numbers that are not finite, or not those that were written.
    """
    picked, checksums = range(data.shape[1])[columns], Checksums(data.file.filename, data.file)
    block = np.empty((data.shape[0], len(picked)))
    for place, column in enumerate(picked):
        block[:, place] = data[:, column]
        refuse_not_finite(data.file.filename, f"{data.name.lstrip('/')}[:, {column}]", block[:, place])
        checksums.verify_column(data.name.lstrip("/"), column, block[:, place])
    return block


def refuse_missing(path: Path, file: Any, wanted: Iterable[str]) -> None:
    """Name the datasets that a body file needs and this one lacks.

    Raises:
        InputError: there are some.
    """
    missing = [f"/{name}" for name in wanted if not hasattr(file.get(name), "shape")]
    if missing:
        raise InputError(f"{path} is an incomplete body file; missing: {', '.join(missing)}; write it again")


def _interface(group: Any) -> StoredInterface:
    return StoredInterface(
        coupling=group["coupling"][()].decode(),
        components=tuple(group["components"][()].tolist()),
        **{name: group[name][()] for name in ("point", "axes", "node_ids", "weights")},
    )


def _body(
    name: str, group: Any, kinds: list[str], read_basis: Callable[[str, slice], Floats],
    read_switching: Callable[[str], Switching],
) -> StoredBody:  # fmt: skip
    full, output = group.get("full_frequencies_hz"), group.get("output_matrix")
    return StoredBody(
        name=name,
        frequencies_hz=group["frequencies_hz"][()],
        mode_kind=tuple(kinds[code] for code in group["mode_kind"][()]),
        rigid_count=int(group["rigid_count"][()]),
        full_frequencies_hz=None if full is None else full[()],
        recipe=json.loads(group["recipe"][()]),
        output_matrix=group["input_matrix"][()].T if output is None else output[()],
        certificate=_tree(group["certificate"], np.asarray) if "certificate" in group else None,
        read_basis=read_basis,
        read_switching=read_switching,
        floating=read_frame(group["floating_frame"]) if "floating_frame" in group else None,
        ranking=read_ranking(group["ranking"]) if "ranking" in group else (),
        has_recovery="recovery" in group,
        has_switching="switching" in group,
        **{matrix: group[matrix][()] for matrix in MATRICES},
    )


def _strings(data: Any) -> list[str]:
    return [text.decode() for text in data[()].tolist()]
