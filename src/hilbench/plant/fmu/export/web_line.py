"""Export of a web line as an FMU: the line with or without its drives, and its web as emulated by load motors."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from hilbench.compiled import Vector
from hilbench.plant.fmu.export.machine import (
    FORGOTTEN,
    ExportedMachine,
    ExportedVariable,
    Kernel,
    P,
    Place,
    U,
    asked,
    output,
    parameter,
)
from hilbench.plant.interface import Quantity
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line import kernel, line_kernel, records
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.simulated import modulus_names
from hilbench.plant.web_line.stations import ONLY_DRIVEN


def _go_line(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, samples: int, duration: float) -> None:
    """Step a web line or a servo axis with its drives; `out` as the columns of `web_line.layout.Layout`."""
    if samples > 0:
        kernel.advance(p, s, u, w, samples)
    kernel.observe(p, s, u, w, out)


def _go_web(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, samples: int, duration: float) -> None:
    """Step a web line of driven rollers on their measured motion.

    `u`: speeds of the N rollers, in place of set points of their motors, which are off. `out`: as of a line, then E of
    the K spans, and the torque at each motor that emulates web and resistance (see `LineFollower.load_torques_Nm`).
    """
    line = records.line_of(p, s, u, w)
    for i in range(line.n):
        line_kernel.set_speed(line, i, records.given(line, i).setpoint)
    if duration > 0.0:
        line_kernel.roll_on(line, duration, records.web(line).sample_time_s, inf)
    kernel.observe(p, s, u, w, out)
    line_kernel.put_moduli(line, out, kernel.columns(line))
    for i in range(line.n):
        loaded, speed = records.axis(line, i).web_load != 0.0, records.given(line, i).setpoint
        rad_per_m, at = records.motor(line, i).rad_per_m, kernel.columns(line) + line.k + i
        out[at] = line_kernel.web_torque_Nm(line, out, i, loaded, rad_per_m, speed)


LINE, _WEB = Kernel("line", _go_line), Kernel("web", _go_web)


def exported_line(model: ModelParameters, *, drives: bool) -> ExportedMachine:
    """Export definition of a web line. With its drives' loops the inputs are speeds, without them the motors' torques.

    Raises ValueError for a line without drives, or one not supported in an FMU (stations).
    """
    if model.stations is not None:
        raise ValueError("a line of driven rollers alone; one with stations can't be exported yet")
    if drives and model.drives is None:
        raise ValueError("'drives:' in the machine for an FMU with its drives")
    machine = Line(model)
    p, layout = machine._p.copy(), machine._layout
    u = machine._inputs.copy()
    rows, inputs, n, k = layout.motor_rows(p), layout.motor_inputs(u), layout.axes, layout.spans
    inputs.mode = MotorMode.VELOCITY if drives else MotorMode.TORQUE
    if not drives:
        rows.limit_Nm, rows.current_s = inf, 0.0
    columns, described = layout.columns, machine.describe()
    outputs = [quantity for quantity in described.outputs if not quantity.name.startswith("length")]
    starts = {"x": columns["x_m"], "v": columns["v_m_s"], "tau": columns["tau_Nm"], "F": columns["F_N"]}
    starts["strain"] = columns["strain"]
    variables = [
        output(quantity, starts[symbol].start + number)
        for quantity, (symbol, number) in ((each, _numbered(each.name)) for each in outputs)
    ]
    for axis in range(n):
        at, per_m = lay.U_MOTORS + axis * lay.UM_SIZE + lay.UM_SETPOINT, float(rows[axis].rad_per_m)
        variables.append(asked(axis + 1, "m", Place(U, at, per_m if drives else 1.0), drives=drives))
    variables += _boundary()
    variables += _moduli(model, layout)
    inertia = lay.column(lay.AXIS, "roller_mass_kg")
    variables += [
        parameter(
            Quantity(f"roller_inertia{axis}_kg_m2", "kg·m²", f"of roller {axis} about its own shaft"),
            Place(P, lay.W_SIZE + (axis - 1) * lay.A_SIZE + inertia, model.radius_m(axis) ** -2),
        )
        for axis in range(1, n + 1)
    ]
    state = machine._state.copy()
    return ExportedMachine(
        name="web_line" if drives else "web_line_mechanics",
        description=f"web line of {n} driven rollers and {k} spans" + (" with its drives" if drives else ""),
        kernel=LINE, p=p, s=state, u=u, work=len(layout.new_work()), out=layout.output_size,
        variables=tuple(variables),
        forgotten=tuple(Place(FORGOTTEN, at) for at in _limited(layout)),
        sample_s=float(p[lay.W_SAMPLE_TIME_S]),
        time=(lay.S_COUNT, 1.0 / float(p[lay.W_SAMPLE_TIME_S])),
    )  # fmt: skip


def exported_load(model: ModelParameters) -> ExportedMachine:
    """Export definition of a line's web on the motion of its rollers: speeds in, tensions and load torques out.

    Raises ValueError for a model without a web, or with stations.
    """
    if model.stations is not None:
        raise ValueError(f"a line with stations, expected {ONLY_DRIVEN}")
    follower = LineFollower(model)
    p, layout = follower._p.copy(), follower._layout
    n, k = layout.axes, layout.spans
    variables = [
        ExportedVariable(
            Quantity(f"v{axis}_m_s", "m/s", f"speed of roller {axis} in the step"),
            "input",
            (Place(U, lay.U_MOTORS + (axis - 1) * lay.UM_SIZE + lay.UM_SETPOINT),),
        )
        for axis in range(1, n + 1)
    ]
    variables += _boundary()
    for place, symbol, unit, what in (
        (layout.columns["F_N"].start, "F", "N", "tension"),
        (layout.columns["strain"].start, "strain", "1", "strain"),
        (layout.output_size, "E", "Pa", "Young's modulus as it acts"),
    ):
        for number in range(1, k + 1):
            name = f"{symbol}{number}" + (f"_{unit}" if unit != "1" else "")
            variables.append(output(Quantity(name, unit, f"{what} of the web in span {number}"), place + number - 1))
    for axis in range(1, n + 1):
        what = f"at the motor of axis {axis}: emulates the web and the roller's resistance"
        variables.append(output(Quantity(f"tau_load{axis}_Nm", "N·m", what), layout.output_size + k + axis - 1))
    variables += _moduli(model, layout)
    return ExportedMachine(
        name="web",
        description=f"web of a line of {n} driven rollers on their motion, for load motors",
        kernel=_WEB, p=p, s=follower._state.copy(), u=follower._inputs.copy(), work=len(layout.new_work()),
        out=layout.output_size + k + n, variables=tuple(variables), forgotten=(), sample_s=0.0,
        time=(lay.S_COUNT, 1.0 / float(p[lay.W_SAMPLE_TIME_S])),
    )  # fmt: skip


def _numbered(name: str) -> tuple[str, int]:
    """Symbol and number, from 0, of a name like ``F2_N``."""
    symbol = name.rstrip("_NmradsPg")  # letters of the units
    digits = symbol[len(symbol.rstrip("0123456789")) :]
    return symbol.removesuffix(digits), int(digits) - 1


def _boundary() -> list[ExportedVariable]:
    quantities: Sequence[Quantity] = (
        Quantity("strain_prev", "1", "strain of the web that enters"),
        Quantity("F_next_N", "N", "tension behind the last roller"),
    )
    return [ExportedVariable(each, "input", (Place(U, at),)) for at, each in enumerate(quantities)]


def _moduli(model: ModelParameters, layout: Layout) -> list[ExportedVariable]:
    """E of the web in each span, by the machine's names."""
    if model.web is None:
        return []
    places = [
        Place(P, layout.first_span + j * lay.SP_SIZE + lay.column(lay.SPAN, "modulus_Pa")) for j in range(layout.spans)
    ]
    return [
        parameter(quantity, at)
        for quantity, at in zip(modulus_names(layout.spans)[-layout.spans :], places, strict=True)
    ]


def _limited(layout: Layout) -> list[int]:
    first = layout.first_drive + lay.column(lay.DRIVE, "limited")
    return [first + motor * lay.DRIVE_SIZE for motor in range(layout.motors)]
