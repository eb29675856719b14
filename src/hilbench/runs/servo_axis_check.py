"""Check of an experiment's steps on a servo axis: inertias that can be emulated, speeds and torques in limits."""

from __future__ import annotations

from hilbench.bench.check import CheckedBench
from hilbench.bench.servo_axis_check import check_emulated_inertia, imitable_inertias_kg_m2
from hilbench.runs.check import CheckedExperiment
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.drive_check import beyond, torque_limit_Nm
from hilbench.runs.set_point_schedule import Move, start_of
from hilbench.topology.parts import Role
from hilbench.topology.quantities import SHAFT_COULOMB_FRICTION, SHAFT_INERTIA, SPEED


def start_values(config: ExperimentConfig) -> dict[str, float]:
    """Values of the quantities of a shaft at the start, by path."""
    shaft = config.emulated_shaft()
    return {SPEED: 0.0, SHAFT_INERTIA: shaft.inertia_kg_m2, SHAFT_COULOMB_FRICTION: shaft.shaft.coulomb_friction_Nm}


def check_steps(
    loaded: LoadedConfig, bench: CheckedBench, asked: list[Move], *, with_margins: bool
) -> CheckedExperiment:
    """Warnings on the steps' speeds and torques, and the largest inertia that the load motor can emulate, over the
    largest that is asked for. Raises UnusableInputError at the step that asks for one it cannot."""
    config, document = loaded.config, loaded.document
    limits, inertias = config.safety.limits, [start_of(config).values[SHAFT_INERTIA]]
    warnings: list[str] = []
    most_Nm = torque_limit_Nm(config, config.parts_of(Role.AXIS)[0])
    for move in asked:
        before, after, at = move.before.values, move.after.values, document.place(move.after.place)
        inertia = after[SHAFT_INERTIA]
        if inertia != before[SHAFT_INERTIA]:
            check_emulated_inertia(config, document, inertia, move.after.place)
            inertias.append(inertia)
        change_rad_s = abs(after[SPEED] - before[SPEED])
        if change_rad_s:
            warnings += beyond(at, "speed", abs(after[SPEED]), limits.speed_rad_s, "rad/s")
        if move.duration_s > 0.0:
            needed_Nm = inertia * change_rad_s / move.duration_s + after[SHAFT_COULOMB_FRICTION]
            if change_rad_s and needed_Nm > most_Nm:
                warnings.append(
                    f"{at}: {change_rad_s:g} rad/s within {move.duration_s:g} s ask for {needed_Nm:.3g} N·m of axis 1, "
                    f"which has {most_Nm:g} N·m, expected a longer ramp"
                )
    reserve = imitable_inertias_kg_m2(config)[1] / max(inertias)
    return CheckedExperiment(bench, None, None, warnings, list(bench.notes), inertia_reserve=reserve)
