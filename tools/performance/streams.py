"""What a stream costs the cycle of the bench, and what its own process does with a sample."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hilbench.apps.streams.sinks import Target, open_sink
from hilbench.apps.streams.stream import Stream
from hilbench.results.recording_builder import Recorder
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import sample_type
from performance.table import Section, best_cpu_s

_CYCLES = 4000
_TIMES = 7


def measure(config: BenchConfig) -> Section:
    """CPU of the bench's thread a cycle, with a stream to PlotJuggler; of a stream's process for a sample."""
    section = Section(
        "Streams",
        "CPU time of the bench's thread a cycle, of the demo's signals: keeping a sample for the recording, and "
        "packing and handing it to the process of a stream. Below: that process for a sample.",
    )
    sample = sample_type(config.signals)()
    recorder = Recorder(config.signals)
    with tempfile.TemporaryDirectory() as folder:
        stream = Stream(Target("plotjuggler", port=9870), config, Path(folder))

        def streamed() -> None:
            for _ in range(_CYCLES):
                stream.sample(sample)

        def recorded() -> None:
            for _ in range(_CYCLES):
                recorder.sample(sample)

        ours, kept = (best_cpu_s(task, _TIMES) / _CYCLES * 1e6 for task in (streamed, recorded))
        stream.close()
        cycle_us = config.cycle_time_s * 1e6
        section.add("a sample kept for the recording", kept, "µs")
        section.add("a sample handed to a stream", ours, "µs")
        section.add("the same, of a cycle", 100.0 * ours / cycle_us, "%")
        row = [0.123456789] * len(config.signals)
        targets = (
            ("MCAP file", Target("mcap", path=Path(folder) / "x.mcap")),
            ("PlotJuggler", Target("plotjuggler", port=9870)),
        )
        for name, target in targets:
            sink = open_sink(target, config.signals, config.name, 0.0)

            def taken(take: object = sink.take) -> None:
                assert callable(take)
                for _ in range(_CYCLES):
                    take(row)

            section.add(f"its process, {name}", best_cpu_s(taken, _TIMES) / _CYCLES * 1e6, "µs")
            sink.close()
    return section
