"""Base of a closed line, its test rig and servo axes: the kernel's vectors, motor ports, states and effects by name.

All are driven axes moved by the kernel; a line has web between them and uses metres, a rig and a servo axis may have
load motors on their shafts and use radians.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Vector
from hilbench.cycle_program import CompiledStage
from hilbench.plant.drive_loops import OFF
from hilbench.plant.effect import Effect, MachineKind
from hilbench.plant.effects import find_effect
from hilbench.plant.interface import Motor, PlantDescription, PlantState, Quantity, checked_name
from hilbench.plant.motor_port import FEEDBACK_SIZE, MotorPort
from hilbench.plant.sampling import locked_sample_time_s, samples_per
from hilbench.plant.sensor_rows import chained_with_noise, silence
from hilbench.plant.sensors import SensorNoise, SensorParameters
from hilbench.plant.web_line import kernel, rig_cycle
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import DRIVE, Layout, column
from hilbench.plant.web_line.line_vectors import LineVectors

KIND = MachineKind.WEB_LINE
YOUNGS_MODULUS = Quantity("youngs_modulus_Pa", "Pa", "Young's modulus E of the web, without the effects on it")


@dataclass(frozen=True, slots=True)
class _Memory:
    """State in addition to its names: the kernel's whole state vector, the ports' feedback, and the sensors' noise."""

    state: bytes
    feedback: tuple[tuple[float, float, float, float, bool], ...]
    noise: SensorNoise | None


class LineStep(NamedTuple):
    """Arguments of `rig_cycle.step` in addition to the vectors of a line."""

    samples: int  #: of the drives
    motors: NDArray[np.int64]  #: rows of those with ports
    sensors: Vector
    silence: Vector  #: zeros in place of noise


@dataclass(frozen=True, slots=True)
class FurtherState:
    """Position or speed of a part without a motor, a state and an output: `place` in the integrated quantities."""

    quantity: Quantity
    place: int


@dataclass(frozen=True, slots=True)
class CarriagePush:
    """Input force of a carriage: its place in the parameters, and the force added by an effect, N."""

    place: int
    more_N: float


def axis_names(axes: int, unit: Literal["m", "rad"]) -> tuple[Quantity, ...]:
    """Position and speed of each driven axis, named as in states and outputs."""
    place = "at the web: angle × nominal radius / gear ratio" if unit == "m" else "of the motor's shaft"
    return (
        *(Quantity(f"x{k}_{unit}", unit, f"position of axis {k} {place}") for k in range(1, axes + 1)),
        *(Quantity(f"v{k}_{unit}_s", f"{unit}/s", f"speed of axis {k} {place}") for k in range(1, axes + 1)),
    )


def torque_names(axes: int, motors: int, of: str) -> tuple[Quantity, ...]:
    """Torque of each motor: `tau1_Nm` … of the axes, then `tau_load1_Nm` … of the load motors."""
    own = (Quantity(f"tau{k}_Nm", "N·m", f"torque of motor {k}, {of}") for k in range(1, axes + 1))
    load = (Quantity(f"tau_load{k}_Nm", "N·m", f"torque of load motor {k}, {of}") for k in range(1, motors - axes + 1))
    return (*own, *load)


def boundary_names() -> tuple[Quantity, ...]:
    """Boundary inputs of a line."""
    return (
        Quantity("strain_prev", "1", "strain of the web that enters; the tension before the line follows it"),
        Quantity("F_next_N", "N", "tension behind the last roller"),
    )


def span_names(spans: int) -> tuple[Quantity, ...]:
    """Tensions, then strains, of the spans."""
    return (
        *(Quantity(f"F{k}_N", "N", f"tension of the web in span {k}") for k in range(1, spans + 1)),
        *(Quantity(f"strain{k}", "1", f"strain of the web in span {k}") for k in range(1, spans + 1)),
    )


def modulus_names(spans: int) -> tuple[Quantity, ...]:
    """E of the web as a parameter: of all spans and, where there are several, of each."""
    each = (
        Quantity(
            f"span{k}.youngs_modulus_Pa", "Pa", f"Young's modulus E of the web in span {k}, without the effects on it"
        )
        for k in range(1, spans + 1)
    )
    return (YOUNGS_MODULUS, *each) if spans > 1 else (YOUNGS_MODULUS,) * spans


def moduli_by_name(p: Vector) -> dict[str, Vector]:
    """E in a parameter vector (P,), by the names of `modulus_names`: views of all spans (K,) or of one (1,)."""
    moduli: Vector = Layout.of(p).matrices(p)["span"][:, lay.column(lay.SPAN, "modulus_Pa")]
    views = (moduli, *(moduli[k : k + 1] for k in range(len(moduli))))
    return {quantity.name: view for quantity, view in zip(modulus_names(len(moduli)), views, strict=False)}


def known_effect(effect_id: str, kind: MachineKind = KIND) -> Effect:
    """Effect of a kind of machine with this id. Raises ValueError that lists the known ones."""
    try:
        return find_effect(effect_id, kind)
    except KeyError as error:
        raise ValueError(error.args[0]) from None


def set_effect(
    p: Vector,
    effect_id: str,
    axis: int | None,
    span: int | None,
    slot: int,
    parameters: Mapping[str, float],
    able: Iterable[str],
    kind: MachineKind = KIND,
) -> None:
    """Check and write one effect into a parameter vector (P,); on an error leave it unchanged and raise ValueError.

    `able`: ids of the effects that this machine can have.
    """
    effect = known_effect(effect_id, kind)
    layout = Layout.of(p)
    axes = len(lay.driven_rows(p)) if effect.per_axis else None
    problem = (
        effect.axis_problem(axis, axes) or effect.section_problem(span, layout.spans) or effect.problem(parameters)
    )
    if problem is None and not 0 <= slot < effect.slots:
        problem = f"effect '{effect_id}' with slot {slot}, expected 0 to {effect.slots - 1}"
    if problem is None and effect_id not in able:
        problem = f"effect '{effect_id}' here, expected one of {', '.join(able)}"
    if problem:
        raise ValueError(problem)
    changed = p.copy()
    lay.write_effect(changed, effect_id, axis, slot, effect.filled(parameters), span=span, kind=kind)
    lay.check_effects(changed)
    p[:] = changed


def checked_positive(name: str, value: float, unit: str) -> float:
    """Positive finite value of a parameter. Raises ValueError."""
    if not 0.0 < value < np.inf:
        raise ValueError(f"{name} = {value!r} {unit}, expected a positive number")
    return float(value)


class SimulatedLine:
    """Simulation of driven axes with a motor port for each motor; see `hilbench.plant.interface.Plant`.

    `p` (P,): parameter vector, owned by the machine; `state` (S,): initial state; `unit`: of positions. `effects`: ids
    of the supported ones. `further`: motion of parts without a motor; `derived`: outputs computed from the integrated
    quantities (`Layout.y`); `forces`: force inputs of carriages; `sensors` of the motors, with noise by `seed`. Without
    ports every motor is off.
    """

    kind = KIND

    def __init__(
        self,
        p: Vector,
        state: Vector,
        ports: Sequence[MotorPort],
        unit: Literal["m", "rad"],
        effects: Iterable[str],
        parameters: Mapping[Quantity, float],
        further: Sequence[FurtherState] = (),
        derived: Mapping[Quantity, Callable[[Vector], float]] = MappingProxyType({}),
        forces: Mapping[Quantity, CarriagePush] = MappingProxyType({}),
        sensors: Sequence[SensorParameters] = (),
        seed: int = 0,
    ) -> None:
        self._p, self._state = p, state
        self._sample_time_s = p.item(lay.W_SAMPLE_TIME_S)
        self._layout = layout = Layout.of(p)
        self._ports = tuple(ports)
        self._noise = SensorNoise(np.random.SeedSequence(seed).spawn(len(sensors))) if sensors else None
        self._inputs, self._work = layout.new_inputs(), layout.new_work()
        self._out = np.zeros(layout.output_size)
        self._parameters = {quantity.name: value for quantity, value in parameters.items()}
        m, k = layout.motors, layout.spans
        #: Rows of the driven axes, and of the motors with ports: the kernel's, from 0.
        self._driven = lay.driven_rows(p)
        self._motors = (*self._driven, *range(layout.axes, m))
        n = len(self._driven)
        rows = layout.motor_rows(p)
        shown = [rows[motor] for motor in self._motors]
        self._places_of_motors = np.array(self._motors, np.int64)
        figures = [each.figures for each in sensors] or np.zeros((len(shown), rig_cycle.SENSOR))
        self._figures = np.array(figures, dtype=float).reshape(-1)
        self._silence, self._always = silence(len(shown))
        self._shown = np.zeros(FEEDBACK_SIZE * len(shown))
        self._show = self._stage(0, self._shown, self._shown)
        axis_of = {row: number for number, row in enumerate(self._driven, 1)}
        self._per_m = [1.0 if unit == "m" else float(rows[row].rad_per_m) for row in self._driven]
        axes, spans = axis_names(n, unit), span_names(k)
        description = PlantDescription(
            kind=self.kind,
            position_unit=unit,
            axes=n,
            motors=tuple(Motor(axis_of[int(row.axis)], float(row.rad_per_m) if unit == "m" else 1.0) for row in shown),
            states=(
                *axes,
                *torque_names(n, len(shown), "as it acts"),
                *spans[k:],
                *(each.quantity for each in further),
            ),
            inputs=(*_inputs(k), *forces),
            outputs=(
                *axes,
                *torque_names(n, len(shown), "as its drive reports it"),
                *spans,
                *(each.quantity for each in further),
                *derived,
            ),
            parameters=tuple(parameters),
            effects=tuple(effects),
        )
        self._further = tuple(further)
        self._derived = tuple(derived.values())
        self._forces = {quantity.name: push for quantity, push in forces.items()}
        columns = [(row, scale) for row, scale in zip(self._driven, self._per_m, strict=True)]
        columns += [(m + row, scale) for row, scale in columns[:n]]
        columns += [(2 * m + motor, 1.0) for motor in self._motors]
        columns += [(3 * m + place, 1.0) for place in range(2 * k)]
        self._describe_as(description, columns)

    def _describe_as(self, description: PlantDescription, columns: Sequence[tuple[int, float]]) -> None:
        """Take names; `columns`: those of the outputs in the kernel's report, and their scales."""
        self._description, self._columns = description, columns
        self._output_names = [quantity.name for quantity in description.outputs]
        self._places = {quantity.name: i for i, quantity in enumerate(description.states)}

    def describe(self) -> PlantDescription:
        """Description; see `hilbench.plant.interface.Machine`."""
        return self._description

    @property
    def ports(self) -> tuple[MotorPort, ...]:
        """Ports of the axes' motors, then of load motors."""
        return self._ports

    @property
    def vectors(self) -> LineVectors:
        """Vectors for compiled callers; call `show` after they have changed them."""
        return LineVectors(self._p, self._state, self._inputs, self._work, self._out)

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""
        return float(self._state[lay.S_COUNT] * self._p[lay.W_SAMPLE_TIME_S])

    def lock_to(self, duration_s: float) -> None:
        """Set the drives' sample time to the nearest to the model's of which `duration_s` is a multiple."""
        time_s, sample_s = self.time_s, locked_sample_time_s(duration_s, self._sample_time_s)
        self._p[lay.W_SAMPLE_TIME_S] = sample_s
        self._state[lay.S_COUNT] = round(time_s / sample_s)

    def step(self, duration_s: float) -> None:
        """Step by a multiple of the drives' sample time with the ports' set points; write the feedback to them.

        Raises ValueError for another duration.
        """
        samples = samples_per(duration_s, self._p.item(lay.W_SAMPLE_TIME_S))
        self._read_ports()
        self._advance(samples)
        self._observe()

    def _read_ports(self) -> None:
        read_ports(self._layout, self._motors, self._ports, self._state, self._inputs)

    def _advance(self, samples: int) -> None:
        kernel.advance(self._p, self._state, self._inputs, self._work, samples)

    def step_in_vectors(self, duration_s: float) -> LineStep:
        """Step arguments for compiled callers, with the ports' modes and limits. Raises ValueError as `step`."""
        samples = samples_per(duration_s, self._p.item(lay.W_SAMPLE_TIME_S))
        self._read_ports()
        return LineStep(samples, self._places_of_motors, self._figures, self._silence[0])

    def steps_in_modes(self, set_points: Vector, duration_s: float, shown: Vector) -> CompiledStage | None:
        """`step` with set points (M,) in place of the ports', whose modes and limits are kept; the feedback goes into
        `shown`, (5 M,): position, velocity, torque, reference, torque limited.

        The ports stay; the caller keeps the vectors. None if a subclass steps otherwise. Raises ValueError as `step`.
        """
        if (type(self).step, type(self)._advance) != (SimulatedLine.step, SimulatedLine._advance):
            return None
        step = self.step_in_vectors(duration_s)
        return self._stage(step.samples, set_points, shown)

    def _stage(self, samples: int, set_points: Vector, shown: Vector) -> CompiledStage:
        noise = self._noise
        numbers = (self._silence, self._always) if noise is None else (noise.rows, noise.next)
        rig = rig_cycle.RigArrays(self.vectors, self._places_of_motors, set_points, self._figures, shown)
        return chained_with_noise(rig_cycle.step_by, samples, rig_cycle.NoisyRig(rig, *numbers), noise)

    def _observe(self) -> None:
        """Update `_out` to the state, and the ports' feedback."""
        self._refresh()
        self.show()

    def show(self) -> None:
        """Write the outputs `out` of changed vectors to the ports."""
        if self._ports:
            self._show()
            for port, shown in zip(self._ports, self._shown.reshape(-1, FEEDBACK_SIZE).tolist(), strict=True):
                port.feedback = shown

    def _refresh(self) -> None:
        kernel.observe(*self.vectors)

    def outputs(self) -> dict[str, float]:
        """Present outputs, with the present parameters."""
        self._refresh()
        values, y = self._out.tolist(), self._layout.y(self._state)
        result = [values[place] * scale for place, scale in self._columns]
        result += [y.item(each.place) for each in self._further]
        result += [of(y) for of in self._derived]
        return dict(zip(self._output_names, result, strict=True))

    def get_state(self) -> PlantState:
        """Present state; an equal machine continues from it bit for bit."""
        self._refresh()
        columns, n, rows = self._layout.columns, self._layout.axes, list(self._driven)
        y = self._layout.y(self._state)
        torques = self._layout.motor_states(self._state).torque_Nm[list(self._motors)]
        values = [*(y[rows] * self._per_m), *(y[n:][rows] * self._per_m), *torques, *self._out[columns["strain"]]]
        values += [y[each.place] for each in self._further]
        feedback = tuple(port.feedback for port in self._ports)
        return PlantState(
            values=dict(zip(self._places, map(float, values), strict=True)),
            memory=_Memory(self._state.tobytes(), feedback, deepcopy(self._noise)),
        )

    def set_state(self, state: PlantState | Mapping[str, float]) -> None:
        """Restore a state of an equal machine; or transfer states by name, the others stay.

        A position or speed is that of an axis with its motor; a control loop continues from the given torque by
        bumpless transfer. Raises ValueError for an unknown name, or a state of another machine.
        """
        if not isinstance(state, PlantState):
            self._transfer(state)
            return
        memory = state.memory
        if not isinstance(memory, _Memory) or len(memory.state) != self._state.nbytes:
            raise ValueError(f"a state of another machine, expected one of a {self.kind} of {len(self._driven)} axes")
        self._state[:] = np.frombuffer(memory.state)
        self._refresh()
        for port, shown in zip(self._ports, memory.feedback, strict=True):
            port.feedback = shown
        self._noise = deepcopy(memory.noise)
        self._show = self._stage(0, self._shown, self._shown)

    def _transfer(self, values: Mapping[str, float]) -> None:
        n, k, state = self._layout.axes, self._layout.spans, self._state
        driven, motors = len(self._driven), len(self._motors)
        drives = self._layout.motor_states(state)
        for name in values:
            if name not in self._places:
                checked_name("state", name, self._description.states)
        for name, value in values.items():
            place = self._places[name]
            if place < 2 * driven:
                at = lay.S_Y + self._driven[place % driven] + (n if place >= driven else 0)
                apart = state.item(at + 2 * n) - state.item(at) if self._twists(self._driven[place % driven]) else -0.0
                state[at] = value / self._per_m[place % driven]
                state[at + 2 * n] = state.item(at) + apart
            elif place < 2 * driven + motors:
                drive = drives[self._motors[place - 2 * driven]]
                drive.torque_Nm, drive.mode = value, OFF
            elif place < 2 * driven + motors + k:
                span = place - 2 * driven - motors
                material = lay.S_Y + 4 * n + span
                length = state.item(material + k) * lay.factor_on_length(self._p, self._layout, span + 1)
                state[material] = length / (1.0 + value)
            else:
                self._set_further(self._further[place - 2 * driven - motors - k], value)
        lay.refresh_modes(self._p, state)
        self._observe()

    def _twists(self, row: int) -> bool:
        """True if a part of the load of an axis is behind a twisting shaft."""
        return self._p.item(lay.W_SIZE + row * lay.A_SIZE + lay.place("resonance", "inertia_share")) != 0.0

    def _set_further(self, state: FurtherState, value: float) -> None:
        """Transfer the motion of a part without a motor; the strains of spans that a carriage lengthens stay."""
        n, k, vector = self._layout.axes, self._layout.spans, self._state
        at = lay.S_Y + state.place
        if state.place < n and state.place > k:
            row = self._layout.axis_rows(self._p)[state.place]
            grows_m = lay.strand_length_m(row, value) - lay.strand_length_m(row, vector.item(at))
            for span in range(int(row.first_span), int(row.last_span) + 1):
                length = lay.S_Y + 4 * n + k + span
                vector[length - k] *= 1.0 + grows_m / vector.item(length)
                vector[length] += grows_m
        vector[at] = vector[at + 2 * n] = value

    def parameter(self, name: str) -> float:
        """Present value of a parameter. Raises ValueError for an unknown name."""
        return self._parameters[checked_name("parameter", name, self._description.parameters)]

    def push_of(self, name: str) -> CarriagePush:
        """Where a force input enters, by its name."""
        return self._forces[name]

    def set_input(self, name: str, value: float) -> None:
        """Set an input from now on. Raises ValueError for an unknown name."""
        checked_name("input", name, self._description.inputs)
        if name == "strain_prev":
            self._inputs[0] = value
        elif name == "F_next_N":
            self._inputs[1] = value
        elif name in self._forces:
            push = self._forces[name]
            self._p[push.place] = value + push.more_N
        else:
            span = [quantity.name for quantity in self._description.inputs].index(name) - 2
            self._layout.length_rates(self._inputs)[span] = value

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Set an effect's parameters from now on; strain and motion stay.

        Raises ValueError for an unknown effect, one that this machine cannot have, or a wrong axis, span, slot or
        parameter.
        """
        strain = self._out[self._layout.columns["strain"]].copy()
        set_effect(self._p, effect_id, axis, section, slot, parameters, self.describe().effects, self.kind)
        if effect_id == "splice":
            lay.await_splice(self._state)
        lay.set_strain(self._p, self._state, strain)
        lay.refresh_modes(self._p, self._state)

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Make an effect neutral from now on. Raises as `set_effect`."""
        self.set_effect(effect_id, axis, section=section, slot=slot, **known_effect(effect_id, self.kind).filled({}))

    def _set_inertia(self, name: str, value: float, axis: int, roller_mass_kg: float) -> None:
        """Set another mass on the roller's side of the gear of an axis (from 1). Raises ValueError."""
        row = self._layout.axis_rows(self._p)[self._driven[axis - 1]]
        if not 0.0 <= value < np.inf or row.motor_mass_kg + roller_mass_kg <= 0.0:
            raise ValueError(f"{name} = {value!r} kg·m², expected 0 or more, and inertia of roller or motor above 0")
        before, row.roller_mass_kg = row.roller_mass_kg, roller_mass_kg
        try:
            lay.check_effects(self._p)
        except ValueError:
            row.roller_mass_kg = before
            raise
        self._parameters[name] = float(value)


def _inputs(spans: int) -> tuple[Quantity, ...]:
    """Inputs of a line of so many spans: boundary, and growth of their lengths; none without a web."""
    if not spans:
        return ()
    rates = (Quantity(f"length_rate{k}_m_s", "m/s", f"growth of the length of span {k}") for k in range(1, spans + 1))
    return (*boundary_names(), *rates)


def read_ports(
    layout: Layout, motors: Sequence[int], ports: Sequence[MotorPort], state: Vector, inputs: Vector
) -> None:
    """Read set points of the ports into the inputs; clears the torque-limited flags.

    `motors`: the kernel's motor, from 0, of each port.
    """
    for motor, port in zip(motors, ports, strict=False):
        at = lay.U_MOTORS + motor * lay.UM_SIZE
        inputs[at : at + lay.UM_SIZE] = port.mode, port.setpoint, port.slope, port.torque_limit_Nm
    first = layout.first_drive + column(DRIVE, "limited")
    state[first : first + layout.motors * lay.DRIVE_SIZE : lay.DRIVE_SIZE] = 0.0
