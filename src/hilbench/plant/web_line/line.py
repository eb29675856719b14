"""The closed model: drives, rollers and web of a line, advanced in step with the bus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hilbench.plant.effects import Domain, find_effect
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.sampling import samples_per
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.offline import start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.ports import read_ports, write_ports


class Line:
    """N driven rollers with N-1 spans of web between them; motor k drives roller k through port k.

    Starts at rest, with every span strained as the web that enters. `advance` takes the set points from the ports
    and writes the feedback to them; without ports every motor is off. Parameters may change between calls.
    Raises ValueError for ports that do not fit, or ports on a model without drives.
    """

    def __init__(self, parameters: ModelParameters, ports: Sequence[MotorPort] | None = None, *, substeps: int = 1):
        if ports is not None and (parameters.drives is None or len(ports) != parameters.axis_count):
            raise ValueError(f"{len(ports)} ports, expected a model with drives and {parameters.axis_count} axes")
        self.parameters = parameters
        self._ports = ports or ()
        self._p = lay.pack(parameters, substeps)
        self._layout = Layout.of(self._p)
        self._inputs = self._layout.new_inputs()
        self._inputs[lay.U_STRAIN_PREV] = parameters.upstream_strain
        self._inputs[lay.U_F_NEXT_N] = parameters.boundary.downstream_tension_N
        self._work = self._layout.new_work()
        self._out = np.zeros(self._layout.output_size)
        self._state = start_state(self._p, parameters)
        self._elastic = any(_acts_on_elasticity(entry.effect) for entry in parameters.effects)
        self._observe()

    def advance(self, duration_s: float) -> None:
        """Go on by a multiple of the drives' sample time, with the ports' set points held.

        Raises ValueError for another duration.
        """
        samples = samples_per(duration_s, self._p.item(lay.W_SAMPLE_TIME_S))
        read_ports(self._layout, self._ports, self._state, self._inputs)
        kernel.advance(self._p, self._state, self._inputs, self._work, samples)
        self._observe()

    def _observe(self) -> None:
        kernel.observe(self._p, self._state, self._inputs, self._work, self._out)
        write_ports(self._layout, self._p, self._ports, self._state, self._out)

    @property
    def time_s(self) -> float:
        """Time since the start; the time of the effects' laws."""
        return float(self._state[lay.S_COUNT] * self._p[lay.W_SAMPLE_TIME_S])

    @property
    def youngs_modulus_Pa(self) -> float:
        """E, without the effects on it."""
        return float(self._p[lay.W_MODULUS_PA])

    @youngs_modulus_Pa.setter
    def youngs_modulus_Pa(self, value: float) -> None:
        if not 0.0 < value < np.inf:
            raise ValueError(f"Young's modulus {value!r} Pa, expected a positive number")
        self._p[lay.W_MODULUS_PA] = value

    @property
    def elasticity_factor(self) -> float:
        """What the effects on E make of it now; 1 without any."""
        if not self._elastic:
            return 1.0
        sample_s, time_s = self._p[lay.W_SAMPLE_TIME_S], self.time_s
        return float(laws.elasticity_factor(self._p, time_s, laws.step_factor(self._p, time_s, sample_s)))

    @property
    def tension_N(self) -> Vector:
        """Tension of each span (K,), with the present E."""
        kernel.observe(self._p, self._state, self._inputs, self._work, self._out)
        return self._out[self._layout.columns["F_N"]].copy()

    @property
    def strain(self) -> Vector:
        """Strain of each span (K,)."""
        return self._out[self._layout.columns["strain"]].copy()

    @property
    def x_m(self) -> Vector:
        """Motor positions at the web (N,): angle × nominal radius / gear ratio."""
        return self._out[self._layout.columns["x_m"]].copy()

    @property
    def v_m_s(self) -> Vector:
        """Motor speeds at the web (N,)."""
        return self._out[self._layout.columns["v_m_s"]].copy()

    @property
    def tau_Nm(self) -> Vector:
        """Measured motor torques (N,)."""
        return self._out[self._layout.columns["tau_Nm"]].copy()

    def set_boundary(self, strain_prev: float, F_next_N: float) -> None:
        """Upstream strain and downstream tension from now on; the upstream tension follows the strain."""
        self._inputs[lay.U_STRAIN_PREV] = strain_prev
        self._inputs[lay.U_F_NEXT_N] = F_next_N

    def set_length_rates(self, rates_m_s: ArrayLike) -> None:
        """L' of each span (K,) from now on (dancers, moving rollers)."""
        self._layout.length_rates(self._inputs)[:] = rates_m_s

    def set_effect(self, effect_id: str, axis: int | None = None, *, slot: int = 0, **parameters: float) -> None:
        """Give an effect these parameters from now on; strain and motion stay.

        Raises KeyError for an unknown effect, ValueError for what is wrong with axis, slot or parameters.
        """
        strain = self.strain
        set_effect(self._p, effect_id, axis, slot, parameters)
        self._elastic |= _acts_on_elasticity(effect_id)
        lay.set_strain(self._p, self._state, strain)
        lay.refresh_modes(self._p, self._state)

    def clear_effect(self, effect_id: str, axis: int | None = None, *, slot: int = 0) -> None:
        """Make an effect neutral from now on. Raises as `set_effect`."""
        neutral = find_effect(effect_id).filled({})
        self.set_effect(effect_id, axis, slot=slot, **neutral)

    def set_state(
        self,
        *,
        strain: ArrayLike | None = None,
        x_m: ArrayLike | None = None,
        v_m_s: ArrayLike | None = None,
        tau_Nm: ArrayLike | None = None,
    ) -> None:
        """State transfer: strains (K,), positions and speeds at the web (N,), motor torques (N,).

        What is not given stays. A control loop that is entered next goes on from the torque.
        """
        n, state = self._layout.axes, self._state
        for start, values in ((lay.S_Y, x_m), (lay.S_Y + n, v_m_s)):
            if values is not None:
                state[start : start + n] = values
                state[start + 2 * n : start + 3 * n] = values
        if strain is not None:
            lay.set_strain(self._p, state, strain)
        if tau_Nm is not None:
            self._layout.motor_states(self._state)[:, lay.SM_TORQUE_NM] = tau_Nm
        lay.refresh_modes(self._p, self._state)
        self._observe()


def _acts_on_elasticity(effect_id: str) -> bool:
    return find_effect(effect_id).domain is Domain.ELASTICITY


def set_effect(p: Vector, effect_id: str, axis: int | None, slot: int, parameters: dict[str, float]) -> None:
    """Check and write one effect into a parameter vector, or leave it as it was and raise (see `Line.set_effect`)."""
    effect = find_effect(effect_id)
    axes = Layout.of(p).axes if effect.per_axis else None
    problem = effect.axis_problem(axis, axes) or effect.problem(parameters)
    if problem is None and not 0 <= slot < effect.slots:
        problem = f"effect '{effect_id}' with slot {slot}, expected 0 to {effect.slots - 1}"
    if problem:
        raise ValueError(problem)
    changed = p.copy()
    lay.write_effect(changed, effect_id, axis, slot, effect.filled(parameters))
    lay.check_effects(changed)
    p[:] = changed
