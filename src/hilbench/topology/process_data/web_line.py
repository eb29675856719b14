"""A web line: the tensions of its spans, what is estimated at some, and what is around the line.

Sub-indices are given once and for all: span k, of a line with more than driven rollers the section behind driven
roller k, has the five of 6403h from 5·(k - 1) + 1 on, from the 17th on those from 101 + 5·(k - 17) on; of dancers,
accumulators and reels station k the two from 81 + 2·(k - 1) on; sensors of these, and load cells, have those of 6413h
from 3 on, forces on carriages that are fed forward those from 9 on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hilbench.topology.process_data.table import (
    INPUTS,
    OUTPUTS,
    PER_PDO,
    QUALITY_EVERY,
    STATUS_TPDO,
    IoPdo,
    IoSignal,
    ProcessData,
    SimulatedTorque,
)
from hilbench.topology.signals import Shape

#: Sub-indices of 6403h that each span has.
_PER_SPAN: Final = 5
#: So many spans stand before the stations in 6403h; the others behind them, from this one on.
_FIRST_SPANS: Final = 16
_FIRST_OF_FURTHER: Final = 101
#: The first of stations in 6403h, and in 6413h.
_FIRST_OF_STATIONS: Final = 81
_FIRST_OF_SENSORS: Final = 3
_FIRST_OF_FORCES: Final = 9


@dataclass(frozen=True, slots=True)
class _Span:
    """The signals of a span; all but the tension only where something is estimated."""

    tension: IoSignal
    modulus: IoSignal
    deviation: IoSignal
    torque: IoSignal
    residual: IoSignal


def _span(shape: Shape, number: int) -> _Span:
    k, of = shape.numbered(number), f" of span {number}" if shape.spans > 1 else ""
    before = shape.axis_before(number)
    # Of a line with more than driven rollers a section is sent once, and may have any number of spans.
    place, axis = before if shape.has_stations else number, before + 1
    further = place - 1 - _FIRST_SPANS
    first = _PER_SPAN * (place - 1) + 1 if further < 0 else _FIRST_OF_FURTHER + _PER_SPAN * further
    return _Span(
        IoSignal(f"F{k}_sim_N", INPUTS, first, f"Simulated tension{of} [N]"),
        IoSignal(f"E{k}_sim_Pa", INPUTS, first + 1, f"Estimated Young's modulus{of} [Pa]"),
        IoSignal(f"E{k}_sd_Pa", INPUTS, first + 2, f"Standard deviation of the estimated Young's modulus{of} [Pa]"),
        IoSignal(f"tau{axis}_sim_Nm", INPUTS, first + 3, f"Simulated torque of axis {axis} [N m]"),
        IoSignal(f"tau{axis}_residual_Nm", INPUTS, first + 4, f"Torque residual of axis {axis} [N m]"),
    )


def _stations(shape: Shape) -> list[tuple[IoSignal, IoSignal]]:
    """Estimate of each dancer, accumulator and reel, and its deviation."""
    found = []
    for at, name in enumerate(shape.stations):
        letter, what = ("x", "position") if name in shape.carriages else ("r", "radius")
        first, of = _FIRST_OF_STATIONS + 2 * at, f"{what} of station {at + 1}"
        estimate = IoSignal(f"{letter}_{name}_sim_m", INPUTS, first, f"Simulated {of} [m]")
        found.append(
            (estimate, IoSignal(f"{letter}_{name}_sd_m", INPUTS, first + 1, f"Standard deviation of the {of} [m]"))
        )
    return found


def process_data(shape: Shape) -> ProcessData:
    """Process data of a line of this shape."""
    stations = _stations(shape)
    further = (
        IoSignal(signal, OUTPUTS, first + at, f"{what} {at + 1}: {of}")
        for first, what, of, signals in (
            (_FIRST_OF_SENSORS, "Sensor", "of a dancer, accumulator or reel [m], or load cell [N]", shape.sensors),
            (_FIRST_OF_FORCES, "Force", "on the carriage of a dancer or accumulator [N]", shape.forces),
        )
        for at, (_, signal) in enumerate(signals)
    )
    spans = {number: _span(shape, number) for number in shape.simulated}
    estimated = [spans[number] for number in shape.estimated]
    others = [span.tension for number, span in spans.items() if number not in shape.estimated]
    contents: list[tuple[tuple[IoSignal, ...], int]] = []
    for span in estimated:
        contents += [((span.tension, span.modulus), 1), ((span.deviation, span.residual), QUALITY_EVERY)]
    contents += [(tuple(others[at : at + PER_PDO]), 1) for at in range(0, len(others), PER_PDO)]
    # A radius changes slowly, a carriage may not.
    slow = [1] * len(shape.carriages) + [QUALITY_EVERY] * len(shape.reels)
    contents += zip(stations, slow, strict=True)
    numbers = (number for number in range(1, len(contents) + 2) if number != STATUS_TPDO)
    published = [
        signal
        for number, span in spans.items()
        for signal in (
            (span.tension, span.modulus, span.deviation, span.torque, span.residual)
            if number in shape.estimated
            else (span.tension,)
        )
    ]
    return ProcessData(
        published=(*published, *(signal for pair in stations for signal in pair)),
        boundary_inputs=(
            IoSignal("strain_prev", OUTPUTS, 1, "Upstream strain [1]"),
            IoSignal("F_next_N", OUTPUTS, 2, "Downstream tension [N]"),
            *further,
        ),
        sent=tuple(IoPdo(number, signals, every) for number, (signals, every) in zip(numbers, contents, strict=False)),
        torques=tuple(
            SimulatedTorque(shape.axis_before(number) + 1, spans[number].torque.name, spans[number].residual.name)
            for number in shape.estimated
        ),
    )
