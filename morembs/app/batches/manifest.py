"""What is remembered of a batch: a file of JSON lines, one event each, so that a killed batch loses nothing.

A line is written at once and forced to the disk; a last line that is cut off is dropped by the next reader. Paths are
relative to the folder of the file; inputs have the names that were opened, whose links may lead elsewhere later. The
file stays locked while a batch runs, on systems that have such locks.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from morembs.app.batches.tolerances import TOL
from morembs.base.closing import Closing
from morembs.base.errors import InputError, OutputError
from morembs.storage.contents import Content, own_files

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]


class ManifestFormat:
    """Format of a manifest."""

    NAME = "morembs-batch"
    VERSION = 1


_FIRST = {"event": "begun", "format": ManifestFormat.NAME, "version": ManifestFormat.VERSION}


@dataclass(frozen=True, kw_only=True)
class Ended:
    """A job that ended well: its ``key``, what was in its files (inputs by the names that were opened), and ``facts``
    for reports."""

    key: str
    inputs: Mapping[Path, Content]
    outputs: Mapping[Path, Content]
    facts: Mapping[str, Any]

    def holds(self, key: str, outputs: Iterable[Path]) -> bool:
        """True if the same job with the same inputs would give the files that are there."""
        if self.key != key or set(self.outputs) != {Path(os.path.realpath(path)) for path in outputs}:
            return False
        return all(content.still_in(path) for path, content in [*self.outputs.items(), *self.inputs.items()])


class Manifest(Closing):
    """The manifest at ``path``, made where there is none; closed by ``close`` or ``with``.

    Raises:
        InputError: it is another file, damaged, or in use by another batch.
        OutputError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(os.path.realpath(path))
        self._handle = _open_locked(self.path)
        try:
            events = _events(self.path, self._handle)
            self._ended = {event["output"]: event for event in events if event.get("event") == "ended"}
            # Of each job that has begun, the last attempt.
            self._started = {event["output"]: event for event in events if event.get("event") == "started"}
            if not events:
                self._write(_FIRST)
            elif len(events) > max(TOL.manifest_lines, 4 * len(self._ended)):
                self._compact()
            self._write({"event": "opened", "pid": os.getpid(), "host": platform.node()})
        except BaseException:
            os.close(self._handle)
            raise

    def last(self, output: Path) -> Ended | None:
        """How the job that writes ``output`` ended last, None if it never did well."""
        event = self._ended.get(self._name(output))
        if event is None:
            return None
        try:
            inputs, outputs = (
                {self.path.parent / name: Content.from_plain(values) for name, values in event[part].items()}
                for part in ("inputs", "outputs")
            )
            normal = {Path(os.path.normpath(path)): content for path, content in outputs.items()}
            return Ended(key=event["key"], inputs=inputs, outputs=normal, facts=event["facts"])
        except (KeyError, TypeError, ValueError, AttributeError):
            return None  # of another version: the job is due again

    def record_start(self, output: Path, key: str, **values: object) -> str:
        """Remember that a job begins, with ``values`` for people; the token of this attempt, which no other has."""
        name = self._name(output)
        number = 1 + int(self._started.get(name, {}).get("attempt", 0))
        self._started[name] = {"event": "started", "output": name, "key": key, "attempt": number, **values}
        self._write(self._started[name])
        return f"{key[:8]}.{number}"

    def record_loss(self, output: Path, **values: object) -> None:
        """Remember that an attempt was killed, with ``values`` for people."""
        self._write({"event": "lost", "output": self._name(output), **values})

    def record_end(self, output: Path, end: Ended, **values: object) -> None:
        """Remember a job that ended well, with ``values`` for people."""
        event = {
            "event": "ended",
            "output": self._name(output),
            "key": end.key,
            "facts": end.facts,
            **values,
            "inputs": {self._input_name(path): vars(content) for path, content in end.inputs.items()},
            "outputs": {self._name(path): vars(content) for path, content in end.outputs.items()},
        }
        self._write(event)
        self._ended[event["output"]] = event

    def record_failure(self, output: Path, message: str) -> None:
        """Remember that a job failed, for people: it is due again."""
        self._write({"event": "failed", "output": self._name(output), "message": message})

    def close(self) -> None:
        """Let another batch have it."""
        os.close(self._handle)

    def _name(self, path: Path) -> str:
        try:
            return Path(os.path.relpath(os.path.realpath(path), self.path.parent)).as_posix()
        except ValueError:  # on another drive
            return Path(os.path.realpath(path)).as_posix()

    def _input_name(self, path: Path) -> str:
        """The name of an input: its links and dots stay, as they may mean another file later."""
        below = path.is_relative_to(self.path.parent)
        return (path.relative_to(self.path.parent) if below else path).as_posix()

    def _write(self, *events: Mapping[str, object]) -> None:
        now = round(time.time(), 3)
        lines = "".join(json.dumps({"at": now, **event}, allow_nan=False) + "\n" for event in events).encode()
        try:
            while lines:
                lines = lines[os.write(self._handle, lines) :]
            os.fsync(self._handle)
        except OSError as error:
            raise OutputError(
                f"{self.path} cannot be written ({error.strerror}); free space there, then run again"
            ) from error

    def _compact(self) -> None:
        """Leave the last start and end of each job only: in a new file, locked before it takes the name."""
        new = self.path.with_name(f".{self.path.name}.new")
        with contextlib.suppress(OSError):
            new.unlink()
        old, self._handle = self._handle, _open_locked(new)
        self._write(_FIRST, *self._started.values(), *self._ended.values())
        if fcntl is None:
            # Windows gives no open file another name, nor that of one that is open.
            os.close(old)
            os.close(self._handle)
            os.replace(new, self.path)
            self._handle = _open_locked(self.path)
        else:
            os.replace(new, self.path)
            os.close(old)


def is_manifest(path: Path) -> bool:
    """True if a file begins as a manifest does."""
    try:
        with own_files(), open(path, "rb") as file:
            first = json.loads(file.readline(TOL.first_line_bytes))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(first, dict) and first.get("format") == ManifestFormat.NAME


def read_ended(path: Path) -> dict[Path, dict[str, Any]]:
    """How each job of a manifest ended last where it did well, by its body file; the file stays as it is.

    Raises:
        InputError: it is damaged, or of another version.
    """
    events = _read_events(path)[0]
    ended = {event["output"]: event for event in events if event.get("event") == "ended"}
    folder = Path(os.path.realpath(path)).parent
    return {Path(os.path.realpath(folder / name)): event for name, event in ended.items()}


def _open_locked(path: Path) -> int:
    """An open handle of the file, which this process has for itself."""
    try:
        # Flags that only some systems have: no links; on Windows no other ends of lines.
        more = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
        # The process may write it, and all may read it.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | more, 0o644)
    except OSError as error:
        raise OutputError(f"{path} cannot be written ({error.strerror}); give another --manifest") from error
    if fcntl is None:
        return handle
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise InputError(
            f"{path} is in use by {_user(path)}; wait for it, or give another --manifest",
            kind="file",
            keyword=path.name,
        ) from error
    except OSError:
        pass  # a disk without locks
    return handle


def _user(path: Path) -> str:
    """Who opened a manifest last."""
    who = "another batch"
    with contextlib.suppress(OSError, ValueError, KeyError):
        for line in path.read_bytes().splitlines():
            if line.startswith(b'{"') and b'"event": "opened"' in line:
                event = json.loads(line)
                who = f"pid {event['pid']} on host {event['host']}"
    return who


def _events(path: Path, handle: int) -> list[dict[str, Any]]:
    """The events; the file loses a line that was cut off at its end."""
    events, whole, rest = _read_events(path)
    if rest and not events:
        raise InputError(
            f"{path} is not a manifest of a batch; give another --manifest", kind="file", keyword=path.name
        )
    if rest:
        os.ftruncate(handle, whole)
    return events


def _read_events(path: Path) -> tuple[list[dict[str, Any]], int, bytes]:
    """The events, the bytes of their lines, and a line that was cut off at the end."""
    with own_files(), open(path, "rb") as file:
        *whole, rest = file.read().split(b"\n")
    events = []
    for number, line in enumerate(whole, start=1):
        try:
            event = json.loads(line)
            known = isinstance(event, dict) and (number > 1 or event.get("format") == ManifestFormat.NAME)
            if known and event["event"] in ("started", "ended"):
                known = isinstance(event["output"], str) and isinstance(event.get("attempt", 0), int)
        except (ValueError, RecursionError, KeyError):
            known = False
        if not known:
            what = "is not a manifest of a batch" if number == 1 else f"cannot be read in line {number}"
            raise InputError(
                f"{path} {what}; move it away to begin again, or give another --manifest",
                kind="file",
                keyword="manifest",
            )
        events.append(event)
    if events and events[0].get("version") != ManifestFormat.VERSION:
        raise InputError(
            f"{path} has the format version {events[0].get('version')}; this morembs reads {ManifestFormat.VERSION}",
            kind="file",
            keyword=path.name,
        )
    return events, sum(len(line) + 1 for line in whole), rest
