"""Experiments as Python generators: a function of a file, resumed every cycle with that cycle's sample."""

from __future__ import annotations

import importlib.util
import traceback
from collections.abc import Callable, Generator
from pathlib import Path

from hilbench.bench.bench import Bench
from hilbench.errors import BenchFaultError, HilbenchError, UnusableInputError, UnusableValueError
from hilbench.runs.criteria import CriterionResult, failed_or_passed
from hilbench.topology.sample import CycleSample

Experiment = Callable[[Bench], Generator[None, CycleSample, None]]


def load_experiment(path: Path, function: str) -> Experiment:
    """The generator function of a file. Raises UnusableInputError when the file or the function is none."""
    spec = importlib.util.spec_from_file_location(f"hilbench_experiment_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise UnusableInputError(path, "no such Python file, expected one with the experiment")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever the file raises, a SystemExit too: it is the author's to read
        raise UnusableInputError(_place(path, error), f"{type(error).__name__}: {error}") from error
    found = getattr(module, function, None)
    if not callable(found):
        raise UnusableInputError(path, f"no function '{function}', expected a generator function of the bench")
    experiment: Experiment = found
    return experiment


def run_experiment_function(bench: Bench, path: Path, function: str, judged: list[CriterionResult]) -> None:
    """Run it; an assertion that fails is a failed criterion, anything else it raises a bench fault.

    Raises BenchFaultError naming file and line.
    """
    experiment = load_experiment(path, function)
    name = f"{path.name}: {function}"
    try:
        bench.follow(experiment(bench))
    except UnusableValueError as error:
        raise BenchFaultError(f"{_place(path, error)}: {error}") from error
    except (HilbenchError, KeyboardInterrupt):
        raise
    except AssertionError as error:
        text = f"{_place(path, error)}: {error}".rstrip(": ")
        judged.append(failed_or_passed(name, text))
    except BaseException as error:  # a SystemExit ends the run as any other does
        raise BenchFaultError(f"{_place(path, error)}: {type(error).__name__}: {error}") from error
    else:
        judged.append(failed_or_passed(name))


def _place(path: Path, error: BaseException) -> str:
    """The last line of the file that the error passed."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    return f"{path}:{lines[-1]}" if lines else str(path)
