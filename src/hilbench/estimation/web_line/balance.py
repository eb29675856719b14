"""The momentum balance of the roller behind the first span, on measured motion and torque.

    m·v2' = (i/r)·τ2 + F_next − R2(v2) − F,   F = E·h          (design section 5)

Everything but E is measured or in the model, effects included, so each cycle says something about E:
h = F/E is the web's section times its strain, as the encoders show it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hilbench.compiled import entry_point
from hilbench.plant.web_line import kernel, laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.span import SpanFollower

_AXIS = 1  #: index of axis 2
#: Relative change of E from which the follower is told: creep and damping depend on it.
_WORTH_TELLING = 1e-4


@dataclass(slots=True)
class BalanceSample:
    """One instant of the balance; forces at the web."""

    x2_m: float  #: measured position of roller 2; of several rollers as one, of their centre of mass
    force_N: float  #: (i/r)·τ2 + F_next − R2(v2), with the model's effects
    web_per_Pa: float  #: ∂F/∂E in N/Pa: section times strain; 0 while the web is slack
    velocity_m_s: float  #: of roller 2, from two positions


MeasuredForce = Callable[[Vector, float, float, float, float], float]


def _measured_force(sources: int) -> MeasuredForce:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point
    def measured_force(p: Vector, torque_Nm: float, x_m: float, v_m_s: float, f_next_N: float) -> float:
        if sources < 0:
            return 0.0
        n = int(p[lay.W_AXES])
        axis = lay.W_SIZE + _AXIS * lay.A_SIZE
        motor = lay.W_SIZE + n * lay.A_SIZE + _AXIS * lay.M_SIZE
        ratio = p[motor + lay.M_RAD_PER_M]
        torque = laws.shaft_torque_Nm(p, motor, laws.true_torque_Nm(p, motor, torque_Nm), x_m * ratio)
        direction = laws.measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
        resistance = laws.measured_resistance_N(p, axis, x_m, v_m_s, direction)
        force: float = laws.passed_on_N(p, axis, ratio * torque, direction) + f_next_N - resistance
        return force

    return measured_force


#: Force of the web on roller 2 (N, less `f_next_N`'s pull) by the parameters of a line, the torque that is measured
#: there (N·m), place and speed of the roller at the web (m, m/s), and the tension behind it (N).
web_force_N = _measured_force(kernel.source_number(__file__))


def mass_at_web_kg(p: Vector) -> float:
    """Mass of roller 2 with its motor, by the parameters of a line, as its effects have it."""
    axis = Layout.of(p).axis_rows(p)[_AXIS]
    inertia = 1.0 + axis[lay.place("inertia_mismatch", "relative_change")]
    return float((axis[lay.A_MOTOR_MASS_KG] + axis[lay.A_ROLLER_MASS_KG]) * inertia)


class MeasuredBalance:
    """The balance of axis 2 of a two-roller model, cycle by cycle; also the strain that the encoders show.

    The model's `torque_delay` of axis 2 is not taken out here: `hilbench.estimation.web_line.delay` does, with what it
    finds. Gear play is passed over. Raises ValueError for a model without a web or with other than two rollers.
    """

    def __init__(self, model: ModelParameters) -> None:
        if model.web is None or model.axis_count != 2:
            raise ValueError(f"a model of {model.axis_count} axes, expected two driven rollers with a web")
        self.web = SpanFollower(model)
        self._p = lay.pack(model)
        axis = Layout.of(self._p).axis_rows(self._p)[_AXIS]
        self.mass_kg = mass_at_web_kg(self._p)
        self.force_per_torque_per_m = model.motor_rad_per_m(2)  #: i/r
        self.section_m2 = model.section_m2(1)
        self.span_length_m = model.span_length_m(1)
        self.dry_friction_N = float(
            axis[lay.place("coulomb_friction", "force_N")] + axis[lay.place("stribeck_friction", "force_N")]
        )
        self._before: tuple[float, float] | None = None

    def reset(self) -> None:
        """The next update starts anew, with the web strained as upstream."""
        self._before = None

    def use_modulus(self, youngs_modulus_Pa: float) -> None:
        """E that the web's creep and damping go by."""
        if abs(youngs_modulus_Pa / self.web.parameter("youngs_modulus_Pa") - 1.0) > _WORTH_TELLING:
            self.web.set_parameter("youngs_modulus_Pa", youngs_modulus_Pa)

    def update(
        self, x1_m: float, x2_m: float, torque_Nm: float, strain_prev: float, F_next_N: float, duration_s: float
    ) -> BalanceSample:
        """The balance at this SYNC, `duration_s` after the last; positions at the web, torque at the motor."""
        web = self.web
        if self._before is None:
            web.reset((x1_m, x2_m), strain=[strain_prev])
            velocity_m_s = 0.0
        else:
            web.follow((x1_m, x2_m), duration_s)
            velocity_m_s = (x2_m - self._before[1]) / duration_s
        web.set_input("strain_prev", strain_prev)
        web.set_input("F_next_N", F_next_N)
        self._before = (x1_m, x2_m)
        force_N = float(web_force_N(self._p, torque_Nm, x2_m, velocity_m_s, F_next_N))
        return BalanceSample(x2_m, force_N, float(web.tension_N[0]) / web.parameter("youngs_modulus_Pa"), velocity_m_s)
