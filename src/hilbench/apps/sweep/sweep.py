"""Many runs of one config over a grid or a sample of its values: in processes of their own, resumable, one table."""

from __future__ import annotations

import csv
import itertools
import json
import math
import os
import select
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants, can_be_in_process
from hilbench.canopen.master_guard import mastery
from hilbench.errors import (
    EXIT_BENCH_FAULT,
    EXIT_CRITERION_FAILED,
    EXIT_INTERRUPTED,
    EXIT_PASSED,
    HilbenchError,
    UnusableInputError,
    one_line,
)
from hilbench.files import make_folder, write_whole, written_whole
from hilbench.forked_workers import ForkedWorker, forked_workers
from hilbench.processes import ChildProcess, finishing
from hilbench.real_time import for_good
from hilbench.results.recording_builder import Recorder
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load_with_overrides, parse_change

_DEFINITION, _LOG, _TABLE, _PARQUET = "sweep.json", "results.jsonl", "results.csv", "results.parquet"
_LAST_WORDS = 300
_MOST_RUNS = 10_000
_RUN = "run"
#: So many cycles have called all that a run calls in its cycles.
_LOADING_CYCLES = 50
_CONNECT_S = 10


@dataclass(frozen=True)
class Axis:
    """One value that is varied: a list of texts, or a range (`low` … `high`) from which samples are drawn."""

    path: str
    values: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0


@dataclass(frozen=True)
class Row:
    """One run: its number, what was varied, its exit code, metrics and folder (None: it got none), and last words."""

    number: int
    changes: dict[str, str]
    exit_code: int
    run: str | None = None
    metrics: dict[str, float | None] = field(default_factory=dict)
    said: str = ""
    judged: bool = True

    @property
    def passed(self) -> bool | None:
        """None: it was completed, and nothing was judged."""
        return self.exit_code == EXIT_PASSED if self.judged or self.exit_code else None


@dataclass(frozen=True)
class Job:
    """One run to be done: the arguments of `hilbench.results`, and the folder that it makes its run folder in."""

    number: int
    changes: dict[str, str]
    arguments: tuple[str, ...]
    folder: str

    @property
    def log(self) -> Path:
        """File for what it says, beside its folder."""
        return Path(self.folder).with_suffix(".log")


def begin(job: Job, copy: ForkedWorker | None = None) -> ChildProcess:
    """Start a run in a process of its own, or let a copy of this process become it; what it says is kept where it
    failed."""
    job.log.parent.mkdir(parents=True, exist_ok=True)
    job.log.unlink(missing_ok=True)
    return ChildProcess(f"run {job.number}", ["hilbench.results", *job.arguments], job.log, copy=copy)


def row_of(job: Job, process: ChildProcess) -> Row | None:
    """Row of a run, once it has ended; None when it was interrupted."""
    code, said, folder = process.wait(), process.last_words(), Path(job.folder)
    process.end()
    if code in (EXIT_PASSED, EXIT_CRITERION_FAILED, EXIT_INTERRUPTED):
        job.log.unlink(missing_ok=True)
    if code == EXIT_INTERRUPTED:
        return None
    folders = sorted(folder.glob("*/")) if folder.is_dir() else []
    result = RunFolder(folders[-1]).result if folders else None
    left = json.loads(result.read_text(encoding="utf-8")) if result is not None and result.exists() else {}
    faults = " ".join(fault["text"] for fault in left.get("faults", []))
    said = "" if code in (EXIT_PASSED, EXIT_CRITERION_FAILED) else (faults or said)[:_LAST_WORDS]
    run = str(folders[-1].relative_to(folder.parents[1])) if folders else None
    return Row(job.number, job.changes, code, run, left.get("metrics", {}), said, bool(left.get("criteria")))


def execute(job: Job) -> Row | None:
    """Do a run in a process of its own, here; None when it was interrupted."""
    return row_of(job, begin(job))


@contextmanager
def _on_cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask cluster. Raises UnusableInputError when it can't be used."""
    try:
        from distributed import Client
    except ImportError:
        raise UnusableInputError("--cluster", "needs Dask, expected 'pip install hilbench[cluster]'") from None
    try:
        client = Client(address, timeout=_CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        reason = one_line(error)
        raise UnusableInputError(f"--cluster {address}", f"{reason}, expected a running Dask scheduler") from error
    with client, client.get_executor(pure=False) as pool:
        yield pool


def parse_axis(text: str) -> Axis:
    """``KEY=1,2,3``, ``KEY=1..3:5`` (5 values from 1 to 3) or ``KEY=1..3`` (a range to sample).

    Raises UnusableInputError.
    """
    path, equals, values = text.partition("=")
    place = f"--vary {text}"
    if not equals or not path or not values:
        raise UnusableInputError(place, "expected KEY=V1,V2,…, KEY=FROM..TO:COUNT or KEY=FROM..TO")
    if ".." not in values:
        return Axis(path, tuple(value.strip() for value in values.split(",")))
    bounds, colon, count = values.partition(":")
    try:
        low, high = (float(bound) for bound in bounds.split(".."))
        number = int(count) if colon else 0
    except ValueError:
        raise UnusableInputError(place, "expected FROM..TO or FROM..TO:COUNT in numbers") from None
    if not 0.0 < high - low < math.inf or (colon and not 2 <= number <= _MOST_RUNS):
        raise UnusableInputError(place, f"expected FROM below TO, and a COUNT of 2 to {_MOST_RUNS}")
    if not colon:
        return Axis(path, low=low, high=high)
    return Axis(path, tuple(f"{value:.12g}" for value in np.linspace(low, high, number)))


def points(axes: Sequence[Axis], samples: int | None, seed: int) -> list[dict[str, str]]:
    """Changes of each run: the grid of all lists, each with `samples` points of the ranges (Latin hypercube).

    Raises UnusableInputError for ranges without a number of samples, or the other way round, and for too many runs.
    """
    lists = [axis for axis in axes if axis.values]
    ranges = [axis for axis in axes if not axis.values]
    if bool(ranges) != (samples is not None):
        raise UnusableInputError("--samples", "expected together with a range KEY=FROM..TO, and only then")
    count = math.prod(len(axis.values) for axis in lists) * (samples or 1)
    if count > _MOST_RUNS:
        raise UnusableInputError("--vary", f"{count} runs in all, expected {_MOST_RUNS} at most")
    drawn: list[dict[str, str]] = [{}]
    if ranges:
        from scipy.stats import qmc

        unit = qmc.LatinHypercube(len(ranges), rng=np.random.default_rng(seed)).random(samples or 1)
        drawn = [
            {
                axis.path: f"{axis.low + (axis.high - axis.low) * share:.12g}"
                for axis, share in zip(ranges, row, strict=True)
            }
            for row in unit
        ]
    grid = itertools.product(*([(axis.path, value) for value in axis.values] for axis in lists))
    return [{**dict(chosen), **sample} for chosen in grid for sample in drawn]


class Sweep:
    """The runs of one sweep in one folder.

    Raises UnusableInputError when a value cannot be used, or the folder holds another sweep.
    """

    def __init__(self, config: Path, changes: Sequence[str], runs: Sequence[dict[str, str]], out: Path) -> None:
        for run in runs:  # every point is checked before the first one runs
            loaded = load_with_overrides(config, changes=[*changes, *_texts(run)])
        self._config = config
        self._changes = list(changes)
        self.runs = list(runs)
        self.out = out
        #: Runs share the wire and the clock of a real bus: there is one at a time.
        self.alone = loaded.config.bus_address.interface != "embedded" or loaded.config.pace == "realtime"
        self._bus, self._master_id = loaded.config.bus_address, loaded.config.master.node_id
        self._embedded = self._bus.interface == "embedded"
        # In real time what comes late is a part of what a run shows, and nothing does in one process.
        self._in_process = loaded.config.pace == "lockstep" and can_be_in_process(loaded.config)
        self._any = loaded.config
        self.rows = self._resume()

    def _resume(self) -> dict[int, Row]:
        definition = {"config": str(self._config.resolve()), "changes": self._changes, "runs": self.runs}
        path = self.out / _DEFINITION
        if path.exists():
            if json.loads(path.read_text(encoding="utf-8")) != definition:
                raise UnusableInputError(self.out, "holds another sweep, expected this one or an empty folder")
        else:
            make_folder(self.out)
            write_whole(path, json.dumps(definition, indent=2))
        log = self.out / _LOG
        text = log.read_text(encoding="utf-8", errors="replace") if log.exists() else ""
        if not text.endswith("\n"):  # what a killed process has left of a line: that run is done again
            text = text[: text.rfind("\n") + 1]
            write_whole(log, text)
        rows = [Row(**json.loads(line)) for line in text.splitlines()]
        return {row.number: row for row in rows}

    def run(self, jobs: int, done: Callable[[Row], None], cluster: str | None = None) -> None:
        """Do what is left, `jobs` at a time; `done` gets each row. Ctrl-C ends the runs that go on.

        `cluster`: address of a running Dask scheduler, whose workers do the runs instead, as many at a time as they
        have threads. They need this hilbench, and the config and the sweep's folder under the same paths. Runs that
        are under way there go on after Ctrl-C. Raises UnusableInputError when there is no such cluster, and for a real
        bus that has a master.
        """
        left = [self._job(number) for number in range(len(self.runs)) if number not in self.rows]
        if left and self.alone and not self._embedded:
            with mastery(self._bus, self._master_id, f"sweep of {self._config.name}"):
                pass  # each run takes the bus for itself; a bus that has a master would make all of them fail
        if cluster is None:
            self._run_here(left, 1 if self.alone else jobs, done)
        elif self.alone:
            raise UnusableInputError("--cluster", "runs on a real bus, or in real time, go one after the other here")
        else:
            self._run_there(left, cluster, done)

    def _run_here(self, left: Sequence[Job], jobs: int, done: Callable[[Row], None]) -> None:
        """Run jobs in forks of this process, which has loaded what each of them needs."""
        if len(left) > 1:
            self._load()
        waiting, running = deque(left), dict[int, tuple[Job, ChildProcess]]()
        ends = select.poll()
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    job = waiting.popleft()
                    with forked_workers({_RUN: lambda: None}) as made:
                        process = begin(job, made.pop(_RUN, None))
                    end = os.pidfd_open(process.pid)
                    running[end] = job, process
                    ends.register(end, select.POLLIN)
                for end, _ in ends.poll():
                    ends.unregister(end)
                    os.close(end)
                    self._keep(row_of(*running.pop(end)), done)
        finally:
            for _, process in running.values():
                process.end()

    def _load(self) -> None:
        """Load what a run needs, by a bench that is started, runs a little and is left again; what is wrong with it the
        runs say."""
        with for_good(), suppress(HilbenchError):
            if self._in_process:
                recorder = Recorder(self._any.signals)
                with Bench(self._any, observers=[recorder], participants=Participants.IN_PROCESS) as bench:
                    bench.run(_LOADING_CYCLES * self._any.cycle_time_s)

    def _run_there(self, left: Sequence[Job], cluster: str, done: Callable[[Row], None]) -> None:
        with _on_cluster(cluster) as pool:
            waiting = {pool.submit(execute, job): job for job in left}
            try:
                while waiting:
                    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                        job, error = waiting.pop(future), future.exception()
                        lost = Row(job.number, job.changes, EXIT_BENCH_FAULT, said=f"not done: {error}"[:_LAST_WORDS])
                        self._keep(future.result() if error is None else lost, done)
            except BaseException:
                for future in waiting:
                    future.cancel()
                raise

    def _keep(self, row: Row | None, done: Callable[[Row], None]) -> None:
        if row is None:
            return
        self.rows[row.number] = row
        with finishing("a run is entered into the table"):
            with open(self.out / _LOG, "a", encoding="utf-8") as log:
                log.write(json.dumps(asdict(row)) + "\n")
            self.write_table()
        done(row)

    def _job(self, number: int) -> Job:
        changes, folder = self.runs[number], self.out.resolve() / "runs" / f"{number:05d}"
        arguments = [str(self._config.resolve()), "--out", str(folder)]
        for text in [*self._changes, *_texts(changes)]:
            arguments += ["--set", text]
        if self._in_process:
            arguments.append("--in-process")
        elif self._embedded:
            arguments += ["--bus", f"embedded:sweep{os.getpid()}n{number}"]
        return Job(number, changes, tuple(arguments), str(folder))

    def sorted_rows(self) -> list[Row]:
        """The rows in the order of their numbers."""
        return [row for _, row in sorted(self.rows.items())]

    @property
    def varied(self) -> list[str]:
        """The keys of the config that were varied."""
        return list(dict.fromkeys(path for run in self.runs for path in run))

    def shown_metrics(self) -> list[str]:
        """Metrics of the criteria; without any, those that are not the same in all runs."""
        judged = list(dict.fromkeys(criterion.metric for criterion in self._any.criteria))
        found = dict.fromkeys(name for row in self.rows.values() for name in row.metrics)
        return judged or [name for name in found if len({row.metrics.get(name) for row in self.rows.values()}) > 1]

    def write_table(self) -> Path:
        """`results.csv`: a row a run, in order; what was varied, exit code, metrics, folder."""
        metrics = dict.fromkeys(name for row in self.rows.values() for name in row.metrics)
        path = self.out / _TABLE
        with written_whole(path) as partial, open(partial, "w", encoding="utf-8", newline="") as file:
            columns = ["number", *self.varied, "exit_code", "passed", *metrics, "run", "said"]
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(self._table())
        return path

    def _table(self) -> list[dict[str, Any]]:
        return [
            {"number": row.number, **row.changes, "exit_code": row.exit_code, "passed": row.passed}
            | row.metrics
            | {"run": row.run, "said": row.said}
            for row in self.sorted_rows()
        ]

    def write_parquet(self) -> Path | None:
        """Write the table as `results.parquet`, with types; None where pyarrow is not installed."""
        if find_spec("pyarrow") is None:
            return None
        import pandas

        path = self.out / _PARQUET
        with written_whole(path) as partial:
            pandas.DataFrame(self._table()).to_parquet(partial, index=False)
        return path

    def as_data(self) -> list[dict[str, Any]]:
        """The table for machines."""
        return [{**asdict(row), "passed": row.passed} for row in self.sorted_rows()]


def _texts(changes: dict[str, str]) -> list[str]:
    texts = [f"{path}={value}" for path, value in changes.items()]
    for text in texts:
        parse_change(text)
    return texts
