"""Run the tests that need a kernel with CAN: on a vcan of this machine, or in the guest where its kernel has none.

The interface is made for the run, named so that it can't be anybody else's, and removed afterwards. The exit status is
that of the tests; 124 for a guest that was ended by its time limit, 125 for one that could not be had.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GUEST_LIMIT_S = 780
TESTS = ["-q", "-m", "vcan", "-p", "no:cacheprovider", "--durations=8", "tests/vcan", "tests/foreign"]


def ip(*words: str) -> subprocess.CompletedProcess[str]:
    """One `ip link` command."""
    return subprocess.run(["ip", "link", *words], capture_output=True, text=True, check=False)


def on_this_kernel(name: str) -> int:
    """Run the tests on a vcan that is there."""
    try:
        ip("set", name, "up", "txqueuelen", "1000")
        command = [sys.executable, "-m", "pytest", *TESTS]
        return subprocess.run(command, cwd=ROOT, env={**os.environ, "HILBENCH_VCAN": name}, check=False).returncode
    finally:
        ip("delete", name)


def main() -> int:
    """Try this kernel, then the guest."""
    name = f"hv{os.getpid()}"
    try:
        made = ip("add", "dev", name, "type", "vcan")
    except FileNotFoundError:
        made = None
    if made is not None and made.returncode == 0:
        return on_this_kernel(name)
    if made is not None and "not permitted" in made.stderr:
        print("test-vcan: a vcan can't be made here (not permitted), expected root or CAP_NET_ADMIN", file=sys.stderr)
        return 1
    python = str(Path(sys.executable))
    guest = [sys.executable, str(ROOT / "tools" / "vcan_guest" / "guest.py"), "--limit", str(GUEST_LIMIT_S)]
    inside = ["env", "HILBENCH_VCAN=vcan0", "HILBENCH_CAN=can0,can1", python, "-m", "pytest", *TESTS]
    return subprocess.run([*guest, *inside], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
