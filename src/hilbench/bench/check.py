"""What must hold before anything starts: EDS files, PDO maps and the capacity of the bus; errors name file and line."""

from __future__ import annotations

from dataclasses import dataclass

from hilbench.bench.config import BenchConfig
from hilbench.bench.load_model import imitated_web
from hilbench.bench.nodes import Nodes
from hilbench.bus.load import BusLoad, cycle_load
from hilbench.errors import UnusableInputError
from hilbench.strict_yaml import Document
from hilbench.web.stability import (
    SampledShaft,
    imitation_delay_s,
    largest_stiffness_Nm_per_rad,
    web_stiffness_Nm_per_rad,
)


@dataclass(frozen=True)
class CheckedBench:
    """What the check found."""

    load: BusLoad
    frames_per_cycle: float
    stiffness_reserve: float  #: stiffest web that the load motor can imitate stably, over the stiffest in the config


def check_bench(config: BenchConfig, document: Document) -> CheckedBench:
    """Check a config as far as can be without a bus.

    Raises UnusableInputError with the place in the config when an EDS can't be used or lacks an object that is
    mapped, when the PDO set does not fit on the bus at worst, or when the web is too stiff to be imitated stably.
    """
    for part, node in config.nodes:
        if not node.eds.is_file():
            raise UnusableInputError(
                document.place(("nodes", part, "eds")), f"no file {node.eds}, expected an EDS file"
            )
    try:
        nodes = Nodes(config)
    except (KeyError, ValueError) as error:
        raise UnusableInputError(document.place(("nodes",)), f"PDO map: {error.args[0]!s}") from error
    except UnusableInputError as error:
        part = error.place.replace(" ", "_")
        if part in config.nodes.__class__.model_fields:
            raise UnusableInputError(document.place(("nodes", part)), error.problem) from error
        raise
    frames = nodes.cyclic_frames()
    load = cycle_load(frames, config.cycle_time_s, config.bus.bitrate)
    if load.fraction > 1.0:
        raise UnusableInputError(
            document.place(("bus", "bitrate")),
            f"the PDO set takes {load.bits:.0f} bit times of the {load.capacity_bits:.0f} in a cycle of "
            f"{config.cycle_time_s * 1e3:g} ms at {config.bus.bitrate} bit/s ({100 * load.fraction:.0f} %), "
            f"expected at most 100 %: a longer cycle, a higher bit rate or fewer PDOs",
        )
    reserve = stiffness_reserve(config)
    if reserve < 1.0:
        raise UnusableInputError(
            document.place(("model", "web")),
            f"the load motor can't imitate so stiff a web over a cycle of {config.cycle_time_s * 1e3:g} ms: the loop "
            f"of web and sampled shaft is stable up to {100 * reserve:.0f} % of it, expected at least 100 %: a shorter "
            f"cycle, a heavier axis 2 or a softer web",
        )
    return CheckedBench(load, sum(frame.per_cycle for frame in frames), reserve)


def stiffness_reserve(config: BenchConfig) -> float:
    """Largest stable stiffness of the imitated web over the largest that the config asks for at the start."""
    web = imitated_web(config.model, config.load)
    shaft = SampledShaft.of_model(config.model, cycle_s=config.cycle_time_s)
    asked = max(web_stiffness_Nm_per_rad(web), web_stiffness_Nm_per_rad(config.model))
    return largest_stiffness_Nm_per_rad(shaft, imitation_delay_s(shaft)) / asked
