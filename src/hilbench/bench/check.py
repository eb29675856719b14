"""What must hold before anything starts: EDS files, PDO maps and the capacity of the bus; errors name file and line."""

from __future__ import annotations

from dataclasses import dataclass

from hilbench.bench.config import BenchConfig
from hilbench.bench.nodes import Nodes
from hilbench.bus.load import BusLoad, cycle_load
from hilbench.errors import UnusableInputError
from hilbench.strict_yaml import Document


@dataclass(frozen=True)
class CheckedBench:
    """What the check found."""

    load: BusLoad
    frames_per_cycle: float


def check_bench(config: BenchConfig, document: Document) -> CheckedBench:
    """Check a config as far as can be without a bus.

    Raises UnusableInputError with the place in the config when an EDS can't be used or lacks an object that is
    mapped, or when the PDO set does not fit on the bus at worst.
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
    return CheckedBench(load, sum(frame.per_cycle for frame in frames))
