"""A web line: the tensions of its spans, what is estimated at some, and what is around the line.

Sub-indices are given once and for all: span k has the five of 6403h from 5·(k - 1) + 1 on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hilbench.topology.process_data.table import (
    INPUTS,
    OUTPUTS,
    QUALITY_EVERY,
    STATUS_TPDO,
    IoPdo,
    IoSignal,
    ProcessData,
    SimulatedTorque,
)
from hilbench.topology.signals import Shape

#: REAL32 that a PDO holds.
_PER_PDO: Final = 2
#: Sub-indices of 6403h that each span has.
_PER_SPAN: Final = 5


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
    first, axis = _PER_SPAN * (number - 1) + 1, shape.axis_before(number) + 1
    return _Span(
        IoSignal(f"F{k}_sim_N", INPUTS, first, f"Simulated tension{of} [N]"),
        IoSignal(f"E{k}_sim_Pa", INPUTS, first + 1, f"Estimated Young's modulus{of} [Pa]"),
        IoSignal(f"E{k}_sd_Pa", INPUTS, first + 2, f"Standard deviation of the estimated Young's modulus{of} [Pa]"),
        IoSignal(f"tau{axis}_sim_Nm", INPUTS, first + 3, f"Simulated torque of axis {axis} [N m]"),
        IoSignal(f"tau{axis}_residual_Nm", INPUTS, first + 4, f"Torque residual of axis {axis} [N m]"),
    )


def process_data(shape: Shape) -> ProcessData:
    """Of a line with so many spans."""
    spans = {number: _span(shape, number) for number in shape.simulated}
    estimated = [spans[number] for number in shape.estimated]
    others = [span.tension for number, span in spans.items() if number not in shape.estimated]
    contents: list[tuple[tuple[IoSignal, ...], int]] = []
    for span in estimated:
        contents += [((span.tension, span.modulus), 1), ((span.deviation, span.residual), QUALITY_EVERY)]
    contents += [(tuple(others[at : at + _PER_PDO]), 1) for at in range(0, len(others), _PER_PDO)]
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
        published=tuple(published),
        told=(
            IoSignal("strain_prev", OUTPUTS, 1, "Upstream strain [1]"),
            IoSignal("F_next_N", OUTPUTS, 2, "Downstream tension [N]"),
        ),
        sent=tuple(IoPdo(number, signals, every) for number, (signals, every) in zip(numbers, contents, strict=False)),
        torques=tuple(
            SimulatedTorque(shape.axis_before(number) + 1, spans[number].torque.name, spans[number].residual.name)
            for number in shape.estimated
        ),
    )
