"""Protocol between hub and clients of the embedded bus, and its socket paths.

One SOCK_SEQPACKET socket per channel, `<directory>/<channel>.sock`. A connection begins with requests: a packet of
JSON, answered by a packet of JSON ({"error": text} when refused). The request "join" makes the connection a station;
from then on its packets carry frames: a header of 8 bytes (kind, frames lost for this receiver so far), then records.
To the hub a record is a `struct can_frame` (or `struct canfd_frame`, kind FD); from the hub
it is followed by the time of reception, int64 ns. All in the machine's byte order, as in the kernel.
"""

from __future__ import annotations

import os
import re
import socket
import stat
import struct
from pathlib import Path

from hilbench.errors import BusError

VERSION = 1

KIND_CLASSICAL = 1
KIND_FD = 2

#: kind, frames dropped for this receiver (modulo 2**32)
HEADER = struct.Struct("=B3xI")
#: struct can_frame: identifier and flags, length, flags (see OWN), data
CAN_RECORD = struct.Struct("=IBB2x8s")
#: struct canfd_frame: the same with 64 bytes
FD_RECORD = struct.Struct("=IBB2x64s")
STAMP = struct.Struct("=q")
STAMPED_CAN_RECORD = struct.Struct("=IBB2x8sq")
STAMPED_FD_RECORD = struct.Struct("=IBB2x64sq")

#: Flag byte: CANFD_BRS and CANFD_ESI of <linux/can.h>, and ours: this receiver sent the frame itself.
BIT_RATE_SWITCH = 0x01
OWN = 0x80

#: Most records in one packet from a client.
MAX_RECORDS = 128
PACKET_BYTES = 1 << 16

DEFAULT_CHANNEL = "hilbench0"
DEFAULT_BITRATE = 1_000_000
DEFAULT_DATA_BITRATE = 2_000_000
_CHANNEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,47}")
_SUN_PATH_BYTES = 108


def directory() -> Path:
    """The per-user directory of the sockets; made if need be. Raises BusError unless only its user can enter it."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(runtime, "hilbench") if runtime and os.path.isdir(runtime) else Path(f"/tmp/hilbench-{os.getuid()}")
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        status = path.lstat()
    except OSError as error:
        raise BusError(f"{path}: {error.strerror}, expected a directory for the embedded bus' sockets") from None
    if not stat.S_ISDIR(status.st_mode):
        raise BusError(f"{path}: found something else, expected a directory for the embedded bus' sockets")
    if status.st_uid != os.getuid():
        raise BusError(f"{path}: belongs to user {status.st_uid}, expected user {os.getuid()}")
    if status.st_mode & 0o077:
        raise BusError(f"{path}: mode is {stat.S_IMODE(status.st_mode):04o}, expected 0700")
    return path


def is_channel(text: str) -> bool:
    """True if a bus can have this name: a name, or the whole path of a hub's socket."""
    return bool(_CHANNEL.fullmatch(text)) or is_path(text)


def is_path(channel: str) -> bool:
    """True if a channel is the path of a socket: of a hub in another runtime directory than this program's."""
    return channel.startswith("/") and channel.endswith(".sock") and channel.isprintable()


def socket_path(channel: str) -> Path:
    """Socket on which the hub of `channel` listens. Raises BusError for a name that cannot be a channel."""
    if not is_channel(channel):
        raise BusError(f"embedded bus: channel {channel!r}, expected up to 48 letters, digits, '_', '-' or '.'")
    path = Path(channel) if is_path(channel) else directory() / f"{channel}.sock"
    if len(os.fsencode(path)) >= _SUN_PATH_BYTES:
        raise BusError(f"{path}: too long for a socket, expected a shorter XDG_RUNTIME_DIR")
    return path


def lock_path(folder: Path) -> Path:
    """File whose lock (flock) is held while a hub is started or ends."""
    return folder / ".lock"


def log_path(folder: Path, channel: str) -> Path:
    """File with the error output of a failed hub."""
    return folder / f"{channel}.log"


def peer(connection: socket.socket) -> tuple[int, int]:
    """Process and user id at the other end (SO_PEERCRED: as the kernel saw it connect or listen)."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("=iII"))
    pid, uid, _gid = struct.unpack("=iII", credentials)
    return int(pid), int(uid)


def peer_user(connection: socket.socket) -> int:
    """User id of the process at the other end."""
    return peer(connection)[1]


def may_join(connection: socket.socket) -> bool:
    """True if the process that has connected may be on this user's bus: the same user, or root, who stops every bus."""
    return peer_user(connection) in (os.getuid(), 0)


def may_trust(connection: socket.socket) -> bool:
    """True if we may join the bus of the process that listens: our own, or as root any."""
    return os.getuid() in (peer_user(connection), 0)
