"""``python -m morembs`` is the command ``morembs``."""

from morembs.app.cli import console

console()
