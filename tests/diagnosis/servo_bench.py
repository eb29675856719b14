"""What the bench of the servo axis records of an experiment, inside this process, and what is diagnosed of it."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.machines import emulation_of
from hilbench.results.recording import Recording
from hilbench.results.recording_builder import Recorder
from hilbench.runs.config import ExperimentConfig, load

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
SHIPPED, HIDDEN = CONFIGS / "servo_axis.yaml", CONFIGS / "hidden_shaft_friction.yaml"
#: Where what acts in the drive, its torque or encoder is hidden; what a load motor can't emulate.
IN_THE_STAND = frozenset(
    {
        "torque_ripple",
        "torque_offset",
        "torque_scale",
        "torque_delay",
        "torque_ripple_load",
        "feed_forward",
        "encoder_error",
        "inertia_mismatch",
        "inertia_step",
        "load_dependent_friction",
        "resonance",
    }
)


def hiding(config: Path, *effects: tuple[str, dict[str, float]], **changes: Any) -> ExperimentConfig:
    """The config with these effects hidden, in the load where it can be, and nothing else."""
    data = load(config)[0].model_dump()
    data |= {"criteria": [], **changes}
    for place in ("hardware", "load"):
        entries = [
            {"effect": name, "axis": 1, "parameters": parameters}
            for name, parameters in effects
            if (name in IN_THE_STAND) == (place == "hardware")
        ]
        data[place] = {**data[place], "effects": entries}
    return ExperimentConfig.model_validate(data)


def recorded(config: ExperimentConfig) -> Recording:
    """What a run of its steps records."""
    recorder = Recorder(config.signals)
    with Bench(config, observers=[recorder], participants=Participants.IN_PROCESS) as running:
        for step in config.steps:
            step.run(running, [])
    return recorder.recording(datetime.now(UTC), config.description)


def diagnosed(config: ExperimentConfig) -> Diagnosis:
    """Of a run, as the command does it."""
    return diagnose(recorded(config), config.machine, "the bench", emulation=emulation_of(config))
