"""Task of the load motors: they apply to their shafts the torque of the emulated machine."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.bench.tasks.load_model import LoadModel
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.topology.sample import CycleSample


class LoadTask(CyclicTask):
    """Task of load motors, by their names; a kind of machine defines in `after` the motion that its model follows."""

    def __init__(self, motors: Sequence[str], model: LoadModel) -> None:
        self.model = model
        self._commands = [(motor, f"tau_{motor}_cmd_Nm") for motor in motors]

    def owns(self, path: str) -> bool:
        """True if a quantity is one of the emulated mechanics."""
        return path.startswith("load.")

    def value(self, path: str) -> float:
        """Present value of a quantity."""
        return self.model.value(path)

    def set(self, path: str, value: float) -> None:
        """Another value from now on."""
        self.model.set(path, value)

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """The torques that follow from the last sample, N·m at the load motors' shafts."""
        for motor, command in self._commands:
            outputs[motor] = getattr(sample, command)

    def follow(self, sample: CycleSample, positions: Sequence[float], speeds: Sequence[float], *, late: bool) -> None:
        """Let the model follow the measured motion (N,) of the axes, in the machine's unit; record its torques."""
        torques_Nm = self.model.update(positions, speeds, late=late)
        for (_, command), torque_Nm in zip(self._commands, torques_Nm, strict=True):
            setattr(sample, command, torque_Nm)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """Command zero torque."""
        self.model.stop()
