"""Contents of a body file: small parts at once, large ones when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.body.body import BODY, Body
from morembs.fem.fe_model import Component
from morembs.fem.interface import Interface
from morembs.storage.checksums import GROUP, Checksums, warn_unsealed
from morembs.storage.hdf5 import reading_format, tree
from morembs.storage.kinds import refuse_not_finite
from morembs.storage.table import Later, Row, Table, dataset, derived, read_rows, table_of

if TYPE_CHECKING:
    from morembs.body.vtkhdf_series import Grid

T = TypeVar("T")
FORMAT = "morembs-body"


class FormatVersion:
    """Versions of the format ``morembs-body``."""

    # Transposed input matrices are output matrices, and all matrices are symmetric.
    PLAIN = 1
    # Output matrices of their own.
    TWO_BASES = 2
    # Gyroscopic and circulatory matrices.
    SKEW_PARTS = 3
    # The latest that is read.
    LATEST = SKEW_PARTS


class ByName(dict[str, T], Generic[T]):
    """Parts of a file by their names; a missing name is refused with the present ones."""

    def __init__(self, what: str, parts: Mapping[str, T]) -> None:
        super().__init__(parts)
        self.what = what

    def __missing__(self, name: object) -> T:
        raise InputError(f"the file has no {self.what} {name!r}; {nearest(str(name), self)}", kind="unknown")


INTERFACE = table_of(Interface, build=dict)


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

    def __getattr__(self, name: str) -> Any:
        bodies = self.__dict__.get("bodies") or {}
        one = f"bodies[{next(iter(bodies), 'NAME')!r}].{name}"
        cure = f"; a file may hold several bodies: take {one}" if name[0] != "_" and hasattr(Body, name) else ""
        raise AttributeError(f"StoredBodies has no {name!r}{cure}")

    @derived("text", doc=f"`{FORMAT}`")
    def format(self) -> str:
        """What kind of file it is."""
        return FORMAT

    format_version: int = dataset("whole", doc="1, 2 or 3, see [version](#rules)")

    @derived("text", doc="`SI`", known=("SI",))
    def unit_system(self) -> str:
        """The units of all numbers."""
        return "SI"

    @derived(
        "text",
        "bodies",
        "groups of /bodies in their order",
        doc="groups of `/bodies`, in the order they were written",
        read=True,
    )
    def body_names(self) -> list[str]:
        """Names of the bodies."""
        return list(self.bodies)

    @derived(
        "text",
        "interfaces",
        "groups of /interfaces in their order",
        doc="groups of `/interfaces`, in the order of the inputs",
        read=True,
    )
    def interface_names(self) -> list[str]:
        """Names of the interfaces."""
        return list(self.interfaces)

    @derived("text", "kinds", "names of the codes in mode_kind, from 0", read=True)
    def mode_kinds(self) -> tuple[str, ...]:
        """Names of all kinds of coordinates."""
        # Not at the top: files are shown without what reduces.
        from morembs.reducers.base import MODE_KINDS

        return MODE_KINDS

    recipe: Mapping[str, Any] = dataset("json", "", "what was asked for, as JSON")
    warnings: tuple[str, ...] = dataset(
        "text",
        "any",
        "what to know before the bodies are used, a sentence each",
        name="check/warnings",
        default=(),
        since="0.2",
    )
    mass: float = dataset("real", units="kg", name="mass_properties/mass", doc="mass", positive=True)
    center_of_mass: Floats = dataset(
        "real", "3", units="m", name="mass_properties/center_of_mass", doc="in the coordinates of the model"
    )
    inertia: Floats = dataset(
        "real", "3 3", "about the centre of mass, axes of the model", "kg m2", name="mass_properties/inertia"
    )
    node_ids: Ints = dataset("whole", "N", "labels of the nodes in the source", name="nodes/ids")
    coordinates: Floats = dataset("real", "N 3", units="m", name="nodes/coordinates", doc="of the nodes")
    input_interface: Ints = dataset(
        "whole",
        "m",
        "per column of input_matrix: place in /interface_names from 0",
        name="inputs/interface_index",
        largest="interfaces-1",
    )
    input_component: Ints = dataset(
        "whole",
        "m",
        "degree of freedom: 0..2 along x, y, z; 3..5 about them; 6 generalised",
        name="inputs/component",
        largest=str(Component.SCALAR),
    )
    input_node_id: Ints = dataset(
        "whole", "m", "label of the node of a direct interface, -1 for a frame", name="inputs/node_id"
    )
    interfaces: dict[str, Interface]
    bodies: dict[str, Body]
    provenance: dict[str, Any]

    def _facts(self) -> dict[str, object]:
        orders = ", ".join(f"{name} (order {len(body.stiffness_matrix)})" for name, body in self.bodies.items())
        return {
            "bodies": orders,
            "mass": f"{self.mass:.4g} kg",
            "nodes": len(self.node_ids),
            "interfaces": list(self.interfaces),
            "warnings": len(self.warnings) or None,
        }


FILE = table_of(StoredBodies, build=dict)


def choose_body(bodies: StoredBodies, name: str | None, place: Path | str = "the file") -> Body:
    """The body ``name``, or the only one.

    Args:
        bodies: of one file.
        name: None for the only one.
        place: words for the file in messages.

    Raises:
        InputError: no such body, or several and no name.
    """
    known = bodies.bodies
    if name is None and len(known) != 1:
        first = next(iter(known), "NAME")
        raise InputError(
            f"{place} holds {len(known)} bodies ({', '.join(known)}); name one, as by --body {first}", kind="missing"
        )
    if name is not None and name not in known:
        raise InputError(f"{place} has no body {name!r}; {nearest(name, known)}", kind="unknown")
    return known[name or next(iter(known))]


class BodyFile:
    """A body file that is opened when something is read of it.

    ``content`` is what was read at once; ``evaluated`` gives a body at other values of its parameters.
    """

    content: StoredBodies

    def __init__(self, path: Path, evaluated: Callable[[BodyFile, Body], Any]) -> None:
        self.path, self.evaluated = path, evaluated

    def open_file(self) -> AbstractContextManager[Any]:
        """The open file."""
        return reading_format(self.path, "a body file", FORMAT, FormatVersion.LATEST)

    def load(self, file: Any) -> StoredBodies:
        """Everything in the open file, which ``check_file`` has seen, but what bodies read later."""
        values = read_rows(file, FILE)
        names, interfaces, kinds = (values.pop(name) for name in ("body_names", "interface_names", "mode_kinds"))
        values["warnings"] = (*values.get("warnings", ()), *warn_unsealed(self.path, file, "check/warnings"))
        shown = {name: _interface(name, file[f"interfaces/{name}"], values["node_ids"]) for name in interfaces}
        self.content = StoredBodies(
            interfaces=ByName("interface", shown),
            bodies=ByName("body", {name: self._body(name, file[f"bodies/{name}"], kinds) for name in names}),
            provenance={name: item for name, item in tree(file.get("provenance", {})).items() if name != GROUP},
            **values,
        )
        return self.content

    def _body(self, name: str, group: Any, kinds: Sequence[str]) -> Body:
        values = read_rows(group, BODY, later=partial(self._later, name))
        values.setdefault("output_matrix", values["input_matrix"].T)
        values["mode_kind"] = tuple(kinds[code] for code in values["mode_kind"])
        return Body(name=name, file=self, **values)

    def _later(self, body: str, row: Row) -> Callable[..., Any]:
        """What reads a dataset of a body, or a group of them, at each call."""
        if isinstance(row.kind, Table):
            return Later(partial(self._group, f"bodies/{body}/{row.place}", row.kind))
        return partial(self._columns, f"bodies/{body}/{row.place}")

    def _columns(self, name: str, columns: slice = slice(None)) -> Floats:
        with self.open_file() as file:
            return basis_columns(file[name], columns)

    def _group(self, name: str, table: Table) -> Any:
        with self.open_file() as file:
            Checksums(self.path, file).verify(lambda item: item.startswith(f"{name}/"))
            return read_rows(file[name], table, f"the {name.rpartition('/')[2]} data lack")

    def modes(self, body: str, count: int) -> Floats:
        """Shapes (k, n, 3) of the first elastic modes of a body that the file keeps."""
        from morembs.body.vtkhdf_series import stored_modes

        return stored_modes(self.path, body, count)

    def parametric(self, body: Body) -> Any:
        """The ``ParametricBody`` of a body with parameters."""
        return self.evaluated(self, body)

    def outline(self) -> tuple[Grid, Ints, dict[str, Floats]]:
        """As ``Part.outline``, of the cells that the file keeps.

        Raises:
            InputError: it keeps none, or is gone or damaged.
        """
        # Not at the top: most who read a file do not look at shapes.
        from morembs.body.vtkhdf_series import read_grid

        points = {name: interface.point for name, interface in self.content.interfaces.items()}
        return read_grid(self.path), self.content.node_ids, points


def _interface(name: str, group: Any, kept: Ints) -> Interface:
    """An interface of a file with nodes of the labels ``kept``."""
    values, order = read_rows(group, INTERFACE), np.argsort(kept, kind="stable")
    rows = np.full(len(values["node_ids"]), -1)
    if len(kept):
        places = order[np.minimum(np.searchsorted(kept, values["node_ids"], sorter=order), len(kept) - 1)]
        rows = np.where(kept[places] == values["node_ids"], places, -1)
    return Interface(name=name, nodes=rows, **values)


def basis_columns(data: Any, columns: slice) -> Floats:
    """Columns of a basis dataset, one by one: each lies in one piece, and several at once take far longer.

    Raises:
        InputError: numbers that are not finite, or differ from their checksum.
    """
    picked, checksums = range(data.shape[1])[columns], Checksums(data.file.filename, data.file)
    block = np.empty((data.shape[0], len(picked)))
    for place, column in enumerate(picked):
        block[:, place] = data[:, column]
        refuse_not_finite(data.file.filename, f"{data.name.lstrip('/')}[:, {column}]", block[:, place])
        checksums.verify_column(data.name.lstrip("/"), column, block[:, place])
    return block
