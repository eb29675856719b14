"""A web line: its signals, quantities and process data (part `topology` of a kind of machine)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final

from hilbench.estimation.web_line.config import METHODS as METHODS
from hilbench.plant.web_line.parameters import LARGEST_MODULUS_Pa, LEAST_MODULUS_Pa, ModelParameters
from hilbench.topology.blocks import LoadShaftConfig, TwinConfig
from hilbench.topology.main_quantities.web_line import SMALLEST as SMALLEST
from hilbench.topology.main_quantities.web_line import main_quantities as main_quantities
from hilbench.topology.process_data.web_line import process_data as process_data
from hilbench.topology.quantities import LINE_SPEED, MODEL_CHANGE, Permitted
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_config import controller_misfits, estimate_misfits
from hilbench.topology.web_line_config import whole_misfits as whole_misfits
from hilbench.topology.web_line_quantities import TENSION_PROBE, TENSION_SET_POINT, WEB_BROKEN, YOUNGS_MODULUS
from hilbench.topology.web_line_shape import forces_at_start, sensors_at_start, web_line_shape
from hilbench.topology.web_line_signals import WEB_LINE

if TYPE_CHECKING:
    from hilbench.topology.config import BenchConfig

SIGNALS: Final = WEB_LINE
QUANTITIES: Final = {
    LINE_SPEED: Permitted(-100.0, 100.0, "m/s"),
    TENSION_SET_POINT: Permitted(0.0, 1e5, "N"),
    YOUNGS_MODULUS: Permitted(LEAST_MODULUS_Pa, LARGEST_MODULUS_Pa, "Pa"),
    WEB_BROKEN: Permitted(0.0, 1.0, "1", only_ends=True),
    TENSION_PROBE: Permitted(0.0, 1.0, "1", only_ends=True),
    MODEL_CHANGE: Permitted(0.0, 1.0, "1", only_ends=True),
}
TWIN_KEYS: Final = frozenset(TwinConfig.model_fields) - {"inertia", "prediction", "live_diagnosis"}


def boundary(machine: ModelParameters, shape: Shape) -> Mapping[str, float]:
    """Web that comes in and goes out, sensors, forces on carriages."""
    of_web = {"strain_prev": machine.upstream_strain, "F_next_N": machine.boundary.downstream_tension_N}
    return of_web | sensors_at_start(machine, shape) | forces_at_start(machine, shape)


def shape(config: BenchConfig) -> Shape:
    """Spans, and which of them are estimated and controlled; stations."""
    twin, controllers = config.twin, config.controllers.values()
    return web_line_shape(config.web_line, tuple(config.load_motors), twin, controllers, config.load.measured)


def build(config: BenchConfig) -> None:
    """Build hardware and emulated machine. Raises ValueError for what can't be built."""
    config.rig_parameters()


def misfits(key: str, value: Any, machine: Any) -> Iterator[str]:
    """Why the value of a key can't be that of a bench with this line."""
    if key == "controllers":
        if not value:
            yield "at least one"
        yield from controller_misfits(value.values(), machine.span_count)
    if key == "twin":
        yield from estimate_misfits(value, machine)
    if key == "load":
        yield from value.web.misfits(machine.span_count)
    if (key == "load" and value.shaft != LoadShaftConfig()) or (key == "hardware" and value.shaft):
        yield "no 'shaft:', which is of a servo axis (machine: {kind: servo_axis})"
