"""A load motor acts on its shaft as the machine that is not there would."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.bench.tasks.load_model import LoadModel
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.topology.quantities import is_of_load
from hilbench.topology.sample import CycleSample


class LoadTask(CyclicTask):
    """The task of one load motor, by its name; a kind of machine says in `after` what motion its model follows."""

    def __init__(self, motor: str, model: LoadModel) -> None:
        self.model = model
        self._motor = motor
        self._command = f"tau_{motor}_cmd_Nm"

    def owns(self, path: str) -> bool:
        """Whether a quantity is one of the imitated mechanics."""
        return is_of_load(path)

    def value(self, path: str) -> float:
        """Its present value."""
        return self.model.value(path)

    def set(self, path: str, value: float) -> None:
        """Another value from now on."""
        self.model.set(path, value)

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """The torque that follows from the last sample, N·m at the load motor's shaft."""
        outputs[self._motor] = getattr(sample, self._command)

    def follow(self, sample: CycleSample, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> None:
        """Let the model follow the measured motion (N,) of the axes, in the machine's unit; the torque is recorded."""
        (torque_Nm,) = self.model.update(positions, speeds, late=late)
        setattr(sample, self._command, torque_Nm)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """No torque."""
        self.model.stop()
