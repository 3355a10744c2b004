"""The file of a simulation: each dataset is declared here, by which it is written, read and documented."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from morembs.app.kinds import RESULT, RESULT_FORMAT
from morembs.base.types import Floats
from morembs.storage.checksums import GROUP, Checksums
from morembs.storage.hdf5 import reading_format, tree
from morembs.storage.table import dataset, derived, read_rows, table_of
from morembs.storage.writer import writing


class ResultVersion:
    """Versions of the file of a simulation."""

    LATEST = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerHistory:
    """The motion of a marker along the inertial axes."""

    position: Floats = dataset("real", "s 3", "along the inertial axes", "m")
    axes: Floats = dataset("real", "s 3 3", "axes of the marker as columns")
    velocity: Floats = dataset("real", "s 3", "along the inertial axes", "m/s")
    angular_velocity: Floats = dataset("real", "s 3", "along the inertial axes", "rad/s")
    load: Floats = dataset(
        "real",
        "s 6",
        "force and moment of all joints, loads and springs on the body at the marker, contacts left out",
        "N, Nm",
        doc="force and moment of all joints, loads and springs on the body at the marker, along the axes of the body, "
        "of members and of bodies with `[[sliding]]` along the inertial ones; contacts are not in it",
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class BodyHistory:
    """A body: the motion of its frame, its own coordinates, and its markers."""

    kind: str = dataset(
        "text", doc="`elastic`, `rigid`, `member`, or `held`", known=("elastic", "rigid", "member", "held")
    )
    position: Floats | None = dataset("real", "s 3", "of the frame", "m", default=None, when="of bodies that float")
    rotation: Floats | None = dataset(
        "real", "s 3 3", "axes of the frame as columns", default=None, when="of bodies that float"
    )
    coordinates: Floats = dataset("real", "s any", "elastic coordinates, of a member its configuration")
    speeds: Floats = dataset("real", "s any", "of the frame and of the coordinates, as the simulator has them")
    markers: Mapping[str, MarkerHistory] = dataset(table_of(MarkerHistory), name="markers/*")


@dataclass(frozen=True, kw_only=True, eq=False)
class JointHistory:
    """A joint and its arguments."""

    kind: str = dataset("text", doc="as in the system file")
    between: tuple[str, ...] = dataset("text", "2", "its markers")
    reaction: Floats = dataset("real", "s 6", "on the second marker, at it, along the inertial axes", "N, Nm")


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactHistory:
    """The p points of a contact."""

    gap: Floats = dataset("real", "s any", "of the points to the surface, zero where they touch", "m")
    force: Floats = dataset("real", "s any", "on the points along the normal", "N")
    friction: Floats = dataset("real", "s any 2", "on the points along `axis` in the tangent plane, and across", "N")
    slip: Floats = dataset("real", "s any 2", "of the points over the surface", "m/s")
    foot: Floats = dataset("real", "s any 3", "nearest points of the surface", "m")


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpactList:
    """Impacts of all contacts, in their order."""

    time: Floats = dataset("real", "i", "", "s", doc="of each impact")
    loss: Floats = dataset("real", "i", "energy that is lost", "J")
    contact: tuple[str, ...] = dataset("text", "i", "contacts that meet in it")


@dataclass(frozen=True, kw_only=True, eq=False)
class SliderHistory:
    """A load or a rider, and the path below it."""

    position: Floats = dataset("real", "s", "along the path", "m")
    displacement: Floats = dataset("real", "s 3", "of the path there, static modes included, axes of the body", "m")
    largest_amplitude: Floats = dataset("real", "s", "of the static modes", "N")
    stress: Floats | None = dataset(
        "real", "s 6", "at the path there (xx, yy, zz, xy, yz, zx)", "Pa", default=None, when="where its tables have it"
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class SwitchLog:
    """Every change of active static modes."""

    time: Floats = dataset("real", "c", "", "s", doc="of each change")
    slider: tuple[str, ...] = dataset("text", "c", "whose window moved")
    position: Floats = dataset("real", "c", "along the path", "m")
    rank: Any = dataset("whole", "c", "static modes in use from then on")
    dropped: Floats = dataset("real", "c", "largest amplitude that went, per largest of all")


@dataclass(frozen=True, kw_only=True, eq=False)
class EnergyHistory:
    """Energies; ``kinetic + potential - work`` is constant up to integration error."""

    kinetic: Floats = dataset("real", "s", "", "J", doc="kinetic energy")
    potential: Floats = dataset("real", "s", "gravity, strain, springs", "J")
    work: Floats = dataset("real", "s", "put in by loads, dampers and prescribed motions since the start", "J")


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """All of the file of a simulation, SI units. A time at which the run was restarted occurs twice.

    ``provenance`` says where it comes from: the group /provenance, on which nothing outside depends.
    """

    @derived("text", doc=f"`{RESULT_FORMAT}`")
    def format(self) -> str:
        """What kind of file it is."""
        return RESULT_FORMAT

    @derived("whole", doc="1")
    def format_version(self) -> int:
        """Its version."""
        return ResultVersion.LATEST

    time: Floats = dataset("real", "s", "", "s", doc="times of all histories")
    bodies: Mapping[str, BodyHistory] = dataset(table_of(BodyHistory), name="bodies/*")
    joints: Mapping[str, JointHistory] = dataset(table_of(JointHistory), name="joints/*")
    energy: EnergyHistory = dataset(table_of(EnergyHistory))
    contacts: Mapping[str, ContactHistory] = dataset(table_of(ContactHistory), name="contacts/*")
    impacts: ImpactList | None = dataset(table_of(ImpactList), default=None, when="if there are contacts")
    sliders: Mapping[str, SliderHistory] = dataset(table_of(SliderHistory), name="sliders/*")
    switches: SwitchLog | None = dataset(table_of(SwitchLog), default=None, when="if there are sliders")
    system: str = dataset("text", doc="text of the system file")
    changes: tuple[str, ...] = dataset("text", "any", "keys that were given another value", default=(), when="if any")
    warnings: tuple[str, ...] = dataset("text", "any", "what to know, a sentence each", default=(), when="if any")
    provenance: Mapping[str, Any] = field(default_factory=dict)


RECORDING = table_of(Recording)


def write_recording(path: Path, recording: Recording) -> None:
    """Write the file, whole or not at all.

    Raises:
        OutputError: it cannot be written; an old file is kept.
    """
    with writing(path, excluded=["provenance"]) as out:
        given = {key: getattr(recording, key) or None for key in ("changes", "warnings")}
        out.rows("", RECORDING, recording, **given)
        out.tree("provenance", recording.provenance)


def read_recording(path: str | Path) -> Recording:
    """All of the file of a simulation.

    Raises:
        InputError: another file, a damaged one, or one of a newer version.
    """
    place = Path(path)
    with reading_format(place, RESULT.name, RESULT_FORMAT, ResultVersion.LATEST) as file:
        Checksums(place, file).verify()
        recording: Recording = read_rows(file, RECORDING)
        origin = {name: item for name, item in tree(file["provenance"]).items() if name != GROUP}
    return replace(recording, provenance=origin)
