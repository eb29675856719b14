"""``python -m hilbench.live CONFIG --pace PACE --connection N``: live diagnosis process, started by a bench."""

import sys
from argparse import ArgumentParser
from multiprocessing.connection import Connection
from pathlib import Path
from typing import get_args

from hilbench.bench.reports.diagnosis_updates import ProposalOutcome, Ready, Samples
from hilbench.cpu_throttle import throttle_cpu
from hilbench.exit_status import ended
from hilbench.live.session import Session, warm_up
from hilbench.machine_kinds import machine_part
from hilbench.real_time import give_way
from hilbench.topology.blocks import Pace
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import read_resolved


def main() -> None:
    """Answer every chunk of samples until the bench ends this process, or closes the connection."""
    parser = ArgumentParser(prog="python -m hilbench.live")
    parser.add_argument("config", type=Path, help="resolved bench config")
    parser.add_argument("--pace", choices=get_args(Pace), default="realtime", help="by the clock, or by SYNC")
    parser.add_argument("--connection", type=int, required=True, help="open socket to the bench")
    given = parser.parse_args()
    config = read_resolved(given.config).model_copy(update={"pace": given.pace})
    with Connection(given.connection) as connection:
        answer(connection, config)


def answer(connection: Connection, config: BenchConfig) -> None:
    """Answer messages until the connection is closed."""
    live = config.twin.live_diagnosis
    assert live is not None, "it is started where there is one"
    machine = machine_part(config.machine.kind, "live_diagnosis")(config)
    given = [signal.name for signal in config.signals], machine, live, config.cycle_time_s
    warm_up(*given)
    session = Session(*given)
    if config.pace == "realtime":
        cores = config.realtime.cores
        taken = {core for core in (cores.bench, cores.hardware, cores.twin) if core is not None}
        give_way(taken, before=config.realtime.priority)
        throttle_cpu()
    connection.send(Ready())
    while True:
        try:
            message = connection.recv()
        except EOFError:
            return
        if isinstance(message, Samples):
            connection.send(session.samples(message))
        elif isinstance(message, ProposalOutcome):
            session.outcome(message)


if __name__ == "__main__":
    sys.exit(ended(main))
