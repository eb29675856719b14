"""A servo axis: one shaft with its drive and, on the same shaft, the load motor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hilbench.apps.pages.live.machines import svg
from hilbench.arrays import Array
from hilbench.topology.config import BenchConfig
from hilbench.topology.servo_axis import INERTIA

_WIDTH, _HEIGHT, _MIDDLE, _RADIUS = 620.0, 190.0, 80.0, 46.0


def drawing(config: BenchConfig) -> str:
    """Drawing of a bench with one shaft."""
    return svg.picture(_WIDTH, _HEIGHT, "The shaft", _shapes(config))


def settled(config: BenchConfig, names: Sequence[str], first: Array, last: Array) -> bool:
    """True: the shaft has no memory."""
    return True


def _shapes(config: BenchConfig) -> Iterator[str]:
    motors = [*config.drives, *config.load_motors]
    places = {name: 110.0 + 400.0 * at / max(len(motors) - 1, 1) for at, name in enumerate(motors)}
    yield svg.line([(110.0, _MIDDLE), (510.0, _MIDDLE)], "shaft")
    yield svg.circle(310.0, _MIDDLE, 0.8 * _RADIUS, "roller")
    inertia = {"unit": INERTIA.in_unit, "kind": "simulated", "before": "J "}
    yield svg.value(310.0, _MIDDLE + 62.0, INERTIA.twin_signal, per=INERTIA.si_per_shown, **inertia)
    yield svg.value(310.0, _MIDDLE + 80.0, "v1_rad_s", "rad/s")
    for name, x in places.items():
        load = name in config.load_motors
        yield svg.part(name, (svg.circle(x, _MIDDLE, 0.6 * _RADIUS, "load" if load else "roller"),))
        yield svg.text(x, _MIDDLE - 0.6 * _RADIUS - 10.0, name)
        yield svg.value(x, _MIDDLE + 0.6 * _RADIUS + 20.0, f"tau_{name}_Nm" if load else "tau1_Nm", "N·m")
