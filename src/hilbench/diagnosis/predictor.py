"""Interface of a prediction of a recording's measured signals from a parameter vector."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.axis_free_run import AxisFreeRun
from hilbench.diagnosis.coupling import Arm
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion, coupled_motion
from hilbench.diagnosis.residual_analysis import Condition
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.diagnosis.web_line.loop_check import Loop
from hilbench.diagnosis.web_line.on_measured_motion import LineOnMeasuredMotion
from hilbench.plant.model_file import Machine
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]

#: Share of a cycle by which a row of a bench's recording may be off the cycles.
_UNEVEN_CYCLES: Final = 1e-6


class Predictor(Protocol):
    """Prediction that a diagnosis can use."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""

    @property
    def measured(self) -> Array:
        """(signals, n)."""

    @property
    def rows(self) -> NDArray[np.bool_]:
        """(n,): those that count."""

    @property
    def every(self) -> int:
        """Rows of the recording per row of the prediction."""

    @property
    def exact(self) -> bool:
        """True if a right model leaves white noise and nothing else."""

    @property
    def tolerances(self) -> Array:
        """(signals,): possible error of each signal in addition to its noise."""

    @property
    def emulation(self) -> AnyEmulation | None:
        """Emulation of web or shaft by a load motor; None where they were real."""

    @property
    def narrower(self) -> Predictor | None:
        """Prediction in half the band of frequencies; None where all are compared."""

    def floor(self, signal: int) -> float:
        """Standard deviation of the noise of a signal, from the recording alone."""

    def conditions(self, parameters: Array) -> list[Condition]:
        """States that residuals may depend on, time first; (n,) each."""

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n)."""


@dataclass(frozen=True)
class Choice:
    """Chosen prediction, why it was chosen, and the drives' loops as the recording shows them."""

    predictor: Predictor
    basis: str  #: for a person
    loops: list[Loop] = field(default_factory=list)  #: of the axes on which they could be looked at
    simpler: Choice | None = None  #: to be believed instead where it leaves nothing unexplained


def choice(model: Machine, data: Measured, emulation: AnyEmulation | None = None) -> Choice:
    """A free run where the drives' loops are those of the model; else on measured motion, which needs none.

    A recording with neither both positions nor both torques is run freely, with the loops that it shows. Where it has
    a load motor the web was emulated: as `emulation` says, or as benches do it by default, by one load motor at the
    last roller. What happened in its cycles can't be told from rows between them.
    """
    commands = "the recorded commands"
    if isinstance(model, ServoAxisParameters):
        shaft = emulation if isinstance(emulation, ShaftEmulation) else None
        if not data.emulated and (beside := coupled_motion(model, data)) is not None and beside.arm is not None:
            gravity = "; gravity goes with the angles of both" if beside.arm is Arm.CARRIED else ""
            return Choice(beside, f"measured motion of an axis {beside.arm}, below {beside.corner_hz:.2g} Hz{gravity}")
        if not data.emulated or not data.commands_m_s.size:
            return Choice(OnMeasuredMotion(model, data), "measured motion of a lone axis")
        shaft = shaft or ShaftEmulation(data.period_s, ServoRigParameters.matching(model))
        if not _is_cycle(data.period_s / shaft.cycle_s) or round(data.period_s / shaft.cycle_s) != 1:
            return Choice(OnMeasuredMotion(model, data), "measured motion: there is not a row each cycle")
        return Choice(AxisFreeRun(model, data, shaft), commands)
    if model.web is None:
        return Choice(OnMeasuredMotion(model, data), "measured motion of a lone axis")
    return _web_choice(model, data, emulation if isinstance(emulation, Emulation) else None)


def _is_cycle(cycles: float) -> bool:
    """True if a row of a bench's recording is whole cycles after the one before."""
    return cycles > 0.5 and abs(cycles - round(cycles)) <= _UNEVEN_CYCLES


def _web_choice(model: ModelParameters, data: Measured, emulation: Emulation | None) -> Choice:
    commands = "the recorded commands"
    if data.emulated:
        emulation = emulation or Emulation.usual(model, data.period_s)
        if not _is_cycle(data.period_s / emulation.cycle_s):
            return Choice(FreeRun(model, data), commands)
        return Choice(FreeRun(model, data, emulation), commands)
    if not set(data.x_m) | set(data.v_m_s) >= set(range(1, model.axis_count + 1)):
        return Choice(FreeRun(model, data), commands)
    motion = LineOnMeasuredMotion(model, data)
    loops = motion.loops()
    if not data.commands_m_s.size:
        return Choice(motion, f"measured motion: there are no commands{_blind(motion)}")
    if loops and all(loop.is_known for loop in loops):
        return Choice(FreeRun(model, data), commands, loops)
    why = "the drives' loops are not those of the model" if loops else "the drives' loops are not identifiable"
    if motion.knows_strain or len(data.tau_Nm) == model.axis_count:
        # A torque that is recorded late looks like a lag of its loop; what moves by the model's loops has them.
        only_late = bool(loops) and all(loop.is_known or loop.is_only_late(model) for loop in loops)
        simpler = Choice(FreeRun(model, data), commands) if only_late else None
        return Choice(motion, f"measured motion: {why}{_blind(motion)}", loops, simpler)
    others = [loop for loop in loops if loop.is_understood and not loop.is_known]
    return Choice(FreeRun(model, data, loops=others), f"{commands}, with the loops that the drives show", loops)


def _blind(motion: LineOnMeasuredMotion) -> str:
    return "" if motion.knows_strain else "; without positions the strain is not observable, nor what acts on it"


def predictor_for(model: Machine, data: Measured, emulation: AnyEmulation | None = None) -> Predictor:
    """Prediction that `choice` chooses, of an axis by itself."""
    return choice(model, replace(data, other_rad=None), emulation).predictor
