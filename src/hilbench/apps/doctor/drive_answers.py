"""Read the answers of a stand's drives, and find what its last run recorded of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from hilbench.apps.doctor.drift import NodeAnswers
from hilbench.apps.doctor.examination import PRESENT_S, start_nodes
from hilbench.bench.lifecycle.in_process import InProcess
from hilbench.bench.lifecycle.participants import check_in_process
from hilbench.bench.lifecycle.startup import start_children
from hilbench.can.open import open_link, open_python_can
from hilbench.canopen.listening import listen, master_at_work, present
from hilbench.canopen.master_guard import master_of
from hilbench.canopen.sdo_client import SDO_ANSWERS, SdoClient
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.exchange.node_data import StandData, ask_all
from hilbench.results.run_folder import RunFolder
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import read_resolved

_LISTEN_S = 0.5


@dataclass(frozen=True)
class LastRun:
    """Record of the last run of a stand: its folder, its config, its nodes."""

    folder: RunFolder
    config: BenchConfig
    data: StandData


def last_run(runs: Path, stand: str) -> tuple[LastRun | None, list[str]]:
    """Last run of a stand among the folders in `runs`, None for none; and a line for each that can't be read."""
    found: list[tuple[RunFolder, StandData]] = []
    problems = []
    for path in sorted(runs.glob("*/nodes.json")):
        try:
            data = StandData.read(path)
        except UnusableInputError as error:
            problems.append(str(error))
            continue
        if data.stand == stand:
            found.append((RunFolder(path.parent), data))
    for folder, data in sorted(found, key=lambda each: each[1].time, reverse=True):
        try:
            return LastRun(folder, read_resolved(folder.config), data), problems
        except UnusableInputError as error:
            problems.append(str(error))
    return None, problems


def read_stand(
    config: BenchConfig, *, start: bool, in_process: bool, announce: Callable[[str], None]
) -> tuple[NodeAnswers, frozenset[str]]:
    """Answers of the drives, by part, and which of them were started for that; nothing is written to any.

    start: simulated drives are started when none of them is there. in_process: they are, without processes. Raises
    UnusableInputError where another master is at work, or no node answers; BenchFaultError for a bus that is lost.
    """
    simulated = frozenset(part.name for part in config.stand_drives if part.is_simulated)
    if in_process:
        check_in_process(config)
        here = InProcess(config)
        here.boot()
        with SdoClient(here.open_python_can(), config.master.sdo_timeout_s) as reader:
            return ask_all(reader, config), simulated
    with ExitStack() as resources:
        bus = config.bus_address.as_it_runs()
        link = resources.enter_context(closing(open_link(bus)))
        master = master_at_work(listen(link, _LISTEN_S), master_of(bus), config.master.node_id)
        if master is not None:
            raise UnusableInputError(str(bus), f"another master is at work: {master}, expected none: nodes are asked")
        fresh: frozenset[str] = frozenset()
        ids = list(config.simulated_drives)
        if start and ids and not present(link, ids, PRESENT_S):
            announce("start simulated hardware")
            fresh = simulated
            if not start_nodes(link, ids, partial(start_children, config), config.master.boot_timeout_s, resources):
                raise BenchFaultError(f"simulated hardware is not there within {config.master.boot_timeout_s:g} s")
        announce("ask the drives")
        with SdoClient(open_python_can(bus, SDO_ANSWERS), config.master.sdo_timeout_s) as reader:
            answers = ask_all(reader, config)
    if not any(answers.values()):
        raise UnusableInputError(str(bus), f"none of {', '.join(answers)} answers, expected the drives of the config")
    return answers, fresh
