"""Coverage-guided fuzzing of everything that reads files or takes frames (atheris, libFuzzer).

    pip install -e '.[fuzz]'
    python tools/fuzz.py                        all targets, a minute each
    python tools/fuzz.py eds config --seconds 300

Each target runs in a process of its own. What makes one fail, hang (10 s) or take more than 2 GB is kept in
tests/fuzz/found, where a test reads it from then on. Exit code 1 when something was found.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOUND = ROOT / "tests" / "fuzz" / "found"
#: libFuzzer: seconds until an input counts as a hang, MB until it takes too much, longest input in bytes.
LIMITS = ("-timeout=10", "-rss_limit_mb=2048", "-max_len=20000", "-print_final_stats=1")


def fuzz(name: str, arguments: list[str]) -> None:
    """Fuzz one target in this process; does not return."""
    import warnings

    import atheris

    sys.path.insert(0, str(ROOT))
    warnings.simplefilter("ignore")
    with atheris.instrument_imports(include=["hilbench", "canopen", "can", "configparser", "yaml", "tests"]):
        from tests.fuzz.targets import TARGETS
    target = TARGETS[name]
    for number, seed in enumerate(target.seeds()):
        Path(arguments[-1], f"seed{number}").write_bytes(seed)
    atheris.Setup([sys.argv[0], *arguments], target.run)
    atheris.Fuzz()


def search(name: str, seconds: int) -> str:
    """Fuzz a target in a process of its own; the row of the table."""
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-") as folder:
        corpus, crashes = Path(folder, "corpus"), Path(folder, "crashes")
        corpus.mkdir()
        crashes.mkdir()
        limits = [*LIMITS, f"-max_total_time={seconds}", f"-artifact_prefix={crashes}/"]
        command = [sys.executable, __file__, "--inside", name, *limits, str(corpus)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        said = done.stdout + done.stderr
        executed = re.findall(r"number_of_executed_units: (\d+)", said)
        coverage = re.findall(r"cov: (\d+)", said)
        found = sorted(crashes.iterdir())
        for path in found:
            shutil.copy(path, FOUND / f"{name}-{path.name[-12:]}")
        if found or done.returncode:
            lines = [line for line in said.splitlines() if not line.startswith("INFO")]
            print("\n".join(lines)[-3000:], file=sys.stderr)
        return (
            f"| {name} | {seconds} | {executed[-1] if executed else '–'} | {coverage[-1] if coverage else '–'} "
            f"| {len(found)} |"
        )


def main() -> int:
    """Fuzz the targets one after the other."""
    if sys.argv[1:2] == ["--inside"]:
        fuzz(sys.argv[2], sys.argv[3:])
    sys.path.insert(0, str(ROOT))
    from tests.fuzz.targets import TARGETS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", help=f"some of {', '.join(TARGETS)}; all of them if not given")
    parser.add_argument("--seconds", type=int, default=60, help="for each target")
    options = parser.parse_args()
    before = set(FOUND.iterdir()) if FOUND.exists() else set()
    FOUND.mkdir(parents=True, exist_ok=True)
    print("| target | seconds | inputs | edges | found |\n|---|--:|--:|--:|--:|")
    for name in options.targets or TARGETS:
        print(search(name, options.seconds), flush=True)
    return 1 if set(FOUND.iterdir()) - before else 0


if __name__ == "__main__":
    sys.exit(main())
