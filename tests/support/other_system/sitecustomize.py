"""Makes a Python program, and all that it starts, see what Windows or macOS has, as far as this can be hidden.

Python runs this file first where its folder is on the path; the variable OTHER_SYSTEM says which system. For "windows"
no open or mapped file can be removed or renamed, nor take the name of another, as on that system.
"""

import ctypes
import mmap
import os
import shutil
import signal
import sys
from pathlib import Path

HIDDEN = {
    "windows": {
        "modules": ("fcntl", "resource", "pwd", "grp", "termios"),
        "os": (
            "posix_fallocate",
            "sched_getaffinity",
            "fork",
            "link",
            "geteuid",
            "getuid",
            "getpgid",
            "killpg",
            "mkfifo",
            "O_NOFOLLOW",
            "O_DIRECTORY",
            "sysconf",
            "fchmod",
        ),
        "signal": ("SIGHUP", "SIGALRM", "SIGKILL", "SIGUSR1", "setitimer", "alarm", "pthread_sigmask"),
    },
    "macos": {"modules": (), "os": ("posix_fallocate", "sched_getaffinity"), "signal": ()},
}


def held() -> set[str]:
    """Files that this process has open or mapped."""
    names = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            names.add(os.readlink(entry))
        except OSError:
            continue
    for line in Path("/proc/self/maps").read_text().splitlines():
        names.add(line.partition("/")[2] and "/" + line.partition("/")[2])
    return names


def refusing(call):
    """``call``, which refuses names of files in use."""

    def checked(*names, dir_fd=None, **keys):
        folder = "" if dir_fd is None else os.readlink(f"/proc/self/fd/{dir_fd}")
        for name in names:
            place = os.path.realpath(os.path.join(folder, os.fspath(name)))
            if place in held() and not os.path.isdir(place):
                raise PermissionError(13, "The process cannot access the file, which is in use", str(name))
        return call(*names, dir_fd=dir_fd, **keys) if dir_fd is not None else call(*names, **keys)

    return checked


def library(name, *rest, **keys):
    """Without a name there is no library."""
    if name is None:
        raise TypeError("LoadLibrary() argument 1 must be str, not None")
    return loaded(name, *rest, **keys)


which = os.environ.get("OTHER_SYSTEM", "")
if which in HIDDEN:
    # It has a side for each system, and would load that of this one.
    import psutil  # noqa: F401

    for module in HIDDEN[which]["modules"]:
        sys.modules[module] = None
    for owner, attributes in ((os, HIDDEN[which]["os"]), (signal, HIDDEN[which]["signal"])):
        for attribute in attributes:
            if hasattr(owner, attribute):
                delattr(owner, attribute)
    if which == "windows":
        del mmap.MADV_DONTNEED
        loaded, ctypes.CDLL = ctypes.CDLL, library
        shutil._use_fd_functions = False  # noqa: SLF001
        for function in ("unlink", "remove", "rename", "replace"):
            setattr(os, function, refusing(getattr(os, function)))
