"""Usual sizes of a servo axis, of which the sizes of effects are shares."""

from __future__ import annotations

from hilbench.plant.effect import MachineSizes
from hilbench.plant.parameters import per_item
from hilbench.plant.servo_axis.parameters import ServoAxisParameters


def machine_sizes(
    model: ServoAxisParameters,
    *,
    top_speed_rad_s: float = 1.0,
    torque_Nm: float | None = None,
    sample_time_s: float | None = None,
) -> MachineSizes:
    """Usual sizes at the shaft of a model: forces are torques, at a radius of 1.

    top_speed_rad_s: highest speed, which is not in a model. torque_Nm: usual torque of the motor; its default is the
    drive's limit (1 N·m where the model has none). sample_time_s: that of a recording, for a model without drives;
    default 1 ms.
    """
    drives = model.drives
    limit_Nm = per_item(drives.torque_limit_Nm, 1) if drives is not None else 1.0
    time_s = drives.sample_time_s if drives is not None else sample_time_s
    return MachineSizes(
        force_N=limit_Nm if torque_Nm is None else torque_Nm,
        speed_m_s=top_speed_rad_s,
        radius_m=1.0,
        gear_ratio=1.0,
        strain=1.0,
        sample_time_s=0.001 if time_s is None else time_s,
    )
