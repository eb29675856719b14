"""Write CLAIMS.md: each figure that README and the docs' first page claim, with the run that last showed it.

    claims.py [RUNS]

The figures are those of `result.json` and `diagnosis.json` in the run folders of RUNS; the newest run of a config
counts.
Exit code 1 where a claim does not hold or nothing shows it: its row is red then.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "CLAIMS.md"
_HEAD = """# Claims

Figures of README and of the docs' first page, the command that shows each, and the last run that did: `make claims`
runs them and writes this page. Figures of other pages stand there with how they were measured; those of speed are
written by `make bench` into [docs/performance.md](docs/performance.md).

| claim | shown by | found | date, commit | |
|---|---|--:|---|---|
"""


@dataclass(frozen=True)
class Claim:
    """What a page says, and what has to lie between which limits for it."""

    page: str
    text: str  #: as it stands there; line ends do not count
    config: str
    figure: str  #: a metric of the run, or `effect` of its diagnosis
    least: float
    most: float
    unit: str

    @property
    def command(self) -> str:
        """What shows it."""
        does = "diagnose" if self.figure in _OF_DIAGNOSIS else "run"
        return f"hilbench {does} bench_configs/{self.config}.yaml"

    def is_made(self) -> bool:
        """Whether the page says so."""
        return self.text in " ".join((ROOT / self.page).read_text(encoding="utf-8").split())


#: Figures of a diagnosis: the force of the dry friction that it found, N.
_OF_DIAGNOSIS = {"coulomb_friction.force_N": ("coulomb_friction", "force_N")}
#: A figure with two digits holds where the measured one rounds to it.
CLAIMS = (
    Claim("README.md", "within 1 % after 0.13 s", "web_section_step", "E_time_to_1pct_s", 0.0, 0.135, "s"),
    Claim("docs/index.md", "within 1 % after 0.13 s", "web_section_step", "E_time_to_1pct_s", 0.0, 0.135, "s"),
    Claim("README.md", "back within ±1 N after 0.48 s", "web_section_step", "tension_recovery_s", 0.0, 0.485, "s"),
    Claim("docs/index.md", "back within ±1 N after 0.48 s", "web_section_step", "tension_recovery_s", 0.0, 0.485, "s"),
    Claim("README.md", "takes about 20 s", "web_section_step_pid", "E_time_to_1pct_s", 18.0, 22.0, "s"),
    Claim(
        "README.md",
        "names the effect with its parameters and their 95 % intervals",
        "hidden_friction",
        "coulomb_friction.force_N",
        3.0,
        6.0,
        "N",
    ),
)


def newest(runs: Path, claim: Claim) -> tuple[float, Mapping[str, Any]] | None:
    """The figure of a claim in the newest run that has it, with all that the run's result says; None: there is none."""
    for folder in sorted(runs.glob(f"{claim.config}-*"), key=lambda each: each.stat().st_mtime, reverse=True):
        if (folder / "result.json").exists():
            result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
            value = _found(folder, claim) if claim.figure in _OF_DIAGNOSIS else result["metrics"].get(claim.figure)
            if value is not None:
                return float(value), result
    return None


def _found(folder: Path, claim: Claim) -> float | None:
    effect, parameter = _OF_DIAGNOSIS[claim.figure]
    path = folder / "diagnosis.json"
    found = json.loads(path.read_text(encoding="utf-8"))["effects"] if path.exists() else []
    return next((each["parameters"][parameter]["value"] for each in found if each["effect"] == effect), None)


def row(runs: Path, claim: Claim) -> tuple[str, bool]:
    """A line of the table, and whether the claim holds."""
    what = f"| {claim.text} ([{claim.page}]({claim.page})) | `{claim.command}` |"
    if not claim.is_made():
        return f"{what} | | 🔴 the page does not say so |", False
    shown = newest(runs, claim)
    if shown is None:
        return f"{what} | | 🔴 no run shows it |", False
    value, result = shown
    commit = (result["provenance"] or {}).get("git") or {}
    when = (
        f"{result['began'][:10]}, {commit.get('commit', 'no commit')[:8]}{' and changes' * bool(commit.get('changed'))}"
    )
    holds = claim.least <= value <= claim.most
    return f"{what} {value:.3g} {claim.unit} | {when} | {'🟢' if holds else '🔴 does not hold'} |", holds


def main() -> int:
    """Write the page; the exit code."""
    rows = [row(Path(sys.argv[1] if len(sys.argv) > 1 else "runs"), claim) for claim in CLAIMS]
    PAGE.write_text(_HEAD + "\n".join(text for text, _ in rows) + "\n", encoding="utf-8")
    return 0 if all(holds for _, holds in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
