"""Vocabulary of effects that a model may lack: one table for configs, injection, kernels, bus and diagnosis.

A row defines an effect (`hilbench.plant.effect`). To add one: a row in `EFFECTS`, and its law
(`hilbench.plant.web_line.laws`; the offsets of its parameters in the kernel's arrays,
`hilbench.plant.web_line.layout`, follow from this table).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import inf, pi

from hilbench.did_you_mean import expected_one_of
from hilbench.plant.effect import (
    AT_A_ROLLER,
    Domain,
    Effect,
    EffectPlace,
    Lookalike,
    MachineKind,
    Parameter,
    Probe,
    ProbeOver,
    Rotary,
    Section,
    Size,
)

_EVERY_KIND = frozenset(MachineKind)


def _phase() -> Parameter:
    return Parameter("phase_rad", "rad", 0.0, -2.0 * pi, 2.0 * pi, Size(1.0), required=False)


def _relative(
    size: float = 0.1, name: str = "relative_change", *, required: bool = True, lower: float = -0.95
) -> Parameter:
    return Parameter(name, "1", 0.0, lower, 10.0, Size(size), required)


def _fed_forward(name: str) -> Parameter:
    return Parameter(name, "1", 0.0, 0.0, 2.0, Size(0.1), required=False)


def _onset() -> Parameter:
    return Parameter("time_s", "s", 0.0, 0.0, inf, Size(1.0))


# Sizes: 5 % of a usual force, at the web, at the roller's shaft, or as speed-dependent force at half the top speed;
# a third of that where it is compared with the torque of the motor directly.
_FORCE, _TORQUE = Size(0.05, force=1), Size(0.05, force=1, radius=1)
_PER_SPEED, _PER_ANGULAR_SPEED = Size(0.1, force=1, speed=-1), Size(0.1, force=1, radius=2, speed=-1)
_PER_SQUARE, _PER_ANGULAR_SQUARE = Size(0.2, force=1, speed=-2), Size(0.2, force=1, radius=3, speed=-2)
_MOTOR_TORQUE = Size(1.0 / 64.0, force=1, radius=1, gear=-1)
#: Shares of the highest speed at which a law with a speed of its own is tried.
_SHARES = (0.01, 0.04, 0.15)
#: Frequencies at which a resonance is tried: close enough that a fit finds it from the nearest.
_FREQUENCIES_HZ = (5.0, 6.5, 8.5, 11.0, 14.0, 18.0, 24.0, 31.0, 40.0, 52.0)

#: Look-alike of a web with another E that comes at once.
_FORCE_STEP = Lookalike(
    "a step of a force at the last roller (friction, downstream tension)",
    "step the tension after the change, and reverse",
)

#: Of inseparable explanations the first one here is named.
EFFECTS: tuple[Effect, ...] = (
    Effect(
        id="coulomb_friction",
        law="R += Fc·sign(v), sticks at v = 0",
        domain=Domain.ROLLER_RESISTANCE,
        parameters=(Parameter("force_N", "N", 0.0, 0.0, 1e5, _FORCE),),
        object_index=0x2200,
        shown_by="stop, start and reverse the axis",
        kinds=_EVERY_KIND,
        rotary=Rotary(
            "friction torque += Tc·sign(ω), sticks at ω = 0",
            (Parameter("torque_Nm", "N·m", 0.0, 0.0, 1e5, _TORQUE),),
            0x2280,
        ),
        removable=False,
    ),
    Effect(
        id="viscous_friction",
        law="R += b·v",
        domain=Domain.ROLLER_RESISTANCE,
        parameters=(Parameter("coefficient_N_s_per_m", "N·s/m", 0.0, 0.0, 1e5, _PER_SPEED),),
        object_index=0x2201,
        shown_by="hold several speeds",
        kinds=_EVERY_KIND,
        rotary=Rotary(
            "friction torque += b·ω",
            (Parameter("coefficient_Nm_s_per_rad", "N·m·s/rad", 0.0, 0.0, 1e5, _PER_ANGULAR_SPEED),),
            0x2281,
        ),
        removable=False,
    ),
    Effect(
        id="stribeck_friction",
        law="R += Fs·exp(-(v/vs)²)·sign(v), sticks at v = 0",
        domain=Domain.ROLLER_RESISTANCE,
        parameters=(
            Parameter("force_N", "N", 0.0, 0.0, 1e5, _FORCE),
            Parameter("speed_m_s", "m/s", 0.1, 1e-5, 100.0, Size(0.025, speed=1)),
        ),
        object_index=0x2202,
        shown_by="creep at 1 to 20 % of the highest speed",
        kinds=_EVERY_KIND,
        rotary=Rotary(
            "friction torque += Ts·exp(-(ω/ωs)²)·sign(ω), sticks at ω = 0",
            (
                Parameter("torque_Nm", "N·m", 0.0, 0.0, 1e5, _TORQUE),
                Parameter("speed_rad_s", "rad/s", 0.5, 1e-5, 1e4, Size(0.025, speed=1, radius=-1)),
            ),
            0x2282,
            Probe(ProbeOver.SHARES_OF_TOP_SPEED, "speed_rad_s", tried=_SHARES),
        ),
        probe=Probe(ProbeOver.SHARES_OF_TOP_SPEED, "speed_m_s", tried=_SHARES),
    ),
    Effect(
        id="roller_eccentricity",
        law="web speed = v·(1 + (a/r)·cos(phi + phi0)), phi the roller's angle",
        domain=Domain.WEB_KINEMATICS,
        parameters=(Parameter("amplitude_m", "m", 0.0, 0.0, 0.1, Size(0.35, radius=1, strain=1)), _phase()),
        object_index=0x2203,
        shown_by="hold a speed for many turns of the roller",
    ),
    Effect(
        id="friction_asymmetry",
        law="R += d·|v|: viscous b+d forward, b-d backward",
        domain=Domain.ROLLER_RESISTANCE,
        parameters=(Parameter("viscous_difference_N_s_per_m", "N·s/m", 0.0, -1e5, 1e5, _PER_SPEED),),
        object_index=0x2204,
        shown_by="run the same speeds in both directions",
        kinds=_EVERY_KIND,
        rotary=Rotary(
            "friction torque += d·|ω|: viscous b+d forward, b-d backward",
            (Parameter("viscous_difference_Nm_s_per_rad", "N·m·s/rad", 0.0, -1e5, 1e5, _PER_ANGULAR_SPEED),),
            0x2284,
        ),
    ),
    Effect(
        id="torque_ripple",
        law="shaft torque = motor torque + A·sin(n·phi_motor + phi0)",
        domain=Domain.MOTOR_TORQUE,
        parameters=(
            Parameter("amplitude_Nm", "N·m", 0.0, 0.0, 1e4, _MOTOR_TORQUE),
            Parameter("order", "1/turn", 1.0, 1e-3, 1e4, Size(1.0)),
            _phase(),
        ),
        object_index=0x2205,
        shown_by="ramp the speed slowly through many motor turns",
        slots=4,
        kinds=_EVERY_KIND,
        probe=Probe(ProbeOver.MOTOR_ANGLE, "order"),
    ),
    Effect(
        id="torque_offset",
        law="measured torque = motor torque + b",
        domain=Domain.TORQUE_MEASUREMENT,
        parameters=(Parameter("offset_Nm", "N·m", 0.0, -1e4, 1e4, _MOTOR_TORQUE),),
        object_index=0x2206,
        shown_by="hold two loads that are well apart",
        kinds=_EVERY_KIND,
        removable=False,
    ),
    Effect(
        id="torque_scale",
        law="shaft torque = (1+s)·(motor torque as the drive knows it)",
        domain=Domain.MOTOR_TORQUE,
        parameters=(_relative(0.05),),
        object_index=0x2207,
        shown_by="ramp the speed steeply and hold two loads",
        kinds=_EVERY_KIND,
    ),
    Effect(
        id="torque_delay",
        law="measured torque is the motor torque of delay_s ago",
        domain=Domain.TORQUE_MEASUREMENT,
        parameters=(Parameter("delay_s", "s", 0.0, 0.0, 0.05, Size(4.0, sample_time=1)),),
        object_index=0x2208,
        shown_by="ramp the speed steeply",
        kinds=_EVERY_KIND,
        probe=Probe(ProbeOver.STRENGTHS, "delay_s", tried=(0.25, 0.75, 2.5, 7.5)),
    ),
    Effect(
        id="inertia_mismatch",
        law="m·(1+s)",
        domain=Domain.INERTIA,
        parameters=(_relative(lower=-0.99),),
        object_index=0x2209,
        shown_by="ramp the speed steeply",
        kinds=_EVERY_KIND,
    ),
    Effect(
        id="inertia_step",
        law="J·(1+s) from time_s on",
        domain=Domain.INERTIA,
        parameters=(_onset(), _relative()),
        strength=("relative_change",),
        object_index=0x22A0,
        shown_by="ramp the speed steeply before and after the change",
        slots=4,
        kinds=frozenset({MachineKind.SERVO_AXIS}),
        probe=Probe(ProbeOver.ONSET, "time_s"),
    ),
    Effect(
        id="backlash",
        law="gear play: the motor turns by gap_rad (motor side, stop to stop) without moving the roller",
        domain=Domain.GEAR,
        parameters=(Parameter("gap_rad", "rad", 0.0, 0.0, 1.0, Size(0.01)),),
        object_index=0x220A,
        shown_by="let the torque change its sign: brake, reverse",
        needs_gear=True,
    ),
    Effect(
        id="elasticity_shift",
        per_section=True,
        law="E·(1+s)",
        domain=Domain.ELASTICITY,
        parameters=(_relative(),),
        object_index=0x220B,
        shown_by="step the tension",
    ),
    Effect(
        id="elasticity_step",
        per_section=True,
        law="E·(1+s) from time_s on",
        domain=Domain.ELASTICITY,
        parameters=(_onset(), _relative()),
        strength=("relative_change",),
        object_index=0x220C,
        shown_by="record longer before and after the change",
        slots=4,
        probe=Probe(ProbeOver.ONSET, "time_s"),
        lookalike=_FORCE_STEP,
    ),
    Effect(
        id="elasticity_drift",
        per_section=True,
        law="E·(1 + k·t)",
        domain=Domain.ELASTICITY,
        parameters=(Parameter("rate_per_s", "1/s", 0.0, -1.0, 1.0, Size(1e-3)),),
        object_index=0x220D,
        shown_by="record longer at constant conditions",
    ),
    Effect(
        id="web_damping",
        per_section=True,
        law="F = E·S·(strain + T·strain')",
        domain=Domain.ELASTICITY,
        parameters=(Parameter("time_constant_s", "s", 0.0, 0.0, 1.0, Size(5.0, sample_time=1)),),
        object_index=0x220E,
        shown_by="step the speed difference quickly",
    ),
    Effect(
        id="web_slip",
        per_section=True,
        law="web speed at the roller behind a span = v·(1 - c·(F - F_next)) (creep)",
        domain=Domain.WEB_KINEMATICS,
        parameters=(Parameter("creep_per_N", "1/N", 0.0, 0.0, 1e-2, Size(0.565, strain=1, force=-1)),),
        object_index=0x220F,
        shown_by="hold several tensions at several line speeds",
        implied_axis=2,
    ),
    Effect(
        id="strain_offset",
        per_section=True,
        law="F = E·S·(strain - strain0)",
        domain=Domain.ELASTICITY,
        parameters=(Parameter("strain", "1", 0.0, -0.1, 0.1, Size(0.07, strain=1)),),
        object_index=0x2210,
        shown_by="let E change, or load axis 1 with the web",
    ),
    Effect(
        id="upstream_disturbance",
        law="F_prev += A·sin(2·pi·f·t + phi0), the upstream strain in proportion",
        domain=Domain.BOUNDARY,
        parameters=(
            Parameter("amplitude_N", "N", 0.0, 0.0, 1e5, Size(0.025, force=1)),
            Parameter("frequency_Hz", "Hz", 1.0, 0.0, 250.0, Size(1.0)),
            _phase(),
        ),
        object_index=0x2211,
        shown_by="record longer at constant speed, then at another speed",
        slots=4,
        probe=Probe(ProbeOver.TIME, "frequency_Hz"),
    ),
    Effect(
        id="span_length_error",
        per_section=True,
        law="L·(1+s)",
        domain=Domain.GEOMETRY,
        parameters=(_relative(),),
        object_index=0x2212,
        shown_by="step the speed difference at several line speeds",
    ),
    Effect(
        id="elasticity_ramp",
        per_section=True,
        law="E·(1 + s·(t - time_s)/duration_s) from time_s on, E·(1+s) after duration_s",
        domain=Domain.ELASTICITY,
        parameters=(_onset(), Parameter("duration_s", "s", 1.0, 1e-3, 1e9, Size(1.0)), _relative()),
        strength=("relative_change",),
        object_index=0x2213,
        shown_by="record longer before and after the change",
        slots=2,
        probe=Probe(ProbeOver.ONSET_AND_DURATION, "time_s", "duration_s"),
        at_once="elasticity_step",
        lookalike=_FORCE_STEP,
    ),
    Effect(
        id="unbalance",
        law="torque on the roller += A·sin(phi + phi0), phi the roller's angle",
        domain=Domain.ROLLER_TORQUE,
        parameters=(Parameter("amplitude_Nm", "N·m", 0.0, 0.0, 1e5, _TORQUE), _phase()),
        object_index=0x2214,
        shown_by="turn slowly for many turns of the roller, then at another speed",
        kinds=_EVERY_KIND,
    ),
    # On the force through the gear, which is the motor's: a gear of efficiency η passes 1 - k = η of it when it drives
    # and takes 1/η = 1 + k when it is driven, to first order. Hamon, Gautier, Garrec, *Dynamic identification of robots
    # with a dry friction model depending on load and velocity* (IROS 2010), combine it with Coulomb's.
    Effect(
        id="load_dependent_friction",
        law="R += k·|load|·sign(v), load what the motor pushes with; sticks at v = 0",
        domain=Domain.GEAR,
        parameters=(Parameter("share", "1", 0.0, 0.0, 0.9, Size(0.05)),),
        object_index=0x2215,
        shown_by="run the same speeds in both directions under two loads that are well apart",
        kinds=_EVERY_KIND,
        alike=(("coulomb_friction", "turn both ways under two loads that are well apart"),),
    ),
    # Moved air, c = ½·ρ·c_w·A at the web: windage of rollers and fans, of a web at high speed.
    Effect(
        id="quadratic_drag",
        law="R += c·v·|v|",
        domain=Domain.ROLLER_RESISTANCE,
        parameters=(Parameter("coefficient_N_s2_per_m2", "N·s²/m²", 0.0, 0.0, 1e5, _PER_SQUARE),),
        object_index=0x2216,
        shown_by="hold several speeds up to the highest",
        kinds=_EVERY_KIND,
        rotary=Rotary(
            "friction torque += c·ω·|ω|",
            (Parameter("coefficient_Nm_s2_per_rad2", "N·m·s²/rad²", 0.0, 0.0, 1e5, _PER_ANGULAR_SQUARE),),
            0x2296,
        ),
    ),
    # Ripple that comes from the current (errors of its scale in the phases, harmonics of the back-EMF) grows with it;
    # cogging, which does not, is torque_ripple: Holtz, Springob, *Identification and compensation of torque ripple in
    # high-precision permanent magnet motor drives* (IEEE Trans. IE 1996).
    Effect(
        id="torque_ripple_load",
        law="shaft torque = motor torque·(1 + A·sin(n·phi_motor + phi0))",
        domain=Domain.MOTOR_TORQUE,
        parameters=(
            Parameter("relative_amplitude", "1", 0.0, 0.0, 0.5, Size(0.05)),
            Parameter("order", "1/turn", 1.0, 1e-3, 1e4, Size(1.0)),
            _phase(),
        ),
        object_index=0x2217,
        shown_by="ramp the speed slowly through many motor turns under two loads that are well apart",
        slots=4,
        kinds=_EVERY_KIND,
        probe=Probe(ProbeOver.MOTOR_ANGLE, "order", by_torque=True),
        alike=(("torque_ripple", "turn slowly under two loads that are well apart"),),
    ),
    # By the actual motion, not the reference: a loop whose feed-forward fits makes one into the other, and the recorded
    # torque then lacks exactly this. The loop's better tracking by it is no part of the law.
    Effect(
        id="feed_forward",
        law="measured torque leaves out s_J·m·a + s_b·b·v + s_C·Fc·sign(v), what a feed-forward adds behind the loop",
        domain=Domain.TORQUE_MEASUREMENT,
        parameters=(_fed_forward("inertia_share"), _fed_forward("viscous_share"), _fed_forward("coulomb_share")),
        strength=("inertia_share", "viscous_share", "coulomb_share"),
        object_index=0x2218,
        shown_by="run the same motion with the feed-forward off, or with the load motor's torque recorded",
        kinds=_EVERY_KIND,
        alike=(
            ("inertia_mismatch", "run the same motion with the feed-forward off"),
            ("viscous_friction", "run the same motion with the feed-forward off"),
            ("coulomb_friction", "run the same motion with the feed-forward off"),
        ),
    ),
    # An eccentric disc (Ernst, *Digital length and angle measurement technology*), or a resolver's unequal amplitudes.
    Effect(
        id="encoder_error",
        law="measured motor angle = phi + A·sin(phi + phi0), phi the motor's angle; the drive's loops believe it",
        domain=Domain.POSITION_MEASUREMENT,
        parameters=(Parameter("amplitude_rad", "rad", 0.0, 0.0, 0.5, Size(1e-3)), _phase()),
        object_index=0x2219,
        shown_by="hold a low and a high speed for many turns of the motor",
        kinds=_EVERY_KIND,
        alike=(("torque_ripple", "hold a low and a high speed: the error of an encoder grows with its square"),),
    ),
    Effect(
        id="drive_gain",
        law="gains of the velocity loop kp·(1 + p) and ki·(1 + q)",
        domain=Domain.DRIVE,
        parameters=(
            _relative(0.2, "kp_relative_change", required=False),
            _relative(0.2, "ki_relative_change", required=False),
        ),
        strength=("kp_relative_change", "ki_relative_change"),
        object_index=0x221A,
        shown_by="step the speed",
        kinds=_EVERY_KIND,
        nuisance=True,
    ),
    Effect(
        id="drive_lag",
        law="time constant of the current loop T + lag_s, 0 at least",
        domain=Domain.DRIVE,
        parameters=(Parameter("lag_s", "s", 0.0, -0.1, 0.1, Size(2.0, sample_time=1)),),
        object_index=0x221B,
        shown_by="step the speed",
        kinds=_EVERY_KIND,
        nuisance=True,
        alike=(("torque_delay", "step the speed: a torque that is reported late moves nothing"),),
    ),
    # Two masses (Schröder, *Elektrische Antriebe - Regelung von Antriebssystemen*), all friction at the motor. From its
    # torque to its speed there are zeros where the load oscillates against a held motor, and poles above them where
    # both oscillate.
    Effect(
        id="resonance",
        law=(
            "inertia_share of the inertia is behind a shaft that twists, and swings at frequency_Hz while the motor is "
            "held (antiresonance); with the motor, at frequency_Hz/sqrt(1 - inertia_share) (resonance)"
        ),
        domain=Domain.INERTIA,
        parameters=(
            Parameter("inertia_share", "1", 0.0, 0.0, 0.95, Size(0.2)),
            Parameter("frequency_Hz", "Hz", 30.0, 0.5, 400.0, Size(1.0)),
            Parameter("damping", "1", 0.05, 1e-3, 2.0, Size(0.05), required=False),
        ),
        object_index=0x221D,
        shown_by="step the speed as steeply as the drive can",
        kinds=frozenset({MachineKind.SERVO_AXIS}),
        probe=Probe(ProbeOver.FREQUENCIES, "frequency_Hz", tried=_FREQUENCIES_HZ),
    ),
    # Springs in series: one tension in a span, a strain in each piece. It comes in with the strain of the web that
    # enters, as for the step of E (Brandenburg 1973; its tension upstream is another then). A splice is twice as
    # thick, or soft with glue.
    Effect(
        id="splice",
        law="a piece of web with E·(1+s), length_m long, enters at time_s: in a span in series with the rest",
        domain=Domain.ELASTICITY,
        parameters=(_onset(), _relative(0.3), Parameter("length_m", "m", 0.3, 1e-3, 1e4, Size(0.3), required=False)),
        strength=("relative_change",),
        object_index=0x221C,
        shown_by="record several passages, and one at another speed",
        probe=Probe(ProbeOver.PASSAGE, "time_s"),
    ),
)

#: Largest difference of a station's value from the model's.
_MOST = 1e6
_CARRIAGES, _ROLLERS = frozenset({"dancer", "accumulator"}), frozenset({"idler", "dancer", "accumulator"})


def _of_a_station(
    effect_id: str, law: str, parameter: Parameter, stations: frozenset[str], index: int, shown_by: str
) -> Effect:
    return Effect(
        id=effect_id,
        law=law,
        domain=Domain.STATION,
        parameters=(parameter,),
        object_index=index,
        shown_by=shown_by,
        stations=stations,
    )


#: Effects of dancers, accumulators, idlers and reels: differences from the model's values. A negative friction or
#: spring is limited to 0.
STATION_EFFECTS: tuple[Effect, ...] = (
    _of_a_station(
        "carriage_coulomb_friction",
        "friction of the carriage += Fc·sign(v), sticks at v = 0",
        Parameter("force_N", "N", 0.0, -_MOST, _MOST, _FORCE),
        _CARRIAGES,
        0x2240,
        "move the carriage to and fro",
    ),
    _of_a_station(
        "carriage_viscous_friction",
        "friction of the carriage += b·v",
        Parameter("coefficient_N_s_per_m", "N·s/m", 0.0, -_MOST, _MOST, Size(5.0, force=1, speed=-1)),
        _CARRIAGES,
        0x2241,
        "move the carriage to and fro, fast and slowly",
    ),
    _of_a_station(
        "carriage_force",
        "what pushes the carriage += F",
        Parameter("force_N", "N", 0.0, -_MOST, _MOST, _FORCE),
        _CARRIAGES,
        0x2242,
        "run at a steady speed",
    ),
    _of_a_station(
        "carriage_spring",
        "spring of the carriage += k",
        Parameter("stiffness_N_per_m", "N/m", 0.0, -_MOST, _MOST, Size(0.1, force=1, radius=-1)),
        _CARRIAGES,
        0x2243,
        "hold several positions of the carriage",
    ),
    _of_a_station(
        "idler_coulomb_friction",
        "friction of each roller without a motor += Fc·sign(v), sticks at v = 0",
        Parameter("force_N", "N", 0.0, -_MOST, _MOST, Size(0.02, force=1)),
        _ROLLERS,
        0x2244,
        "stop, start and reverse the line",
    ),
    _of_a_station(
        "idler_viscous_friction",
        "friction of each roller without a motor += b·v",
        Parameter("coefficient_N_s_per_m", "N·s/m", 0.0, -_MOST, _MOST, Size(0.02, force=1, speed=-1)),
        _ROLLERS,
        0x2245,
        "hold several speeds",
    ),
    _of_a_station(
        "reel_radius",
        "radius at the start = r·(1+s)",
        Parameter("relative_change", "1", 0.0, -0.3, 0.3, Size(0.005)),
        frozenset({"unwinder", "rewinder"}),
        0x2246,
        "wind for a while at several speeds",
    ),
)

_OF_KIND: Mapping[MachineKind, dict[str, Effect]] = {
    kind: {effect.id: effect.in_kind(kind) for effect in EFFECTS if kind in effect.kinds} for kind in MachineKind
}
#: Including those of the stations that a line may have.
_KNOWN: Mapping[MachineKind, Mapping[str, Effect]] = {
    **_OF_KIND,
    MachineKind.WEB_LINE: _OF_KIND[MachineKind.WEB_LINE] | {effect.id: effect for effect in STATION_EFFECTS},
}


def effects_of(kind: MachineKind) -> tuple[Effect, ...]:
    """Vocabulary of a kind of machine, with its units there; without effects of stations."""
    return tuple(_OF_KIND[kind].values())


def find_effect(effect_id: str, kind: MachineKind = MachineKind.WEB_LINE) -> Effect:
    """Effect with this id. Raises KeyError with a message that lists the ids known for that kind of machine."""
    known = _KNOWN[kind]
    try:
        return known[effect_id]
    except KeyError:
        raise KeyError(f"unknown effect '{effect_id}'{expected_one_of(effect_id, known)}") from None


#: Emulated effects of a line, for a message.
_EMULATED_OF_A_LINE = "an effect of the web or a roller's resistance"


def effect_problem(
    effect_id: str,
    axis: int | None,
    place: EffectPlace,
    axes: int | None,
    loaded: Collection[int] | None = (),
    kind: MachineKind = MachineKind.WEB_LINE,
    *,
    section: Section | None = None,
    sections: int | None = None,
) -> str | None:
    """Reason why an effect can't be hidden at a place, in one line, or None.

    axis, section: those given for it, from 1, or a station's name (None: none). axes, sections: number of them in the
    machine. loaded: axes with a load motor on their shaft. Unknown properties of the machine are None.
    """
    try:
        effect = find_effect(effect_id, kind)
    except KeyError as error:
        return str(error.args[0])
    if not effect.enters(place):
        if place is EffectPlace.HARDWARE:
            expected = "expected one of the axes; the web is the load model's"
            return f"effect '{effect_id}' in the simulated hardware, {expected}"
        emulated = "a resistance of the shaft" if kind is MachineKind.SERVO_AXIS else _EMULATED_OF_A_LINE
        return f"{emulated}; {effect_id} belongs in 'hardware:'"
    if place is EffectPlace.LOAD and effect.domain in AT_A_ROLLER and loaded is not None and axis not in loaded:
        where, motor = " or ".join(map(str, loaded)) or "none", "a load motor" if len(loaded) > 1 else "the load motor"
        return f"{effect_id} of axis {where}, where {motor} is; other axes' in 'hardware:'"
    return effect.axis_problem(axis, axes) or effect.section_problem(section, sections)
