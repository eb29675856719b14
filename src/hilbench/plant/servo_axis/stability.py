"""Stability limit of inertia emulation by a load motor on a servo axis over a sampled bus.

The emulation feeds the acceleration back, filtered and predicted: a loop of gain (J_i − J_r)/J_r with the dead time of
the bus in it. `hilbench.plant.sampled_shaft` has the loop, this module the law.
"""

from __future__ import annotations

import numpy as np

from hilbench.plant.parameters import per_item
from hilbench.plant.sampled_shaft import (
    LinearLaw,
    SampledShaft,
    emulation_delay_s,
    largest_stable,
    spectral_radius_under,
)
from hilbench.plant.servo_axis.emulation import FILTER_CYCLES
from hilbench.plant.servo_axis.parameters import ServoRigParameters
from hilbench.plant.servo_axis.tracking_filter import gains, transition

#: Searched range, in multiples of the real inertia; a shaft without inertia is the least.
_MOST_RATIO, _LEAST_RATIO = 20.0, 1.0
_ACCELERATION = 2  #: index in the filter's motion


def sampled_shaft(rig: ServoRigParameters, cycle_s: float) -> SampledShaft:
    """Real shaft with its drive and load motor. Raises ValueError for an axis without drives."""
    drives = rig.axis.drives
    if drives is None:
        raise ValueError("the axis has no drives, expected 'drives'")
    return SampledShaft(
        inertia_kg_m2=rig.inertia_kg_m2,
        velocity_kp_Nm_s_per_rad=per_item(drives.velocity_kp_Nm_s_per_rad, 1),
        velocity_ki_Nm_per_rad=per_item(drives.velocity_ki_Nm_per_rad, 1),
        current_loop_time_constant_s=per_item(drives.current_loop_time_constant_s, 1),
        load_current_loop_time_constant_s=rig.load_motor.current_loop_time_constant_s,
        sample_time_s=drives.sample_time_s,
        cycle_s=cycle_s,
    )


def emulation_law(inertia_kg_m2: float, cycle_s: float, filter_s: float, lead_s: float) -> LinearLaw:
    """Linear law of emulated additional inertia, as in `hilbench.plant.servo_axis.emulation`; memory: the motion."""
    gain, forward = gains(cycle_s, filter_s), transition(cycle_s)
    memory = forward - np.outer(gain, forward[0])
    acceleration = -inertia_kg_m2 * transition(lead_s)[_ACCELERATION]
    motion = np.column_stack([gain, np.zeros(len(gain))])
    return LinearLaw(memory, motion, acceleration @ memory, acceleration @ motion)


def spectral_radius(shaft: SampledShaft, inertia_kg_m2: float, filter_cycles: float = FILTER_CYCLES) -> float:
    """Largest magnitude of the loop's eigenvalues while this inertia is emulated in addition to the real one."""
    filter_s, lead_s = filter_cycles * shaft.cycle_s, emulation_delay_s(shaft)
    return spectral_radius_under(shaft, emulation_law(inertia_kg_m2, shaft.cycle_s, filter_s, lead_s))


def imitable_inertia_kg_m2(shaft: SampledShaft, filter_cycles: float = FILTER_CYCLES) -> tuple[float, float]:
    """Least and largest inertia that can be emulated on the shaft without instability of the loop."""
    real = shaft.inertia_kg_m2
    lighter = largest_stable(lambda ratio: spectral_radius(shaft, -ratio * real, filter_cycles), _LEAST_RATIO)
    heavier = largest_stable(lambda ratio: spectral_radius(shaft, ratio * real, filter_cycles), _MOST_RATIO)
    return real * (1.0 - lighter), real * (1.0 + heavier)
