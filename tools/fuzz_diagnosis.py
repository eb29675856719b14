"""Whether a diagnosis ends with a verdict or one line that says what is wrong, whatever the recording is.

    fuzz_diagnosis.py [--seeds N] [--first-seed N] [--jobs N] [--cases FILE]

A seed draws eight recordings of the independent line (`diagnose_independent.py`), and damages each: it is cut to half a
second up to all of it, begins anywhere, lacks some channels, has a frozen or dead one, or values that are no number.
Prints how many ended with which verdict, how many were refused, and what ended otherwise; exit code 1 then.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter
from dataclasses import replace
from pathlib import Path

import diagnose_independent as independent
import finished_cases
import numpy as np

from hilbench.diagnosis.diagnosis import diagnose
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording

_ALWAYS = "t_s"
_REFUSED, _UNEXPECTED = "refused", "unexpected"


def cases_of(seed: int) -> list[independent.Recorded]:
    """The drawn ones, each with a number of its own."""
    return [replace(case, condition=f"damaged {k}", seed=seed) for k, case in enumerate(independent.drawn(seed))]


def damaged(recording: Recording, rng: np.random.Generator) -> Recording:
    """Cut, without some channels, and with values that no stand should record."""
    rows = len(recording.channels[_ALWAYS])
    count = int(rows * rng.choice([1.0, rng.uniform(0.0125, 1.0)]))
    first = int(rng.integers(rows - count + 1))
    channels = {name: values[first : first + count].copy() for name, values in recording.channels.items()}
    others = [name for name in channels if name != _ALWAYS]
    for name in rng.choice(others, int(rng.choice([0, 0, 1, 2, 3])), replace=False):
        del channels[name]
    name, at = str(rng.choice(list(channels))), int(rng.integers(count))
    damage = rng.choice(["none", "none", "frozen", "dead", "no number"])
    if damage == "frozen":
        channels[name][at:] = channels[name][at]
    elif damage == "dead":
        channels[name][:] = 0.0
    elif damage == "no number":
        channels[name][at : at + int(rng.integers(1, 50))] = np.nan
    return Recording(channels)


def run(case: independent.Recorded) -> independent.Recorded:
    """Record, damage, diagnose."""
    recording, model = independent.recorded(case)
    rng = np.random.default_rng([41, case.seed, int(case.condition.split()[1])])
    began = time.process_time()
    try:
        case.verdict = diagnose(damaged(recording, rng), model, "stand").verdict
    except UnusableInputError as error:
        case.verdict, case.problem = _REFUSED, str(error)
    except Exception:  # what is looked for here
        case.verdict, case.problem = _UNEXPECTED, traceback.format_exc()
    case.seconds = round(time.process_time() - began, 2)
    return case


def main() -> int:
    """Run on all cores and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=63, help="eight recordings each")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    asked = [case for seed in seeds for case in cases_of(seed)]
    done = finished_cases.finish(asked, run, options.cases, options.jobs)
    unexpected = [case for case in done if case.verdict == _UNEXPECTED]
    print(len(done), "recordings:", dict(Counter(case.verdict for case in done)))
    print(f"CPU time of a diagnosis: largest {max(case.seconds or 0.0 for case in done):.0f} s")
    for case in unexpected:
        print(f"\nseed {case.seed}, {case.condition}: {case.problem}")
    return 1 if unexpected else 0


if __name__ == "__main__":
    sys.exit(main())
