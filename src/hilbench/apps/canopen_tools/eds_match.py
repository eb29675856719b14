"""EDS file of a device by vendor-ID and product code (1018h)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hilbench.canopen import eds
from hilbench.canopen.sdo_client import SdoClient
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from canopen import ObjectDictionary

_SUFFIXES = (".eds", ".dcf")
_VENDOR, _PRODUCT, _REVISION = 0, 1, 2


@dataclass(frozen=True)
class EdsFile:
    """An EDS file and its values for vendor id, product code and revision (none: not given)."""

    path: Path
    identity: tuple[frozenset[int], ...]

    def fits(self, found: tuple[int | None, ...]) -> bool:
        """True if vendor-ID and product code are a device's; what the file leaves open the device has as 0."""
        values = zip((_VENDOR, _PRODUCT), found, strict=False)
        return bool(self.identity[_PRODUCT]) and all(value in (self.identity[at] or {0}) for at, value in values)

    def is_of_revision(self, revision: int | None) -> bool:
        """True if the file is of this revision, or does not state one."""
        return not self.identity[_REVISION] or revision in self.identity[_REVISION]


def identity(od: ObjectDictionary) -> tuple[frozenset[int], ...]:
    """Vendor id, product code and revision: for each, what [DeviceInfo] and 1018h give (0 means none)."""
    device = od.device_information
    header = (device.vendor_number, device.product_number, device.revision_number)
    return tuple(
        frozenset(value for value in (given, default(od, 0x1018, sub)) if value) for sub, given in enumerate(header, 1)
    )


def default(od: ObjectDictionary, index: int, sub: int) -> int | None:
    """The default value that a file gives an object; None: none, or no number."""
    try:
        value = eds.variable(od, index, sub).default
    except KeyError:
        return None
    return int(value) if isinstance(value, int) else None


def eds_files(folder: Path, left_out: Callable[[UnusableInputError], None]) -> list[EdsFile]:
    """EDS and DCF files of a folder, by name; `left_out` is called for those that cannot be used."""
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.suffix.lower() in _SUFFIXES:
            try:
                found.append(EdsFile(path, identity(eds.load_eds(path, 1))))
            except UnusableInputError as error:
                left_out(error)
    return found


def fitting(files: Iterable[EdsFile], found: tuple[int | None, ...]) -> list[EdsFile]:
    """The files that fit a device of this identity: those of its revision before any other."""
    return sorted((f for f in files if f.fits(found)), key=lambda file: not file.is_of_revision(found[_REVISION]))


def read_identity(reader: SdoClient, node_id: int) -> tuple[int | None, ...]:
    """Vendor-ID, product code, revision and serial number (1018h:1 to 4); None for what it does not have."""
    answers = (reader.read(node_id, 0x1018, sub) for sub in (1, 2, 3, 4))
    return tuple(int.from_bytes(answer, "little") if isinstance(answer, bytes) else None for answer in answers)
