"""A servo axis: what the twin estimates of its shaft."""

from __future__ import annotations

from hilbench.topology.process_data.table import INPUTS, QUALITY_EVERY, IoPdo, IoSignal, ProcessData, SimulatedTorque
from hilbench.topology.signals import Shape


def process_data(shape: Shape) -> ProcessData:
    """Process data of any servo axis."""
    published = inertia, friction, deviation, torque, residual, friction_sd, viscous, viscous_sd = tuple(
        IoSignal(name, INPUTS, sub, text)
        for sub, (name, text) in enumerate(
            (
                ("J_sim_kg_m2", "Estimated inertia of the shaft [kg m2]"),
                ("coulomb_sim_Nm", "Estimated dry friction of the shaft [N m]"),
                ("J_sd_kg_m2", "Standard deviation of the estimated inertia [kg m2]"),
                ("tau1_sim_Nm", "Simulated torque of axis 1 [N m]"),
                ("tau1_residual_Nm", "Torque residual of axis 1 [N m]"),
                ("coulomb_sd_Nm", "Standard deviation of the estimated dry friction [N m]"),
                ("viscous_sim_Nm_s_per_rad", "Estimated viscous friction of the shaft [N m s/rad]"),
                ("viscous_sd_Nm_s_per_rad", "Standard deviation of the estimated viscous friction [N m s/rad]"),
            ),
            1,
        )
    )
    return ProcessData(
        published=published,
        boundary_inputs=(),
        sent=(
            IoPdo(1, (inertia, friction)),
            IoPdo(2, (deviation, residual), QUALITY_EVERY),
            IoPdo(4, (viscous, viscous_sd), QUALITY_EVERY),
            IoPdo(5, (friction_sd,), QUALITY_EVERY),
        ),
        torques=(SimulatedTorque(1, torque.name, residual.name),),
    )
