"""Verbs on the proofs of certificates: the files that a stranger needs for a proof, and the proof itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from morembs.app.cli.bodies import body_argument, values_of
from morembs.app.cli.messages import echo, print_json, printing
from morembs.app.cli.terminal import AsJson, Quiet, Verb, example, messages, progress_line
from morembs.base.errors import InputError

app = typer.Typer()
Body = Annotated[Path, body_argument(metavar="BODY.h5", help="A body file.")]
At = Annotated[
    list[str] | None,
    typer.Option(
        "--at", metavar="NAME=VALUE", help="Values of parameters in SI units, also several; others are nominal."
    ),
]


@app.command(cls=Verb, epilog=example("morembs certify part.h5 --model part.model.h5 --witness part.witness.h5"))
def certify(
    body: Body,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL.h5", help="The model file of the body.")
    ] = None,
    witness: Annotated[Path | None, typer.Option("--witness", metavar="W.h5", help="The file to write.")] = None,
    at: At = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Write the files that a stranger needs to prove the certificates of a body again, or those at values."""
    with messages(), progress_line(quiet):
        if model is None or witness is None:
            raise InputError(
                "certify writes a witness of certificates in a body file, and needs --model MODEL.h5 --witness W.h5; "
                "to certify bodies take the table [certify] of their job, with band_hz = [0, 2000]: morembs reduce "
                "JOB.toml"
            )
        # Not at the top: help needs no numbers.
        from morembs.app.jobs.witness import witness_at_values, witness_of_file

        values = _values(at)
        made = witness_at_values(body, model, witness, values) if values else witness_of_file(body, model, witness)
        written = [str(made)]
        with printing(written):
            if as_json:
                print_json([{"file": str(body), "model": str(model), "written": written}])
            else:
                here = "".join(f" --at {name}={value!r}" for name, value in values.items())
                echo(f"written: {witness}; to verify: morembs verify {body} {model} {witness}{here}")


@app.command(cls=Verb, epilog=example("morembs verify part.h5 part.model.h5 part.witness.h5"))
def verify(
    body: Body,
    model: Annotated[Path, typer.Argument(metavar="MODEL.h5", help="Its model file.", show_default=False)],
    witness: Annotated[Path, typer.Argument(metavar="W.h5", help="The witness.", show_default=False)],
    at: At = None,
) -> None:
    """Prove the certificates of a body again, by a program of its own; exit code 1 if they are not proven."""
    from morembs.certificate import morembs_verify

    values = [part for each in at or [] for part in ("--at", each)]
    raise typer.Exit(morembs_verify.main([str(body), str(model), str(witness), *values]))


def _values(at: list[str] | None) -> dict[str, float]:
    return values_of(",".join(at or []))
