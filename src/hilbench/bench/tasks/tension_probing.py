"""Probing of the machine: a small known change of the tension, where production data can't tell E from friction.

While the line runs steadily, dry friction, an offset of the torque and a wrong E look the same. The torque's response
to a small change of the tension separates them (`hilbench.estimation.web_line.probing_step`, in the twin): the
set-point goes up and down by a small share for some seconds. It is done when the twin states a wide deviation of E, or
on request (path `tension_control.probe`, object 2200h sub 7); its begin and end are notices, it
is in the journal, and in the recorded set-point.

At rest E and the web's strain are not identifiable at all, for a twin that is started with a web already
in the line. Where that is permitted, the rollers make a movement of a millimetre at most (`StandstillExcitation`)
until the twin knows both, or for some seconds; begun, reported and refused in the same way, and shown by the recorded
commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from operator import attrgetter

from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.limits import is_synchronized
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs
from hilbench.bench.tasks.tension_task import TensionTask
from hilbench.bench.tasks.tension_trust import TwinSignals
from hilbench.bench.tasks.web_standstill_excitation import StandstillExcitation
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_config import ProbingConfig
from hilbench.topology.web_line_quantities import TENSION_PROBE
from hilbench.twin.virtual_io import RUNNING

#: Slower than this a roller may turn back within a probe, and dry friction with it.
_LEAST_SPEED_M_S = 0.05
#: Relative deviation of E from which the web counts as unknown (a known one at rest has 10 to 17 %,
#: by unmeasured friction), and the longest movement at rest, s.
_UNKNOWN, _LONGEST_AT_REST_S = 0.25, 20.0
#: How to allow the probe requested.
_ALLOW = "hilbench sdo write bench 2200:7 1 (0 refuses)"


class Probing(CyclicTask):
    """Probes of one tension loop; a `SettableQuantity`: 1 requests or allows one, 0 ends or refuses it.

    `at_rest`: the movement permitted at rest, `of_all`: all spans that it identifies.
    """

    def __init__(
        self,
        config: ProbingConfig,
        loop: TensionTask,
        line_speed: Reference,
        state: BenchState,
        at_rest: StandstillExcitation | None = None,
        of_all: Sequence[TwinSignals] = (),
    ) -> None:
        self._config = config
        self._loop = loop
        self._at_rest = at_rest
        self._moves = False  # the probe under way is a movement at rest
        self._signals, *self._of_all = (attrgetter(each.modulus, each.deviation) for each in (loop.names.twin, *of_all))
        self._line_speed = line_speed
        self._state = state
        self._steady_for_s = 0.0
        self._steady_at = (0.0, 0.0)  # line speed and set-point
        self._since_s: float | None = None  # the probe began, in its own time; None while there is none
        self._rested_s = inf
        self._wanted = self._asked = False

    def owns(self, path: str) -> bool:
        """True if it is the switch of the probes."""
        return path == TENSION_PROBE

    def value(self, path: str) -> float:
        """Return 1 while a probe is under way or waits for a steady line."""
        return float(self._since_s is not None or self._wanted)

    def set(self, path: str, value: float) -> None:
        """1: begin as soon as the line is steady; 0: none, or not now."""
        if value and self._config.mode == "off":
            self._note("not made: 'probing' is off in the config")
            return
        if not value and self._since_s is not None:
            self._end("ended by request")
        if not value and self._asked:
            self._note("refused")
        self._wanted, self._asked = bool(value), False
        self._rested_s = inf if value else 0.0

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Shift the set-point of the loop as the probe is far."""
        if self._config.mode == "off":
            return
        cycle_s = self._state.cycle_s
        steady = self._is_steady(sample)
        if self._since_s is None:
            self._rested_s += cycle_s
            if steady:
                self._consider(sample)
            return
        self._since_s += cycle_s
        if self._moves:
            self._go_on_at_rest(sample)
        elif not steady:
            self._end("broken off: the line is not steady")
        elif self._is_over(sample):
            self._end(self._known(sample))
        else:
            half = int(2.0 * self._since_s / self._config.period_s)
            self._loop.shift_set_point(self._size_N if half % 2 == 0 else -self._size_N)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled stages: none, where there are no probes."""
        return CompiledStages(cycles=lambda: MANY if self._config.mode == "off" else 0)

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        """The drives are off."""
        if self._since_s is not None:
            self._end("broken off: the drives are off")
        self._steady_for_s = 0.0

    def _is_over(self, sample: CycleSample) -> bool:
        """True after its time, or when a whole period has sufficed."""
        is_due = self._since_s is not None and self._since_s >= self._config.period_s and not self._is_wide(sample)
        return is_due or (self._since_s or 0.0) >= self._config.duration_s

    @property
    def _size_N(self) -> float:
        return 0.01 * self._config.amplitude_pct * self._loop.set_point_N

    def _go_on_at_rest(self, sample: CycleSample) -> None:
        movement, since_s = self._at_rest, self._since_s or 0.0
        assert movement is not None, "begun"
        if is_synchronized(sample):
            self._end(self._known(sample))
        elif movement.is_beyond(sample):
            self._end("broken off: a roller has moved further than is permitted")
        elif self._line_speed.present != 0.0 or not sample.twin_status & RUNNING:
            self._end("aborted: the line is not at rest with a twin")
        elif since_s >= _LONGEST_AT_REST_S:
            self._end(f"not told in {_LONGEST_AT_REST_S:g} s, {self._known(sample)}")
        else:
            movement.go_on()

    def _rests_unknown(self, sample: CycleSample) -> bool:
        """True if the line rests, and the twin runs without knowing a web."""
        if self._at_rest is None or self._line_speed.present != 0.0 or is_synchronized(sample):
            return False
        known = (of_span(sample) for of_span in self._of_all)
        unknown = any(deviation_Pa > _UNKNOWN * modulus_Pa for modulus_Pa, deviation_Pa in known)
        return bool(sample.twin_status & RUNNING) and unknown

    def _is_steady(self, sample: CycleSample) -> bool:
        now = (self._line_speed.present, self._loop.set_point_N)
        runs = self._loop.closed and is_synchronized(sample) and abs(now[0]) >= _LEAST_SPEED_M_S
        usable = runs or self._rests_unknown(sample)
        same = usable and now == self._steady_at
        self._steady_at = now
        self._steady_for_s = self._steady_for_s + self._state.cycle_s if same else 0.0
        return same and (self._since_s is not None or self._steady_for_s >= self._config.settled_s)

    def _consider(self, sample: CycleSample) -> None:
        wide = self._is_wide(sample) and self._rested_s >= self._config.rest_s
        if self._wanted or (wide and self._config.mode == "on"):
            self._begin(sample)
        elif wide and not self._asked:
            self._asked = True
            self._note(f"wanted, {self._known(sample)}; allow it: {_ALLOW}")

    def _is_wide(self, sample: CycleSample) -> bool:
        modulus_Pa, deviation_Pa = self._signals(sample)
        return bool(isfinite(deviation_Pa) and deviation_Pa > 0.01 * self._config.deviation_pct * modulus_Pa)

    def _begin(self, sample: CycleSample) -> None:
        self._since_s, self._wanted, self._asked = 0.0, False, False
        movement = self._at_rest if self._line_speed.present == 0.0 else None
        self._moves = movement is not None
        if movement is not None:
            movement.begin(sample)
            what = f"the rollers move by up to {1e3 * movement.travel_m:g} mm for up to {_LONGEST_AT_REST_S:g} s"
        else:
            what = f"tension set-point ±{self._size_N:.3g} N for {self._config.duration_s:g} s"
        self._note(f"{what}, {self._known(sample)}")
        self._journal(1.0)

    def _end(self, why: str) -> None:
        self._since_s, self._rested_s, self._moves = None, 0.0, False
        self._loop.shift_set_point(0.0)
        if self._at_rest is not None:
            self._at_rest.end()
        self._note(why)
        self._journal(0.0)

    def _known(self, sample: CycleSample) -> str:
        modulus_Pa, deviation_Pa = self._signals(sample)
        return f"E = {modulus_Pa:.5g} Pa ± {100.0 * deviation_Pa / modulus_Pa:.2g} %"

    def _journal(self, value: float) -> None:
        cycle = self._state.running().timing.cycles
        self._state.journal(Change(cycle, "set", TENSION_PROBE, value, 1.0 - value))

    def _note(self, text: str) -> None:
        self._state.reports.note("probe", text)
