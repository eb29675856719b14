"""`hilbench recover`: the recording, result and report of a run that was cut off."""

from __future__ import annotations

from pathlib import Path

from hilbench.apps.report.html import write_report
from hilbench.results.recording import read_recording
from hilbench.results.recover import recover_run
from hilbench.results.run_folder import RunFolder


def recover_command(path: Path) -> None:
    """Write what the run folder lacks, and say what that is."""
    folder = RunFolder.open(path)
    written = recover_run(folder)
    if not folder.report.exists():
        written.append(write_report(folder))
    recording = read_recording(folder.recording)
    print(f"{recording.samples} samples, {recording.time_s[-1]:.3f} s recovered")
    for file in written:
        print(file)
