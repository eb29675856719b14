"""All rows of the matrix."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from faults.acts import (
    babble,
    disturb,
    emergency_stop,
    hold_up,
    jump,
    nothing,
    other_devices,
    say,
    second_hardware,
    send_signal,
    settable_clock,
    twin_bus_off,
)
from faults.attacks import attacks, download
from faults.run import FOREVER, Fault, shipped_parts
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import Frame

#: Controlwords: fault reset, shutdown, switch on, enable operation.
RESET_AND_ENABLE = (0x80, 0x06, 0x07, 0x0F)
LONG: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 8.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]
SHORT: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 3.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]

STOPPED = "quick stop, exit 3"


def faults() -> list[Fault]:
    """All rows."""
    kill, stop = signal.SIGKILL, signal.SIGSTOP
    pre_operational, reset = Frame(0, bytes((128, 1))), Frame(0, bytes((129, 1)))
    return [
        Fault("bench: kill -9", "supervisor and drives stop, data recovered", (-9,), "", send_signal(kill)),
        Fault(
            "bench: SIGSTOP",
            "supervisor sends the emergency stop, exit 3 when it goes on",
            (3,),
            "emergency stop (COB-ID 001h)",
            hold_up(4.0),
        ),
        Fault("bench: Ctrl-C", "quick stop, exit 130", (130,), "interrupted", send_signal(signal.SIGINT)),
        Fault(
            "twin: kill -9",
            "loop opens, process started again, loop closes",
            (0,),
            "tension loop closed again",
            send_signal(kill, "hilbench.twin"),
            {"steps": _with_loop_back()},
        ),
        Fault(
            "twin: SIGSTOP for 3 s",
            "loop opens, twin taken back, loop closes",
            (0,),
            "tension loop closed again",
            hold_up(3.0, "hilbench.twin"),
            {"steps": _with_loop_back()},
        ),
        Fault(
            "hardware: kill -9",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC",
            send_signal(kill, "hilbench.hardware"),
        ),
        Fault(
            "hardware: SIGSTOP",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC",
            send_signal(stop, "hilbench.hardware"),
        ),
        Fault(
            "supervisor: kill -9",
            STOPPED,
            (3,),
            "supervisor ended",
            send_signal(kill, "hilbench.bench.lifecycle.supervisor"),
        ),
        Fault(
            "hub: kill -9",
            "exit 3, bus lost; drives stop by 1016h",
            (3,),
            "hub",
            send_signal(kill, "hilbench.can.hub"),
            embedded=True,
        ),
        Fault(
            "hub: SIGSTOP",
            "exit 3, nobody answers",
            (3,),
            "no answer",
            send_signal(stop, "hilbench.can.hub"),
            embedded=True,
        ),
        Fault("emergency stop from a terminal", "drives stop at once, exit 3", (3,), "emergency stop", emergency_stop),
        Fault("drive to PRE-OPERATIONAL (NMT)", STOPPED, (3,), "axis", say(pre_operational)),
        Fault("drive power-cycled (boot-up)", STOPPED, (3,), "axis", say(reset)),
        Fault("drive: fault by itself", STOPPED, (3,), "FAULT", say(download(1, 0x2001, 0x5441, 2))),
        Fault(
            "trip: speed",
            STOPPED,
            (3,),
            "beyond its trip level",
            nothing,
            {
                "steps": [
                    *FOREVER[:1],
                    {"hold": {"until_s": 1.5}},
                    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
                ],
                "safety": {"cycle_timeout_s": 1.0, "limits": {"speed_m_s": {"trip": 1.2}}},
            },
        ),
        Fault(
            "web break",
            "EMCY FF15h, quick stop, exit 3",
            (3,),
            "web break",
            nothing,
            {
                "steps": [
                    *FOREVER[:1],
                    {"hold": {"until_s": 1.5}},
                    {"step": {"path": "load.web.broken", "to": 1}},
                    FOREVER[1],
                ]
            },
        ),
        Fault(
            "wrong EDS: another product",
            "exit 3 before anything moves",
            (3,),
            "1018h",
            other_devices,
            _wrong_eds(),
            ("--no-start",),
        ),
        Fault("two nodes with one id in the config", "exit 2, both named", (2,), "both have", nothing, _same_id()),
        Fault("two devices with one id on the bus", "exit 3", (3,), "", second_hardware),
        Fault(
            "babbling node, 1 s, real time",
            "exit 3 or ridden out, counted",
            (0, 3),
            "",
            babble(1.0),
            {"steps": SHORT},
            real_time=True,
        ),
        *_disturbances(),
        Fault(
            "bench bus off",
            "exit 3, reported; drives stop by themselves",
            (3,),
            "bus off",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x201, 0x7FF),))),
            embedded=True,
        ),
        Fault(
            "bench bus off, real time",
            "exit 3, reported; drives stop by themselves",
            (3,),
            "bus off",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x201, 0x7FF),))),
            real_time=True,
            embedded=True,
        ),
        Fault(
            "drives bus off",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC from axis1",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x181, 0x7FF),))),
            embedded=True,
        ),
        Fault(
            "twin bus off",
            "loop opens, process started again, loop closes",
            (0,),
            "tension loop closed again",
            twin_bus_off,
            {"steps": _with_loop_back()},
            embedded=True,
        ),
        *(
            Fault(
                f"clock set {'forth' if hours > 0 else 'back'} by an hour, {pace}",
                "no difference",
                (0,),
                "",
                jump(hours * 3600.0),
                {"steps": SHORT if pace == "real time" else LONG},
                real_time=pace == "real time",
                environment=settable_clock,
            )
            for hours in (1, -1)
            for pace in ("lockstep", "real time")
        ),
        *(
            Fault(
                f"{what}: kill -9, real time",
                expected,
                (3,),
                words,
                send_signal(kill, command),
                real_time=True,
                embedded=what == "hub",
            )
            for what, command, expected, words in (
                ("hardware", "hilbench.hardware", "exit 3, nobody answers", "no answer to SYNC"),
                ("supervisor", "hilbench.bench.lifecycle.supervisor", STOPPED, "supervisor ended"),
                ("hub", "hilbench.can.hub", "exit 3, bus lost; drives stop by 1016h", "hub"),
            )
        ),
        Fault(
            "bench: SIGSTOP, real time",
            "supervisor sends the emergency stop, exit 3 when it goes on",
            (3,),
            "emergency stop (COB-ID 001h)",
            hold_up(5.0),
            real_time=True,
        ),
        Fault(
            "drive: EMCY, and goes on",
            "noted, goes on",
            (0,),
            "EMCY 2310h: current",
            say(Frame(0x081, bytes.fromhex("1023030000000000"))),
            {"steps": LONG},
        ),
        Fault("drive: heartbeat stops", STOPPED, (3,), "has sent no heartbeat", say(download(1, 0x1017, 0, 2))),
        Fault(
            "drive: fault, reset by somebody again and again",
            "quick stop, exit 3; not enabled again",
            (3,),
            "FAULT",
            say(download(1, 0x2001, 0x5441, 2), *(download(1, 0x6040, word, 2) for word in RESET_AND_ENABLE * 8)),
        ),
        Fault(
            "object that the drive refuses (SDO abort)",
            "exit 3 before anything moves, object and code named",
            (3,),
            "abort",
            nothing,
            _refused_object(),
        ),
        Fault(
            "lost frames 1.0%, lockstep",
            "exit 3: an answer is missing",
            (3,),
            "no answer to SYNC",
            disturb(ErrorInjection(seed=6, lost=0.01)),
            embedded=True,
        ),
        Fault(
            "disk full (at 2.5 MB)",
            "the trace ends with a notice, the run goes on",
            (0,),
            "cannot be written",
            nothing,
            {"steps": LONG},
            (),
            2_500_000,
        ),
        Fault(
            "cycle overrun of 50 ms, real time",
            "missed cycles counted, goes on",
            (0,),
            "",
            hold_up(0.05),
            {"steps": SHORT},
            real_time=True,
        ),
        Fault(
            "node that does not answer (SDO time-out)",
            "exit 3, node named",
            (3,),
            "no answer from axis1",
            nothing,
            _silent_node(),
        ),
        *attacks(LONG, _with_loop_back()),
    ]


def _disturbances() -> Iterator[Fault]:
    """Lost, duplicated, delayed and corrupted frames; in lockstep a lost answer is not made up for, the others are."""
    for share in (0.001, 0.01, 0.1):
        ridden_out: tuple[str, tuple[int, ...]] = ("ridden out", (0,))
        for pace, delay_s in (("lockstep", 0.0005), ("real time", 0.002)):
            real = pace == "real time"
            expected = ("ridden out, or safe state and exit 3", (0, 3)) if real and share == 0.1 else ridden_out
            for name, injection in (
                ("lost", ErrorInjection(seed=6, lost=share)),
                ("duplicated", ErrorInjection(seed=6, duplicated=share)),
                ("delayed", ErrorInjection(seed=6, delayed=share, delay_s=delay_s)),
                ("corrupted", ErrorInjection(seed=6, corrupted=share)),
            ):
                if name == "lost" and not real:
                    continue
                words = "error passive" if name == "corrupted" and share == 0.1 and not real else ""
                yield Fault(
                    f"{name} frames, {share:.1%}, {pace}",
                    *expected,
                    words,
                    disturb(injection),
                    {"steps": SHORT if real else LONG},
                    real_time=real,
                    embedded=True,
                )


def _with_loop_back() -> list[dict[str, Any]]:
    return [
        FOREVER[0],
        {"wait_until": {"condition": "loop_closed < 1", "timeout_s": 1000.0}},
        {"wait_until": {"condition": "loop_closed > 0", "timeout_s": 1000.0, "for_s": 1.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
    ]


def _same_id() -> dict[str, Any]:
    parts = shipped_parts()
    parts["load_motors"]["load"]["node_id"] = 2
    return parts


def _refused_object() -> dict[str, Any]:
    """1001h, the error register, can't be written: abort 06010002h."""
    parts = shipped_parts()
    parts["drives"]["axis1"]["parameters"] = {"1001h": 1}
    return parts


def _silent_node() -> dict[str, Any]:
    parts = shipped_parts()
    parts["drives"]["axis1"]["simulated"] = False
    return {**parts, "master": {"boot_timeout_s": 3.0}}


def _wrong_eds() -> dict[str, Any]:
    """The nodes, axis 1 with the EDS of another product (1018h:2)."""
    parts = shipped_parts()
    text = Path(parts["drives"]["axis1"]["eds"]).read_text(encoding="utf-8")
    at = text.index("DefaultValue", text.index("[1018sub2]"))
    path = Path(tempfile.gettempdir()) / f"wrong-{os.getpid()}.eds"
    path.write_text(text[:at] + "DefaultValue=0x12345678" + text[text.index("\n", at) :], encoding="utf-8")
    parts["drives"]["axis1"]["eds"] = str(path)
    return parts
