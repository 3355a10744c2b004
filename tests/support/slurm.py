"""Slurm on this machine alone: its two daemons on free ports of the loopback, without a system that starts them."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from tests.support.dask_cluster import PATIENCE

CONFIGURATION = """
ClusterName=loopback
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
AuthType=auth/none
CredType=cred/none
SlurmUser=root
SlurmdUser=root
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SchedulerType=sched/builtin
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 RealMemory=4000 State=UNKNOWN
PartitionName=night Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def why_not() -> str:
    """Why Slurm cannot run here, empty where it can."""
    missing = [name for name in ("slurmctld", "slurmd", "sbatch") if shutil.which(name) is None]
    if missing:
        return f"Slurm is not installed: {', '.join(missing)}"
    if os.geteuid() != 0:
        return "Slurm is started by root only"
    return "" if any(Path("/sys/fs/cgroup").glob("*")) else "no control groups are mounted on /sys/fs/cgroup for slurmd"


@contextlib.contextmanager
def slurm(folder: Path) -> Iterator[dict[str, str]]:
    """A queue ``night`` of two cores, and the environment by which the commands of Slurm know it."""
    for name in ("state", "spool"):
        (folder / name).mkdir()
    path = folder / "slurm.conf"
    host = socket.gethostname().partition(".")[0]
    path.write_text(CONFIGURATION.format(folder=folder, host=host, ports=_free_ports(2)))
    environment = {"SLURM_CONF": str(path)}
    daemons = []
    try:
        for words in (["slurmctld", "-D", "-i"], ["slurmd", "-D", "-N", host]):
            with open(folder / f"{words[0]}.log", "wb") as log:
                daemons.append(
                    subprocess.Popen(
                        [*words, "-f", str(path)],
                        stdin=subprocess.DEVNULL,
                        stdout=log,
                        stderr=log,
                        start_new_session=True,
                        env={**os.environ, **environment},
                    )
                )
        _wait_for_node(environment, folder)
        yield environment
    finally:
        with contextlib.suppress(OSError):
            subprocess.run(["scancel", "--full", "-u", "root"], env={**os.environ, **environment}, capture_output=True)
        for daemon in reversed(daemons):
            daemon.terminate()
            try:
                daemon.wait(30)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait()


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


def _wait_for_node(environment: dict[str, str], folder: Path) -> None:
    end = time.monotonic() + PATIENCE
    while True:
        seen = subprocess.run(
            ["sinfo", "-h", "-o", "%T"], env={**os.environ, **environment}, capture_output=True, text=True
        )
        if seen.stdout.strip() == "idle":
            return
        if time.monotonic() > end:
            logs = "\n".join(path.read_text(errors="replace")[-2000:] for path in folder.glob("*.log"))
            raise TimeoutError(f"Slurm has no node: {seen.stdout} {seen.stderr}\n{logs}")
        time.sleep(0.1)
