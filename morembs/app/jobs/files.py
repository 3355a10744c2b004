"""Input and output files of a job, as its stages name them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from morembs.app.jobs.stages.stage import select_stages
from morembs.app.jobs.tables import Job
from morembs.base.errors import InputError
from morembs.storage.contents import promise
from morembs.storage.safefile import check_writable, one_file


def inputs_of(job: Job) -> dict[str, Path]:
    """The files that the job reads by the words for each: itself, and what its stages read."""
    files = {"the job file": job.path}
    for stage in select_stages(job):
        files |= stage.reads(job)
    return files


def results_of(job: Job) -> dict[str, Path]:
    """The files that the job writes, by the words for each."""
    return {words: path for stage in select_stages(job) for words, path in stage.writes(job).items()}


def prepare_output(job: Job) -> None:
    """Check before any work that the results can be written, and say that they will be: none is read from then on."""
    inputs, finals = inputs_of(job), results_of(replace(job, attempt=""))
    for name, path in results_of(job).items():
        for other, taken in inputs.items():
            if one_file(finals[name], taken):
                raise InputError(
                    f"{name} = {str(path)!r} would overwrite {other}; give it a name of its own",
                    kind="output",
                    keyword=name,
                )
        promise(finals[name])
        check_writable(path)
        inputs[name] = finals[name]
