"""Limits and sizes of what all rooms stand on: values, budgets, processes and messages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class BaseTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # --- Values
    # Size of a load, a speed or a place in SI units: products of four, times a stiffness, are finite numbers.
    largest_value: float = 1e60
    # Frequency (Hz) that no body has: sound of 18 km/s has a wave of a few atoms there.
    largest_hz: float = 1e12

    # --- Budget of memory
    # Bytes of an array below which it is not worth a file.
    array_bytes: int = 16_000_000
    # The same where the budget is nearly used up.
    tight_array_bytes: int = 1_000_000
    # Part of the budget that an array may take in memory before it goes to a file.
    array_share: float = 0.02
    # Part of what is left that one block of columns may take.
    block_share: float = 0.25
    # The same where every block costs as much as a pass over a file, so that blocks are to be wide.
    wide_block_share: float = 0.6
    # Columns of a block, at most.
    most_columns: int = 256
    # Part of the whole budget that columns of an array in a file may take which a product reads at once.
    read_share: float = 0.03
    # Columns that it reads at once, at most.
    most_read_columns: int = 64
    # Part of the budget left below which it is tight.
    tight_share: float = 0.3
    # Bytes of zeros that are written at once where the system cannot reserve space on a disk.
    zeros_at_once: int = 1 << 22
    # Seconds between looks at the resident memory: pages come at a few GB/s at most, so that not many are missed.
    memory_seconds: float = 0.01

    # --- Processes
    # Bytes of an array below which it goes with the message to a process.
    message_bytes: int = 100_000
    # Seconds that idle processes may take to leave.
    leaving_seconds: float = 10.0
    # Bytes of the name of the temporary folder that leave room for the name of a socket: 104 on macOS, less
    # /morembs-12345678/pymp-12345678/listener-12345678 and its end.
    folder_bytes: int = 104 - 49 - 1
    # Seconds within which one request to stop may arrive twice, as from ``timeout``; a later one is a second request.
    same_request_seconds: float = 1.0
    # Seconds after which an exception that was dropped is raised again.
    raise_again_seconds: float = 0.05

    # --- Messages
    # Characters of a value that a message quotes.
    quoted_characters: int = 60
    # Columns of a summary.
    text_columns: int = 100
    # Values that it shows of a list.
    shown_values: int = 3
    # Characters that it shows of a text.
    text_characters: int = 70


TOL = BaseTolerances()
