"""MDF4 files of other tools, read by asammdf, and refused before it stumbles over them."""

from __future__ import annotations

import gc
import io
import logging
import os
import struct
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.errors import UnusableInputError
from hilbench.results.text_table import EXPECTED_FORMATS, check_unpacked, short_reason
from hilbench.topology.signal_kinds import TIME

#: The most that deflate can shrink data (RFC 1951: 258 bytes by two bits), and a little.
_DEFLATE_MOST = 1040
#: Bytes of all texts that are unpacked, at most.
_MOST_TEXT = 1_000_000_000
_HEAD_BYTES = 64 + 104  # identification block and header block (ASAM MDF 4: IDBLOCK, HDBLOCK)


#: Channels of a file by name, (n,) each, the time first; their units; when it was begun, and its comment.
MdfChannels = tuple[dict[str, NDArray[Any]], dict[str, str], datetime, str]


def read_mdf(path: Path) -> MdfChannels:
    """Channels of numbers of an MDF4 file, over one time base. Raises UnusableInputError."""
    _check_head(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import asammdf  # takes half a second
    with _tracebacks_dropped():
        try:
            with asammdf.MDF(path) as mdf:
                _check_blocks(mdf, path)
                return _channels(mdf, path)
        except (UnusableInputError, MemoryError):
            raise
        except Exception as error:  # asammdf raises whatever its parser stumbles over: struct.error, KeyError, …
            found = short_reason(error)
        gc.collect()  # what it had half made
    raise UnusableInputError(path, f"not a readable MDF4 file ({found})")


@contextmanager
def _tracebacks_dropped() -> Iterator[None]:
    """Suppress the tracebacks that asammdf prints of a damaged file: on standard output, by its logger, and when
    half-made objects are let go."""
    logger, hook = logging.getLogger("asammdf"), sys.unraisablehook
    logger.disabled, disabled = True, logger.disabled
    sys.unraisablehook = lambda _: None
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.disabled, sys.unraisablehook = disabled, hook


def _check_head(path: Path) -> None:
    """Refuse early what the library's destructor would answer with a traceback on standard error."""
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD_BYTES)
            size = os.fstat(file.fileno()).st_size
    except OSError as error:
        raise UnusableInputError(path, f"cannot be read ({error.strerror}), {EXPECTED_FORMATS}") from error
    if not head.startswith(b"MDF     4.") or len(head) < _HEAD_BYTES:
        raise UnusableInputError(path, f"not an MDF file of version 4, {EXPECTED_FORMATS}")
    if any(link >= size for link in struct.unpack_from("<6Q", head, 64 + 24)):  # links of the header block
        raise UnusableInputError(path, f"cut off after {size} bytes, expected a whole MDF file")
    _check_lists(path, struct.unpack_from("<2Q", head, 64 + 24))


def _check_lists(path: Path, first: Sequence[int]) -> None:
    """Refuse lists of blocks that never end: the library follows a block's first link for ever.

    `first`: the first data group and the first entry of the file history. Data groups lead to channel groups, and these
    to channels, by their second link.
    """
    seen: set[int] = set()
    waiting = list(first)
    size = path.stat().st_size
    with open(path, "rb") as file:
        while waiting:
            address = waiting.pop()
            if address == 0:
                continue
            if address in seen:
                raise UnusableInputError(
                    path, f"a list of blocks comes back to byte {address}, expected a whole MDF file"
                )
            seen.add(address)
            if address >= size:
                continue  # the library says what is missing
            file.seek(address)
            block = file.read(24 + 16)
            if len(block) == 24 + 16:
                following, inner = struct.unpack_from("<2Q", block, 24)
                waiting += [following, inner] if block[:4] in (b"##DG", b"##CG") else [following]


def _check_blocks(mdf: Any, path: Path) -> None:
    """Refuse sizes that can't be: the library's compiled part takes them as they are, and reads and writes by them."""
    size = path.stat().st_size
    check_unpacked(sum(group.channel_group.cycles_nr * len(group.channels) for group in mdf.groups), path)
    texts = sum(block.original_size for group in mdf.groups for kept in group.signal_data for block in kept or ())
    if texts > _MOST_TEXT:
        raise UnusableInputError(
            path, f"texts of {texts / 1e6:.0f} MB when unpacked, expected at most {_MOST_TEXT / 1e6:.0f} MB"
        )
    for group in mdf.groups:
        info = group.channel_group
        record_bytes = info.samples_byte_nr + info.invalidation_bytes_nr
        blocks = list(group.get_data_blocks())
        if any(
            block.address + block.compressed_size > size or block.original_size > _DEFLATE_MOST * block.compressed_size
            for block in blocks
        ):
            raise UnusableInputError(path, "a data block is larger than the file, expected a whole MDF file")
        if sum(block.original_size for block in blocks) != info.cycles_nr * record_bytes:
            raise UnusableInputError(
                path, f"the data are not those of {info.cycles_nr} samples, expected a whole MDF file"
            )
        for channel in group.channels:
            if channel.byte_offset + (channel.bit_offset + channel.bit_count + 7) // 8 > record_bytes:
                raise UnusableInputError(
                    path, f"channel {channel.name} is outside its record, expected a whole MDF file"
                )


def _channels(mdf: Any, path: Path) -> MdfChannels:
    channels: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for signal in mdf.iter_channels(skip_master=True):
        if signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiu":
            continue  # text and structures are no channels of ours
        if TIME not in channels:
            channels[TIME] = np.array(signal.timestamps, np.float64)
        elif not np.array_equal(channels[TIME], signal.timestamps):
            raise UnusableInputError(path, f"channel {signal.name} has a time base of its own, expected one for all")
        if signal.name in channels and signal.name != TIME:
            raise UnusableInputError(path, f"channel {signal.name} is there twice, expected once")
        if signal.name != TIME:
            channels[signal.name] = np.array(signal.samples)
            units[signal.name] = signal.unit
    return channels, units, mdf.start_time.astimezone(UTC), mdf.header.description or ""
