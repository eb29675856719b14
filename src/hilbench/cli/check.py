"""`hilbench check`: says what a config means for the bus, or what is wrong with it."""

from __future__ import annotations

import json

from hilbench.bench.check import check_bench
from hilbench.experiment.config import LoadedConfig


def check_command(loaded: LoadedConfig, *, as_json: bool) -> None:
    """Print a summary of a config that can be run."""
    checked = check_bench(loaded.config, loaded.document)
    config, load = loaded.config, checked.load
    if as_json:
        summary = {
            "name": config.name,
            "bus": config.bus.address,
            "bitrate": config.bus.bitrate,
            "cycle_s": config.cycle_time_s,
            "pace": config.pace,
            "frames_per_cycle": checked.frames_per_cycle,
            "bus_load_pct": 100 * load.fraction,
            "stiffness_reserve": checked.stiffness_reserve,
            "notes": checked.notes,
            "steps": len(config.steps),
            "criteria": len(config.criteria),
        }
        print(json.dumps(summary, indent=2))
        return
    print(f"{config.name}: usable")
    print(
        f"bus {config.bus.address}, {config.bus.bitrate} bit/s, cycle {config.cycle_time_s * 1e3:g} ms, {config.pace}"
    )
    print(
        f"{checked.frames_per_cycle:.1f} frames a cycle, at worst {load.bits:.0f} of {load.capacity_bits:.0f} "
        f"bit times ({100 * load.fraction:.0f} %)"
    )
    print(f"load motor: could imitate a web {checked.stiffness_reserve:.1f} times as stiff before its loop is unstable")
    for note in checked.notes:
        print(f"note: {note}")
    print(f"{len(config.steps)} steps, {len(config.criteria)} criteria")
