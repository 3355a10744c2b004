"""Standard input data of a flexible body (Wallrapp 1993, 1994): contents of a SID_FEM file, and its reader.

The files of different programs lay out the columns of Gr and Ge in two ways; which one a file has follows from
identities between its matrices: sym(Gr_l) = J1_l and Ge = 2 Cr1.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.exporters.tolerances import TOL

TERMS = ("mdCM", "J", "Ct", "Cr", "Me", "Gr", "Ge", "Oe", "ksigma", "Ke", "De")
NODE_TERMS = ("origin", "phi", "psi", "AP")
# Rows and columns of J: 11, 22, 33, 12, 13, 23 (other than those of Oe: 11, 22, 33, 12, 23, 13).
INERTIA = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_ENTRY = re.compile(r"\s*m([01])\s*\(\s*(\d+)\s*,\s*(\d+)\s*(?:,\s*(\d+)\s*)?\)\s*=\s*(\S+)\s*$")
_FIELD = re.compile(r"\s*(order|nrow|ncol|nqn|nq|structure)\s*=\s*(\d+)\s*$")
_FREQUENCY = re.compile(r"ielastq.*:\s*(\S+)\s*Hz", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Taylor:
    """M(q) = ``M0`` (nrow, ncol) + sum_l ``M1`` (nrow, nq, ncol)[:, l] q_l; ``M1`` is None at order 0."""

    M0: Floats
    M1: Floats | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SidNode:
    """A frame of the body: ``origin`` (3, 1), ``phi`` (3, nq) displacements, ``psi`` (3, nq) rotations, ``AP`` (3, 3)
    its axes as columns."""

    origin: Taylor
    phi: Taylor
    psi: Taylor
    AP: Taylor


@dataclass(frozen=True, kw_only=True, eq=False)
class Sid:
    """A body; SI units if the file has them.

    ``mdCM`` (3, 1), ``J`` (6, 1), ``Ct`` (nq, 3), ``Cr`` (nq, 3), ``Me`` (nq, nq), ``Oe`` (nq, 6), ``ksigma`` (nq, 1),
    ``Ke``, ``De`` (nq, nq). In one layout, whatever that of the file: ``Gr`` (nq, 3, 3) and ``Ge`` (nq, nq, 3), the
    matrices that the velocity of each elastic coordinate multiplies. ``dialect`` is the layout of the file: "fembs"
    (columns axis by axis), "mode-major" (mode by mode) or "mixed" (Gr mode by mode, Ge axis by axis).
    """

    mass: float
    frequencies_hz: Floats
    mdCM: Taylor
    J: Taylor
    Ct: Taylor
    Cr: Taylor
    Me: Taylor
    Gr: Floats
    Ge: Floats
    Oe: Taylor
    ksigma: Taylor
    Ke: Taylor
    De: Taylor
    nodes: Mapping[int, SidNode]
    dialect: str = "fembs"

    @property
    def count(self) -> int:
        """Number nq of elastic coordinates."""
        return len(self.Me.M0)


def read_sid(path: str | Path) -> Sid:
    """Read a SID_FEM file of any of the known layouts.

    Raises:
        InputError: no such file, not a SID file, incomplete, or matrices that fit no known layout.
    """
    place = Path(path)
    try:
        text = place.read_text(encoding="latin-1")
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror or error}); expected a SID_FEM file",
            kind="file",
            keyword=Path(path).name,
        ) from error
    parsed = _Parser(place).parse(text.splitlines())
    missing = [name for name in TERMS if name not in parsed.terms]
    if missing or parsed.mass is None:
        raise InputError(
            f"{path} is no complete SID file; missing: {', '.join(missing) or 'mass'}; write it again",
            kind="file",
            keyword=Path(path).name,
        )
    terms = parsed.terms
    _refuse_shapes(place, terms)
    Gr, Ge, dialect = _layout(place, terms)
    plain = {name: terms[name] for name in TERMS if name not in ("Gr", "Ge")}
    nodes = {}
    for label, parts in parsed.nodes.items():
        lacking = [name for name in NODE_TERMS if name not in parts]
        if lacking:
            raise InputError(
                f"{path}: node {label} has no {lacking[0]}; write the file again", kind="file", keyword=Path(path).name
            )
        nodes[label] = SidNode(**parts)
    return Sid(
        mass=parsed.mass,
        frequencies_hz=np.array(parsed.frequencies),
        Gr=Gr,
        Ge=Ge,
        dialect=dialect,
        nodes=nodes,
        **plain,
    )


class _Parser:
    """Sections by name; entries that a section does not list are zero."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.terms: dict[str, Taylor] = {}
        self.nodes: dict[int, dict[str, Taylor]] = {}
        self.mass: float | None = None
        self.frequencies: list[float] = []

    def parse(self, text: list[str]) -> _Parser:
        """Read all lines."""
        lines = iter(enumerate(text, start=1))
        node: dict[str, Taylor] | None = None
        for number, line in lines:
            word, _, value = (part.strip() for part in line.partition("="))
            if word == "new node":
                node = self.nodes.setdefault(self._integer(number, value), {})
            elif word == "end node":
                node = None
            elif word == "mass":
                self.mass = self._real(number, value)
            elif frequency := _FREQUENCY.search(line):
                self.frequencies.append(self._real(number, frequency[1]))
            elif node is not None and word in NODE_TERMS:
                node[word] = self._taylor(lines, word)
            elif node is None and word in TERMS:
                self.terms[word] = self._taylor(lines, word)
        return self

    def _taylor(self, lines: Iterator[tuple[int, str]], name: str) -> Taylor:
        sizes: dict[str, int] = {}
        entries: list[tuple[int, re.Match[str]]] = []
        number = 0
        for number, line in lines:
            if line.strip() == f"end {name}":
                return self._fill(name, sizes, entries, number)
            if field := _FIELD.match(line):
                sizes[field[1]] = int(field[2])
            elif entry := _ENTRY.match(line):
                entries.append((number, entry))
            elif line.strip():
                raise InputError(
                    f"{self.path}, line {number}: {line.strip()[:60]!r} is no entry of {name}; mend it",
                    kind="file",
                    keyword=self.path.name,
                )
        raise InputError(f"{self.path} ends within {name}; write it again", kind="file", keyword=self.path.name)

    def _fill(self, name: str, sizes: dict[str, int], entries: list[tuple[int, re.Match[str]]], last: int) -> Taylor:
        lacking = [key for key in ("order", "nrow", "ncol", "nq") if key not in sizes]
        if lacking:
            raise InputError(
                f"{self.path}, before line {last}: {name} has no {lacking[0]}; write the file again",
                kind="file",
                keyword=self.path.name,
            )
        shape = (sizes["nrow"], sizes["ncol"])
        if shape[0] * shape[1] * max(1, sizes["nq"]) > TOL.max_sid_entries:
            raise InputError(
                f"{self.path}, before line {last}: {name} has the impossible shape {shape}; write the file again"
            )
        M0 = np.eye(*shape) if sizes.get("structure") == 4 else np.zeros(shape)
        M1 = np.zeros((shape[0], sizes["nq"], shape[1])) if sizes["order"] else None
        for number, entry in entries:
            target = M0 if entry[1] == "0" else M1
            at = tuple(int(index) - 1 for index in entry.group(2, 3, 4) if index)
            inside = target is not None and len(at) == target.ndim
            if target is None or not inside or not all(0 <= i < k for i, k in zip(at, target.shape, strict=True)):
                where = entry[0].split("=")[0].strip()
                raise InputError(
                    f"{self.path}, line {number}: entry {where} of {name} lies outside; expected m0(row, column) and "
                    "m1(row, coordinate, column), some programs write m1(row, column, coordinate)",
                    kind="file",
                    keyword=self.path.name,
                )
            target[at] = self._real(number, entry[5])
        return Taylor(M0=M0, M1=M1)

    def _real(self, number: int, text: str) -> float:
        try:
            return float(text.replace("D", "E").replace("d", "e"))
        except ValueError:
            raise InputError(
                f"{self.path}, line {number}: {text!r} is no number; mend it", kind="file", keyword=self.path.name
            ) from None

    def _integer(self, number: int, text: str) -> int:
        if not text.isdigit():
            raise InputError(
                f"{self.path}, line {number}: {text!r} is no node number; mend it", kind="file", keyword=self.path.name
            )
        return int(text)


def _refuse_shapes(path: Path, terms: Mapping[str, Taylor]) -> None:
    n = len(terms["Me"].M0)
    shapes = {
        "mdCM": (3, 1),
        "J": (6, 1),
        "Ct": (n, 3),
        "Cr": (n, 3),
        "Me": (n, n),
        "Gr": (3, 3 * n),
        "Ge": (n, 3 * n),
        "Oe": (n, 6),
        "ksigma": (n, 1),
        "Ke": (n, n),
        "De": (n, n),
    }
    for name, shape in shapes.items():
        term = terms[name]
        if term.M0.shape != shape or (term.M1 is not None and term.M1.shape[1] != n):
            raise InputError(
                f"{path}: the shape of {name} does not fit {n} elastic coordinates; write it again",
                kind="file",
                keyword=Path(path).name,
            )


def axis_major(A: Floats, n: int) -> Floats:
    """(n, rows, 3) of (rows, 3 n) whose column is axis * n + mode."""
    return A.reshape(len(A), 3, n).transpose(2, 0, 1)


def mode_major(A: Floats, n: int) -> Floats:
    """(n, rows, 3) of (rows, 3 n) whose column is 3 mode + axis."""
    return A.reshape(len(A), n, 3).transpose(1, 0, 2)


def _layout(path: Path, terms: Mapping[str, Taylor]) -> tuple[Floats, Floats, str]:
    """Gr (n, 3, 3) and Ge (n, n, 3), and the layout they had."""
    n = len(terms["Me"].M0)
    Gr, Ge, J, Cr = (terms[name] for name in ("Gr", "Ge", "J", "Cr"))
    J1 = np.zeros((n, 6)) if J.M1 is None else J.M1[:, :, 0].T
    Cr1 = np.zeros((n, n, 3)) if Cr.M1 is None else Cr.M1
    # The symmetric part belongs to geometric stiffening.
    twice = (Cr1 - Cr1.transpose(1, 0, 2)).transpose(1, 0, 2)
    gr, ge = ({"fembs": axis_major(A, n), "mode-major": mode_major(A, n)} for A in (Gr.M0, Ge.M0))
    # Schwarz's inequality on the integrals.
    modal = np.abs(np.diag(terms["Me"].M0)).max(initial=0.0)
    least_gr = TOL.sid_roundoff * 2 * np.sqrt(np.abs(J.M0[:3]).sum() * modal)
    least_ge = TOL.sid_roundoff * 2 * modal
    off_gr = {
        key: _off(np.stack([(G[:, a, b] + G[:, b, a]) / 2 for a, b in INERTIA], axis=1), J1, least_gr)
        for key, G in gr.items()
    }
    off_ge = {key: _off(G, twice, least_ge) for key, G in ge.items()}
    for name, off in (("Gr", off_gr), ("Ge", off_ge)):
        if min(off.values()) > TOL.sid_identity:
            known = "sym(Gr) = J1" if name == "Gr" else "Ge = 2 Cr1"
            raise InputError(
                f"{path}: {name} fits no known layout ({known} fails in both); check what wrote the file",
                kind="file",
                keyword=Path(path).name,
            )
    of_ge = min(off_ge, key=lambda key: off_ge[key])
    # Where both fit (one mode, or a symmetric body), as the other matrix.
    of_gr = of_ge if off_gr[of_ge] <= TOL.sid_identity else min(off_gr, key=lambda key: off_gr[key])
    if off_ge["fembs"] <= TOL.sid_identity and off_ge["mode-major"] <= TOL.sid_identity:
        of_gr = min(off_gr, key=lambda key: off_gr[key])
        of_ge = of_gr
    return gr[of_gr], ge[of_ge], of_ge if of_gr == of_ge else "mixed"


def _off(A: Floats, B: Floats, least: float) -> float:
    size = max(np.abs(A).max(initial=0.0), np.abs(B).max(initial=0.0), least)
    return float(np.abs(A - B).max(initial=0.0) / size) if size else 0.0
