"""Limits and block sizes of HDF5 files."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StorageTolerances:
    """Quantities that decide, each with the line that derives or cites it."""

    # Bytes of a dataset that are in memory at a time.
    block_bytes: int = 1 << 24
    # Rows of a chunk, at most: HDF5 allows 4 GiB, 16 bytes of each complex number.
    chunk_rows: int = 2**32 // 16
    # Bytes over those in the file that a dataset may announce: deflate packs 1032 to 1 at best.
    largest_compression: int = 1100
    # Bytes below which nobody asks.
    small_bytes: int = 1 << 20
    # Bytes over those in the file of data that differ; what is packed tighter must fit into the free memory together.
    usual_compression: int = 100
    # Nanoseconds by which times of files are coarse on some disks (2 s on FAT): a younger file may have changed
    # without a new time.
    coarse_time_ns: int = 2_000_000_000


TOL = StorageTolerances()
