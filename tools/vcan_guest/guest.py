"""Run a command in a virtual machine whose kernel has CAN: guest.py [--limit S] [--take PATH] COMMAND...

For machines whose own kernel has none (containers, many CI runners). The guest is QEMU in software emulation with
Debian's kernel; the host's root file system is its own, read-only. In it are a `vcan0` and two emulated SJA1000
controllers on one wire, `can0` and `can1`, at 1 Mbit/s. What is needed comes from Debian's packages, once.

The guest's clock follows its instructions (-icount: one is 1 ns, and waiting takes no time), so that nothing in it
depends on what else the host does: time-outs and jitter repeat. Python, the virtual environment and the checkout are in
its memory, because the clock goes on while a file is waited for. What numba compiles is compiled on the host, for no
processor in particular (COMPILED, which is in the environment of the command).

The exit status is the command's; 124 when its time limit ended it, 125 when the guest gave no status. The limit is of
the guest's time: a host that does other work besides takes longer, and the guest has done no more. A guest that shows
no sign of life is ended as well.
"""

from __future__ import annotations

import argparse
import gzip
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CACHE = ROOT / ".cache" / "vcan-guest"
IMAGE, INITRD, CHECKOUT_ARCHIVE = CACHE / "vmlinuz", CACHE / "initrd.gz", CACHE / "checkout.tar"
#: The initial file system that a guest gets: Python and the virtual environment, then INITRD.
MEMORY = CACHE / "memory.img"
KERNEL = CACHE / "kernel"  #: its package, unpacked
#: Machine code that host and guest share.
NUMBA_CACHE = CACHE / "numba"
COMPILED = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": "", "NUMBA_CACHE_DIR": str(NUMBA_CACHE)}
#: What of the checkout is in the guest's memory, and what of Python is not, because nothing there imports it.
CHECKOUT = ("src", "tests", "tools", "eds", "bench_configs", "docs/ci.md", "pyproject.toml", ".cache/node-canopen")
NOT_IN_LIBRARY = ("*/site-packages", "*/dist-packages", "*/test", "*/config-*", "*/idlelib")
NOT_IN_ENVIRONMENT = [
    *("*/bin/ruff", "*/scipy/*/tests", "*/pandas/tests", "*/numba/tests", "*/numba/cuda/tests"),
    *(
        f"*/site-packages/{name}"
        for name in (
            "cmake",
            "dask",
            "distributed",
            "fmpy",
            "foxglove",
            "grimp",
            "lxml",
            "mkdocs",
            "mypy",
            "mypyc",
            "pip",
            "playwright",
            "pyarrow",
            "scipy-stubs",
            "setuptools",
            "textual",
            "xarray",
        )
    ),
]
PACKAGES = ("qemu-system-x86", "seabios", "busybox-static", "can-utils", "iproute2", "kmod", "cpio")
#: In the order in which they are loaded; what the kernel has built in is not there as a file and is passed over.
MODULES = [
    "virtio_ring",
    "virtio",
    "virtio_pci_legacy_dev",
    "virtio_pci_modern_dev",
    "virtio_pci",
    "netfs",
    "fscache",
    "9pnet",
    "9pnet_virtio",
    "9p",
    "can",
    "can-raw",
    "can-bcm",
    "can-dev",
    "vcan",
    "sja1000",
    "kvaser_pci",
]
NO_STATUS, _TIMED_OUT = 125, 124
#: The guest writes its time into `alive` so often (s of its time); that long on the host without it is a guest that
#: hangs, on a host with ten times the work that it has cores for as well.
ALIVE_EVERY_S, SILENT_S = 5, 1800.0
#: How often the host looks.
LOOK_S = 1.0
#: After so long without a word on the console the host says how far the guest is.
WORDS_EVERY_S = 60.0
#: What a BIOS and a coloured output tell a terminal.
_TERMINAL = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|c)|\r")


def run(*command: str | Path, **options: object) -> None:
    """Run a command; its failure is ours."""
    subprocess.run([str(word) for word in command], check=True, **options)  # type: ignore[call-overload]


def say(text: str, who: str = "vcan guest") -> None:
    """A line for whoever waits."""
    print(f"{who}: {text}", flush=True)


def install_packages() -> None:
    """Install what is missing of the packages, by sudo where this is not root."""
    missing = [
        name
        for name in PACKAGES
        if subprocess.run(["dpkg", "-s", name], capture_output=True, check=False).returncode != 0
    ]
    if missing:
        say(f"install {', '.join(missing)}")
        as_root = [] if os.geteuid() == 0 else ["sudo"]
        apt = [*as_root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", "-qq"]
        run(*apt, "update")
        run(*apt, "install", "--yes", "--no-install-recommends", *missing)


def provide_kernel() -> None:
    """Kernel image and initial file system, unpacked and built once."""
    newest = max((HERE / name).stat().st_mtime for name in ("init", "guest.py"))
    if not IMAGE.exists():
        say("fetch Debian's kernel")
        CACHE.mkdir(parents=True, exist_ok=True)
        depends = subprocess.run(
            ["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True, check=True
        ).stdout
        package = next(word for word in depends.split() if word.startswith("linux-image-") and word[12].isdigit())
        run("apt-get", "download", "-qq", package, cwd=CACHE)
        run("dpkg", "-x", next(CACHE.glob("linux-image-*.deb")), KERNEL)
        shutil.copy(next((KERNEL / "boot").glob("vmlinuz-*")), IMAGE)
    if not INITRD.exists() or INITRD.stat().st_mtime < newest:
        build_initrd()
    [modules] = (KERNEL / "lib" / "modules").iterdir()
    if not (modules / "modules.dep").exists():  # else dpkg makes it, when it installs the package
        run("/sbin/depmod", "-b", KERNEL, modules.name)


def build_initrd() -> None:
    """busybox, the modules in their order, and `init`, as a compressed cpio archive."""
    tree = CACHE / "initrd"
    shutil.rmtree(tree, ignore_errors=True)
    (tree / "bin").mkdir(parents=True)
    (tree / "modules").mkdir()
    shutil.copy("/bin/busybox", tree / "bin" / "busybox")
    shutil.copy(HERE / "init", tree / "init")
    (tree / "init").chmod(0o755)
    files = {path.name.replace("_", "-"): path for path in (KERNEL / "lib" / "modules").rglob("*.ko")}
    for name in MODULES:
        path = files.get(f"{name.replace('_', '-')}.ko")
        if path is not None:
            shutil.copy(path, tree / "modules" / f"{name}.ko")
    (tree / "modules" / "order").write_text("\n".join(MODULES) + "\n")
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    archive = subprocess.run(
        ["cpio", "--quiet", "-o", "-H", "newc"], cwd=tree, input=names.encode(), capture_output=True, check=True
    ).stdout
    INITRD.write_bytes(gzip.compress(archive, 1))


def entries(folder: Path, excluded: Sequence[str]) -> Iterator[Path]:
    """A folder with all folders that it is in, and what is in it but for these patterns; folders before their files."""
    yield from reversed([each for each in (folder, *folder.parents) if each != Path("/")])
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not _matches(Path(place, name), excluded)]
        kept = [name for name in files if not _matches(Path(place, name), excluded)]
        yield from (Path(place, name) for name in (*folders, *kept))


def _matches(path: Path, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(str(path), pattern) for pattern in patterns)


def pack_python() -> None:
    """The standard library and the virtual environment, again when the latter has changed.

    The kernel puts them into memory while it boots: unpacking them there takes it a fraction of what `tar` takes.
    """
    environment = Path(sys.prefix)
    installed = [Path(__file__), INITRD, *environment.glob("lib/python*/site-packages")]
    if MEMORY.exists() and MEMORY.stat().st_mtime >= max(path.stat().st_mtime for path in installed):
        return
    say("pack Python and the virtual environment")
    library = Path(sysconfig.get_path("stdlib"))
    # Each folder once: the two may be in the same one.
    packed = dict.fromkeys((*entries(library, NOT_IN_LIBRARY), *entries(environment, NOT_IN_ENVIRONMENT)))
    names = b"\0".join(os.fsencode(path.relative_to("/")) for path in packed)
    partial = MEMORY.with_suffix(".part")
    with partial.open("wb") as file:
        run("cpio", "--quiet", "-0", "-o", "-H", "newc", cwd="/", input=names, stdout=file)
        file.flush()
        file.seek(0, os.SEEK_END)
        file.write(INITRD.read_bytes())
    partial.rename(MEMORY)


def pack_checkout(others: Sequence[Path]) -> None:
    """The checkout with its byte code, what numba has compiled, and what else the caller wants there.

    With times to the nanosecond, which numba compares. Not with the machine code for this processor.
    """
    say("pack the checkout")
    run(sys.executable, "-m", "compileall", "-q", ROOT / "src", ROOT / "tests")
    partial = CHECKOUT_ARCHIVE.with_suffix(".part")
    paths = [path for path in (*(ROOT / name for name in CHECKOUT), NUMBA_CACHE, *others) if path.exists()]
    words = [path.relative_to("/") for path in paths]
    run("tar", "--format=posix", "-C", "/", "-cf", partial, "--exclude=*/src/hilbench/*.nb[ci]", *words)
    partial.rename(CHECKOUT_ARCHIVE)


def write_command(share: Path, command: Sequence[str]) -> None:
    """The script that the guest runs: the checkout into memory, interfaces up, the command in the checkout."""
    share.mkdir(parents=True, exist_ok=True)
    for name in ("status", "alive"):
        (share / name).unlink(missing_ok=True)
    (share / "checkout").write_text(str(ROOT))
    covered = [shlex.quote(str(path)) for path in (sysconfig.get_path("stdlib"), ROOT)]
    if not Path(sys.prefix).is_relative_to(ROOT):
        covered.append(shlex.quote(sys.prefix))
    (share / "command.sh").write_text(
        "\n".join(
            [
                "export HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
                "export PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1",
                f"while read -r up _ < /proc/uptime; do echo $up > /mnt/share/alive; sleep {ALIVE_EVERY_S}; done &",
                "echo 'up; takes the checkout into its memory'",
                # What modprobe looks for is not on the host.
                f"mkdir /run/kernel && mount --bind {shlex.quote(str(KERNEL))} /run/kernel",
                "export MODPROBE_OPTIONS='-d /run/kernel'",
                f"tar -xf {shlex.quote(str(CHECKOUT_ARCHIVE))} -C /run/files || exit",
                f"for path in {' '.join(covered)}; do mount --bind /run/files$path $path || exit; done",
                "ip link add dev vcan0 type vcan && ip link set vcan0 up txqueuelen 1000",
                "for c in can0 can1; do",
                "    ip link set $c up txqueuelen 1000 type can bitrate 1000000 || echo no $c",
                "done",
                f"cd {shlex.quote(str(ROOT))}",
                "echo 'begins'",
                shlex.join(["env", *(f"{name}={value}" for name, value in COMPILED.items()), *command]),
                "",
            ]
        )
    )


@dataclass
class Watch:
    """Ends a guest that has used its time up, or shows no sign of life; says how far it is while it is silent."""

    name: str
    process: subprocess.Popen[str]
    alive: Path  #: the guest's time, as the guest writes it
    limit_s: float  #: of the guest's time
    word_s: float = field(default_factory=time.monotonic)  #: when the console last said something
    ended: str = ""  #: why the guest was ended
    over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Until `over`."""
        start_s = heard_s = time.monotonic()
        own_s = 0.0
        while not self.over.wait(LOOK_S):
            now_s = time.monotonic()
            before_s, own_s = own_s, self._own_time_s(own_s)
            if own_s != before_s:
                heard_s = now_s
            if own_s > self.limit_s:
                self._end(f"more than {self.limit_s:g} s of its own time, {now_s - start_s:.0f} s here")
            elif now_s - heard_s > SILENT_S:
                self._end(f"no sign of life for {SILENT_S:g} s, after {own_s:.0f} s of its own time")
            if now_s - self.word_s > WORDS_EVERY_S:
                self.word_s = now_s
                say(f"({own_s:.0f} s of its own time in {now_s - start_s:.0f} s)", self.name)

    def _own_time_s(self, otherwise_s: float) -> float:
        try:
            return float(self.alive.read_text())
        except (OSError, ValueError):  # not there yet, or just being written
            return otherwise_s

    def _end(self, why: str) -> None:
        self.ended = self.ended or why
        self.process.kill()


def boot(name: str, command: Sequence[str], limit_s: float) -> int:
    """Boot a guest that `prepare` has provided for, print what its console says, return the status of the command.

    `name` tells guests apart that run at the same time, in the output as well. `limit_s`: of the guest's time.
    """
    share = CACHE / f"guest-{name}"
    write_command(share, command)
    qemu = [
        "setpriv", "--pdeathsig", "KILL",
        "qemu-system-x86_64", "-accel", "tcg,thread=single,tb-size=512", "-smp", "1", "-icount", "shift=0,sleep=off",
        "-m", "2560", "-cpu", "max,-la57",
        "-nographic", "-no-reboot", "-nic", "none", "-kernel", str(IMAGE), "-initrd", str(MEMORY),
        "-append", "console=ttyS0 quiet loglevel=3 panic=-1 mitigations=off tsc=reliable rootfstype=ramfs",
        "-virtfs", "local,path=/,mount_tag=hostroot,security_model=none,readonly=on,multidevs=remap",
        "-virtfs", f"local,path={share},mount_tag=share,security_model=none,multidevs=remap",
        "-object", "can-bus,id=wire", "-device", "kvaser_pci,canbus=wire", "-device", "kvaser_pci,canbus=wire",
    ]  # fmt: skip
    say("boots", name)
    process = subprocess.Popen(qemu, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace")
    watch = Watch(name, process, share / "alive", limit_s)
    watcher = threading.Thread(target=watch.run)
    watcher.start()
    assert process.stdout is not None
    for line in process.stdout:
        said = _TERMINAL.sub("", line).rstrip()
        if said:
            say(said, name)
            watch.word_s = time.monotonic()
    process.wait()
    watch.over.set()
    watcher.join()
    if watch.ended:
        print(f"{name}: ended: {watch.ended}", file=sys.stderr)
        return _TIMED_OUT
    status = share / "status"
    if not status.exists():
        print(f"{name}: ended without a status", file=sys.stderr)
        return NO_STATUS
    return int(status.read_text())


def prepare(others: Sequence[Path] = ()) -> bool:
    """Provide what a guest needs, with `others` of .cache in its memory; False, and said why, when it can't be had."""
    try:
        install_packages()
        provide_kernel()
        pack_python()
        pack_checkout(others)
    except (subprocess.CalledProcessError, OSError) as error:
        print(f"vcan guest: cannot be provisioned: {error}", file=sys.stderr)
        return False
    return True


def main() -> int:
    """Provision, boot, run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=840.0, help="seconds of its own time that the guest may take")
    parser.add_argument("--take", type=Path, action="append", default=[], help="what of .cache is there besides")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    return boot("guest", options.command, options.limit) if prepare(options.take) else NO_STATUS


if __name__ == "__main__":
    sys.exit(main())
