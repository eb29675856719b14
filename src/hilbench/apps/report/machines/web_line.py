"""A web line: velocities and what mass conservation asks of them, the torque that E is seen by, E, the tension."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.chart import BLUE, BROWN, GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION, Chart, Curve
from hilbench.apps.report.machines.picture import (
    AVERAGED,
    SMOOTHING_S,
    Array,
    ComparedSignal,
    Line,
    MachinePictures,
    RunPicture,
    ShownRun,
    estimate,
    lines,
)
from hilbench.diagnosis.synchronization import reference_estimate
from hilbench.errors import UnusableInputError
from hilbench.results.recording import Recording
from hilbench.runs.config import load_with_overrides
from hilbench.runs.figures import ESTIMATE_BAND, working_window
from hilbench.runs.machines.web_line import expected_v1_m_s
from hilbench.topology.main_quantities.web_line import line_speed, modulus
from hilbench.topology.signals import Shape, shape_of


def _command(run: ShownRun) -> str:
    return line_speed(shape_of(run.recording.channels)).signal


def _surface_velocity(run: ShownRun, position: str) -> Array:
    """Velocity of the web at an axis, m/s, by a position."""
    return run.velocity(position) * _radius_ratio(run, position)


def _surface_command(run: ShownRun, command: str) -> Array:
    """The same by a command of a velocity."""
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
    """The number of the span behind a driven axis, as names have it; None where a recording does not tell it."""
    numbers = [span for span in range(1, shape.spans + 1) if shape.axis_before(span) == axis]
    return shape.numbered(numbers[0]) if numbers else None


def _beyond_the_line(run: ShownRun) -> Chart:
    """A thousand times finer than the velocities: what each axis runs faster than the one behind it."""
    shape, steady = shape_of(run.recording.channels), _steady(run)
    fine, entering = [], "strain_prev"
    for axis, colour in zip(range(1, shape.axes), cycle(_COLOURS), strict=False):
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
    """Where the line-speed command has not changed for twice the time of the averages."""
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
    try:
        return None if recording.is_reduced else reference_estimate(load_with_overrides(config).config, recording)
    except UnusableInputError:
        return None


#: Slower than this nobody says that a line runs in reverse, m/s: what mass conservation asks there is that of forward.
_REVERSE_M_S: Final = -1e-3
#: Of axes and spans, in their order; of two axes the leading one is vermillion.
_COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE, BROWN, SKY)


def _velocities(shape: Shape) -> RunPicture:
    last = shape.axes
    behind = [Line(f"x{last}_m", f"axis {last}", VERMILLION, 2.6, alpha=0.8, values=_surface_velocity)]
    others = [
        Line(f"x{axis}_m", f"axis {axis}", colour, 1.3, values=_surface_velocity)
        for axis, colour in zip(range(1, last), cycle(_COLOURS), strict=False)
    ]
    commands = [
        Line(f"v{axis}_cmd_m_s", "commands" if axis == last else "", INK, 0.8, (4, 4), values=_surface_command)
        for axis in range(last, 0, -1)
    ]
    fine = (
        "velocity of axis 1 minus line speed (axis 2), and what mass conservation asks for at the strain of the "
        "emulated web once it is steady."
        if last == 2
        else "what each axis turns faster than the one behind it, and what mass conservation asks for at the strains "
        "of the emulated web once they are steady."
    )
    return RunPicture(
        "velocities",
        "Velocities",
        f"Velocities at the web, averaged over {SMOOTHING_S:g} s, but not over a step or the ends of a ramp. Below: "
        + fine,
        (lines("velocity in m/s", *behind, *others, *commands), _beyond_the_line),
        needs=("x1_m", f"x{last}_m"),
    )


def _torques(axis: int) -> RunPicture:
    """Of the axis behind a span at which something is estimated."""
    return RunPicture(
        "torques",
        f"Torque of axis {axis}",
        f"Motor torque of axis {axis}: measured, averaged over {SMOOTHING_S:g} s, and simulated by the twin. Their "
        "difference is what the twin learns E from.",
        (
            lines(
                "torque in N·m",
                Line(f"tau{axis}_Nm", "measured", SKY, 0.7, spread=True),
                Line(f"tau{axis}_Nm", "averaged", BLUE, values=AVERAGED),
                Line(f"tau{axis}_sim_Nm", "simulated", VERMILLION, 1.2),
            ),
        ),
        needs=(f"tau{axis}_Nm",),
    )


def _elasticity(number: str) -> RunPicture:
    """`number`: of the span whose E the twin tells, as names have it."""
    return RunPicture(
        f"elasticity{number}",
        f"Young’s modulus in span {number}" if number else "Young’s modulus",
        f"Young’s modulus of the emulated web with a band of ±{100 * ESTIMATE_BAND:g} % (grey), and the "
        "twin’s, with a band of ±2 standard deviations where the twin states one.",
        (estimate(modulus(number)),),
        with_reference="PID: what the published tracking simulation makes of the same measurements.",
        zoomed=True,
    )


def _tension(number: str) -> RunPicture:
    """`number`: of the span, as names have it."""
    return RunPicture(
        f"tension{number}",
        f"Web tension in span {number}" if number else "Web tension",
        "Tension of the emulated web, tension simulated by the twin (the virtual sensor that the controller sees),"
        " and set-point.",
        (
            lines(
                "tension in N",
                Line(f"F{number}_true_N", "true", BLUE),
                Line(f"F{number}_sim_N", "simulated", VERMILLION, 1.2),
                Line(f"F{number}_ref_N", "set-point", INK, 0.9, (4.0, 2.0)),
                least=4.0,
            ),
        ),
        zoomed=True,
    )


def _stations(shape: Shape) -> list[RunPicture]:
    """Carriages and reels, of a line that has any."""
    found = []
    for key, title, label, symbol, names in (
        ("positions", "Positions of the carriages", "position in m", "x", shape.carriages),
        ("radii", "Radii of the reels", "radius in m", "r", shape.reels),
    ):
        true = [
            Line(f"{symbol}_{name}_true_m", name, colour) for name, colour in zip(names, cycle(_COLOURS), strict=False)
        ]
        simulated = [Line(f"{symbol}_{name}_sim_m", "simulated", VERMILLION, 1.2) for name in names]
        wanted = [Line(f"{symbol}_{name}_ref_m", "set-point", INK, 0.9, (4.0, 2.0)) for name in names]
        text = (
            f"{title} of the emulated line, as the twin has them without or with a sensor"
            f"{', and set-points where a controller keeps them' if symbol == 'x' else ''}."
        )
        if names:
            found.append(RunPicture(key, title, text, (lines(label, *true, *simulated, *wanted, least=0.01),)))
    force_lines = [
        Line(f"f_{name}_cmd_N", name, colour) for name, colour in zip(shape.pushed, cycle(_COLOURS), strict=False)
    ]
    if force_lines:
        title = "Forces on the carriages"
        found.append(RunPicture("forces", title, f"{title}, as sent ahead.", (lines("force in N", *force_lines),)))
    return found


@cache
def pictures_of(shape: Shape) -> MachinePictures:
    """The pictures of a line, one of the tension a span. Of a recording in which nothing is estimated, or no span is
    named, as of the smallest line."""
    axes = max(shape.axes, 2)
    estimated = [(span, shape.numbered(span)) for span in shape.estimated or (1,)]
    behind_estimated = [shape.axis_before(span) + 1 for span, _ in estimated]
    numbers = [shape.numbered(span) for span in range(1, max(shape.spans, 1) + 1)]
    shape = replace(shape, axes=axes)
    return MachinePictures(
        (
            _velocities(shape),
            *(_torques(behind) for behind in behind_estimated),
            *(_elasticity(number) for _, number in estimated),
            *map(_tension, numbers),
            *_stations(shape),
        ),
        compared=(
            *(
                ComparedSignal(
                    f"elasticity{number}",
                    f"Young’s modulus{f' in span {number}' if number else ''}, of the twin",
                    "E in N/mm²",
                    (f"E{number}_sim_Pa",),
                    1e6,
                )
                for _, number in estimated
            ),
            *(
                ComparedSignal(
                    f"tension{number}",
                    f"Web tension in span {number}" if number else "Web tension",
                    "tension in N",
                    (f"F{number}_true_N", f"F{number}_sim_N"),
                )
                for number in numbers
            ),
            *(
                ComparedSignal(
                    "torque",
                    f"Torque of axis {behind}, averaged",
                    "torque in N·m",
                    (f"tau{behind}_Nm",),
                    values=AVERAGED,
                )
                for behind in behind_estimated
            ),
            *(
                ComparedSignal(
                    "velocity" if axes == 2 else f"velocity{span}",
                    "Velocity of axis 1 minus line speed" if axes == 2 else f"Velocity of axis {span} minus the next",
                    "v1 − line in mm/s" if axes == 2 else f"v{span} − v{span + 1} in mm/s",
                    (f"x{span}_m",),
                    1e-3,
                    values=_working_velocity,
                )
                for span in range(1, axes)
            ),
        ),
        reference=_published if shape.spans < 2 else lambda config, recording: None,
    )
