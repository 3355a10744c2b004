"""What a body file holds, as frozen types, taken from the open HDF5 file."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.summary import error_words, hertz, kinds_words, summarised
from morembs.base.types import Floats, Ints
from morembs.body.floating.frame import FloatingFrame
from morembs.body.floating.ranking import RankedTerm
from morembs.body.floating.spin import ReducedSpin
from morembs.body.tables import BODY, FILE, INTERFACE
from morembs.body.view import Viewed, refuse_no_modes
from morembs.fem.fe_model import STRUCTURAL
from morembs.storage.checksums import GROUP, Checksums
from morembs.storage.lemma import read_lemmas
from morembs.storage.table import read_rows
from morembs.storage.table_check import refuse_not_finite

if TYPE_CHECKING:
    from morembs.body.vtkhdf_series import View
    from morembs.fem.interface import CouplingKind
    from morembs.reducers.base import ReducedModel
    from morembs.reducers.switching_tables import StaticModeTables

T = TypeVar("T")
# Part of the largest entry by which round-off may make the matrices of a file differ from their transposes.
SYMMETRIC = 1e-9


class ByName(dict[str, T], Generic[T]):
    """Parts of a file by their names; a name that is not there is refused with those that are."""

    def __init__(self, what: str, parts: Mapping[str, T]) -> None:
        super().__init__(parts)
        self.what = what

    def __missing__(self, name: object) -> T:
        raise InputError(f"the file has no {self.what} {name!r}; {nearest(str(name), self)}")


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class StoredInterface:
    """Interface: ``point`` (3,) m, ``axes`` (3, 3) as rows, ``node_ids`` (ns,) labels, ``weights`` (ns,); names of
    generalised ``forces``."""

    coupling: str
    components: tuple[int, ...]
    point: Floats
    axes: Floats
    node_ids: Ints
    weights: Floats
    forces: tuple[str, ...] = ()

    @property
    def kind(self) -> CouplingKind:
        """What the coupling does."""
        # Not at the top: files are shown without what couples and solves.
        from morembs.fem.interface import COUPLINGS

        return COUPLINGS[self.coupling]


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class StoredBody(Viewed):
    """One body of a file, SI units: matrices (n, n), ``input_matrix`` (n, m), ``output_matrix`` (m, n), which is its
    transpose unless the body is not symmetric, ``frequencies_hz`` (n,); ``certificate`` maps names to values;
    ``floating`` is what a simulator with large rotations needs, None for a body that is held or not symmetric,
    ``ranking`` says which of its terms matter; ``spin`` has the matrices of a frame that turns;
    ``has_recovery`` says whether the file has stress shapes,
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
    recipe: dict[str, Any]
    certificate: dict[str, Any] | None
    read_basis: Callable[[str, slice], Floats]
    read_switching: Callable[[str], StaticModeTables]
    read_view: Callable[[StoredBody, int], View]
    read_parametric: Callable[[str], Any]
    full_frequencies_hz: Floats | None = None
    floating: FloatingFrame | None = None
    ranking: tuple[RankedTerm, ...] = ()
    spin: ReducedSpin | None = None
    has_recovery: bool = False
    has_switching: bool = False
    has_parameters: bool = False

    def _facts(self) -> dict[str, object]:
        return {
            "name": self.name,
            "order": len(self.stiffness_matrix),
            "elastic frequencies": hertz(self.frequencies_hz[self.rigid_count :]),
            "error": self._error(),
            "coordinates": kinds_words(self.mode_kind),
            "frame": None if self.floating is None else self.floating.kind,
        }

    def _error(self) -> str:
        known = self.certificate
        if known is None:
            return "not certified"
        if "limits" not in known:  # of version 0.1
            return f"{float(np.max(known['error'])):.1e} at samples"
        kinds = {"bound": "proven", "estimate": "estimate", "none": "sampled"}
        measure, kind = (str(known[key]) for key in ("measure", "bound_kind"))
        return error_words(measure, known["limits"][measure][1], known["error"], known["band_hz"], kinds[kind])

    @property
    def symmetric(self) -> bool:
        """Whether all matrices are symmetric: one-sided, without gyroscopic and circulatory terms."""
        both = self.stiffness_matrix, self.damping_matrix
        return self._one_sided and all(
            np.abs(A - A.T).max(initial=0.0) <= SYMMETRIC * np.abs(A).max(initial=0.0) for A in both
        )

    @property
    def _one_sided(self) -> bool:
        return bool(np.array_equal(self.output_matrix, self.input_matrix.T))

    @property
    def matrices(self) -> tuple[Floats, Floats, Floats]:
        """M, K, D (n, n), at rest where the body may spin."""
        return self.mass_matrix, self.stiffness_matrix, self.damping_matrix

    def basis(self, columns: slice = slice(None)) -> Floats:
        """Displacements (3 n_nodes, k) of the nodes for some coordinates, read from the file at each call.

        Raises:
            InputError: the file is gone or damaged.
        """
        return self.read_basis(self.name, columns)

    def view(self, modes: int) -> View:
        """The first elastic ``modes`` that the file keeps, for ``plot`` and ``to_pyvista``.

        Raises:
            InputError: no positive count was asked for, the body keeps no nodes, or the file is gone or damaged.
        """
        refuse_no_modes(modes)
        return self.read_view(self, modes)

    def reduced(self) -> ReducedModel:
        """The matrices as a reduced model without a basis, to be certified again."""
        from morembs.reducers.base import ReducedModel

        n = len(self.stiffness_matrix)
        V = np.zeros((0, n))
        return ReducedModel(
            name=self.name,
            M=self.mass_matrix,
            K=self.stiffness_matrix,
            D=self.damping_matrix,
            B=self.input_matrix,
            C=self.output_matrix,
            V=V,
            W=None if self.symmetric else V if self._one_sided else np.zeros((0, n)),
            mode_kind=self.mode_kind,
            rigid_count=self.rigid_count,
            recipe=self.recipe,
            structural=float(self.recipe.get(STRUCTURAL, 0.0)),
        )

    def switching(self) -> StaticModeTables:
        """Static modes of candidate loads, read from the file at each call.

        Raises:
            InputError: the body has none, or the file is gone or damaged.
        """
        if not self.has_switching:
            raise InputError(
                f"body {self.name!r} has no static modes of candidate loads; reduce with "
                'method = "static-modes-switching"'
            )
        switching = self.read_switching(self.name)
        for name, values in vars(switching).items():
            if isinstance(values, np.ndarray):
                refuse_not_finite(f"body {self.name!r}", f"switching/{name}", values)
        return switching

    @property
    def parametric(self) -> Any:
        """The body at other values of its parameters, a ``ParametricBody``, read from the file at each call.

        Raises:
            InputError: it has no parameters, or the file is gone or damaged.
        """
        if not self.has_parameters:
            raise InputError(f'body {self.name!r} has no parameters; make it with method = "parametric"')
        return self.read_parametric(self.name)


@summarised
@dataclass(frozen=True, kw_only=True, eq=False)
class StoredBodies:
    """All of a body file; what is written first comes first in the mappings.

    ``mass`` kg, ``center_of_mass`` (3,) m, ``inertia`` (3, 3) kg m2 about it; ``node_ids`` (n,),
    ``coordinates`` (n, 3) m; ``input_interface``, ``input_component``, ``input_node_id`` (m,) tell for each
    column of an input matrix the position of its interface, its motion 0..5 (6: of a generalised force) and
    its node (-1: a frame, or none). ``warnings``
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

    def _facts(self) -> dict[str, object]:
        orders = ", ".join(f"{name} (order {len(body.stiffness_matrix)})" for name, body in self.bodies.items())
        return {
            "bodies": orders,
            "mass": f"{self.mass:.4g} kg",
            "nodes": len(self.node_ids),
            "interfaces": list(self.interfaces),
            "warnings": len(self.warnings) or None,
        }


def choose_body(bodies: StoredBodies, name: str | None, place: Path | str = "the file") -> StoredBody:
    """The body ``name``, or the only one.

    Raises:
        InputError: no such body, or several and no name.
    """
    known = bodies.bodies
    if name is None and len(known) != 1:
        first = next(iter(known), "NAME")
        raise InputError(f"{place} holds {len(known)} bodies ({', '.join(known)}); name one, as by --body {first}")
    if name is not None and name not in known:
        raise InputError(f"{place} has no body {name!r}; {nearest(name, known)}")
    return known[name or next(iter(known))]


def stored_bodies(file: Any, **readers: Callable[..., Any]) -> StoredBodies:
    """Everything in an open body file, which ``check_file`` has seen, but what the ``readers`` of a body read later."""
    values = read_rows(file, FILE)
    names, interfaces, kinds = (values.pop(name) for name in ("body_names", "interface_names", "mode_kinds"))
    bodies = {name: _body(name, file[f"bodies/{name}"], kinds, readers) for name in names}
    shown = {name: StoredInterface(**read_rows(file[f"interfaces/{name}"], INTERFACE)) for name in interfaces}
    return StoredBodies(
        interfaces=ByName("interface", shown),
        bodies=ByName("body", bodies),
        provenance={name: item for name, item in _tree(file.get("provenance", {})).items() if name != GROUP},
        **values,
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


def _body(name: str, group: Any, kinds: Sequence[str], readers: Mapping[str, Any]) -> StoredBody:
    values = read_rows(group, BODY)
    values.setdefault("output_matrix", values["input_matrix"].T)
    values["mode_kind"] = tuple(kinds[code] for code in values["mode_kind"])
    certificate = _tree(group["certificate"], np.asarray) if "certificate" in group else None
    if certificate is not None and "proof" in certificate:
        certificate["proof"] = [asdict(lemma) for lemma in read_lemmas(json.loads(certificate["proof"]))]
    return StoredBody(
        name=name,
        has_recovery="recovery" in group,
        has_switching="switching" in group,
        has_parameters="parametric" in group,
        certificate=certificate,
        **values,
        **readers,
    )
