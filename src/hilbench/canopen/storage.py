"""Store and restore parameters, 1010h and 1011h (CiA 301); stored values survive in a file."""

from __future__ import annotations

import json
import os
from functools import partial
from itertools import product
from pathlib import Path

from hilbench.canopen.object_store import CANNOT_STORE, ObjectStore, SdoAbort
from hilbench.errors import UnusableInputError

_SAVE = int.from_bytes(b"save", "little")
_LOAD = int.from_bytes(b"load", "little")
_ON_COMMAND = 1
#: Sub-index → object area it stores: all, communication, application, manufacturer.
_AREAS = {1: (0x1000, 0x9FFF), 2: (0x1000, 0x1FFF), 3: (0x6000, 0x9FFF), 4: (0x2000, 0x5FFF)}
#: Not parameters although writable: commands, error history, and set points that must not act after a reset.
NO_PARAMETERS = {0x1003, 0x1010, 0x1011, 0x6040, 0x6060, 0x6071, 0x607A, 0x60FF}


class Storage:
    """Non-volatile memory of a device; without a path it lasts as long as the object."""

    def __init__(self, store: ObjectStore, path: Path | None) -> None:
        self._store = store
        self._path = path
        self._stored: dict[str, str] = self._read()
        for (sub, area), (index, do) in product(_AREAS.items(), ((0x1010, self._save), (0x1011, self._load))):
            if (index, sub) in store:
                cell = store.cell(index, sub)
                cell.on_write, cell.on_read = partial(do, area), lambda: _ON_COMMAND

    def apply(self, first: int, last: int) -> None:
        """Apply stored values to the objects first to last after a reset, in place of the defaults."""
        for key, text in self._stored.items():
            index, sub = (int(part, 16) for part in key.split(":"))
            if first <= index <= last and (index, sub) in self._store:
                cell = self._store.cell(index, sub)
                try:
                    cell.value = cell.decode(bytes.fromhex(text))
                except SdoAbort as error:
                    raise UnusableInputError(
                        self._path or "stored parameters",
                        f"{key} is '{text}', expected a value of '{cell.variable.name}'",
                    ) from error

    def _save(self, area: tuple[int, int], signature: int) -> None:
        if signature != _SAVE:
            raise SdoAbort(CANNOT_STORE)
        for cell in self._store:
            index, sub = cell.variable.index, cell.variable.subindex
            if (
                area[0] <= index <= area[1]
                and index not in NO_PARAMETERS
                and cell.variable.access_type in ("rw", "rww", "rwr")
            ):
                self._stored[f"{index:04X}:{sub:02X}"] = cell.encode().hex()
        self._write()

    def _load(self, area: tuple[int, int], signature: int) -> None:
        if signature != _LOAD:
            raise SdoAbort(CANNOT_STORE)
        kept = {key: text for key, text in self._stored.items() if not area[0] <= int(key[:4], 16) <= area[1]}
        self._stored = kept
        self._write()

    def _read(self) -> dict[str, str]:
        if self._path is None or not self._path.exists():
            return {}
        try:
            data = json.loads(self._path.read_text(encoding="ascii"))
            return {f"{int(k[:4], 16):04X}:{int(k[5:], 16):02X}": bytes.fromhex(v).hex() for k, v in data.items()}
        except (OSError, ValueError, AttributeError, TypeError) as error:
            raise UnusableInputError(
                self._path, f"no stored parameters ({error}), expected what 1010h wrote"
            ) from error

    def _write(self) -> None:
        if self._path is None:
            return
        try:
            temporary = self._path.with_suffix(".new")
            temporary.write_text(json.dumps(self._stored, indent=0), encoding="ascii")
            os.replace(temporary, self._path)
        except OSError as error:
            raise SdoAbort(CANNOT_STORE) from error
