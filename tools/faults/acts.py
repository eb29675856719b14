"""What is done to a run."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from faults.run import CLI, Run, shipped_parts
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import Frame
from hilbench.can.hub_client import inject_errors
from hilbench.can.open import BusAddress, open_link

#: clock_gettime, gettimeofday and time of the C library, CLOCK_REALTIME off by the int64 ns in a file.
SETTABLE_CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
static volatile long long *offset;
static int (*real)(clockid_t, struct timespec *);
__attribute__((constructor)) static void begin(void) {
    int file = open(getenv("CLOCK_OFFSET_FILE"), O_RDONLY | O_CLOEXEC);
    real = dlsym(RTLD_NEXT, "clock_gettime");
    offset = mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
}
int clock_gettime(clockid_t id, struct timespec *t) {
    int result = real(id, t);
    if (id == CLOCK_REALTIME && offset) {
        long long ns = t->tv_sec * 1000000000LL + t->tv_nsec + *offset;
        t->tv_sec = ns / 1000000000LL, t->tv_nsec = ns % 1000000000LL;
    }
    return result;
}
int gettimeofday(struct timeval *v, void *zone) {
    struct timespec t;
    int result = clock_gettime(CLOCK_REALTIME, &t);
    v->tv_sec = t.tv_sec, v->tv_usec = t.tv_nsec / 1000;
    return result;
}
time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}
"""


def send_signal(number: int, *words: str) -> Callable[[Run], None]:
    """Send a signal to one of the run's processes once the line runs; no words: the bench."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        os.kill(run.pid_of(*words) if words else run.process.pid, number)

    return act


def hold_up(duration_s: float, *words: str) -> Callable[[Run], None]:
    """SIGSTOP, and SIGCONT after a while."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        pid = run.pid_of(*words) if words else run.process.pid
        os.kill(pid, signal.SIGSTOP)
        time.sleep(duration_s)
        os.kill(pid, signal.SIGCONT)

    return act


def say(*frames: Frame, times: int = 1) -> Callable[[Run], None]:
    """Let a foreign station send frames once the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        link = open_link(bus_of(run))
        try:
            for _ in range(times):
                link.send(frames)
            link.receive(0.05)
        finally:
            link.close()

    return act


def bus_of(run: Run) -> BusAddress:
    """The bus of the run as it runs."""
    return BusAddress.parse(run.address, timing="real" if run.real_time else "virtual")


def babble(duration_s: float) -> Callable[[Run], None]:
    """A node that sends the identifier that wins every arbitration but NMT's, as fast as the wire takes it."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        link = open_link(bus_of(run))
        link.set_filters([(0x7FF, 0x7FF)])
        end_s = time.monotonic() + duration_s
        try:
            while time.monotonic() < end_s and run.process.poll() is None:
                link.send([Frame(0x010, bytes(8))] * 16)
        finally:
            link.close()

    return act


def disturb(injection: ErrorInjection) -> Callable[[Run], None]:
    """Disturb the cyclic frames from when the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        inject_errors(run.address.partition(":")[2], injection)

    return act


def twin_bus_off(run: Run) -> None:
    """The twin's controller leaves the bus; the disturbance is over before its process is there again."""
    run.wait_for_speed()
    channel = run.address.partition(":")[2]
    inject_errors(channel, ErrorInjection(corrupted=1.0, filters=((0x1A0, 0x7FF),)))
    time.sleep(0.5)
    inject_errors(channel, ErrorInjection())


def settable_clock() -> dict[str, str]:
    """Environment in which CLOCK_REALTIME is off by what stands in a file, for every process of a run.

    It stays off for the runs after it, which makes no difference to them either.
    """
    library = Path(os.environ["XDG_RUNTIME_DIR"]) / "clock.so"
    if not library.exists():
        source = library.with_suffix(".c")
        source.write_text(SETTABLE_CLOCK, encoding="ascii")
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        library.with_name("clock").write_bytes(bytes(8))
    return {"LD_PRELOAD": str(library), "CLOCK_OFFSET_FILE": str(library.with_name("clock"))}


def jump(seconds: float) -> Callable[[Run], None]:
    """Set the clock once the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        with Path(settable_clock()["CLOCK_OFFSET_FILE"]).open("r+b") as file:  # in place: it is mapped
            file.write(int(seconds * 1e9).to_bytes(8, "little", signed=True))

    return act


def paced_as(config: Path) -> list[str]:
    """The option with which hardware and twin go with the bench of a config."""
    return ["--pace", yaml.safe_load(config.read_text(encoding="utf-8"))["pace"]]


def second_hardware(run: Run) -> None:
    """A second set of drives with the same node-IDs on the bus."""
    twice = subprocess.Popen(
        [*CLI, "simulate-hardware", str(run.config), *paced_as(run.config)],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def end_with_run() -> None:
        run.process.wait()
        twice.terminate()

    threading.Thread(target=end_with_run, daemon=True).start()


def other_devices(run: Run) -> None:
    """The devices are those of the shipped config, not those that the run's EDS files describe."""
    data = yaml.safe_load(run.config.read_text(encoding="utf-8"))
    data |= shipped_parts()
    config = run.work / "devices.yaml"
    config.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    for command in ("simulate-hardware", "twin"):
        words = [*CLI, command, str(config), *paced_as(config)]
        subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def nothing(run: Run) -> None:
    """The fault is in the config."""


def emergency_stop(run: Run) -> None:
    """From another terminal."""
    run.wait_for_speed()
    subprocess.run([*CLI, "estop", "--bus", run.address], check=True, capture_output=True)
