"""A web line: velocities and what mass conservation asks of them, the tension, E, the torque that E is seen by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.chart import BLUE, BROWN, COLOURS, INK, SKY, VERMILLION, Chart, Curve
from hilbench.apps.report.panel import (
    AVERAGED,
    COMMAND_DASH,
    DASHED,
    SMOOTHING_S,
    Compared,
    MachinePanels,
    Panel,
    Row,
    Series,
    ShownRun,
    estimate,
)
from hilbench.arrays import Array
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording
from hilbench.runs.config import load_with_overrides
from hilbench.runs.figures import ESTIMATE_BAND, working_window
from hilbench.runs.machines.web_line import expected_v1_m_s
from hilbench.topology.main_quantities.web_line import line_speed, modulus
from hilbench.topology.signals import Shape, shape_of
from hilbench.topology.web_line_signals import LINE_SPEED_SIGNAL


def _command(run: ShownRun) -> str:
    return line_speed(shape_of(run.recording.channels)).signal


def _surface_velocity(run: ShownRun, position: str) -> Array:
    """Velocity of the web at an axis, m/s, by a position."""
    return run.velocity(position) * _radius_ratio(run, position)


def _surface_command(run: ShownRun, command: str) -> Array:
    """Surface velocity by a command."""
    return run.get(command) * _radius_ratio(run, command)


def _radius_ratio(run: ShownRun, of_axis: str) -> Array:
    """Radius of the roller that a signal is of by that which its metres are counted at: a reel's at the start."""
    shape = shape_of(run.recording.channels)
    reels = dict(zip((shape.axes, 1) if shape.winds else (1,), reversed(shape.reels), strict=False))
    radius = f"r_{reels.get(int(of_axis[1 : of_axis.index('_')]), '')}_true_m"
    if radius not in run:
        return np.ones(len(run.recording))
    return run.get(radius) / float(run.get(radius)[0])


def _span_behind(shape: Shape, axis: int) -> str | None:
    """The number of the span behind a driven axis, as names have it; None where a recording does not show it."""
    numbers = [span for span in range(1, shape.spans + 1) if shape.axis_before(span) == axis]
    return shape.numbered(numbers[0]) if numbers else None


def _beyond_the_line(run: ShownRun) -> Chart:
    """A thousand times finer than the velocities: what each axis runs faster than the one behind it."""
    shape, steady = shape_of(run.recording.channels), _steady(run)
    fine, entering = [], "strain_prev"
    for axis, colour in zip(range(1, shape.axes), cycle(COLOURS), strict=False):
        span = _span_behind(shape, axis)
        before, behind, strain = f"x{axis}_m", f"x{axis + 1}_m", f"strain{span}_true"
        if before in run and behind in run:
            v_before, v_behind = _surface_velocity(run, before), _surface_velocity(run, behind)
            name = "axis 1 − line" if shape.axes == 2 else f"axis {axis} − axis {axis + 1}"
            fine.append(Curve(name, run.t_s, np.where(steady, 1e3 * (v_before - v_behind), np.nan), colour))
            if entering in run and strain in run:
                came = run.get(entering) if axis == 1 else run.averaged(entering)
                asked = 1e3 * (expected_v1_m_s(v_behind, came, run.averaged(strain)) - v_behind)
                label, shown_at = "mass balance" if axis == shape.axes - 1 else "", steady & (v_behind > _REVERSE_M_S)
                fine.append(Curve(label, run.t_s, np.where(shown_at, asked, np.nan), INK, 0.9, (4, 2)))
        entering = strain
    label = "v1 − line in mm/s" if shape.axes == 2 else "difference in mm/s"
    return Chart(label, fine, least=0.05)


def _steady(run: ShownRun) -> NDArray[np.bool_]:
    """True where the line-speed command has not changed for twice the time of the averages."""
    signal = _command(run)
    if signal not in run:
        return np.ones(len(run.recording), bool)
    command = run.get(signal)
    top = float(np.max(np.abs(command), initial=0.0, where=np.isfinite(command)))
    moved = np.concatenate(([False], ~(np.abs(np.diff(command)) <= 1e-6 * top)))
    count = np.cumsum(moved)
    before = np.clip(np.arange(len(command)) - 2 * run.width, 0, None)
    return np.asarray(count == count[before])


def _working_velocity(run: ShownRun, position: str) -> Array | None:
    """Velocity of an axis minus that of the one behind it while the line runs at its working speed."""
    behind = f"x{int(position[1:-2]) + 1}_m"
    if behind not in run:
        return None
    difference = np.full(len(run.recording), np.nan)
    part = working_window(run.t_s, run.get(_command(run))) if _command(run) in run else None
    part = part or slice(None)
    difference[part] = (_surface_velocity(run, position) - _surface_velocity(run, behind))[part]
    return difference


def _published(config: Path, recording: Recording) -> Array | None:
    """E by the published method; None also for the config of a run that is too old to be understood now."""
    from hilbench.results.web_line_synchronization import reference_estimate  # slow to import: not for a terminal

    try:
        return None if recording.is_reduced else reference_estimate(load_with_overrides(config).config, recording)
    except UnusableInputError:
        return None


#: Slower than this nobody says that a line runs in reverse, m/s: what mass conservation asks there is that of forward.
_REVERSE_M_S: Final = -1e-3


def _each(signal: str, names: Sequence[Any], label: str = "{}", width: float = 1.4, **further: Any) -> list[Series]:
    """A series of each axis or station, in the order of the colours."""
    return [
        Series(signal.format(name), label.format(name), colour, width, **further)
        for name, colour in zip(names, cycle(COLOURS), strict=False)
    ]


def _velocities(shape: Shape) -> Panel:
    last = shape.axes
    behind = Series(f"x{last}_m", f"axis {last}", VERMILLION, 2.6, alpha=0.8, values=_surface_velocity)
    commands = [
        Series(f"v{axis}_cmd_m_s", "commands" if axis == last else "", INK, 0.8, COMMAND_DASH, values=_surface_command)
        for axis in range(last, 0, -1)
    ]
    fine = (
        "velocity of axis 1 minus line speed (axis 2), and what mass conservation asks for at the strain of the "
        "emulated web once it is steady."
        if last == 2
        else "what each axis turns faster than the one behind it, and what mass conservation asks for at the strains "
        "of the emulated web once they are steady."
    )
    return Panel(
        "velocities",
        "Velocities",
        "velocity",
        "m/s",
        (behind, *_each("x{}_m", range(1, last), "axis {}", 1.3, values=_surface_velocity), *commands),
        needs=("x1_m", f"x{last}_m"),
        caption=f"Velocities at the web, averaged over {SMOOTHING_S:g} s, but not over a step or the ends of a ramp. "
        f"Below: {fine}",
        below=_beyond_the_line,
        live=False,
    )


def _speeds(shape: Shape) -> Panel:
    axes = range(1, shape.axes + 1)
    commands = (Series(f"v{axis}_cmd_m_s", f"command {axis}", INK, 0.8, COMMAND_DASH) for axis in axes)
    return Panel(
        "speed",
        "Speeds at the web",
        "speed",
        "m/s",
        (*_each("v{}_m_s", axes, "axis {}"), *commands),
        least=0.1,
        limits="speed_m_s",
        row=Row("line speed", ".3f", LINE_SPEED_SIGNAL if shape.winds else f"v{shape.axes}_m_s"),
    )


def _difference(shape: Shape, axis: int) -> Panel:
    """Panel by which runs are compared, of an axis and the one behind it."""
    both = "Velocity of axis 1 minus line speed", "v1 − line"
    if shape.axes > 2:
        both = f"Velocity of axis {axis} minus the next", f"v{axis} − v{axis + 1}"
    compared, number = Compared(both[0], (f"x{axis}_m",), _working_velocity), axis if shape.axes > 2 else ""
    return Panel(f"velocity{number}", *both, "mm/s", si_per_unit=1e-3, live=False, compared=compared)


def _tension(shape: Shape, span: int) -> Panel:
    number = shape.numbered(span)
    title = f"Web tension in span {number}" if number else "Web tension"
    steps = (
        (f"F{number} in 1 N, s", f"tension{number}_recovery_s"),
        (_of("peak", number, "N"), f"tension{number}_peak_error_N"),
    )
    return Panel(
        f"tension{number}",
        title,
        "tension",
        "N",
        (
            Series(f"F{number}_true_N", "true", BLUE),
            Series(f"F{number}_sim_N", "simulated", VERMILLION, 1.2),
            Series(f"F{number}_ref_N", "set-point", INK, 0.9, DASHED),
        ),
        least=4.0,
        caption="Tension of the emulated web, tension simulated by the twin (the virtual sensor that the controller "
        "sees), and set-point.",
        zoomed=True,
        limits="tension_N",
        row=Row(f"tension {number}".strip(), ".1f") if span in shape.simulated else None,
        steps=steps if span in shape.controlled else (),
        compared=Compared(title, (f"F{number}_true_N", f"F{number}_sim_N")),
    )


def _of(figure: str, number: str, unit: str) -> str:
    return f"{figure} {number}".strip() + f", {unit}"


def _elasticity(shape: Shape, span: int) -> Panel:
    number = shape.numbered(span)
    title = f"Young’s modulus in span {number}" if number else "Young’s modulus"
    return estimate(
        modulus(number),
        f"elasticity{number}",
        title,
        f"Young’s modulus of the emulated web with a band of ±{100 * ESTIMATE_BAND:g} % (grey), and the twin’s, with a "
        "band of ±2 standard deviations where the twin states one.",
        Row(f"E{number}", ".0f"),
        reference="PID: what the published tracking simulation makes of the same measurements.",
        steps=(
            (f"E{number} in 1 %, s", f"E{number}_time_to_1pct_s"),
            (_of("noise", number, "%"), f"E{number}_noise_pct"),
        ),
        compared=Compared(f"{title}, of the twin", (f"E{number}_sim_Pa",)),
    )


def _torque(shape: Shape, span: int) -> Panel:
    """Torque panel of the axis behind a span at which something is estimated."""
    axis = shape.axis_before(span) + 1
    measured = f"tau{axis}_Nm"
    return Panel(
        f"torques{shape.numbered(span)}",
        f"Torque of axis {axis}",
        "torque",
        "N·m",
        (
            Series(measured, "measured", SKY, 0.7, spread=True),
            Series(measured, "averaged", BLUE, values=AVERAGED),
            Series(f"tau{axis}_sim_Nm", "simulated", VERMILLION, 1.2),
        ),
        needs=(measured,),
        caption=f"Motor torque of axis {axis}: measured, averaged over {SMOOTHING_S:g} s, and simulated by the twin. "
        "Their difference is what the twin learns E from.",
        live=False,
        compared=Compared(f"Torque of axis {axis}, averaged", (measured,), AVERAGED),
    )


def _live_torques(shape: Shape) -> tuple[Panel, Panel]:
    """Torque panels of all motors, and of the residual of those behind an estimate."""
    behind = [shape.axis_before(span) + 1 for span in shape.estimated]
    torques = (
        *_each("tau{}_Nm", range(1, shape.axes + 1), "axis {}", 0.9),
        *(Series(f"tau{axis}_sim_Nm", f"axis {axis} simulated", VERMILLION, 1.2) for axis in behind),
        *(Series(f"tau_{name}_Nm", name, BROWN, 0.9) for name in shape.load_motors),
    )
    residuals, unexplained = (
        _each("tau{}_residual_Nm", behind, "axis {}", 0.9),
        "Residual: torque measured less simulated",
    )
    return (
        Panel("torque", "Torques", "torque", "N·m", torques, least=0.5, limits="torque_Nm"),
        Panel("residual", unexplained, "residual", "N·m", residuals, least=0.1),
    )


def _stations(shape: Shape) -> Iterator[Panel]:
    """Carriages and reels, of a line that has any."""
    for key, title, quantity, symbol, names in (
        ("positions", "Positions of the carriages", "position", "x", shape.carriages),
        ("radii", "Radii of the reels", "radius", "r", shape.reels),
    ):
        simulated = (Series(f"{symbol}_{name}_sim_m", "simulated", VERMILLION, 1.2) for name in names)
        wanted = (Series(f"{symbol}_{name}_ref_m", "set-point", INK, 0.9, DASHED) for name in names)
        text = (
            f"{title} of the emulated line, as the twin has them without or with a sensor"
            f"{', and set-points where a controller keeps them' if symbol == 'x' else ''}."
        )
        series = (*_each(f"{symbol}_{{}}_true_m", names), *simulated, *wanted)
        if names:
            yield Panel(key, title, quantity, "m", series, least=0.01, caption=text, live=False)
    if shape.pushed:
        title, forces = "Forces on the carriages", _each("f_{}_cmd_N", shape.pushed)
        yield Panel("forces", title, "force", "N", forces, caption=f"{title}, as sent ahead.", live=False)


def panels_of(shape: Shape) -> MachinePanels:
    """The panels of a line, one of the tension a span. Of a recording in which nothing is estimated, or no span is
    named, as of the smallest line."""
    live = _live_torques(shape)
    shape = replace(shape, axes=max(shape.axes, 2), estimated=shape.estimated or (1,))
    spans = max(shape.spans, *shape.estimated, *shape.controlled)
    return MachinePanels(
        (
            _velocities(shape),
            *(_difference(shape, axis) for axis in range(1, shape.axes)),
            _speeds(shape),
            *(_tension(shape, span) for span in range(1, spans + 1)),
            *(_elasticity(shape, span) for span in shape.estimated),
            *(_torque(shape, span) for span in shape.estimated),
            *live,
            *_stations(shape),
        ),
        _published if shape.spans < 2 else lambda config, recording: None,
    )
