"""Signals of the parts of a web line, in recording order."""

from __future__ import annotations

from typing import Final

from hilbench.topology.signal_kinds import (
    BUS_SIGNALS,
    TIME_SIGNALS,
    Per,
    SignalKind,
    axes_signals,
    estimate_signals,
    load_motor_signals,
    twin_signals,
)

#: The speed of a line whose last axis is a reel: that of all others the last axis has.
LINE_SPEED_SIGNAL: Final = "line_speed_cmd_m_s"

WEB_LINE: Final = (
    *TIME_SIGNALS,
    SignalKind(LINE_SPEED_SIGNAL, "m/s", "commanded speed of the web at the rewinder", "command", Per.WINDER),
    *axes_signals("m", ", at the web", "roller {axis}: encoder times nominal radius"),
    SignalKind(
        "tau{axis}_cmd_Nm",
        "N·m",
        "torque command of the reel that is axis {axis}, motor side",
        "command",
        Per.TORQUED_AXIS,
    ),
    SignalKind("strain_prev", "", "strain of the web upstream of roller 1", "boundary"),
    SignalKind("F_next_N", "N", "web tension downstream of the last roller", "boundary"),
    SignalKind("F{span}_ref_N", "N", "tension set-point", "command", Per.CONTROLLED),
    SignalKind(
        "x_{carriage}_ref_m", "m", "set-point of the position of {carriage}", "command", Per.POSITIONED_CARRIAGE
    ),
    SignalKind(
        "f_{carriage}_cmd_N",
        "N",
        "commanded force of the cylinder on the carriage of {carriage}",
        "command",
        Per.PUSHED_CARRIAGE,
    ),
    *load_motor_signals("m", "encoder times nominal radius"),
    SignalKind("F{span}_sim_N", "N", "web tension simulated by the twin (virtual sensor)", "twin", Per.SIMULATED),
    *estimate_signals("E{span}_sim_Pa", "Pa", "Young's modulus estimated by the twin", "the estimate", Per.ESTIMATED),
    *estimate_signals(
        *("x_{carriage}_sim_m", "m", "position of the carriage of {carriage}, as the twin has it (virtual sensor)"),
        *("the position of {carriage}", Per.CARRIAGE),
    ),
    *estimate_signals(
        *("r_{reel}_sim_m", "m", "radius of the reel {reel} found by the twin (virtual sensor)"),
        *("the radius of {reel}", Per.REEL),
    ),
    *twin_signals("{next}", Per.ESTIMATED),
    SignalKind(
        "loop{span}_closed",
        "",
        "1 while the tension loop is closed on the simulated tension",
        "command",
        Per.CONTROLLED,
        integer=True,
    ),
    SignalKind("E{span}_true_Pa", "Pa", "Young's modulus of the emulated web", "truth", Per.SPAN),
    SignalKind("F{span}_true_N", "N", "tension of the emulated web", "truth", Per.SPAN),
    SignalKind("strain{span}_true", "", "strain of the emulated web", "truth", Per.SPAN),
    SignalKind("x_{carriage}_true_m", "m", "position of the emulated carriage of {carriage}", "truth", Per.CARRIAGE),
    SignalKind("v_{carriage}_true_m_s", "m/s", "speed of the emulated carriage of {carriage}", "truth", Per.CARRIAGE),
    SignalKind("r_{reel}_true_m", "m", "radius of the emulated reel {reel}", "truth", Per.REEL),
    SignalKind(
        "x_{carriage}_meas_m",
        "m",
        "position of the carriage of {carriage}, by its emulated sensor",
        "measured",
        Per.MEASURED_CARRIAGE,
    ),
    SignalKind(
        "r_{reel}_meas_m", "m", "radius of the reel {reel}, by its emulated sensor", "measured", Per.MEASURED_REEL
    ),
    SignalKind(
        "F_{cell}_meas_N",
        "N",
        "web tension at {cell}, the mean of those beside it, by its emulated load cell",
        "measured",
        Per.CELL,
    ),
    *BUS_SIGNALS,
)


def tension_loop_words(number: str) -> str:
    """Name of a span's tension loop in messages; `number` as of `web_line_quantities.tension_set_point`."""
    return f"tension loop of span {number}" if number else "tension loop"
