"""Measured signals of a recording, checked: nothing is guessed, nothing read that only a simulation knows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.data_cleaning import Repair, mended
from hilbench.diagnosis.noise import floor
from hilbench.diagnosis.web_measurements import (
    SLOW_HZ,
    SlowMotion,
    StationSensor,
    accelerates,
    carriage_forces,
    exchanged,
    station_sensors,
    tension_channels,
    unit_of,
)
from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording
from hilbench.topology.signal_kinds import TIME

#: Sampling periods that can be worked with, s.
SHORTEST_PERIOD_S: Final = 0.0005
LONGEST_PERIOD_S: Final = 0.02
#: Least length: below, not even a drift of the noise can be distinguished from an effect.
SHORTEST_S: Final = 5.0
#: Share of the period by which two samples may be further apart than others.
_UNEVEN: Final = 0.01
#: Speeds (by the unit of the position) and strains that a machine has; beyond them a channel is in other units than its
#: name says.
_FASTEST: Final = {"m": 100.0, "rad": 1e4}
_LARGEST_STRAIN: Final = 0.1
#: Speed (m/s, rad/s) below which an axis is at rest, where dry friction is not one law; mean speed from which it has
#: moved.
STANDSTILL_M_S: Final = 5.0 * FRICTION_WIDTH_M_S
_NOTHING_MOVES_M_S: Final = 1e-3
#: Range of a position over its noise from which it is motion, and the steps in which its travel is added up, s.
_OVER_NOISE, _STEP_S = 30.0, 0.1
#: Time without commands after which a free run has forgotten nothing it should and knows nothing it must, s.
_LONGEST_GAP_S: Final = 0.5
#: How long standstill acts on what comes after it, s, and the share of a recording that may be left out for it.
_MOVING_S, _MOSTLY = 0.25, 0.6
#: Share by which two channels of one motion may differ.
_SAME_MOTION: Final = 0.5
#: Least share of a motion's variance that two channels of it have in common.
_ALIKE: Final = 0.9
#: How many times as fast as its position a speed moves where one of the two is in another unit, and which.
_UNITS: Final = (
    (60.0 / (2.0 * np.pi), "v", "rpm", 2.0 * np.pi / 60.0),
    (180.0 / np.pi, "v", "degrees/s", np.pi / 180.0),
    (60.0, "v", "m/min (or rad/min)", 1.0 / 60.0),
    (1000.0, "v", "mm/s", 1e-3),
    (1.0 / (2.0 * np.pi), "v", "turns/s", 2.0 * np.pi),
    (2.0 * np.pi, "x", "turns", 2.0 * np.pi),
    (np.pi / 180.0, "x", "degrees", np.pi / 180.0),
    (1e-3, "x", "mm", 1e-3),
    (1e-6, "x", "µm", 1e-6),
)
_TURN: Final = 2.0 * np.pi
#: Time over which the travels of the web at two rollers are compared, s.
_SAME_TRAVEL_S: Final = 0.5
#: Share by which such a ratio may be missed.
_RATIO: Final = 0.03
_BOUNDARY = ("strain_prev", "F_next_N")
#: How many times as large what enters and leaves is in another unit, which that is, and the right one; and the factor
#: by which it may differ from the model's all the same.
_OTHER_UNITS: Final = {"strain_prev": ((100.0, "%", "a strain (1)"),), "F_next_N": ((1e-3, "kN", "N"),)}
_SAME_SIZE: Final = 2.5
_MAPPED: Final = "say which columns are which channels with 'hilbench convert --columns'"
#: Only a bench has it: who records a web that is there has no load motor.
_LOAD_MOTOR: Final = re.compile(r"tau_\w+_cmd_Nm")


@dataclass(frozen=True)
class Before:
    """Encoder positions up to and with the first row of what was measured, at its period."""

    x_m: Array  #: (m, axes)
    boundary: Array  #: (m, 2) upstream strain, downstream tension (N)
    strain: Array  #: (spans,) of the web at the first of these rows


@dataclass(frozen=True)
class Measured:
    """Checked arrays of one recording; times from 0. `missing` are channels a diagnosis could have used.

    Of a rotary machine positions are in rad, and speeds in rad/s.
    """

    t_s: Array  #: (n,)
    period_s: float
    commands_m_s: Array  #: (n, axes); empty for a lone axis without commands
    boundary: Array  #: (n, 2) upstream strain, downstream tension (N)
    tau_Nm: dict[int, Array]  #: by axis, what is recorded of it
    x_m: dict[int, Array]
    v_m_s: dict[int, Array]
    missing: list[str] = field(default_factory=list)
    emulated: bool = False  #: a load motor emulated the web
    left_out: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  #: (n,), or none: see `usable`
    repairs: list[Repair] = field(default_factory=list)  #: what was wrong with the rows, and is mended
    F_N: dict[int, Array] = field(default_factory=dict)  #: measured tensions, by span
    integrated: bool = False  #: the position is that of a lone axis' speed, added up
    #: Of carriages and reels with a sensor what it said, by the station's name.
    sensors_m: dict[str, StationSensor] = field(default_factory=dict)
    forces_N: dict[str, Array] = field(default_factory=dict)  #: commands to carriages, by station (n,)
    #: What was before the first row; None: nobody knows.
    before: Before | None = None
    #: Displacement of all axes by commands that drives may have taken too late, at most.
    put_off_m: float = 0.0
    #: Rows at which something beyond machine and commands has pushed the axes.
    pushed: tuple[int, ...] = ()
    #: Whoever took this takes it that nothing set in meanwhile: what there is was there from the first row on.
    settled: bool = False
    #: Angle (n,) of another axis that the only one of a rotary machine is coupled with, relative to it.
    other_rad: Array | None = None

    @property
    def duration_s(self) -> float:
        """Length of the recording."""
        return float(self.t_s[-1])

    def usable(self, around_s: float = 0.0) -> NDArray[np.bool_]:
        """(n,): the rows that are as they were measured, and not within a time of one that is not."""
        if not np.any(self.left_out):
            return np.ones(len(self.t_s), bool)
        width = round(around_s / self.period_s)
        return np.asarray(np.convolve(self.left_out, np.ones(2 * width + 1), "same") < 0.5)

    def usable_in_motion(self, at_rest: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(n,): the rows as they were measured, without those at rest (n,), where dry friction is not one law, and what
        these act on: that is forgotten `_MOVING_S` after the axes move again."""
        near = np.convolve(at_rest, np.ones(round(_MOVING_S / self.period_s) + 1), "full")[: len(at_rest)] > 0.0
        usable = ~near if np.mean(near) < _MOSTLY else np.ones(len(at_rest), bool)
        return np.asarray(usable & self.usable(_MOVING_S))


def measured_from(recording: Recording, model: Machine, place: str | Path) -> Measured:
    """Check and take what is needed. Raises UnusableInputError, one line, for what can't be diagnosed."""
    lone, axes = machines.is_lone(model), range(1, model.axis_count + 1)
    commands = [machines.speed_channel(model, axis, "_cmd") for axis in axes]
    emulated = any(_LOAD_MOTOR.fullmatch(name) and bool(np.any(v)) for name, v in recording.channels.items())
    free = not lone or (emulated and model.drives is not None)  # run with the drives' loops, which know their limits
    if TIME not in recording:
        raise UnusableInputError(
            place, f"channel {TIME} missing, expected beside {', '.join(recording.channels)}: {_MAPPED}"
        )
    if any(f"tau{axis}_cmd_Nm" in recording for axis in axes):
        raise UnusableInputError(
            place, "a recording of an axis in torque mode, expected all axes of a line with 'stations' to follow speeds"
        )
    found = mended(
        recording,
        place,
        longest_gap_s=float("inf") if lone else _LONGEST_GAP_S,
        limits_Nm=_limits_Nm(model) if free else None,
    )
    recording = found.recording
    period_s = _period_s(recording.time_s, place)
    if machines.has_stations(model) and not (emulated and all(name in recording for name in commands)):
        raise UnusableInputError(
            place,
            "a model with 'stations', expected a recording of a bench that emulates it, with the commands of all axes",
        )
    if not lone and model.drives is None:
        raise UnusableInputError(place, "a model with a web and no 'drives', expected the drives' control loops")
    torques = {axis: f"tau{axis}_Nm" for axis in axes}
    positions = {axis: machines.position_channel(model, axis) for axis in axes}
    speeds = {axis: machines.speed_channel(model, axis) for axis in axes}
    wanted = [each[axis] for axis in axes for each in (torques, positions, speeds)]
    tensions: dict[int, str] = {}
    if lone:
        _check_lone(recording, model, place)
    else:
        wanted += commands
        recording.require(_BOUNDARY, place)
        _check_enough(recording, place, commands)
        tensions = tension_channels(recording, model.span_count)
    there = [name for name in wanted if name in recording] + list(tensions.values())
    other = machines.position_channel(model, 2)  # of the axis that the only one of a rotary machine is coupled with
    coupled = model.position_unit == "rad" and other in recording
    recording.require([*there, other] if coupled else there, place)

    def channel(name: str) -> Array:
        return np.asarray(recording[name], np.float64)

    def channels(names: dict[int, str]) -> dict[int, Array]:
        return {axis: channel(name) for axis, name in names.items() if name in recording}

    n = len(recording)
    commanded = free and all(name in recording for name in commands)
    x, v = channels(positions), channels(speeds)
    integrated = lone and not x
    if integrated:
        x = {axis: cumulative_trapezoid(values, dx=period_s, initial=0) for axis, values in v.items()}
    measured = Measured(
        t_s=recording.time_s - recording.time_s[0],
        period_s=period_s,
        commands_m_s=np.column_stack([channel(name) for name in commands]) if commanded else np.empty((n, 0)),
        boundary=np.zeros((n, 2)) if lone else np.column_stack([channel(name) for name in _BOUNDARY]),
        tau_Nm=channels(torques),
        x_m=x,
        v_m_s=v,
        missing=[name for name in wanted if name not in there],
        emulated=emulated,
        left_out=found.left_out,
        repairs=found.repairs,
        F_N=channels(tensions),
        integrated=integrated,
        sensors_m=station_sensors(recording, model),
        forces_N=carriage_forces(recording, model),
        other_rad=channel(other) if coupled else None,
    )
    if machines.has_stations(model) and abs(float(measured.commands_m_s[0, -1])) > STANDSTILL_M_S:
        raise UnusableInputError(place, "a line with 'stations' in motion at the first row, expected it at rest there")
    _check_plausible(measured, model, place)
    return measured


def _check_lone(recording: Recording, model: Machine, place: str | Path) -> None:
    """A lone axis needs a torque, and how it moved in the unit of its machine."""
    position, speed = machines.position_channel(model, 1), machines.speed_channel(model, 1)
    other = {"m": ("x1_rad", "v1_rad_s"), "rad": ("x1_m", "v1_m_s")}[model.position_unit]
    if position not in recording and speed not in recording:
        found = [name for name in other if name in recording]
        if found:
            raise UnusableInputError(
                place,
                f"channel {', '.join(found)} and a model of kind {model.kind}, expected {position} or {speed}: a"
                f" {model.kind} moves in {model.position_unit}",
            )
        raise UnusableInputError(
            place,
            f"channels {position}, {speed} missing, expected one of them beside {', '.join(recording.channels)}:"
            f" {_MAPPED}",
        )
    recording.require(["tau1_Nm"], place)


def _check_enough(recording: Recording, place: str | Path, commands: list[str]) -> None:
    """A web line needs a torque, and the commands of all axes or how all moved."""
    axes = range(1, len(commands) + 1)
    if not any(f"tau{axis}_Nm" in recording for axis in axes):
        torques = ", ".join(f"tau{axis}_Nm" for axis in axes)
        raise UnusableInputError(place, f"channels {torques} missing, expected at least one torque")
    if all(name in recording for name in commands):
        return
    missing = [name for name in commands if name not in recording]
    if all(f"x{axis}_m" in recording for axis in axes):
        return
    for name in (f"{letter}{axis}_{unit}" for letter, unit in (("v", "m_s"), ("tau", "Nm")) for axis in axes):
        if name not in recording and not (name[0] == "v" and f"x{name[1]}_m" in recording):
            missing.append(name)
    all_of = "both" if len(axes) == 2 else "all"
    if len(missing) > sum(name in commands for name in missing):
        raise UnusableInputError(
            place,
            f"channels {', '.join(missing)} missing, expected the commands of {all_of} axes, or the positions of"
            f" {all_of}, or the speeds and torques of {all_of}",
        )


def _period_s(t_s: Array, place: str | Path) -> float:
    steps = np.diff(t_s)
    length = float(t_s[-1] - t_s[0] + np.median(steps)) if len(steps) else 0.0  # the last row is a period long as well
    if length < (1.0 - 1e-9) * SHORTEST_S:
        raise UnusableInputError(place, f"{length:g} s long, expected at least {SHORTEST_S:g} s")
    period_s = float(np.median(steps))
    odd = np.flatnonzero(np.abs(steps - period_s) > _UNEVEN * period_s)
    if len(odd):
        at = odd[0]
        raise UnusableInputError(
            place,
            f"channel t_s: {steps[at]:g} s after t = {t_s[at]:g} s where the others are {period_s:g} s apart"
            f" ({len(odd)} such places), expected even sampling",
        )
    if not (1.0 - _UNEVEN) * SHORTEST_PERIOD_S <= period_s <= (1.0 + _UNEVEN) * LONGEST_PERIOD_S:
        raise UnusableInputError(
            place,
            f"channel t_s: samples {period_s:g} s apart, expected {SHORTEST_PERIOD_S:g} to {LONGEST_PERIOD_S:g} s",
        )
    return round(float((t_s[-1] - t_s[0]) / len(steps)), 9)


def _check_plausible(measured: Measured, model: Machine, place: str | Path) -> None:
    _check_units(measured, model, place)
    speeds = {machines.speed_channel(model, axis): values for axis, values in measured.v_m_s.items()}
    for column, values in enumerate(measured.commands_m_s.T):
        speeds[machines.speed_channel(model, column + 1, "_cmd")] = values
    # Of a lone axis with a radius of 1 m and no gear an angle may stand for the position.
    turns = machines.is_lone(model) and model.motor_rad_per_unit(1) == 1.0
    fastest, unit = _FASTEST["rad" if turns else model.position_unit], machines.speed_unit(model)
    for name, values in speeds.items():
        largest = float(np.max(np.abs(values)))
        if largest > fastest:
            raise UnusableInputError(place, f"channel {name} reaches {largest:g}, expected {unit} up to {fastest:g}")
    _check_motion(measured, model, place)
    if isinstance(model, ModelParameters) and model.span_count and not machines.has_stations(model):
        _check_directions(measured, place)
    strain = float(np.max(np.abs(measured.boundary[:, 0])))
    if strain > _LARGEST_STRAIN:
        raise UnusableInputError(place, f"channel strain_prev reaches {strain:g}, expected a strain (1) below 0.1")
    if isinstance(model, ModelParameters) and model.span_count:
        _check_boundary(measured, model, place)
    _check_torques(measured, model, place)
    if not measured.emulated:
        _check_driven(measured, model, place)
    moves = [_travel(x, measured.period_s) for x in measured.x_m.values()]
    moves += [float(np.max(np.abs(v))) * measured.duration_s for v in speeds.values()]
    if max(moves, default=0.0) < _NOTHING_MOVES_M_S * measured.duration_s:
        what = "speed and tension" if not machines.is_lone(model) else "speed"
        raise UnusableInputError(place, f"nothing moves, expected an experiment with changes of {what}")


def _travel(x: Array, period_s: float) -> float:
    """Travel of an axis, to and fro; its range where that may be noise."""
    reach = float(np.ptp(x))
    return reach if reach < _OVER_NOISE * floor(x) else _to_and_fro(x, period_s)


def _to_and_fro(x: Array, period_s: float) -> float:
    """Sum of an axis's steps of `_STEP_S`, noise included."""
    return float(np.sum(np.abs(np.diff(x[:: max(1, round(_STEP_S / period_s))]))))


def _limits_Nm(model: Machine) -> dict[str, float]:
    """Torque limits of the drives, by torque channel."""
    if model.drives is None:
        return {}
    limits_Nm = model.drives.torque_limit_Nm
    return {f"tau{axis}_Nm": float(per_item(limits_Nm, axis)) for axis in range(1, model.axis_count + 1)}


def _check_units(measured: Measured, model: Machine, place: str | Path) -> None:
    """A speed must be the rate of its position: where it is that in other units, they are to be said."""
    width = max(1, round(0.05 / measured.period_s))
    for axis in [] if measured.integrated else sorted(set(measured.x_m) & set(measured.v_m_s)):
        whole = len(measured.t_s) // width * width
        rate = np.diff(measured.x_m[axis][:whole:width]) / (width * measured.period_s)
        speed = measured.v_m_s[axis][:whole].reshape(-1, width).mean(axis=1)[: len(rate)]
        both = float(rate @ speed) / max(float(np.linalg.norm(rate) * np.linalg.norm(speed)), 1e-300)
        ratio = float(rate @ speed) / max(float(rate @ rate), 1e-300)
        if both < _ALIKE or abs(np.log(max(ratio, 1e-300))) < np.log(1.0 + _SAME_MOTION):
            continue
        position, rate_of = machines.position_channel(model, axis), machines.speed_channel(model, axis)
        text = f"channel {rate_of} is {ratio:.4g} times the rate of {position}"
        for known, letter, unit, factor in (*_UNITS, *_of_the_machine(model, axis)):
            if abs(ratio / known - 1.0) < _RATIO:
                name = rate_of if letter == "v" else position
                raise UnusableInputError(
                    place,
                    f"{text}, as if {name} were in {unit}, expected SI units: say so with 'hilbench convert --columns'"
                    f" and {name}: {{column: {name}, factor: {factor:.6g}}}",
                )
        raise UnusableInputError(
            place, f"{text}, expected both in the same unit, of the same axis, by the times in t_s"
        )


def _of_the_machine(model: Machine, axis: int) -> Iterator[tuple[float, str, str, float]]:
    """Unit conversions as in `_UNITS`, for rotating parts where positions and speeds are those of the web."""
    if model.position_unit != "m":
        return
    motor = model.motor_rad_per_unit(axis)
    for what, rad_per_m in (("motor", motor), ("roller", motor / model.gear_ratio(axis))):
        yield rad_per_m * 60.0 / _TURN, "v", f"rpm of the {what}", _TURN / 60.0 / rad_per_m
        yield rad_per_m, "v", f"rad/s of the {what}", 1.0 / rad_per_m
        yield 1.0 / rad_per_m, "x", f"rad of the {what}", 1.0 / rad_per_m


def _check_directions(measured: Measured, place: str | Path) -> None:
    """Check that the web travels as far at all rollers, but for its strain."""
    travel = measured.x_m if len(measured.x_m) > 1 else {}
    rows = max(1, round(_SAME_TRAVEL_S / measured.period_s))
    steps = {axis: np.diff(x[::rows]) for axis, x in sorted(travel.items())}
    for (axis, one), (other, two) in pairwise(steps.items()):
        apart = float(np.sum(np.abs(one - two))) / max(float(np.sum(np.maximum(np.abs(one), np.abs(two)))), 1e-300)
        if apart > _LARGEST_STRAIN:
            raise UnusableInputError(
                place,
                f"channels x{axis}_m and x{other}_m move {np.sum(one):.4g} and {np.sum(two):.4g} m, by"
                f" {100.0 * apart:.0f} % of the way apart, expected one web, of one recording, forward positive at all"
                " rollers",
            )


def _check_boundary(measured: Measured, model: ModelParameters, place: str | Path) -> None:
    """Check the size of boundary inputs against the model: other units differ by a factor of a hundred."""
    usual = {"strain_prev": model.upstream_strain, "F_next_N": model.boundary.downstream_tension_N}
    for (name, known), values in zip(usual.items(), measured.boundary.T, strict=True):
        ratio = float(np.mean(values)) / known if known > 0.0 else 1.0
        for factor, unit, right in _OTHER_UNITS[name]:
            if ratio > 0.0 and abs(np.log(ratio / factor)) < np.log(_SAME_SIZE):
                raise UnusableInputError(
                    place,
                    f"channel {name} is {ratio:.3g} times the {known:.3g} of the model, as if it were in {unit},"
                    f" expected {right}: say so with 'hilbench convert --columns' and {name}: {{column: {name},"
                    f" factor: {1.0 / factor:.6g}}}",
                )


def _check_driven(measured: Measured, model: Machine, place: str | Path) -> None:
    """A torque must accelerate its axis: one with the other sign, in another unit, or of another axis does not."""
    usable = measured.usable(1.0 / SLOW_HZ)
    motion = SlowMotion.of(measured.x_m, measured.v_m_s, measured.tau_Nm, measured.period_s, usable)
    for axis in measured.tau_Nm:
        share = motion.inertia_share(axis, machines.Nm_per_acceleration(model, axis))
        if share is None:
            continue
        unit = unit_of(share)
        as_if = f", as if it were in {unit}" if unit else ""
        text = f"channel tau{axis}_Nm is {share:.3g} times the torque that accelerates axis {axis} by the model{as_if}"
        if machines.is_lone(model):  # of which it may be the model that has another inertia
            if unit is not None:
                measured.repairs.append(Repair("unit", f"tau{axis}_Nm", 0, f"{text}: taken as N·m all the same"))
        elif unit is not None or not accelerates(share):
            raise UnusableInputError(place, f"{text}, expected N·m of the motor, positive where it drives forward")
    if isinstance(model, ModelParameters) and not machines.is_lone(model):
        for one, two in exchanged(motion, model, measured.boundary):
            raise UnusableInputError(
                place,
                f"channel tau{one}_Nm is the torque that axis {two} needs by the model and tau{two}_Nm that of axis"
                f" {one}, as if the two were exchanged, expected each axis' own",
            )


def _check_motion(measured: Measured, model: Machine, place: str | Path) -> None:
    """Check that each axis moves as fast as it is commanded, by its position and by its speed: a dead channel does
    not."""
    for axis, command in enumerate(measured.commands_m_s.T, 1):
        commanded = float(np.sum(np.abs(command[:-1]))) * measured.period_s
        for name, moved in _travels(measured, model, axis):
            if commanded > 0.1 and not 0.5 < moved / commanded < 2.0:
                raise UnusableInputError(
                    place,
                    f"channel {name} moves {moved:.4g} while {machines.speed_channel(model, axis, '_cmd')} says"
                    f" {commanded:.4g} {model.position_unit}, expected position in {model.position_unit} and speed in"
                    f" {machines.speed_unit(model)}",
                )


def _travels(measured: Measured, model: Machine, axis: int) -> Iterator[tuple[str, float]]:
    """Travel of an axis to and fro by each channel of its motion."""
    period_s = measured.period_s
    if axis in measured.x_m and not measured.integrated:
        yield machines.position_channel(model, axis), _to_and_fro(measured.x_m[axis], period_s)
    if axis in measured.v_m_s:
        added = cumulative_trapezoid(measured.v_m_s[axis], dx=period_s, initial=0)
        yield machines.speed_channel(model, axis), _to_and_fro(added, period_s)


def _check_torques(measured: Measured, model: Machine, place: str | Path) -> None:
    limits_Nm = _limits_Nm(model)
    for name, torque in ((f"tau{axis}_Nm", torque) for axis, torque in measured.tau_Nm.items()):
        if float(np.ptp(torque)) == 0.0:
            raise UnusableInputError(place, f"channel {name} never changes, expected a measured torque")
        largest, limit = float(np.max(np.abs(torque))), limits_Nm.get(name, float("inf"))
        if largest > 3.0 * limit:
            raise UnusableInputError(
                place, f"channel {name} reaches {largest:g}, expected N·m within the drive's limit of {limit:g}"
            )
