"""`hilbench check`: says what a config means for the bus and its control loops, or what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite

from hilbench.apps.cli.options import print_json
from hilbench.bench.bus_options import BusOption
from hilbench.bench.schedule import Slot
from hilbench.can.open import open_link
from hilbench.errors import BusError, UnusableInputError
from hilbench.runs.check import CheckedExperiment, check_experiment
from hilbench.runs.config import ExperimentConfig, LoadedConfig


def check_command(loaded: LoadedConfig, *, as_json: bool) -> None:
    """Print a summary of a config that can be run. Raises UnusableInputError, also for a bus that can't be opened."""
    _check_bus(loaded)
    checked = check_experiment(loaded, with_margins=True)
    if as_json:
        print_json(_summary(loaded.config, checked), ensure_ascii=False)
        return
    config, bench, load = loaded.config, checked.bench, checked.bench.load
    print(f"{config.name}: usable")
    print(
        f"bus {config.bus.address}, {config.bus.bitrate} bit/s, cycle {config.cycle_time_s * 1e3:g} ms, {config.pace}"
    )
    print(
        f"{bench.frames_per_cycle:.1f} frames a cycle, at worst {load.bits:.0f} of {load.capacity_bits:.0f} "
        f"bit times ({100 * load.fraction:.0f} %)"
    )
    for option in bench.options:
        print(_fits(option))
    print(_over(bench.schedule))
    for line in bench.fmus:
        print(line)
    if checked.stiffness_reserve is not None:
        print(
            f"load motor: by itself stable up to {checked.stiffness_reserve:.1f} times the stiffness of the stiffest "
            f"web that is asked for"
        )
    if len(checked.stiffness_reserves) > 1:
        print("  " + ", ".join(f"{name} {reserve:.1f}" for name, reserve in checked.stiffness_reserves.items()))
    if checked.inertia_reserve is not None:
        print(f"load motor: stable up to {checked.inertia_reserve:.1f} times the largest inertia that is asked for")
    if checked.worst is not None:
        print(f"tension loop: {checked.worst}")
    for warning in checked.warnings:
        print(f"warning: {warning}")
    for note in checked.notes:
        print(f"note: {note}")
    print(f"{len(config.steps)} steps, {len(config.criteria)} criteria")


def _fits(option: BusOption) -> str:
    """Bus load of a wiring layout, as a line."""
    loads = " and ".join(f"{bits:.0f}" for bits in option.bits)
    where = f"on {option.layout}" + ("" if option.usable else " (a bench can't use that yet)")
    return (
        f"{where}: at worst {loads} bit times; fits cycles from {option.least_lockstep_s * 1e3:g} ms in lockstep, "
        f"{option.least_realtime_s * 1e3:g} ms in real time"
    )


def _over(slots: list[Slot]) -> str:
    """End of answers and set points in a cycle, and those that would be late in real time, as a line."""
    parts = []
    for is_set_point, what in ((False, "answers"), (True, "set points")):
        which = [slot for slot in slots if slot.is_set_point == is_set_point]
        if which:
            last = max(which, key=lambda slot: slot.ends_s)
            parts.append(f"{what} are over after {last.ends_s * 1e3:.2f} of {last.due_s * 1e3:.2f} ms")
    late = [f"{slot.name} ({slot.can_id:03X}h, {slot.ends_s * 1e3:.2f} ms)" for slot in slots if not slot.fits]
    return f"a cycle at worst: {', '.join(parts)}" + (f"; in real time too late: {', '.join(late)}" if late else "")


def _check_bus(loaded: LoadedConfig) -> None:
    """An interface can be opened and closed again without a frame; the embedded bus is started by who needs it."""
    address = loaded.config.bus_address
    if address.interface == "embedded":
        return
    try:
        open_link(address).close()
    except BusError as error:
        place = loaded.document.place(("bus", "address"))
        raise UnusableInputError(place, f"{error}, expected a bus that can be opened") from error


def _summary(config: ExperimentConfig, checked: CheckedExperiment) -> dict[str, object]:
    worst, load = checked.worst, checked.bench.load
    margins = None if worst is None else worst.margins
    return {
        "name": config.name,
        "bus": config.bus.address,
        "bitrate": config.bus.bitrate,
        "cycle_s": config.cycle_time_s,
        "pace": config.pace,
        "frames_per_cycle": checked.bench.frames_per_cycle,
        "bus_load_pct": 100 * load.fraction,
        "fits": [asdict(option) for option in checked.bench.options],
        "schedule": [
            {"name": slot.name, "cob_id": slot.can_id, "ends_s": slot.ends_s, "due_s": slot.due_s}
            for slot in checked.bench.schedule
        ],
        "fmus": checked.bench.fmus,
        "stiffness_reserve": checked.stiffness_reserve,
        "stiffness_reserves": dict(checked.stiffness_reserves),
        "inertia_reserve": checked.inertia_reserve,
        "gain_margin": margins.gain if margins and isfinite(margins.gain) else None,
        "phase_margin_deg": None if margins is None else margins.phase_deg,
        "warnings": checked.warnings,
        "notes": checked.notes,
        "steps": len(config.steps),
        "criteria": len(config.criteria),
    }
