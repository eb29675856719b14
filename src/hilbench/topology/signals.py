"""The one list of a recording's signals, in recording order: the recorder, MDF4 and the report read it.

Names and units are those of the design (files: recording); a name carries its unit, the list says what it means.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Signal:
    """One channel of a recording.

    `unit` is the SI unit as MDF4 shows it ("" for a pure number); `group` says who knows the value:
    ``time``, ``command`` (the bench), ``measured`` (the drives), ``boundary`` (given to the process),
    ``load`` (load motor and load model), ``twin``, ``truth`` (only a simulated bench has it; diagnosis never
    reads it) or ``bus``. `integer` marks counts and bit fields.
    """

    name: str
    unit: str
    description: str
    group: str
    integer: bool = False


#: Name of the time channel, the common time base of all others.
TIME: Final = "t_s"

SIGNALS: Final[tuple[Signal, ...]] = (
    Signal(TIME, "s", "bus time: number of the SYNC times the cycle", "time"),
    Signal("v1_cmd_m_s", "m/s", "velocity command of axis 1, at the web", "command"),
    Signal("v2_cmd_m_s", "m/s", "velocity command of axis 2 (line speed), at the web", "command"),
    Signal("x1_m", "m", "position of roller 1: encoder times nominal radius", "measured"),
    Signal("x2_m", "m", "position of roller 2: encoder times nominal radius", "measured"),
    Signal("v1_m_s", "m/s", "velocity of roller 1: encoder times nominal radius", "measured"),
    Signal("v2_m_s", "m/s", "velocity of roller 2: encoder times nominal radius", "measured"),
    Signal("tau1_Nm", "N·m", "actual torque of axis 1, motor side", "measured"),
    Signal("tau2_Nm", "N·m", "actual torque of axis 2, motor side", "measured"),
    Signal("strain_prev", "", "strain of the web upstream of roller 1", "boundary"),
    Signal("F_next_N", "N", "web tension downstream of roller 2", "boundary"),
    Signal("F_ref_N", "N", "tension set-point", "command"),
    Signal("tau_load_Nm", "N·m", "actual torque of the load motor, motor side", "load"),
    Signal("tau_load_cmd_Nm", "N·m", "torque command of the load motor, motor side", "load"),
    Signal("x_load_m", "m", "position of the load motor: encoder times nominal radius", "load"),
    Signal("F_sim_N", "N", "web tension simulated by the twin (virtual sensor)", "twin"),
    Signal("E_sim_Pa", "Pa", "Young's modulus estimated by the twin", "twin"),
    Signal("E_sd_Pa", "Pa", "standard deviation of the estimate, as the twin states it", "twin"),
    Signal("tau2_sim_Nm", "N·m", "torque of axis 2 simulated by the twin, motor side", "twin"),
    Signal("tau2_residual_Nm", "N·m", "torque of axis 2, measured minus simulated, as the twin reports it", "twin"),
    Signal("twin_age_cycles", "", "cycles since the SYNC that the twin's data are of", "twin", integer=True),
    Signal("twin_status", "", "status bits 2100h:3 of the twin", "twin", integer=True),
    Signal("loop_closed", "", "1 while the tension loop is closed on the simulated tension", "command", integer=True),
    Signal("E_true_Pa", "Pa", "Young's modulus of the imitated web", "truth"),
    Signal("F_true_N", "N", "tension of the imitated web", "truth"),
    Signal("strain_true", "", "strain of the imitated web", "truth"),
    Signal("bus_bits", "bit", "bits on the bus in the cycle, stuff bits included", "bus", integer=True),
    Signal("statusword1", "", "statusword 6041h of axis 1", "bus", integer=True),
    Signal("statusword2", "", "statusword 6041h of axis 2", "bus", integer=True),
    Signal("statusword_load", "", "statusword 6041h of the load motor", "bus", integer=True),
)

BY_NAME: Final[dict[str, Signal]] = {signal.name: signal for signal in SIGNALS}

_UNIT_SUFFIXES: Final = (
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_Nm", "N·m"),
    ("_Pa", "Pa"),
    ("_N", "N"),
    ("_m", "m"),
    ("_s", "s"),
)


def unit_of(name: str) -> str:
    """SI unit of a channel: from the list, or, for a channel that is not in it, from the suffix of its name."""
    if name in BY_NAME:
        return BY_NAME[name].unit
    return next((unit for suffix, unit in _UNIT_SUFFIXES if name.endswith(suffix)), "")
