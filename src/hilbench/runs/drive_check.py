"""Check of an experiment's steps against what the objects of the drives' EDS files allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

from hilbench.cia402 import objects
from hilbench.cia402.assumed import MAX_TORQUE
from hilbench.cia402.units import RPM
from hilbench.exchange.addressing import declared_objects, declared_units
from hilbench.plant.parameters import per_item
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.metrics import metrics_of
from hilbench.runs.set_point_schedule import Move
from hilbench.topology.parts import Part, Role
from hilbench.topology.safety import Limit


@dataclass(frozen=True)
class _Allowed:
    """Limits of a drive, in the machine's unit of position: speed per s, by which object; and acceleration per s²."""

    part: Part
    speed: float
    by: str
    acceleration: float


def drive_warnings(loaded: LoadedConfig, asked: list[Move]) -> Iterator[str]:
    """The drive that each step asks the most of, where that is more than it allows."""
    config = loaded.config
    allowed = [_allowed(config, part) for part in config.parts if part.role is not Role.VIRTUAL_IO]
    slowest = min(allowed, key=lambda drive: drive.speed)
    laziest = min(allowed, key=lambda drive: drive.acceleration)
    speed = metrics_of(config.machine.kind, config.shape).speed
    path, unit = speed.path, speed.unit
    for move in asked:
        before, after = move.before.values[path], move.after.values[path]
        if before == after:
            continue
        at = loaded.document.place(move.after.place)
        if abs(after) > slowest.speed:
            rpm = config.machine.motor_rad_per_unit(slowest.part.axis or 1) / RPM
            yield (
                f"{at}: {after:g} {unit} asks for {abs(after) * rpm:.0f} rpm of {slowest.part.name}, which goes up to "
                f"{slowest.speed * rpm:.0f} rpm ({slowest.by}): it is at its limit, expected at most "
                f"{slowest.speed:.3g} {unit}"
            )
        if move.duration_s > 0.0 and abs(after - before) / move.duration_s > laziest.acceleration:
            yield (
                f"{at}: from {before:g} to {after:g} {unit} within {move.duration_s:g} s is faster than "
                f"{laziest.part.name} accelerates (60C5h), expected a ramp of "
                f"{abs(after - before) / laziest.acceleration:.3g} s or more"
            )


def _allowed(config: ExperimentConfig, part: Part) -> _Allowed:
    read, units = declared_objects(part), declared_units(part)
    rad_per_unit = config.machine.motor_rad_per_unit(part.axis or 1)

    def limit(index: int, unit_rad: float) -> float:
        return float(read(index, 0) or inf) * unit_rad / rad_per_unit

    by = {
        "6080h, max motor speed": limit(objects.MAX_MOTOR_SPEED, RPM),
        "607Fh, max profile velocity": limit(objects.MAX_PROFILE_VELOCITY, units.velocity_rad_s),
    }
    least = min(by, key=lambda name: by[name])
    return _Allowed(part, by[least], least, limit(objects.MAX_ACCELERATION, units.acceleration_rad_s2))


def max_motor_speed_rpm(part: Part) -> float:
    """6080h of a drive; inf without it."""
    return float(declared_objects(part)(objects.MAX_MOTOR_SPEED, 0) or inf)


def torque_limit_Nm(config: ExperimentConfig, part: Part) -> float:
    """Torque limit of an axis's drive: its motor's in the machine's model, or less by 6072h or the simulated one."""
    limit = declared_objects(part)(objects.MAX_TORQUE, 0)
    if limit is None or (not limit and not part.is_simulated):  # a real drive has another one stored
        limit = MAX_TORQUE if part.is_ours else inf
    of_motor_Nm = per_item(config.drive_parameters.torque_limit_Nm, part.axis or 1)
    return min(of_motor_Nm, limit * declared_units(part).torque_Nm)


def beyond(at: str, what: str, value: float, limit: Limit, unit: str) -> Iterator[str]:
    """A value that will end the run, or be warned of in it: at the level itself noise goes beyond."""
    asked = f"{at}: {what} {value:.4g} {unit}".rstrip()
    if limit.trip is not None and value > limit.trip:
        level = f"{limit.trip:g} {unit}".strip()
        yield f"{asked} is beyond the trip level {level}: the run will end there in the safe state"
    elif limit.warning is not None and value >= limit.warning:
        level = f"{limit.warning:g} {unit}".strip()
        yield f"{asked} reaches the warning level {level}, expected less"
