"""``python -m hilbench.hardware CONFIG --pace PACE``: the simulated hardware as a bench starts it."""

import sys

from hilbench.exit_status import ended
from hilbench.hardware.simulation import simulate
from hilbench.processes import report_lost_frames
from hilbench.topology.resolved import config_of_process


def main() -> None:
    """Simulate until the bench ends this process, or disconnects."""
    report_lost_frames(simulate(config_of_process("hilbench.hardware")))


sys.exit(ended(main))
