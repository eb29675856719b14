"""``python -m hilbench.results CONFIG --out FOLDER``: one run of a sweep; its run folder says what came of it."""

import sys
from argparse import ArgumentParser
from pathlib import Path

from hilbench.bench.lifecycle.participants import Participants
from hilbench.exit_status import ended
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides


def main() -> None:
    """Run the experiment of a config; exit codes as of ``hilbench run``."""
    parser = ArgumentParser(prog="python -m hilbench.results")
    parser.add_argument("config", type=Path, help="bench config (YAML)")
    parser.add_argument("--out", type=Path, required=True, help="folder in which the run folder is made")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="another value in the config")
    parser.add_argument("--bus", help="another bus")
    parser.add_argument("--in-process", action="store_true", help="simulated hardware and twin in this process")
    given = parser.parse_args()
    loaded = load_with_overrides(given.config, bus=given.bus, changes=given.set)
    participants = Participants.IN_PROCESS if given.in_process else Participants.STARTED
    outcome = run_experiment(loaded, given.out, participants=participants)
    sys.exit(outcome.exit_code)


sys.exit(ended(main))
