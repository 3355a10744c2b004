"""A system file: its tables, and its paths, which are relative to its folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from morembs.app.jobs.job import read_text, read_toml
from morembs.app.jobs.tables import resolve_path
from morembs.app.kinds import SYSTEM, SYSTEM_FILE, instead, kind_of
from morembs.app.simulations.tables import SystemTables
from morembs.base.errors import InputError
from morembs.base.key_tables import read_table
from morembs.storage.contents import promise
from morembs.storage.safefile import check_writable, one_file

WORDS = "system file"


@dataclass(frozen=True, kw_only=True, eq=False)
class SystemFile:
    """A checked system file: its tables, its text, and the keys that were given another value, KEY=VALUE."""

    path: Path
    text: str
    tables: SystemTables
    changes: tuple[str, ...] = ()

    def resolve(self, path: str) -> Path:
        """A path of the file, seen from the working directory.

        Raises:
            InputError: no file can have this path.
        """
        return resolve_path(self.path, path)

    @property
    def output(self) -> Path:
        """The file of the result."""
        return self.resolve(self.tables.output.path)

    def inputs(self) -> Iterator[tuple[str, Path]]:
        """The files that it reads, by the words for each."""
        yield "the system file", self.path
        for body in self.tables.body:
            yield f"[[body]] {body.name!r} file", self.resolve(body.file)
        for member in self.tables.member:
            yield f"[[member]] {member.name!r} file", self.resolve(member.file)
        laws = [(each.name, each.law) for each in self.tables.load]
        for name, law in [*laws, *((each.name, each.law) for each in self.tables.sliding)]:
            if law is not None and law.file is not None:
                yield f"the law of {name!r}", self.resolve(law.file)
        for sliding in self.tables.sliding:
            if sliding.positions is not None:
                yield f"[[sliding]] {sliding.name!r} positions", self.resolve(sliding.positions)
        for contact in self.tables.contact:
            if contact.surface.file is not None:
                yield f"[[contact]] {contact.name!r} surface", self.resolve(contact.surface.file)
        for joint in self.tables.joint:
            if joint.motion is not None and joint.motion.file is not None:
                yield f"[[joint]] {joint.name!r} motion", self.resolve(joint.motion.file)

    def results(self) -> Iterator[tuple[str, Path]]:
        """The files that it writes, by the words for each."""
        yield "[output] path", self.output
        for table in self.tables.observe:
            yield f"[[observe]] {table.body!r} path", self.resolve(table.path)

    def prepare_output(self) -> None:
        """Check before any work that the results can be written.

        Raises:
            InputError: a result that would overwrite what is read, or another result.
            OutputError: a folder that cannot be written.
        """
        taken = list(self.inputs())
        for name, path in self.results():
            for other, file in taken:
                if one_file(path, file):
                    raise InputError(
                        f"{name} = {str(path)!r} would overwrite {other}; give it a name of its own",
                        kind="output",
                        keyword=name,
                    )
            promise(path)
            check_writable(path)
            taken.append((name, path))


def load_system(path: str | Path, changes: Sequence[str] = ()) -> SystemFile:
    """System of a TOML file, with ``changes`` of its keys, each ``"TABLE.KEY=VALUE"``, as ``load_job`` takes them.

    Raises:
        InputError: the file is missing, is not TOML, or has unknown, missing or wrong keys; one line for each fault.
    """
    path = Path(path)
    if path.exists() and kind_of(path) not in (SYSTEM, None):
        raise InputError(f"{path}: {instead(path, SYSTEM_FILE)}")
    text = read_text(path, WORDS, SYSTEM_FILE)
    data = read_toml(text, path, changes, WORDS, SYSTEM_FILE)
    return SystemFile(path=path, text=text, tables=read_table(SystemTables, data), changes=tuple(changes))
