"""Warnings of Python as this program says its own: one line on standard error, no place in anybody's code."""

from __future__ import annotations

import sys
import warnings
from contextlib import suppress
from pathlib import Path
from typing import TextIO

# What NumPy says of floating-point numbers helps nobody at a command: results are checked for being finite, by name.
_FLOATING_POINT = r".* encountered in "


def speak_plainly() -> None:
    """Say warnings plainly from now on; with the option -W of Python they stay as Python shows them."""
    if sys.warnoptions:
        return
    warnings.filterwarnings("ignore", _FLOATING_POINT, RuntimeWarning)
    warnings.showwarning = _say


def _say(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """The words of a warning and the package that they come from, where it is another one."""
    parts = Path(filename).with_suffix("").parts
    after = parts[parts.index("site-packages") + 1 :] if "site-packages" in parts else ()
    source = f"{after[0]}: " if after and after[0] != __package__ else ""
    stream = sys.stderr if file is None else file
    # Where that cannot be written there is nobody to tell.
    with suppress(OSError, ValueError):
        if stream is not None:
            stream.write(f"warning: {source}{' '.join(str(message).split())}\n")
