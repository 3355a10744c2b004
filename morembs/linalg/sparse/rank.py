"""One process of a parallel MUMPS: ``mpirun -n N python -m morembs.linalg.sparse.rank FOLDER``.

Rank 0 takes commands over a socket in the folder, runs them together with the others, and answers. It ends when the
process at the other end is gone, and the others with it; each ends with the daemon of MPI that started it.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import signal
import socket
import sys
import time
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from morembs.base.memory import peak_memory_bytes
from morembs.linalg.sparse.mumps_codes import Job
from morembs.linalg.sparse.mumps_library import Library, rank_library
from morembs.linalg.sparse.tolerances import TOL

# Arrays of the matrix and of right-hand sides, which rank 0 alone has.
ARRAYS = {"irn": np.int32, "jcn": np.int32, "perm_in": np.int32, "a": None, "rhs": None}
COUNTS = ("n", "nnz", "nrhs", "lrhs")
TOLD = ("icntl", "cntl", "infog", "rinfog")
SOCKET = "socket"
# Number of ``prctl`` for the signal that follows the end of the parent (linux/prctl.h).
PRCTL = {"PR_SET_PDEATHSIG": 1}


class Mpi:
    """The calls of Open MPI that commands need; all in one thread."""

    def __init__(self, library: Any) -> None:
        self._library = library
        self._world, self._byte = self._handle("ompi_mpi_comm_world"), self._handle("ompi_mpi_byte")
        self._long = self._handle("ompi_mpi_int64_t")
        library.MPI_Init(None, None)
        rank, size = ctypes.c_int(), ctypes.c_int()
        library.MPI_Comm_rank(self._world, ctypes.byref(rank))
        library.MPI_Comm_size(self._world, ctypes.byref(size))
        self.rank, self.size = rank.value, size.value
        self.communicator = int(library.MPI_Comm_c2f(self._world))

    def _handle(self, name: str) -> ctypes.c_void_p:
        return ctypes.c_void_p(ctypes.addressof(ctypes.c_char.in_dll(self._library, name)))

    def tell(self, text: str) -> None:
        """Send a command to all other ranks."""
        message = text.encode()
        size = np.array([len(message)], dtype=np.int64)
        for rank in range(1, self.size):
            self._library.MPI_Send(ctypes.c_void_p(size.ctypes.data), 1, self._long, rank, 0, self._world)
            self._library.MPI_Send(message, len(message), self._byte, rank, 1, self._world)

    def hear(self) -> str:
        """The next command of rank 0."""
        flag, pause = ctypes.c_int(), TOL.shortest_poll_seconds
        while True:
            self._library.MPI_Iprobe(0, 0, self._world, ctypes.byref(flag), None)
            if flag.value:
                break
            time.sleep(pause)
            pause = min(2 * pause, TOL.longest_poll_seconds)
        size = np.zeros(1, dtype=np.int64)
        self._library.MPI_Recv(ctypes.c_void_p(size.ctypes.data), 1, self._long, 0, 0, self._world, None)
        message = ctypes.create_string_buffer(int(size[0]))
        self._library.MPI_Recv(message, int(size[0]), self._byte, 0, 1, self._world, None)
        return message.raw.decode()

    def gather(self, value: int) -> list[int]:
        """The values of all ranks, on rank 0."""
        own, values = np.array([value], dtype=np.int64), np.zeros(self.size, dtype=np.int64)
        self._library.MPI_Gather(
            ctypes.c_void_p(own.ctypes.data),
            1,
            self._long,
            ctypes.c_void_p(values.ctypes.data),
            1,
            self._long,
            0,
            self._world,
        )
        return [int(each) for each in values]

    def end(self) -> None:
        """No call after this one."""
        self._library.MPI_Finalize()


class Rank:
    """The instances of MUMPS in this process; ``run`` is called with the same command in all of them."""

    def __init__(self, mpi: Mpi, folder: Path) -> None:
        self.mpi, self.folder = mpi, folder
        self._instances: dict[int, tuple[Library, Any]] = {}
        self._held: dict[int, dict[str, Any]] = {}

    def version(self) -> tuple[str, str]:
        """Versions of header and library."""
        library = rank_library("float64")
        if isinstance(library, str):
            return library, ""
        data = self._new(library, 1)
        loaded = data.version_number.decode("latin-1").strip()
        library.call(data, Job.END)
        return library.version, loaded

    def run(self, command: dict[str, Any]) -> dict[str, Any]:
        """Run the job of a ``command``; what MUMPS says about it, and the peak memory of all ranks."""
        number, job = command["instance"], command["job"]
        if job == Job.NEW:
            library = rank_library(command["dtype"])
            if isinstance(library, str):
                return {"fault": library}
            self._instances[number], self._held[number] = (library, self._new(library, command["sym"])), {}
        library, data = self._instances[number]
        if job != Job.NEW:
            if job != Job.END:
                data.icntl[:], data.cntl[:] = command["icntl"], command["cntl"]
                data.ooc_tmpdir, data.ooc_prefix = command["ooc_tmpdir"].encode(), command["ooc_prefix"].encode()
                if self.mpi.rank == 0:
                    self._give(number, data, command)
            # All ranks come back with the same INFOG, whichever of them failed.
            library.call(data, job)
        answer = {name: list(getattr(data, name)) for name in TOLD}
        if job == Job.END:
            del self._instances[number], self._held[number]
        return {**answer, "peak": self.mpi.gather(peak_memory_bytes())}

    def _new(self, library: Library, sym: int) -> Any:
        data = library.structure()
        data.par, data.sym, data.comm_fortran = 1, sym, self.mpi.communicator
        library.call(data, Job.NEW)
        data.icntl[:4] = [0] * 4
        return data

    def _give(self, number: int, data: Any, command: dict[str, Any]) -> None:
        """Map the arrays of a command; arrays that it does not name are taken back."""
        arrays = self._held[number]
        for name in COUNTS:
            setattr(data, name, command["counts"][name])
        for name, kind in ARRAYS.items():
            file = command["arrays"].get(name)
            if file is None:
                arrays.pop(name, None)
                setattr(data, name, None)
            elif name not in arrays or arrays[name][0] != file:
                # Solutions overwrite their right-hand sides in the file; nothing else is written to.
                mode: Any = "r+" if name == "rhs" else "c"
                array = np.memmap(self.folder / file, dtype=kind or command["dtype"], mode=mode)
                arrays[name] = file, array
                setattr(data, name, array.ctypes.data)


def connect_to_starter(folder: Path) -> socket.socket:
    """A connection to the process that started the ranks."""
    # The path of a socket may be short only.
    opened = os.open(folder, os.O_RDONLY)
    try:
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(f"/proc/self/fd/{opened}/{SOCKET}")
    finally:
        os.close(opened)
    return connection


def _follow(lifeline: socket.socket, folder: Path) -> None:
    """End this rank, and by that all, when nobody listens any more."""
    lifeline.recv(1)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _die_with_parent() -> None:
    before = os.getppid()
    ctypes.CDLL(None).prctl(PRCTL["PR_SET_PDEATHSIG"], signal.SIGKILL)
    if os.getppid() != before:
        os._exit(1)


def main(folder: Path) -> None:
    """Serve until the command to end."""
    _die_with_parent()
    library = ctypes.CDLL("libmpi.so.40", mode=ctypes.RTLD_GLOBAL)
    lifeline = None
    if os.environ.get("OMPI_COMM_WORLD_RANK") == "0":
        lifeline, channel = connect_to_starter(folder), connect_to_starter(folder)
        Thread(target=_follow, args=(lifeline, folder), daemon=True).start()
        lines = channel.makefile("rw", encoding="utf-8", newline="\n")
    mpi = Mpi(library)
    rank = Rank(mpi, folder)
    header, loaded = rank.version()
    pids = mpi.gather(os.getpid())
    if lifeline is not None:
        local = int(os.environ.get("OMPI_COMM_WORLD_LOCAL_SIZE", mpi.size))
        _say(lines, {"header": header, "library": loaded, "pids": pids, "local": local})
    while True:
        text = lines.readline() if lifeline is not None else mpi.hear()
        if mpi.rank == 0:
            mpi.tell(text or "{}")
        command = json.loads(text or "{}")
        if not command:
            break
        answer = rank.run(command)
        if lifeline is not None:
            _say(lines, answer)
    mpi.end()


def _say(lines: Any, answer: dict[str, Any]) -> None:
    lines.write(json.dumps(answer) + "\n")
    lines.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
