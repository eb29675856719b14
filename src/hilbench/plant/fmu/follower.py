"""FMU emulated by load motors: a `Follower` of any kind of machine, by the names mapped in the config."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite, nan
from typing import Literal

from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.fmu.effects import WithoutEffects
from hilbench.plant.fmu.model import FmuModel, FmuState
from hilbench.plant.interface import PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.unit_names import unit_of_name


class FmuFollower(WithoutEffects):
    """FMU follower: measured positions of the driven axes in, torques of the load motors out
    (`hilbench.plant.interface.Follower`).

    The motion of a cycle, and its mean speed, are held over it. Torques are predicted by `lead_s` if the FMU's state
    can be restored; otherwise they are the present ones. `kind` and `unit` are those of the replaced machine, `truths`
    the names of its outputs: unmapped ones are NaN. Raises ValueError for variables that do not fit, BenchFaultError
    when the FMU fails, then and later.
    """

    def __init__(
        self,
        config: FmuLoadConfig,
        kind: str,
        unit: Literal["m", "rad"],
        axes: int,
        cycle_s: float,
        truths: Sequence[str] = (),
        report: Callable[[str], None] = print,
    ) -> None:
        self._found = found = config.variables(unit)
        self._positions_in, self._speeds_in = bool(found.positions), bool(found.speeds)
        inputs, outputs = [*found.positions, *found.speeds], [*found.torques, *found.outputs.values()]
        self._model = FmuModel(config, inputs, outputs, cycle_s, report)
        self._torques = len(found.torques)
        self._axes = axes
        self._positions = self._speeds = [0.0] * axes
        self._time_s = 0.0
        self._truths = dict.fromkeys((*truths, *found.outputs), nan)
        self._description = PlantDescription(
            kind=kind,
            position_unit=unit,
            axes=axes,
            motors=(),
            states=(),
            inputs=(),
            outputs=tuple(_quantity(name, "output") for name in self._truths),
            parameters=tuple(_quantity(name, "parameter") for name in found.parameters),
            effects=(),
        )
        self._model.start()

    def describe(self) -> PlantDescription:
        """Description; see `hilbench.plant.interface.Machine`."""
        return self._description

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self._time_s

    def reset(self, positions: Sequence[float]) -> None:
        """Restart at these positions (N,), at rest; time goes on, and parameters stay."""
        self._positions, self._speeds = list(positions), [0.0] * self._axes
        self._model.start(self._time_s)

    def follow(self, positions: Sequence[float], duration_s: float) -> None:
        """Move the axes to `positions` (N,), `duration_s` (above 0) after the last call."""
        self._speeds = [(now - then) / duration_s for now, then in zip(positions, self._positions, strict=True)]
        self._positions = list(positions)
        self._model.advance(self._inputs(self._positions), duration_s)
        self._time_s += duration_s

    def _inputs(self, positions: Sequence[float]) -> list[float]:
        return [*(positions if self._positions_in else ()), *(self._speeds if self._speeds_in else ())]

    def load_torques_Nm(self, axes: Sequence[int], speeds: Sequence[float], lead_s: float) -> list[float]:
        """Torque of each load motor, in order, predicted `lead_s` ahead with the axes' motion of the last cycle."""
        later = [x + v * lead_s for x, v in zip(self._positions, self._speeds, strict=True)]
        return self._model.ahead(self._inputs(later), lead_s)[: len(axes)]

    def outputs(self) -> dict[str, float]:
        """Present mapped outputs; NaN for the machine's others."""
        return self._truths | dict(zip(self._found.outputs, self._model.values[self._torques :], strict=True))

    def get_state(self) -> PlantState:
        """Present state. Raises ValueError for an FMU that can't save it."""
        return PlantState({}, (self._model.take_state(), self._positions, self._speeds, self._time_s))

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of this FMU. Raises ValueError for another; none can be transferred by name."""
        match state:
            case PlantState(memory=(FmuState() as kept, list() as positions, list() as speeds, float() as time_s)):
                self._model.give_state(kept)
                self._positions, self._speeds, self._time_s = positions, speeds, time_s
            case _:
                raise ValueError("a state that is not this FMU's, expected one that it has handed out")

    def parameter(self, name: str) -> float:
        """Present value. Raises ValueError for a name that the config does not map."""
        checked_name("parameter", name, self._description.parameters)
        return self._model.present(self._found.parameters[name])

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter from now on. Raises ValueError for an unknown name or an impossible value."""
        checked_name("parameter", name, self._description.parameters)
        if not isfinite(value):
            raise ValueError(f"{name} = {value!r}, expected a finite number")
        self._model.put(self._found.parameters[name], value)

    def set_input(self, name: str, value: float) -> None:
        """Raise ValueError: it has no inputs."""
        checked_name("input", name, ())


def _quantity(name: str, what: str) -> Quantity:
    return Quantity(name, unit_of_name(name), f"{what} of the FMU")
