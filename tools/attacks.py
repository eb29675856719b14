"""Malformed files, and clients that mean no good, against the readers, the page and the gateway of hilbench.

    python tools/attacks.py            prints the table
    python tools/attacks.py --write    writes docs/tables/attacks.csv, and a summary into docs/fault_tests.md

A file is read by a command of its own: what holds is an exit code of its kind, a line or two that say what is wrong,
and memory that is bounded. Page and gateway hold when another client is served afterwards as before, without a
traceback and without memory that stays. Exit code 1 when something did not hold.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, Final

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import docs_page  # noqa: E402
from tests import test_size_limits as made  # noqa: E402
from tests.bench.whole_runs import config  # noqa: E402
from tests.pages.page_server import Server  # noqa: E402
from tests.pages.test_bounds import Site  # noqa: E402

HILBENCH: Final = [sys.executable, "-m", "hilbench"]
#: What a command may take, MB and s, lines that it may say; memory from which on it is shown.
MOST_MB, MOST_S, MOST_LINES, SHOWN_MB = 1500, 120, 3, 300
#: What a server may have more afterwards, MB.
MOST_KEPT_MB: Final = 100
VIEWERS: Final = 150
REQUESTS: Final = 500


@dataclass(frozen=True)
class Tried:
    """An attack, what came of it, and whether hilbench held."""

    on: str
    attack: str
    came: str
    held: bool


def text(content: str | bytes) -> Callable[[Path], None]:
    """Writes just this."""

    def write(path: Path) -> None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return write


def halved(write: Callable[[Path], None]) -> Callable[[Path], None]:
    """The first half of such a file."""

    def cut(path: Path) -> None:
        write(path)
        data = path.read_bytes()
        path.write_bytes(data[: len(data) // 2])

    return cut


def shipped(name: str, old: str, new: str) -> Callable[[Path], None]:
    """A file of ours with another text in it."""
    found = (ROOT / name).read_text(encoding="utf-8")
    assert old in found
    return text(found.replace(old, new, 1))


#: Command, name of the file, attack, and who writes it.
SERVO = "eds/hilbench_servo.eds"
FILES: Final[tuple[tuple[str, str, str, Callable[[Path], None]], ...]] = (
    ("check", "a.yaml", "aliases of aliases, 9^9 values", made.laughs),
    ("check", "a.yaml", "the same as a key", made.laughing_key),
    ("check", "a.yaml", "includes fanned out, 20^8", made.fan),
    ("check", "a.yaml", "20 MB in a line", made.large),
    ("check", "a.yaml", "100,000 brackets", text("[" * 100_000)),
    ("check", "a.yaml", "a tag that makes an object", text("name: !!python/object/apply:os.system ['true']\n")),
    ("check", "a.yaml", "a number of 5,000 digits", text(f"seed: {'9' * 5000}\n")),
    ("check", "a.yaml", "zero bytes", text(bytes(10_000))),
    ("check", "a.yaml", "a device as a file to include", text("include: /dev/zero\n")),
    ("simulate-drive", "a.eds", "CompactSubObj=4294967295", made.compact(4_294_967_295)),
    ("simulate-drive", "a.eds", "254,000 objects", made.compact(254, 1000)),
    ("simulate-drive", "a.eds", "a limit of 5,000 digits", shipped(SERVO, "HighLimit=", f"HighLimit={'9' * 5000}")),
    ("convert", "a.csv", "10^6 columns", made.wide),
    ("convert", "a.csv", "numbers of 400 digits", text("t_s,a\n" + f"{'9' * 400},1\n" * 10)),
    ("convert", "a.csv.gz", "600 MB unpacked", made.packed_text),
    ("convert", "a.csv.gz", "the half of that", halved(made.packed_text)),
    ("convert", "a.parquet", "9 GB unpacked", made.columns_of_nothing),
    ("convert", "a.parquet", "the half of that", halved(made.columns_of_nothing)),
    ("convert", "a.mf4", "a block that is there 125,025 times", made.one_block_many_times),
    ("convert", "a.mf4", "the half of that", halved(made.one_block_many_times)),
    ("convert", "a.blf", "200 MB in a container", made.one_large_container),
    ("convert", "a.log", "a line of 20 MB", made.large),
    ("convert", "a.mf4", "a pipe that nobody writes to", os.mkfifo),
    ("convert", "a.log", "a pipe that nobody writes to", os.mkfifo),
    ("check", "a.fmu", "1.1 GB unpacked", made.unpacked("binaries/a.so")),
    ("check", "a.fmu", "a modelDescription.xml of 1.1 GB", made.unpacked("modelDescription.xml")),
)


def words_of(command: str, path: Path) -> list[str]:
    """The command line that reads a file."""
    if command == "convert":
        target = "b.asc" if path.suffix in (".log", ".blf") else "b.log" if path.suffix == ".asc" else "b.csv"
        return ["convert", str(path), str(path.with_name(target))]
    if command == "simulate-drive":
        return [command, str(path), "--node", "5", "--bus", f"embedded:attack{os.getpid()}"]
    if path.suffix == ".fmu":
        given = {"file": path, "torques": "[T]", "positions": "[x, y]"}
        sets = [f"--set=load.fmu.{key}={value}" for key, value in given.items()]
        return [command, str(ROOT / "bench_configs" / "web_section_step.yaml"), *sets]
    return [command, str(path)]


def read(command: str, name: str, attack: str, write: Callable[[Path], None]) -> Tried:
    """A file, read by a command."""
    with TemporaryDirectory(prefix="attack-") as folder:
        path = Path(folder, name)
        writer = get_context("fork").Process(target=write, args=(path,))  # what it takes would count as the command's
        writer.start()
        writer.join()
        with open(Path(folder, "said"), "w+", errors="replace") as said:
            process = subprocess.Popen(
                ["timeout", str(MOST_S), *HILBENCH, *words_of(command, path)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            said.seek(0)
            lines = said.read().replace(f"{folder}/", "").replace(f"{ROOT}/", "").splitlines()
    memory_mb = used.ru_maxrss / 1024
    what = lines[-1].removeprefix("hilbench: ") if lines else "nothing said"
    held = process.returncode in (0, 1, 2) and len(lines) <= MOST_LINES and "unexpected" not in what
    came = f"exit {process.returncode}{f', {memory_mb:.0f} MB' if memory_mb > SHOWN_MB else ''}: {what}"
    return Tried(f"{command} {name}", attack, came, held and memory_mb < MOST_MB)


def hold_silent(site: Site, stack: ExitStack) -> None:
    """Connections without a token that say nothing."""
    for _ in range(VIEWERS):
        with suppress(OSError):
            stack.enter_context(socket.create_connection(site.at, timeout=5))


def send_raw(data: bytes) -> Callable[[Site, ExitStack], None]:
    """A connection that sends this and leaves."""

    def send(site: Site, _: ExitStack) -> None:
        with suppress(OSError), socket.create_connection(site.at, timeout=5) as connection:
            connection.sendall(data)
            connection.recv(100)

    return send


def ask_unread(site: Site, stack: ExitStack) -> None:
    """A viewer who asks, and reads no answer."""
    viewer = stack.enter_context(site.viewer())
    with suppress(Exception):  # the server may end it
        for number in range(REQUESTS):
            viewer.send(json.dumps({"do": "past", "from_s": 0.0, "to_s": 10.0, "number": number}))


def talk(message: str | bytes) -> Callable[[Site, ExitStack], None]:
    """A viewer who says this."""

    def say(site: Site, stack: ExitStack) -> None:
        stack.enter_context(site.viewer()).send(message)

    return say


VIEWERS_DO: Final[tuple[tuple[str, Callable[[Site, ExitStack], None]], ...]] = (
    (f"{VIEWERS} connections without a token, silent", hold_silent),
    ("a head of 1 MB", send_raw(b"GET / HTTP/1.1\r\nX: " + b"x" * 1_000_000)),
    ("a port of 5,000 digits", send_raw(b"GET / HTTP/1.1\r\nHost: a:" + b"9" * 5000 + b"\r\n\r\n")),
    ("no HTTP", send_raw(bytes(range(256)) * 40)),
    (f"{REQUESTS} requests of a viewer who reads none", ask_unread),
    ("4,090 brackets", talk("[" * 4090)),
    ("a number of 5,000 digits", talk(f'{{"number": {"9" * 5000}}}')),
    ("bytes in place of text", talk(bytes(range(256)))),
    ("a message of 5 MB", talk("x" * 5_000_000)),
)


def memory_mb(pid: int) -> float:
    """Resident, of a process."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    return int(found[1]) / 1024 if found else 0.0


def visit() -> Iterator[Tried]:
    """Viewers of the page of a bench that does not run."""
    with TemporaryDirectory(prefix="attack-") as folder:
        server = Server(config(Path(folder)))
        try:
            site = Site(server.address)
            site.session()
            for attack, act in VIEWERS_DO:
                before_mb = memory_mb(server.process.pid)
                with ExitStack() as stack, suppress(Exception):  # how it is refused is the server's to choose
                    act(site, stack)
                more_mb = memory_mb(server.process.pid) - before_mb
                serves = False
                with suppress(Exception):
                    serves = bool(site.session())
                came = (
                    f"{'another viewer is served' if serves else 'nobody is served'}, {max(more_mb, 0.0):.0f} MB more"
                )
                yield Tried("page", attack, came, serves and more_mb < MOST_KEPT_MB)
        finally:
            server.end()


LINES: Final[tuple[tuple[str, bytes], ...]] = (
    ("an index of 4,300 digits", b"[1] 5 read 0x" + b"9" * 4300 + b" 0 u32\r\n"),
    ("a value of 4,300 digits", b"[1] 5 write 0x1017 0 u16 " + b"9" * 4300 + b"\r\n"),
    ("a sequence number of 4,300 digits", b"[" + b"9" * 4300 + b"] 5 read 0x1000 0 u32\r\n"),
    ("a line of 1 MB without an end", b"[1] " + b"x" * 1_000_000),
    ("no text", bytes(range(256)) * 40 + b"\r\n"),
)


@contextmanager
def gateway() -> Iterator[int]:
    """Its port."""
    command = [*HILBENCH, "gateway", "--bus", f"embedded:attack{os.getpid()}", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        out: IO[Any] = process.stdout  # type: ignore[assignment]
        found = re.search(r"127\.0\.0\.1:(\d+)", out.readline())
        assert found is not None
        try:
            yield int(found[1])
        finally:
            process.terminate()


def request() -> Iterator[Tried]:
    """Clients of a gateway to a bus without devices."""
    with gateway() as port:
        for attack, line in LINES:
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5) as client:
                client.sendall(line)
                said = client.recv(200).decode(errors="replace").split("\n")[0].strip() or "the connection is closed"
            with socket.create_connection(("127.0.0.1", port), timeout=5) as other:
                other.sendall(b"[7] info version\r\n")
                serves = other.recv(200).startswith(b"[7] ")
            yield Tried("gateway", attack, f"{said[:60]}; {'others are served' if serves else 'nobody is'}", serves)


def cells(tried: Tried) -> list[str]:
    """A row of the table."""
    came = tried.came if len(tried.came) <= 170 else f"{tried.came[:169]}…"
    return [tried.on, tried.attack, came, "✓" if tried.held else "✗"]


def summary(rows: list[docs_page.Row]) -> str:
    """Attacks by what they are on, and the most memory that a file took."""
    found = []
    for on in dict.fromkeys(row["on"].split()[0] for row in rows):
        of = [row for row in rows if row["on"].split()[0] == on]
        memory = [int(size) for row in of for size in re.findall(r"(\d+) MB(?=:| more)", row["what came"])]
        held = sum(row["held"] == "✓" for row in of)
        shown = f"{max(memory)} MB" if memory else "–"
        found.append((f"`{on}`" if of[0]["on"] != on else on, str(len(of)), str(held), shown))
    return docs_page.markdown(("on", "attacks", "held", "most memory"), found)


TABLE: Final = docs_page.Table("attacks", "fault_tests.md", ("on", "attack", "what came", "held"), summary)


def main() -> None:
    """Try all, print, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write docs/tables/attacks.csv and docs/fault_tests.md")
    write = parser.parse_args().write
    tried = []
    for each in chain((read(*row) for row in FILES), visit(), request()):
        tried.append(each)
        print(f"{'held' if each.held else 'FAILED':7}{each.on}: {each.attack}: {each.came}", flush=True)
    if write:
        TABLE.write(map(cells, tried))
    sys.exit(not all(each.held for each in tried))


if __name__ == "__main__":
    main()
