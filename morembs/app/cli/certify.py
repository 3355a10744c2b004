"""Verbs on the proofs of certificates: the files that a stranger needs for a proof, and the proof itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from morembs.app.cli.bodies import body_argument
from morembs.app.cli.messages import echo, print_json, printing
from morembs.app.cli.terminal import AsJson, Quiet, Verb, example, messages, progress_line
from morembs.base.errors import InputError

app = typer.Typer()
Body = Annotated[Path, body_argument(metavar="BODY.h5", help="A body file.")]


@app.command(cls=Verb, epilog=example("morembs certify part.h5 --model part.model.h5 --witness part.witness.h5"))
def certify(
    body: Body,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL.h5", help="The model file of the body.")
    ] = None,
    witness: Annotated[Path | None, typer.Option("--witness", metavar="W.h5", help="The file to write.")] = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write the files that a stranger needs to prove the certificates of a body again."""
    with messages(), progress_line(quiet):
        if model is None or witness is None:
            raise InputError(
                "certify writes a witness of certificates in a body file, and needs --model MODEL.h5 --witness W.h5; "
                "to certify bodies take the table [certify] of their job, with band_hz = [0, 2000]: morembs reduce "
                "JOB.toml"
            )
        # Not at the top: help needs no numbers.
        from morembs.app.jobs.witness import witness_of_file

        written = [str(witness_of_file(body, model, witness))]
        with printing(written):
            if as_json:
                print_json([{"file": str(body), "model": str(model), "written": written}])
            else:
                echo(f"written: {witness}; to verify: morembs verify {body} {model} {witness}")


@app.command(cls=Verb, epilog=example("morembs verify part.h5 part.model.h5 part.witness.h5"))
def verify(
    body: Body,
    model: Annotated[Path, typer.Argument(metavar="MODEL.h5", help="Its model file.", show_default=False)],
    witness: Annotated[Path, typer.Argument(metavar="W.h5", help="The witness.", show_default=False)],
) -> None:
    """Prove the certificates of a body again, by a program of its own; exit code 1 if they are not proven."""
    from morembs.certificate import morembs_verify

    raise typer.Exit(morembs_verify.main([str(body), str(model), str(witness)]))
