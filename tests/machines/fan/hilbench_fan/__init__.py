"""A fan on a servo axis: a shaft whose load takes c·ω² beside inertia and friction."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from pydantic import Field, NonNegativeFloat

from hilbench.plant.servo_axis.machine import SERVO_AXIS
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

#: All that is not given is as of a servo axis. Futures and live diagnosis would not know of the fan: it brings none.
FAN = replace(
    SERVO_AXIS,
    parameters="hilbench_fan:FanParameters",
    topology="hilbench_fan.topology",
    start_values="hilbench_fan.machine:start_values",
    twin="hilbench_fan.machine:twin",
    tasks="hilbench_fan.machine:tasks",
    metrics="hilbench_fan.machine:metrics_of",
    panels="hilbench_fan.machine:panels_of",
    diagnosis="hilbench_fan.machine",
    prediction="",
    live_diagnosis="",
    fmu_export="",
)


class FanParameters(ServoAxisParameters):
    """The block `machine:` with `kind: fan`."""

    kind: Literal["fan"] = Field(default="fan", description="what machine this is")  # type: ignore[assignment]
    drag_Nm_s2_per_rad2: NonNegativeFloat = Field(description="torque of the fan per speed²")

    def drag_Nm(self, speed_rad_s: float) -> float:
        """Torque of the fan against the motion."""
        return self.drag_Nm_s2_per_rad2 * speed_rad_s * abs(speed_rad_s)
