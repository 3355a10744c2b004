"""The command line."""

from morembs.cli.commands import app, main

__all__ = ["app", "main"]
