"""What a body file holds: some of it at once, the rest when it is asked for."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from morembs.base.errors import InputError, nearest
from morembs.base.former_names import renamed
from morembs.base.summary import summarised
from morembs.base.types import Floats, Ints
from morembs.body.body import BODY, Body
from morembs.body.tables import FILE, FORMAT, FormatVersion
from morembs.fem.interface import Interface
from morembs.storage.checksums import GROUP, Checksums
from morembs.storage.hdf5 import reading_format
from morembs.storage.lemma import read_lemmas
from morembs.storage.table import Later, Row, Table, read_rows, table_of
from morembs.storage.table_check import refuse_not_finite

if TYPE_CHECKING:
    from morembs.body.vtkhdf_series import Grid

T = TypeVar("T")


class ByName(dict[str, T], Generic[T]):
    """Parts of a file by their names; a name that is not there is refused with those that are."""

    def __init__(self, what: str, parts: Mapping[str, T]) -> None:
        super().__init__(parts)
        self.what = what

    def __missing__(self, name: object) -> T:
        raise InputError(f"the file has no {self.what} {name!r}; {nearest(str(name), self)}")


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

    format_version: int
    mass: float
    center_of_mass: Floats
    inertia: Floats
    node_ids: Ints
    coordinates: Floats
    interfaces: dict[str, Interface]
    input_interface: Ints
    input_component: Ints
    input_node_id: Ints
    bodies: dict[str, Body]
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


def choose_body(bodies: StoredBodies, name: str | None, place: Path | str = "the file") -> Body:
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


class BodyFile:
    """A body file that is opened when something is read of it.

    ``content`` is what was read at once; ``evaluated`` gives a body at other values of its parameters.
    """

    content: StoredBodies

    def __init__(self, path: Path, evaluated: Callable[[BodyFile, Body], Any]) -> None:
        self.path, self.evaluated = path, evaluated

    def opened(self) -> AbstractContextManager[Any]:
        """The open file."""
        return reading_format(self.path, "a body file", FORMAT, FormatVersion.LATEST)

    def load(self, file: Any) -> StoredBodies:
        """Everything in the open file, which ``check_file`` has seen, but what bodies read later."""
        values = read_rows(file, FILE)
        names, interfaces, kinds = (values.pop(name) for name in ("body_names", "interface_names", "mode_kinds"))
        shown = {name: _interface(name, file[f"interfaces/{name}"], values["node_ids"]) for name in interfaces}
        self.content = StoredBodies(
            interfaces=ByName("interface", shown),
            bodies=ByName("body", {name: self._body(name, file[f"bodies/{name}"], kinds) for name in names}),
            provenance={name: item for name, item in _tree(file.get("provenance", {})).items() if name != GROUP},
            **values,
        )
        return self.content

    def _body(self, name: str, group: Any, kinds: Sequence[str]) -> Body:
        values = read_rows(group, BODY, later=partial(self._later, name))
        values.setdefault("output_matrix", values["input_matrix"].T)
        values["mode_kind"] = tuple(kinds[code] for code in values["mode_kind"])
        certificate = _tree(group["certificate"], np.asarray) if "certificate" in group else None
        if certificate is not None and "proof" in certificate:
            certificate["proof"] = [asdict(lemma) for lemma in read_lemmas(json.loads(certificate["proof"]))]
        return Body(name=name, certificate=certificate, file=self, **values)

    def _later(self, body: str, row: Row) -> Callable[..., Any]:
        """What reads a dataset of a body, or a group of them, at each call."""
        if isinstance(row.kind, Table):
            return Later(partial(self._group, f"bodies/{body}/{row.place}", row.kind))
        return partial(self._columns, f"bodies/{body}/{row.place}")

    def _columns(self, name: str, columns: slice = slice(None)) -> Floats:
        with self.opened() as file:
            return basis_columns(file[name], columns)

    def _group(self, name: str, table: Table) -> Any:
        with self.opened() as file:
            Checksums(self.path, file).verify(lambda item: item.startswith(f"{name}/"))
            value = read_rows(file[name], table, f"the {name.rpartition('/')[2]} data lack")
        for part, values in vars(value).items():
            if isinstance(values, np.ndarray) and values.dtype.kind == "f":
                refuse_not_finite(self.path, f"{name}/{part}", values)
        return value

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


__getattr__ = renamed(__name__, {"StoredBody": "Body", "StoredInterface": "Interface"})
