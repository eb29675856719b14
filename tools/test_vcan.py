"""Run the tests that need a kernel with CAN: on a vcan of this machine, or in the guest where its kernel has none.

The interface is made for the run, named so that it can't be anybody else's, and removed afterwards. Before, the
step-change experiment runs on the embedded bus: its recording is what the one on the kernel's bus is compared with. The
exit status is that of the tests; 124 for a guest that was ended, because its time is over (its own, which does not run
faster on a host that is busy) or it shows no sign of life, 125 for one that could not be had. Two guests run at the
same time, because each is one core's work. Words on the command line go to pytest, in place of the folders with tests.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from vcan_guest.guest import COMPILED, NO_STATUS, boot, prepare

ROOT = Path(__file__).resolve().parents[1]
EMBEDDED_RUN = ROOT / ".cache" / "embedded-run"
GUEST_LIMIT_S = 3000  #: of the guest's time
TESTS = ["-v", "-m", "vcan", "-p", "no:cacheprovider", "--durations=5"]
#: Runs that are compared with those on the embedded bus, on two controllers, and as the job of docs/ci.md; stations
#: that talk to each other, and what is killed. Each takes about half of the time.
RUNS = [
    "tests/vcan/test_step_change.py",
    "tests/vcan/test_three_spans.py",
    "tests/vcan/test_two_controllers.py",
    "tests/vcan/test_ci_job.py",
]
TALKS = [
    "tests/vcan/test_lost_frames.py",
    "tests/vcan/test_controller_state.py",
    "tests/vcan/test_doctor.py",
    "tests/canopen",
    "tests/cia402",
    "tests/foreign",
    "tests/vcan/test_faults.py",
]


def ip(*words: str) -> subprocess.CompletedProcess[str]:
    """One `ip link` command."""
    return subprocess.run(["ip", "link", *words], capture_output=True, text=True, check=False)


def run_on_the_embedded_bus() -> None:
    """Leave the runs that others are compared with in EMBEDDED_RUN, and the machine code of all in numba's cache."""
    shutil.rmtree(EMBEDDED_RUN, ignore_errors=True)
    # On all cores; a run compiles what it needs on one.
    subprocess.run([sys.executable, "-m", "hilbench", "compile"], check=True, env={**os.environ, **COMPILED})
    for name in ("step_change", "three_spans"):
        config, bus = ROOT / "tests" / "vcan" / f"{name}.yaml", f"embedded:r{os.getpid()}"
        command = [sys.executable, "-m", "hilbench", "run", str(config), "--bus", bus, "--no-report"]
        subprocess.run([*command, "--out", str(EMBEDDED_RUN)], check=True, env={**os.environ, **COMPILED})


def on_this_kernel(name: str, tests: list[str]) -> int:
    """Run the tests on a vcan that is there."""
    try:
        ip("set", name, "up", "txqueuelen", "1000")
        command = [sys.executable, "-m", "pytest", *TESTS, *tests]
        environment = {**os.environ, "HILBENCH_VCAN": name, "HILBENCH_EMBEDDED_RUN": str(EMBEDDED_RUN)}
        return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    finally:
        ip("delete", name)


def in_guests(*groups: list[str]) -> int:
    """Run each group of tests in a guest of its own, on its vcan and its two controllers."""
    if not prepare([EMBEDDED_RUN]):
        return NO_STATUS
    names = [
        "HILBENCH_GUEST=1",
        "HILBENCH_VCAN=vcan0",
        "HILBENCH_CAN=can0,can1",
        f"HILBENCH_EMBEDDED_RUN={EMBEDDED_RUN}",
    ]
    command = ["env", *names, sys.executable, "-m", "pytest", *TESTS]

    def run(number: int) -> int:
        return boot(f"guest {number + 1}", [*command, *groups[number]], GUEST_LIMIT_S)

    with ThreadPoolExecutor(len(groups)) as pool:
        return max(pool.map(run, range(len(groups))))


def main() -> int:
    """Try this kernel, then the guest."""
    name = f"hv{os.getpid()}"
    asked = sys.argv[1:]
    try:
        made = ip("add", "dev", name, "type", "vcan")
    except FileNotFoundError:
        made = None
    if made is not None and "not permitted" in made.stderr:
        print("test-vcan: a vcan can't be made here (not permitted), expected root or CAP_NET_ADMIN", file=sys.stderr)
        return 1
    run_on_the_embedded_bus()
    if made is not None and made.returncode == 0:
        return on_this_kernel(name, asked or [*RUNS, *TALKS])
    return in_guests(asked) if asked else in_guests(RUNS, TALKS)


if __name__ == "__main__":
    sys.exit(main())
