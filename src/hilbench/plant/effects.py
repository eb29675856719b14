"""The vocabulary of what a model may lack: one table that configs, injection, kernel and diagnosis read.

An effect is a named group of parameters of the one web model, neutral until they are given (design section 6).
To add one: a row here, at the end (its place is the number of its CANopen object), and its law in
`hilbench.plant.web_line.laws`; the places of its parameters in the kernel's arrays (`hilbench.plant.web_line.layout`)
follow from this table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import inf, isfinite, pi


class Domain(StrEnum):
    """Where an effect enters the model."""

    ROLLER_RESISTANCE = "roller_resistance"  #: force against the roller's motion, at the web
    MOTOR_TORQUE = "motor_torque"  #: torque that acts on the shaft
    TORQUE_MEASUREMENT = "torque_measurement"  #: torque as the drive reports it
    WEB_KINEMATICS = "web_kinematics"  #: speed of the web at a roller
    ELASTICITY = "elasticity"  #: tension from strain
    BOUNDARY = "boundary"  #: what comes from the neighbouring sections
    GEOMETRY = "geometry"  #: length of the span
    INERTIA = "inertia"  #: moving mass
    GEAR = "gear"  #: between motor and roller


#: Effects of the simulated hardware: drives, shafts and gears.
RIG_DOMAINS = frozenset(
    {Domain.ROLLER_RESISTANCE, Domain.MOTOR_TORQUE, Domain.TORQUE_MEASUREMENT, Domain.INERTIA, Domain.GEAR}
)
#: Effects the load model can imitate: the web's, and forces at the roller.
IMITATED_DOMAINS = frozenset(
    {Domain.ROLLER_RESISTANCE, Domain.WEB_KINEMATICS, Domain.ELASTICITY, Domain.BOUNDARY, Domain.GEOMETRY}
)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an effect. `unit` is as in a recording ("1" for a ratio)."""

    name: str
    unit: str
    neutral: float  #: value in a model without the effect
    lower: float  #: least value with a meaning (inclusive)
    upper: float  #: greatest value with a meaning (inclusive)
    scale: float  #: size of a change that shows clearly on the demonstrator: step size and start value of a fit
    required: bool = True  #: must be given with the effect (phases need not)

    def problem(self, value: float) -> str | None:
        """What is wrong with a value, or None."""
        if not isfinite(value) or not self.lower <= value <= self.upper:
            return f"{self.name} = {value!r} {self.unit}, expected {self.lower:g} to {self.upper:g}"
        return None


@dataclass(frozen=True, slots=True)
class Effect:
    """One effect: id, law, parameters and where it enters."""

    id: str
    per_axis: bool
    law: str
    domain: Domain
    parameters: tuple[Parameter, ...]
    #: Parameters that make the effect vanish when all are neutral; the others only shape it.
    strength: tuple[str, ...]
    #: How many of it a model can hold at one place (several ripple orders, several steps).
    slots: int = 1
    #: Axis that may be named although the effect has no choice of axis: the one at which its law acts.
    implied_axis: int | None = None

    def parameter(self, name: str) -> Parameter:
        """The parameter `name`. Raises KeyError."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def problem(self, parameters: Mapping[str, float]) -> str | None:
        """What is wrong with a set of parameter values, in one line, or None."""
        names = [parameter.name for parameter in self.parameters]
        for name in parameters:
            if name not in names:
                return f"effect '{self.id}' has no parameter '{name}', expected {', '.join(names)}"
        for parameter in self.parameters:
            if parameter.name in parameters:
                problem = parameter.problem(parameters[parameter.name])
                if problem:
                    return f"effect '{self.id}': {problem}"
            elif parameter.required:
                return f"effect '{self.id}' lacks its parameter '{parameter.name}' ({parameter.unit})"
        return None

    def axis_problem(self, axis: int | None, axes: int | None = None) -> str | None:
        """What is wrong with the axis given for it (of a line of `axes`), in one line, or None."""
        if self.per_axis and axis is None:
            return f"effect '{self.id}' lacks its axis, expected one of the axes 1, 2, ..."
        if not self.per_axis and axis not in (None, self.implied_axis):
            return f"effect '{self.id}' with axis {axis}, expected none: it is an effect of the web"
        if axis is not None and (axis < 1 or (axes is not None and axis > axes)):
            return f"effect '{self.id}' with axis {axis}, expected 1 to {axes if axes is not None else 'N'}"
        return None

    def filled(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """All parameters, with the neutral value of those not given."""
        return {p.name: float(parameters.get(p.name, p.neutral)) for p in self.parameters}


def _phase() -> Parameter:
    return Parameter("phase_rad", "rad", 0.0, -2.0 * pi, 2.0 * pi, 1.0, required=False)


def _relative(scale: float = 0.1) -> Parameter:
    return Parameter("relative_change", "1", 0.0, -0.95, 10.0, scale)


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "coulomb_friction",
        True,
        "R += Fc·sign(v), sticks at v = 0",
        Domain.ROLLER_RESISTANCE,
        (Parameter("force_N", "N", 0.0, 0.0, 1e5, 4.0),),
        ("force_N",),
    ),
    Effect(
        "viscous_friction",
        True,
        "R += b·v",
        Domain.ROLLER_RESISTANCE,
        (Parameter("coefficient_N_s_per_m", "N·s/m", 0.0, 0.0, 1e5, 2.0),),
        ("coefficient_N_s_per_m",),
    ),
    Effect(
        "stribeck_friction",
        True,
        "R += Fs·exp(-(v/vs)²)·sign(v), sticks at v = 0",
        Domain.ROLLER_RESISTANCE,
        (
            Parameter("force_N", "N", 0.0, 0.0, 1e5, 4.0),
            Parameter("speed_m_s", "m/s", 0.1, 1e-5, 100.0, 0.1),
        ),
        ("force_N",),
    ),
    Effect(
        "roller_eccentricity",
        True,
        "web speed = v·(1 + (a/r)·cos(phi + phi0)), phi the roller's angle",
        Domain.WEB_KINEMATICS,
        (Parameter("amplitude_m", "m", 0.0, 0.0, 0.1, 2e-5), _phase()),
        ("amplitude_m",),
    ),
    Effect(
        "friction_asymmetry",
        True,
        "R += d·|v|: viscous b+d forward, b-d backward",
        Domain.ROLLER_RESISTANCE,
        (Parameter("viscous_difference_N_s_per_m", "N·s/m", 0.0, -1e5, 1e5, 2.0),),
        ("viscous_difference_N_s_per_m",),
    ),
    Effect(
        "torque_ripple",
        True,
        "shaft torque = motor torque + A·sin(n·phi_motor + phi0)",
        Domain.MOTOR_TORQUE,
        (
            Parameter("amplitude_Nm", "N·m", 0.0, 0.0, 1e4, 0.05),
            Parameter("order", "1/turn", 1.0, 1e-3, 1e4, 1.0),
            _phase(),
        ),
        ("amplitude_Nm",),
        slots=4,
    ),
    Effect(
        "torque_offset",
        True,
        "measured torque = motor torque + b",
        Domain.TORQUE_MEASUREMENT,
        (Parameter("offset_Nm", "N·m", 0.0, -1e4, 1e4, 0.05),),
        ("offset_Nm",),
    ),
    Effect(
        "torque_scale",
        True,
        "shaft torque = (1+s)·(motor torque as the drive knows it)",
        Domain.MOTOR_TORQUE,
        (_relative(0.05),),
        ("relative_change",),
    ),
    Effect(
        "torque_delay",
        True,
        "measured torque is the motor torque of delay_s ago",
        Domain.TORQUE_MEASUREMENT,
        (Parameter("delay_s", "s", 0.0, 0.0, 0.05, 0.004),),
        ("delay_s",),
    ),
    Effect("inertia_mismatch", True, "m·(1+s)", Domain.INERTIA, (_relative(),), ("relative_change",)),
    Effect(
        "backlash",
        True,
        "gear play: the motor turns by gap_rad (motor side, stop to stop) without moving the roller",
        Domain.GEAR,
        (Parameter("gap_rad", "rad", 0.0, 0.0, 1.0, 0.01),),
        ("gap_rad",),
    ),
    Effect("elasticity_shift", False, "E·(1+s)", Domain.ELASTICITY, (_relative(),), ("relative_change",)),
    Effect(
        "elasticity_step",
        False,
        "E·(1+s) from time_s on",
        Domain.ELASTICITY,
        (Parameter("time_s", "s", 0.0, 0.0, inf, 1.0), _relative()),
        ("relative_change",),
        slots=4,
    ),
    Effect(
        "elasticity_drift",
        False,
        "E·(1 + k·t)",
        Domain.ELASTICITY,
        (Parameter("rate_per_s", "1/s", 0.0, -1.0, 1.0, 1e-3),),
        ("rate_per_s",),
    ),
    Effect(
        "web_damping",
        False,
        "F = E·S·(strain + T·strain')",
        Domain.ELASTICITY,
        (Parameter("time_constant_s", "s", 0.0, 0.0, 1.0, 0.005),),
        ("time_constant_s",),
    ),
    Effect(
        "web_slip",
        False,
        "web speed at the roller behind a span = v·(1 - c·(F - F_next)) (creep)",
        Domain.WEB_KINEMATICS,
        (Parameter("creep_per_N", "1/N", 0.0, 0.0, 1e-2, 2e-6),),
        ("creep_per_N",),
        implied_axis=2,
    ),
    Effect(
        "strain_offset",
        False,
        "F = E·S·(strain - strain0)",
        Domain.ELASTICITY,
        (Parameter("strain", "1", 0.0, -0.1, 0.1, 2e-5),),
        ("strain",),
    ),
    Effect(
        "upstream_disturbance",
        False,
        "F_prev += A·sin(2·pi·f·t + phi0), the upstream strain in proportion",
        Domain.BOUNDARY,
        (
            Parameter("amplitude_N", "N", 0.0, 0.0, 1e5, 2.0),
            Parameter("frequency_Hz", "Hz", 1.0, 0.0, 250.0, 1.0),
            _phase(),
        ),
        ("amplitude_N",),
        slots=4,
    ),
    Effect("span_length_error", False, "L·(1+s)", Domain.GEOMETRY, (_relative(),), ("relative_change",)),
    Effect(
        "elasticity_ramp",
        False,
        "E·(1 + s·(t - time_s)/duration_s) from time_s on, E·(1+s) after duration_s",
        Domain.ELASTICITY,
        (
            Parameter("time_s", "s", 0.0, 0.0, inf, 1.0),
            Parameter("duration_s", "s", 1.0, 1e-3, 1e9, 1.0),
            _relative(),
        ),
        ("relative_change",),
        slots=2,
    ),
)

#: Axes of the stand: the load motor is on the second.
_STAND_AXES = 2

_BY_ID = {effect.id: effect for effect in EFFECTS}


def find_effect(effect_id: str) -> Effect:
    """The effect with this id. Raises KeyError with a message that lists the known ids."""
    try:
        return _BY_ID[effect_id]
    except KeyError:
        raise KeyError(f"unknown effect '{effect_id}', expected one of {', '.join(_BY_ID)}") from None


def axis_effects() -> tuple[Effect, ...]:
    """The effects that belong to one axis each."""
    return tuple(effect for effect in EFFECTS if effect.per_axis)


def web_effects() -> tuple[Effect, ...]:
    """The effects that belong to the web (every span of the line)."""
    return tuple(effect for effect in EFFECTS if not effect.per_axis)


def rig_effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Why the simulated hardware cannot have an effect, in one line, or None."""
    try:
        effect = find_effect(effect_id)
    except KeyError as error:
        return str(error.args[0])
    if effect.domain not in RIG_DOMAINS:
        return f"effect '{effect_id}' in the simulated hardware, expected one of the axes; the web is the load model's"
    return effect.axis_problem(axis, _STAND_AXES)


def imitated_effect_problem(effect_id: str, axis: int | None) -> str | None:
    """Why the load model cannot imitate an effect, in one line, or None."""
    try:
        effect = find_effect(effect_id)
    except KeyError as error:
        return str(error.args[0])
    if effect.domain not in IMITATED_DOMAINS:
        return f"an effect of the web or a roller's resistance; {effect_id} belongs in 'hardware:'"
    if effect.domain is Domain.ROLLER_RESISTANCE and axis != 2:
        return f"{effect_id} of axis 2, where the load motor is; other axes' in 'hardware:'"
    return effect.axis_problem(axis, _STAND_AXES)
