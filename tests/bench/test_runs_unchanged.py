"""The shipped machines do what they did: recordings and frames of twelve configs, against what was stored.

`unchanged/NAME.json` holds, for each channel of the recording and each identifier on the bus, a checksum of every block
of cycles, so that a failure says what differs and from when on. A number differs when one of its bits does: lockstep
promises the same bits on any machine, whatever its vector units (tried with those of numpy, OpenBLAS, glibc and numba
switched off). Where OpenBLAS and glibc take part in the cycle, the last bits are the machine's: of those runs the means
of each channel are held, within `TOLERANCE` of its RMS.
Who changes what a machine does on purpose makes the files again, and says in the commit why:

    python -m tests.bench.test_runs_unchanged [NAME…]
"""

from __future__ import annotations

import json
import sys
import tempfile
import zlib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import shipped_run
from tests.tiers import slow

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
STORED = Path(__file__).with_name("unchanged")
#: The shipped experiment in less time: the same steps, the same speed.
SHORTER = (
    "steps.0.ramp.duration_s=2.0",
    "steps.1.hold.until_s=3.0",
    "steps.3.hold.duration_s=2.0",
    "steps.4.ramp.duration_s=1.0",
    "steps.5.hold.duration_s=0.2",
)
DEMONSTRATOR = "web_section_step"
#: Runs of each kind (control of tension, nodes, spans, effects, synchronizers), and what is shorter than shipped.
TO_THE_BIT = {
    DEMONSTRATOR: SHORTER,
    "web_section_step_pid": (),
    "web_section_dual_axis": SHORTER,
    "synchronizers": (),
    "line_two_spans": (),
    "line_three_spans": (),
    "servo_axis": (),
    "mixed_bench": (),
}
#: Those whose last bits depend on the machine's linear algebra: periodic effects, a probe, stations.
BY_MEANS = ("hidden_eccentricity", "probing", "line_with_dancer", "winding_line")
TOLERANCE = 2e-2  #: of a channel's RMS; 0.8 % is what the last bits become in a small torque of the winding line
BLOCK = 50  #: cycles per checksum of the demonstrator
LONG_BLOCK = 1000  #: cycles per checksum of the others

Checksums = dict[str, list[str]]


def checksums(cycles: Sequence[bytes], block: int = BLOCK) -> list[str]:
    """One checksum per block of cycles."""
    blocks = (cycles[first : first + block] for first in range(0, len(cycles), block))
    return [f"{zlib.crc32(b'|'.join(cycles)):08x}" for cycles in blocks]


def of_recording(recording: Recording, block: int) -> Checksums:
    """Per channel; a zero's sign and the bits of a NaN are no difference."""
    found = {}
    for name in recording.channels:
        values = np.asarray(recording[name], dtype="<f8") + 0.0
        values[np.isnan(values)] = np.nan
        found[name] = checksums([value.tobytes() for value in values], block)
    return found


#: Request and answer, by which the twin is asked what it has found once all has stopped.
ASKED_AT_THE_END = ("620", "5A0")


def of_trace(trace: Path, block: int) -> Checksums:
    """Per identifier: its frames of each cycle, from the first SYNC to the last but one, whatever their order.

    What follows the last SYNC is left out: nodes leave OPERATIONAL then.
    """
    frames: dict[str, dict[int, list[bytes]]] = defaultdict(lambda: defaultdict(list))
    cycle = -1
    for line in trace.read_bytes().splitlines():
        identifier, _, data = line.split()[2].partition(b"#")
        cycle += identifier == b"080"
        if cycle >= 0:
            frames[identifier.decode()][cycle].append(b"#" + data)
    return {
        f"frames {identifier}h": checksums([b"".join(sorted(by_cycle[number])) for number in range(cycle)], block)
        for identifier, by_cycle in sorted(frames.items())
        if min(by_cycle) < cycle or identifier not in ASKED_AT_THE_END
    }


def block_of(name: str) -> int:
    """Cycles per checksum of a run."""
    return BLOCK if name == DEMONSTRATOR else LONG_BLOCK


def left_by(name: str, folder: Path) -> RunFolder:
    """Run a config in one process, where it is as shipped once for all that share the folder."""
    if not TO_THE_BIT.get(name):
        return shipped_run(name, folder).folder
    loaded = load_with_overrides(CONFIGS / f"{name}.yaml", changes=TO_THE_BIT[name])
    return run_experiment(loaded, folder, participants=Participants.IN_PROCESS).folder


def checksums_of(name: str, left: RunFolder) -> Checksums:
    """Checksums of all that a run left."""
    return of_recording(read_recording(left.recording), block_of(name)) | of_trace(left.trace, block_of(name))


def means_of(left: RunFolder) -> dict[str, list[float]]:
    """Mean of each channel of a run in each block of cycles, where it has no value as of 0; then its RMS."""
    recording = read_recording(left.recording)
    found = {}
    for channel in recording.channels:
        values = np.nan_to_num(np.asarray(recording[channel], dtype=float), posinf=0.0, neginf=0.0)
        blocks = (values[first : first + LONG_BLOCK] for first in range(0, len(values), LONG_BLOCK))
        found[channel] = [*(float(block.mean()) for block in blocks), float(np.sqrt(np.mean(values**2)))]
    return found


def differences(stored: Checksums, found: Checksums, block: int = BLOCK) -> list[str]:
    """What differs, in words, the earliest first."""
    texts = [(-1, f"{name} is gone") for name in stored.keys() - found.keys()]
    texts += [(-1, f"{name} is new") for name in found.keys() - stored.keys()]
    for name in stored.keys() & found.keys():
        blocks = max(len(stored[name]), len(found[name]))
        for number in range(blocks):
            if stored[name][number : number + 1] != found[name][number : number + 1]:
                first = number * block
                texts.append((first, f"{name} differs from cycle {first} to {first + block - 1} on"))
                break
    return [text for _, text in sorted(texts)]


def stored(name: str) -> dict[str, list[str]]:
    """What was kept of a run, by channel."""
    data = json.loads((STORED / f"{name}.json").read_text(encoding="utf-8"))
    return {channel: text.split() for channel, text in data.items()}


@pytest.mark.parametrize("name", [DEMONSTRATOR, *slow(*(name for name in TO_THE_BIT if name != DEMONSTRATOR))])
def test_a_run_records_the_samples_and_sends_the_frames_that_it_always_did(name, shipped, tmp_path):
    left = left_by(name, tmp_path) if TO_THE_BIT[name] else shipped(name).folder
    assert differences(stored(name), checksums_of(name, left), block_of(name)) == []


@pytest.mark.parametrize("name", slow(*BY_MEANS))
def test_the_means_of_a_run_are_those_that_they_always_were(name, shipped):
    before = {channel: np.array(means, dtype=float) for channel, means in stored(name).items()}
    now = means_of(shipped(name).folder)
    assert now.keys() == before.keys()
    for channel, means in before.items():
        assert now[channel] == pytest.approx(means, abs=TOLERANCE * means[-1], rel=0.0), channel


def test_a_difference_is_named_with_its_cycles():
    cycles = [bytes([number % 7]) for number in range(160)]
    other = [*cycles[:120], b"x", *cycles[121:]]
    stored = {"x1_m": checksums(cycles), "tau1_Nm": checksums(cycles), "frames 181h": checksums(cycles)}
    found = {"x1_m": checksums(other), "tau1_Nm": checksums(cycles), "frames 182h": checksums(cycles)}
    assert differences(stored, found) == [
        "frames 181h is gone",
        "frames 182h is new",
        "x1_m differs from cycle 100 to 149 on",
    ]


if __name__ == "__main__":
    for run in sys.argv[1:] or (*TO_THE_BIT, *BY_MEANS):
        with tempfile.TemporaryDirectory() as scratch:
            left = left_by(run, Path(scratch))
            if run in BY_MEANS:
                kept = {channel: [f"{mean:.12g}" for mean in means] for channel, means in means_of(left).items()}
            else:
                kept = checksums_of(run, left)
        rows = (f'"{name}": "{" ".join(blocks)}"' for name, blocks in kept.items())
        (STORED / f"{run}.json").write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
