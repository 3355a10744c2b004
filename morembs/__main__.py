"""``python -m morembs`` is the command ``morembs``."""

from morembs.cli import console

console()
