"""Rows of a bench that is late, on the cycles of its plant: nothing is lost but what nobody has measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench.live.window import Window

Array = NDArray[np.float64]
CYCLE_S = 0.002
NAMES = ("t_s", "x1_m", "x2_m", "v1_cmd_m_s", "tau1_Nm", "E_sim_Pa")
FIRST = 1000


def plant(cycles: Array) -> Array:
    """(n, signals): a line that is accelerated by 1 m/s² from 1 m/s on, and swings."""
    t_s = (cycles - FIRST) * CYCLE_S
    x_m = t_s + 0.5 * t_s**2
    strain_m = 3e-4 + 2e-5 * np.sin(2.0 * np.pi * 5.0 * t_s)
    return np.column_stack([t_s, x_m, x_m + strain_m, 1.0 + t_s, 0.1 * t_s, 8.7e9 + 0.0 * t_s])


class Bench:
    """Hands rows over as a running bench does, in chunks."""

    def __init__(self) -> None:
        self.window = Window(NAMES, 100_000, CYCLE_S)
        self._sync = FIRST

    def hand_over(
        self, plant_cycles: Sequence[int], told: Sequence[int] | None = None, late: Sequence[int] = ()
    ) -> None:
        """A chunk with a SYNC at each of these cycles of the plant. `told`: what the bench counts for them; `late`:
        rows whose positions are still those of the SYNC before."""
        cycles = np.array(plant_cycles, np.float64)
        rows = plant(cycles)
        rows[:, 0] = np.arange(self._sync - FIRST, self._sync - FIRST + len(rows)) * CYCLE_S
        for at in late:
            rows[at, [1, 2, 4]] = rows[at - 1, [1, 2, 4]]
        is_late = np.isin(np.arange(len(rows)), late)
        self._sync += len(rows)
        counted = cycles if told is None else np.array(told, np.float64)
        self.window.add(self._sync - 1, np.column_stack([rows, counted, is_late]).tobytes())

    def off(self, name: str) -> Array:
        """(n,): a signal of the window less that of the plant."""
        window = self.window
        cycles = np.arange(window.first, window.end, dtype=np.float64)
        rows = window.rows(window.first, window.end)
        return np.asarray(window.column(rows - plant(cycles), name))


def without(cycles: range, *missed: int) -> list[int]:
    return [cycle for cycle in cycles if cycle not in missed]


def test_rows_of_a_bench_that_is_in_time_are_kept_as_they_are() -> None:
    bench = Bench()
    bench.hand_over(range(1000, 1250))
    bench.hand_over(range(1250, 1500))
    assert (bench.window.first, bench.window.end) == (1000, 1500)
    assert np.array_equal(bench.window.rows(1000, 1500), plant(np.arange(1000.0, 1500.0)))
    assert bench.window.known(1000, 1500).all()
    assert bench.window.sync(1300) == 1300


@pytest.mark.parametrize("missed", [(1100,), (1100, 1101, 1102), (1249, 1250, 1251), (1400, 1410, 1411)])
def test_cycles_that_the_bench_has_missed_are_filled_in_as_the_plant_went_through_them(missed: tuple[int, ...]) -> None:
    bench = Bench()
    cycles = without(range(1000, 1600), *missed)
    bench.hand_over(cycles[:250])
    bench.hand_over(cycles[250:])
    assert (bench.window.first, bench.window.end) == (1000, 1600)
    assert bench.window.known(1000, 1600).all()
    for name in ("x1_m", "x2_m"):
        assert np.max(np.abs(bench.off(name))) < 1e-7
    assert np.max(np.abs(bench.off("t_s"))) < 1e-9, "time is that of the plant"
    assert bench.window.sync(1599) == 1599 - len(missed)
    command = bench.off("v1_cmd_m_s")
    assert np.allclose(command[[cycle - 1000 for cycle in missed]], [-CYCLE_S * (1 + k) for k in runs(missed)])
    assert not np.any(np.delete(command, [cycle - 1000 for cycle in missed])), "what was commanded is held meanwhile"


def runs(missed: Sequence[int]) -> list[int]:
    """How many were missed in a row before each."""
    found: list[int] = []
    for at, cycle in enumerate(missed):
        found.append(found[-1] + 1 if at and cycle == missed[at - 1] + 1 else 0)
    return found


def test_positions_of_an_earlier_sync_are_not_taken_for_those_of_this_one() -> None:
    bench = Bench()
    bench.hand_over(range(1000, 1250), late=(50, 51, 120))
    bench.hand_over(range(1250, 1500), late=(20,))
    assert bench.window.known(1000, 1500).all()
    assert np.max(np.abs(bench.off("x2_m"))) < 1e-7
    assert not np.any(bench.off("v1_cmd_m_s")), "what was commanded was in time"


def test_a_sync_that_the_drives_take_for_the_next_one_is_placed_by_the_way_of_the_rollers() -> None:
    """Sent late by nearly a cycle: to the bench it is that of its cycle, to the drives the next; then one at once."""
    bench = Bench()
    plant_cycles, told = list(range(1000, 1500)), list(range(1000, 1500))
    for at in (100, 300, 301):
        plant_cycles[at] = told[at] + 1
    bench.hand_over(plant_cycles, told)
    assert bench.window.known(1000, 1500).all()
    for name in ("x1_m", "x2_m", "tau1_Nm"):
        assert np.max(np.abs(bench.off(name))) < 1e-7


def test_drives_that_have_counted_one_cycle_more_for_good_are_followed() -> None:
    bench = Bench()
    bench.hand_over([*range(1000, 1100), *range(1101, 1251)], range(1000, 1250))
    bench.hand_over(range(1251, 1501), range(1250, 1500))
    assert bench.window.end == 1501
    assert np.max(np.abs(bench.off("x1_m"))) < 1e-7
    assert np.max(np.abs(bench.off("t_s"))) < 1e-9


def test_what_nobody_has_measured_for_long_is_known_to_be_a_guess() -> None:
    bench = Bench()
    bench.hand_over([*range(1000, 1200), *range(1220, 1270)])
    known = bench.window.known(1000, 1270)
    assert np.flatnonzero(~known).tolist() == list(range(200, 220))
    assert np.max(np.abs(bench.off("x1_m"))) < 1e-6


def test_behind_a_pause_of_a_second_the_window_begins_anew() -> None:
    bench = Bench()
    bench.hand_over(range(1000, 1250))
    bench.hand_over(range(1750, 2000))
    assert (bench.window.first, bench.window.end) == (1750, 2000)


def test_a_line_that_was_stopped_at_once_is_followed_again() -> None:
    bench = Bench()
    window = bench.window
    stands = plant(np.full(300, 1249.0))
    bench.hand_over(range(1000, 1250))
    window.add(1549, np.column_stack([stands, np.arange(1250.0, 1550.0), np.zeros(300)]).tobytes())
    assert window.end == 1550
    assert window.first > 1250
    assert np.array_equal(window.column(window.rows(window.first, 1550), "x1_m"), stands[: 1550 - window.first, 1])


def test_after_missed_cycles_one_roller_that_is_a_cycle_further_is_not_of_the_same_instant_as_the_other() -> None:
    bench = Bench()
    cycles = [*range(1000, 1100), *range(1111, 1361)]
    rows = plant(np.array(cycles, np.float64))
    rows[100, 1] = rows[101, 1]  # roller 1 has answered the SYNC after it
    told = np.array(cycles, np.float64)
    bench.window.add(FIRST + len(rows) - 1, np.column_stack([rows, told, np.zeros(len(rows))]).tobytes())
    apart_m = bench.off("x1_m") - bench.off("x2_m")
    assert bench.window.end == 1361
    assert np.max(np.abs(apart_m[112:])) < 1e-7
    assert np.max(np.abs(apart_m)) < 1e-5


def test_what_was_commanded_with_a_sync_that_the_drives_were_ahead_of_acts_from_there() -> None:
    bench = Bench()
    plant_cycles = [
        *range(1000, 1100),
        1101,
        *range(1101, 1250),
    ]  # SYNC 100 is taken for the next, which brings nothing
    rows = plant(np.array(plant_cycles, np.float64))
    commands = 1.0 + 1e-3 * np.arange(len(rows))
    rows[:, NAMES.index("v1_cmd_m_s")] = commands
    told = np.arange(1000.0, 1250.0)
    bench.window.add(FIRST + len(rows) - 1, np.column_stack([rows, told, np.zeros(len(rows))]).tobytes())
    found = bench.window.column(bench.window.rows(1000, 1250), "v1_cmd_m_s")
    assert found[99:104] == pytest.approx(commands[[99, 99, 101, 102, 103]])
