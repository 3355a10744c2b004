"""What every exporter is: options that turn a stored body into the file of another program."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from morembs.base.arguments import check_options
from morembs.base.errors import InputError, OutputError, OverwriteError
from morembs.base.types import Floats
from morembs.body.body import Body
from morembs.body.stored import StoredBodies
from morembs.exporters.read_back import ReadBack, frequencies_between
from morembs.exporters.tolerances import TOL
from morembs.exporters.without_mass import refuse_massless, with_far_mass
from morembs.fem.fe_model import Component
from morembs.problem.damping import frequency_domain_only
from morembs.storage.contents import Content
from morembs.storage.safefile import looked_at

if TYPE_CHECKING:
    from morembs.body.floating.frame import FloatingFrame, InterfaceMarker
    from morembs.exporters.real_time import RealTime

# What a body may have that a target cannot hold -> words for it.
LOSSES = {
    "damping": "its damping matrix",
    "forces": "its generalised forces",
    "stiffening": "its geometric stiffening",
    "stress": "its stress shapes",
    "certificate": "its certificate",
    "switching": "its static modes of candidate loads",
}


@dataclass(frozen=True, kw_only=True)
class Exported:
    """Files that were written, and notes for their users."""

    paths: tuple[Path, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Destination:
    """The file ``path`` that is to be written; ``file`` is the body file it comes from, if it has one."""

    path: Path
    file: Path | None = None

    def beside(self, ending: str) -> Path:
        """A further file of the same set: ``conrod_M.mtx`` beside ``conrod.inp`` for the ending ``_M.mtx``.

        Raises:
            InputError: that is the body file itself.
            OverwriteError: the body was made from it.
        """
        path = self.path.with_name(f"{self.path.name.removesuffix(self.path.suffix)}{ending}")
        self.refuse_source(path)
        return path

    def refuse_source(self, path: Path) -> None:
        """Refuse to write over the body file.

        Raises:
            InputError: in these cases.
        """
        if self.file is not None and _same(path, self.file):
            raise InputError(
                f"{path} is the body file itself; give another name for the output", kind="output", keyword="out"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportContext(Destination):
    """One body on its way to its destination; ``without_mass`` (n, m) are combinations of its elastic coordinates of
    unit stiffness whose mass is made up."""

    source: StoredBodies
    body: Body
    without_mass: Floats | None = None

    def refuse_source(self, path: Path) -> None:
        """Refuse to write over the body file, or over a file that the body was made from.

        Raises:
            InputError: the former.
            OverwriteError: the latter.
        """
        super().refuse_source(path)
        read = np.atleast_1d((self.source.provenance.get("inputs") or {}).get("sha256", [])).tolist()
        if read and path.is_file() and Content.of(path).sha256 in {_text(each) for each in read}:
            raise OverwriteError(
                f"{path} is a file that body {self.body.name!r} was made from; give another name for the output"
            )

    @property
    def frame(self) -> FloatingFrame:
        """Floating frame of the body, its markers in the order of the interfaces.

        Raises:
            InputError: it has none, or no elastic coordinate in it.
        """
        floating = self.body.floating
        if floating is None and self.body.spin is not None:
            raise InputError(
                f"body {self.body.name!r} has the matrices of [spin] and no floating frame, in which a simulator "
                "would count gyroscopic terms twice; reduce it without [spin] for this target",
                kind="unsupported",
            )
        if floating is None:
            raise InputError(
                f"body {self.body.name!r} has no floating frame (it is held to the ground, or not symmetric: "
                "two-sided, gyroscopic or circulatory); export a body of a free, symmetric model with a one-sided "
                "reduction",
                kind="unsupported",
                keyword="frame",
            )
        if not floating.elastic.shape[1]:
            raise InputError(
                f"body {self.body.name!r} has no elastic coordinate; keep at least one mode",
                kind="unsupported",
                keyword="modes",
            )
        order = [name for name in self.source.interfaces if name in floating.markers]
        # A group of a file has its members by the alphabet.
        if order != list(floating.markers):
            floating = replace(floating, markers={name: floating.markers[name] for name in order})
        return floating

    @property
    def coordinates(self) -> Floats:
        """Positions (n, 3) of the stored nodes in m, from the origin of the floating frame along its axes."""
        return np.asarray(self.source.coordinates - self.frame.origin)

    @staticmethod
    def left_from_before(paths: Iterable[Path]) -> tuple[str, ...]:
        """A note on files that lie where a set of another body would have them, but do not belong to this one."""
        left = ", ".join(path.name for path in paths if path.exists())
        return (f"not of this body, but left from before: {left}; remove what is not needed",) if left else ()

    def shapes(self, columns: slice = slice(None)) -> Floats:
        """Displacements (3 n, k) of the stored nodes for some elastic coordinates; allocates these and one block."""
        to_reduced = self.frame.elastic[:, columns]
        rows = 3 * len(self.source.coordinates)
        result = np.zeros((rows, to_reduced.shape[1]), order="F")
        step = max(1, TOL.basis_block_bytes // (8 * max(1, rows)))
        for start in range(0, len(to_reduced), step):
            block = slice(start, min(start + step, len(to_reduced)))
            result += self.body.basis(block) @ to_reduced[block]
        return result

    def markers(self, target: str) -> dict[str, InterfaceMarker]:
        """Interface frames by name, all six degrees of freedom of each, in the order of the file.

        Raises:
            InputError: no interface of the body has a frame that turns.
        """
        markers = {name: self.frame.markers[name] for name in self.source.interfaces if name in self.frame.markers}
        if not markers:
            raise InputError(
                f"{target} needs interface frames with rotations; body {self.body.name!r} has none "
                '(direct interfaces have no frame), take coupling = "rigid" or "average"',
                kind="unsupported",
                keyword="coupling",
            )
        return markers

    def losses_of(self, held: Collection[str]) -> tuple[str, ...]:
        """Notes on what this body has and a target that holds ``held`` (keys of LOSSES) leaves behind."""
        floating, body = self.body.floating, self.body
        scalar = self.source.input_interface[self.source.input_component == Component.SCALAR]
        names = [name for at, name in enumerate(self.source.interfaces) if at in scalar]
        has = {
            "damping": bool(np.any(body.damping_matrix if floating is None else floating.De)),
            "forces": bool(names),
            "stiffening": floating is not None and floating.stiffening is not None,
            "stress": body.has_recovery,
            "certificate": body.certificate is not None,
            "switching": body.has_switching,
        }
        words = LOSSES | {"forces": f"{LOSSES['forces']} ({', '.join(names)})"}
        left = [words[part] for part in LOSSES if has[part] and part not in held]
        return tuple(f"the file cannot hold {what}; left behind" for what in left)


@dataclass(frozen=True, kw_only=True)
class Exporter(ABC):
    """Options of a target; its fields are the keys a user may give.

    ``name`` is what the user types, ``suffix`` the end of the file name, ``about`` one line for people;
    ``needs_frame`` says whether the target describes a body in a floating frame, ``holds`` which of LOSSES its files
    carry: other parts of a body are noted, and ``takes_massless`` whether coordinates without mass stay as they are.
    """

    name: ClassVar[str]
    suffix: ClassVar[str]
    about: ClassVar[str]
    needs_frame: ClassVar[bool] = True
    holds: ClassVar[frozenset[str]] = frozenset()
    takes_massless: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_options(self)

    @abstractmethod
    def _write(self, context: ExportContext) -> Exported:
        """Write the file or files; the input has been checked. Files appear whole or not at all."""

    def _read_back(self, context: ExportContext, files: Mapping[Path, Path]) -> ReadBack | None:
        """What was written, read again: ``files`` has where each file lies until it gets its name. None, by default,
        where there is no reader.

        Raises:
            InputError: it cannot be read.
        """
        return None

    def prepare(self, context: ExportContext, step: float | None = None) -> tuple[ExportContext, tuple[str, ...]]:
        """The body as ``_write`` and ``truncate`` take it, and notes on it; ``step`` in s by default the own one.

        Raises:
            InputError: coordinates without mass that the target does not take.
        """
        own = getattr(self, "time_step", None) if step is None else step
        if own is None:
            if not self.takes_massless:
                refuse_massless(context.body, self.name)
            return context, ()
        heavy, Z, notes = with_far_mass(context.body, own)
        source = (
            replace(context.source, bodies={**context.source.bodies, heavy.name: heavy}) if notes else context.source
        )
        return replace(context, body=heavy, source=source, without_mass=Z), notes

    def truncate(self, context: ExportContext, step: float) -> RealTime | None:
        """What a time ``step`` in s leaves of a body; None for a target that knows no time step.

        Raises:
            StepTooLongError: nothing.
        """
        return None

    def step_error(self, context: ExportContext, angle: float) -> float:
        """Part by which steps put a frequency off that goes on by ``angle`` in rad in a step."""
        return 0.0

    @final
    def export(self, source: StoredBodies, body: Body, path: str | Path, file: Path | None = None) -> Exported:
        """Write ``body`` of ``source`` to ``path``; ``file`` is where the body comes from, if it is a file.

        Raises:
            InputError: the body cannot be expressed in the target, or the output is the input.
            OverwriteError: the body was made from a file that the output would replace.
            OutputError: the file cannot be written.
        """
        context = ExportContext(source=source, body=body, path=Path(path), file=file)
        context.refuse_source(context.path)
        if not len(body.mass_matrix):
            raise InputError(f"body {body.name!r} has no coordinates; keep at least one mode")
        for name in ("mass_matrix", "stiffness_matrix", "damping_matrix", "input_matrix", "output_matrix"):
            if not np.isfinite(getattr(body, name)).all():
                raise InputError(
                    f"{name} of body {body.name!r} has entries that are no numbers; reduce it again", keyword=name
                )
        reason = frequency_domain_only(body.recipe)
        lost = (*context.losses_of(self.holds), *([reason] if reason else []))
        context, notes = self.prepare(context)
        try:
            if self.needs_frame:
                refuse_rigid(context)
            with looked_at(partial(self._look, context)):
                written = self._write(context)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"the matrices of body {body.name!r} cannot be transformed for {self.name!r} ({error}); its mass or "
                "stiffness is not that of a body, reduce it again"
            ) from error
        return replace(written, notes=(*written.notes, *notes, *lost))

    def _look(self, context: ExportContext, files: Mapping[Path, Path]) -> None:
        """Refuse files that are not the body, before they get their names.

        Raises:
            OutputError: in these cases.
        """
        try:
            read = self._read_back(context, files)
        except InputError as error:
            raise OutputError(f"{context.path} was not written: it cannot be read back ({error})") from error
        if read is not None:
            body = context.body
            read.refuse_others(context.path, frequencies_between(body.frequencies_hz, body.rigid_count))


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except OSError:
        return False


def refuse_rigid(context: ExportContext) -> None:
    """The floating frame carries rigid motion; elastic coordinates must not contain it.

    Raises:
        InputError: they do, or Ke or Me is no matrix of a body.
    """
    frame = context.frame
    Ke, Me = frame.Ke, frame.integrals.Me
    if not (np.isfinite(Ke).all() and np.isfinite(Me).all() and (np.diag(Me) > 0).all()):
        raise InputError(
            f"Ke or Me of body {context.body.name!r} has entries that are no numbers, or Me none above zero on its "
            "diagonal; reduce it again"
        )
    # Fails where this is no mass; that of mean axes is one, and what other frames add makes it larger.
    np.linalg.cholesky(Me)
    stiffness = np.linalg.eigvalsh(_scale(Ke, Me))
    if stiffness[0] <= TOL.rigid_stiffness * stiffness[-1]:
        raise InputError(
            f"elastic coordinates of body {context.body.name!r} contain rigid-body motion (a combination of them has "
            "no stiffness); the floating frame carries that motion, reduce the model again",
            kind="unsupported",
            keyword="modes",
        )


def _scale(K: Floats, M: Floats) -> Floats:
    """K in units of the diagonal of K; the scale of single coordinates says nothing about rigid motion."""
    d = np.sqrt(np.where(np.diag(K) > 0, np.diag(K), np.diag(M)))
    return np.asarray(K / np.outer(d, d))


def in_two_digits(what: str, values: Floats, target: str) -> Floats:
    """``values`` as a format with exponents of two digits can hold them; round-off below 1e-99 becomes zero.

    Raises:
        InputError: numbers too large, not finite, or so small that the format would lose them.
    """
    values = np.asarray(values, dtype=float)
    size = np.abs(values)
    largest = float(size.max(initial=0.0))
    if not largest <= TOL.largest_in_two_digits:
        raise InputError(
            f"{what} has the value {largest:.3g}; {target} holds up to 9.9e99; check the units", keyword="units"
        )
    small = (size > 0) & (size < TOL.smallest_in_two_digits)
    if (small & (size > TOL.lost_number * largest)).any():
        raise InputError(
            f"{what} has the value {size[small].max():.3g}; {target} would write it as zero; check the units",
            keyword="units",
        )
    return np.where(small, 0.0, values)


def names_without_blanks(names: Iterable[str], longest: int, target: str) -> None:
    """Check names that a text format separates by blanks.

    Raises:
        InputError: a name that is too long, or has blanks or letters beyond ASCII.
    """
    for name in names:
        if len(name) > longest or not name.isascii() or not name.isprintable() or not name or " " in name:
            raise InputError(
                f"the name {name!r} does not fit {target}; expected up to {longest} ASCII characters without blanks, "
                "rename it in the job",
                keyword="name",
            )
