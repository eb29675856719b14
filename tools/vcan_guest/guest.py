"""Run a command in a virtual machine whose kernel has CAN: guest.py [--limit S] COMMAND...

For machines whose own kernel has none (containers, many CI runners). The guest is QEMU in software emulation with
Debian's kernel; the host's root file system is its own, read-only, so that the checkout and its virtual environment are
there as they are; /mnt/share is writable and stays (.cache/vcan-guest/share). In it are a `vcan0` and two emulated
SJA1000 controllers on one wire, `can0` and `can1`, at 1 Mbit/s. What is needed comes from Debian's packages, once.

The exit status is the command's; 124 when the time limit ended it, 125 when the guest gave no status.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
CACHE = ROOT / ".cache" / "vcan-guest"
SHARE = CACHE / "share"
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
    "can-dev",
    "vcan",
    "sja1000",
    "kvaser_pci",
]
_NO_STATUS, _TIMED_OUT = 125, 124


def run(*command: str | Path, **options: object) -> None:
    """Run a command; its failure is ours."""
    subprocess.run([str(word) for word in command], check=True, **options)  # type: ignore[call-overload]


def install_packages() -> None:
    """Install what is missing of the packages. Needs root."""
    missing = [
        name
        for name in PACKAGES
        if subprocess.run(["dpkg", "-s", name], capture_output=True, check=False).returncode != 0
    ]
    if missing:
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        run("apt-get", "update", "-qq")
        run("apt-get", "install", "-y", "-qq", "--no-install-recommends", *missing, env=environment)


def kernel() -> tuple[Path, Path]:
    """Kernel image and initial file system, unpacked and built once."""
    image, initrd = CACHE / "vmlinuz", CACHE / "initrd.gz"
    newest = max((HERE / name).stat().st_mtime for name in ("init", "guest.py"))
    if not image.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        depends = subprocess.run(
            ["apt-cache", "depends", "linux-image-amd64"], capture_output=True, text=True, check=True
        ).stdout
        package = next(word for word in depends.split() if word.startswith("linux-image-") and word[12].isdigit())
        run("apt-get", "download", "-qq", package, cwd=CACHE)
        run("dpkg", "-x", next(CACHE.glob("linux-image-*.deb")), CACHE / "kernel")
        shutil.copy(next((CACHE / "kernel" / "boot").glob("vmlinuz-*")), image)
    if not initrd.exists() or initrd.stat().st_mtime < newest:
        build_initrd(initrd)
    return image, initrd


def build_initrd(initrd: Path) -> None:
    """busybox, the modules in their order, and `init`, as a compressed cpio archive."""
    tree = CACHE / "initrd"
    shutil.rmtree(tree, ignore_errors=True)
    (tree / "bin").mkdir(parents=True)
    (tree / "modules").mkdir()
    shutil.copy("/bin/busybox", tree / "bin" / "busybox")
    shutil.copy(HERE / "init", tree / "init")
    (tree / "init").chmod(0o755)
    files = {path.name.replace("_", "-"): path for path in (CACHE / "kernel" / "lib" / "modules").rglob("*.ko")}
    for name in MODULES:
        path = files.get(f"{name.replace('_', '-')}.ko")
        if path is not None:
            shutil.copy(path, tree / "modules" / f"{name}.ko")
    (tree / "modules" / "order").write_text("\n".join(MODULES) + "\n")
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    archive = subprocess.run(
        ["cpio", "--quiet", "-o", "-H", "newc"], cwd=tree, input=names.encode(), capture_output=True, check=True
    ).stdout
    initrd.write_bytes(gzip.compress(archive, 1))


def write_command(command: list[str]) -> None:
    """The script that the guest runs in the checkout."""
    SHARE.mkdir(parents=True, exist_ok=True)
    (SHARE / "status").unlink(missing_ok=True)
    (SHARE / "checkout").write_text(str(ROOT))
    (SHARE / "command.sh").write_text(
        "\n".join(
            [
                "export HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
                "export XDG_CACHE_HOME=/mnt/share/cache PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1",
                "ip link add dev vcan0 type vcan && ip link set vcan0 up txqueuelen 1000",
                "for c in can0 can1; do",
                "    ip link set $c up txqueuelen 1000 type can bitrate 1000000 || echo no $c",
                "done",
                f"cd {shlex.quote(str(ROOT))}",
                shlex.join(command),
                "",
            ]
        )
    )


def boot(image: Path, initrd: Path, limit_s: float) -> int:
    """Boot the guest, stream its console, and return the status that the command left."""
    qemu = [
        "qemu-system-x86_64", "-accel", "tcg,thread=multi", "-smp", "2", "-m", "3072", "-cpu", "max",
        "-nographic", "-no-reboot", "-nic", "none", "-kernel", str(image), "-initrd", str(initrd),
        "-append", "console=ttyS0 quiet loglevel=3 panic=-1",
        "-virtfs", "local,path=/,mount_tag=hostroot,security_model=none,readonly=on,multidevs=remap",
        "-virtfs", f"local,path={SHARE},mount_tag=share,security_model=none,multidevs=remap",
        "-object", "can-bus,id=wire", "-device", "kvaser_pci,canbus=wire", "-device", "kvaser_pci,canbus=wire",
    ]  # fmt: skip
    try:
        subprocess.run(qemu, stdin=subprocess.DEVNULL, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        print(f"vcan guest: ended after its limit of {limit_s:g} s", file=sys.stderr)
        return _TIMED_OUT
    status = SHARE / "status"
    if not status.exists():
        print("vcan guest: ended without a status", file=sys.stderr)
        return _NO_STATUS
    return int(status.read_text())


def main() -> int:
    """Provision, boot, run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limit", type=float, default=840.0, help="seconds until the guest is ended and has failed")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    try:
        install_packages()
        image, initrd = kernel()
    except (subprocess.CalledProcessError, OSError) as error:
        print(f"vcan guest: cannot be provisioned: {error}", file=sys.stderr)
        return _NO_STATUS
    write_command(options.command)
    return boot(image, initrd, options.limit)


if __name__ == "__main__":
    sys.exit(main())
