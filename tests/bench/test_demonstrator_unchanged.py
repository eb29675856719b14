"""The demonstrator is the machine that it was: recording and frames of a short step change, against what was stored.

`demonstrator.json` holds, for each channel of the recording and each identifier on the bus, a checksum of every block
of cycles, so that a failure says what differs and from when on. A number differs when one of its bits does: lockstep
promises the same bits on any machine, whatever its vector units (tried with those of numpy, OpenBLAS, glibc and numba
switched off). Who changes what the demonstrator does on purpose makes the file again, and says in the commit why:

    python -m tests.bench.test_demonstrator_unchanged
"""

from __future__ import annotations

import json
import tempfile
import zlib
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
STORED = Path(__file__).with_name("demonstrator.json")
#: The shipped experiment, told faster: the same steps, the same speed.
SHORTER = (
    "steps.0.ramp.duration_s=2.0",
    "steps.1.hold.until_s=3.0",
    "steps.3.hold.duration_s=2.0",
    "steps.4.ramp.duration_s=1.0",
    "steps.5.hold.duration_s=0.2",
)
BLOCK = 50  #: cycles per checksum

Checksums = dict[str, list[str]]


def checksums(cycles: Sequence[bytes]) -> list[str]:
    """One checksum per block of cycles."""
    blocks = (cycles[first : first + BLOCK] for first in range(0, len(cycles), BLOCK))
    return [f"{zlib.crc32(b'|'.join(block)):08x}" for block in blocks]


def of_recording(recording: Recording) -> Checksums:
    """Per channel; a zero's sign and the bits of a NaN are no difference."""
    found = {}
    for name in recording.channels:
        values = np.asarray(recording[name], dtype="<f8") + 0.0
        values[np.isnan(values)] = np.nan
        found[name] = checksums([value.tobytes() for value in values])
    return found


#: Request and answer, by which the twin is asked what it has found once all has stopped.
ASKED_AT_THE_END = ("620", "5A0")


def of_trace(trace: Path) -> Checksums:
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
        f"frames {identifier}h": checksums([b"".join(sorted(by_cycle[number])) for number in range(cycle)])
        for identifier, by_cycle in sorted(frames.items())
        if min(by_cycle) < cycle or identifier not in ASKED_AT_THE_END
    }


def demonstrator(folder: Path) -> Checksums:
    """Run it; the checksums of all that it left."""
    loaded = load_with_overrides(CONFIG, changes=SHORTER)
    left = run_experiment(loaded, folder, participants=Participants.IN_PROCESS).folder
    return of_recording(read_recording(left.recording)) | of_trace(left.trace)


def differences(stored: Checksums, found: Checksums) -> list[str]:
    """What differs, in words, the earliest first."""
    said = [(-1, f"{name} is gone") for name in stored.keys() - found.keys()]
    said += [(-1, f"{name} is new") for name in found.keys() - stored.keys()]
    for name in stored.keys() & found.keys():
        blocks = max(len(stored[name]), len(found[name]))
        for number in range(blocks):
            if stored[name][number : number + 1] != found[name][number : number + 1]:
                first = number * BLOCK
                said.append((first, f"{name} differs from cycle {first} to {first + BLOCK - 1} on"))
                break
    return [text for _, text in sorted(said)]


def test_the_demonstrator_records_the_samples_and_sends_the_frames_that_it_always_did(tmp_path):
    stored = {name: text.split() for name, text in json.loads(STORED.read_text(encoding="utf-8")).items()}
    assert differences(stored, demonstrator(tmp_path)) == []


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
    with tempfile.TemporaryDirectory() as scratch:
        rows = (f'"{name}": "{" ".join(blocks)}"' for name, blocks in demonstrator(Path(scratch)).items())
        STORED.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
