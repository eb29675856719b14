"""``python -m hilbench.twin CONFIG --pace PACE``: the twin as a bench starts it."""

import sys

from hilbench.exit_status import ended
from hilbench.processes import report_lost_frames
from hilbench.topology.resolved import config_of_process
from hilbench.twin.run import run


def main() -> None:
    """Run the twin until the bench ends this process, or has ended itself."""
    report_lost_frames(run(config_of_process("hilbench.twin")))


sys.exit(ended(main))
