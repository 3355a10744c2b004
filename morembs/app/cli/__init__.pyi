from .commands import app
from .entry import console, main

__all__ = ["app", "console", "main"]
