"""Prediction of a web line: its model with the bench's controllers, from the bench's signals."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from operator import attrgetter

import numpy as np

from hilbench.bench.prediction.task import Look
from hilbench.bench.prediction.window import Hindsight, Reading, Window
from hilbench.bench.tasks.limits import is_synchronized
from hilbench.bench.tasks.web_entering_strain import strains_around
from hilbench.bench.tasks.web_limits import limited
from hilbench.control.web_line.feed_forward import ROLLER, rollers_of
from hilbench.control.web_line.strain_trajectory import strain_trajectory
from hilbench.control.web_line.swing_damping import SwingDamping, SwingPlant
from hilbench.control.web_line.tension import tension_controller
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.futures import Offsets, Prepared
from hilbench.prediction.plan import Asked, Move
from hilbench.prediction.web_line.futures import LineControl, LineCourses, LineFutures, LinePresent
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import LINE_SPEED
from hilbench.topology.sample import CycleSample
from hilbench.topology.web_line_quantities import YOUNGS_MODULUS, modulus_of_span, spans_of_moduli, tension_set_point


def foreseen(config: BenchConfig) -> dict[str, str]:
    """The quantities whose courses futures follow, by path, each with the signal that shows it."""
    shape = config.shape
    set_points = {
        tension_set_point(shape.numbered(span)): f"F{shape.numbered(span)}_ref_N" for span in config.tension_controls
    }
    moduli = {path: f"E{shape.numbered(span)}_true_Pa" for path, span in spans_of_moduli(shape).items()}
    return {LINE_SPEED: f"v{shape.axes}_cmd_m_s", **set_points, **moduli}


class LineLook(Look):
    """Looks ahead from the samples of one run."""

    futures: LineFutures
    unready = "the twin is not synchronized, or a tension loop is open"

    def __init__(self, config: BenchConfig, prediction: PredictionConfig) -> None:
        shape, model = config.shape, config.web_line
        super().__init__(limited(config.safety.limits, shape))
        self._config = config
        axes, spans = range(1, shape.axes + 1), range(1, shape.spans + 1)
        self._speeds = [f"v{k}_m_s" for k in axes]
        self._torques = [f"tau{k}_Nm" for k in axes]
        self._commands = [f"v{k}_cmd_m_s" for k in axes]
        self._tensions = [f"F{shape.numbered(span)}_sim_N" for span in spans]
        #: E of each span by its path; that of all spans is a move of each (`hilbench.runs.set_point_schedule`).
        self._moduli = [modulus_of_span(span) if shape.spans > 1 else YOUNGS_MODULUS for span in spans]
        known = shape.numbered(shape.estimated[0])
        self._modulus, self._modulus_sd = f"E{known}_sim_Pa", f"E{known}_sd_Pa"
        self._synchronized = 0.01 * config.twin.synchronized_pct
        self._paths = {span: tension_set_point(shape.numbered(span)) for span in config.tension_controls}
        self._set_points = {span: f"F{shape.numbered(span)}_ref_N" for span in config.tension_controls}
        self._closed = attrgetter(*(f"loop{shape.numbered(span)}_closed" for span in config.tension_controls))
        motors = [each.signal for each in self.watched if each.unit == "N·m"]
        of_axes, of_spans = (*self._speeds, *self._commands, *motors), (*self._tensions, *self._set_points.values())
        of_web = self._modulus, self._modulus_sd, "strain_prev", "F_next_N"
        self.signals = tuple(dict.fromkeys([*of_axes, *of_spans, *of_web]))
        self._noisy = np.array([k for k, each in enumerate(self.watched) if each.unit != "N"])
        self.futures = LineFutures(
            model,
            partial(_control, config),
            self.watched,
            config.loaded_axes,
            span=shape.estimated[0],
            cycle_s=config.cycle_time_s,
            horizon_s=prediction.horizon_s,
            futures=prediction.futures,
        )

    def ready(self, sample: CycleSample) -> bool:
        """True if the present state is known: the twin is synchronized, and every loop closed on it."""
        closed = self._closed(sample)
        return is_synchronized(sample) and bool(np.all(closed)) and getattr(sample, self._modulus) > 0.0

    def moves_of(self, move: Move) -> tuple[Move, ...]:
        """E of all spans is E of each."""
        paths = self._moduli if move.path == YOUNGS_MODULUS else [move.path]
        return tuple(replace(move, path=path) for path in paths)

    def prepare(self, now_s: float, window: Window, hindsight: Hindsight, asked: Asked, *key: int) -> Prepared:
        """Prepare `LineFutures` from the last samples and the planned moves."""
        reading = window.read()
        present, noise = self._present(now_s, reading, window.fit_noise), np.zeros(len(self.watched))
        noise[self._noisy] = reading.noise(*(self.watched[k].signal for k in self._noisy))
        hindsight.compare(now_s, self._measured(reading), self._compared)
        offsets = Offsets(hindsight.lasting.copy(), hindsight.deviation, noise)
        return self.futures.prepare(present, self._courses(present, asked), offsets, *key)

    def _present(self, now_s: float, reading: Reading, fit_noise: float) -> LinePresent:
        modulus_Pa, sd_Pa, strain, behind_N = reading.last(
            self._modulus, self._modulus_sd, "strain_prev", "F_next_N"
        ).tolist()
        commands = reading.fitted(*self._commands)
        tensions = reading.last(*self._tensions)
        set_points = tensions.copy()
        for span, signal in self._set_points.items():
            set_points[span - 1] = reading.last(signal)[0]
        line_speed = float(reading.last(self._commands[-1])[0])
        commands_before = reading.before(*self._commands)
        rise_m_s = float(commands[-1] - commands_before[-1]) * self.futures.step_s / self._config.cycle_time_s
        commands[-1] = line_speed
        return LinePresent(
            now_s=now_s,
            speeds_m_s=reading.fitted(*self._speeds),
            speeds_sd_m_s=reading.noise(*self._speeds) * fit_noise,
            torques_Nm=reading.fitted(*self._torques),
            commands_m_s=commands,
            commands_before_m_s=commands_before,
            tensions_N=tensions,
            set_points_N=set_points,
            modulus_Pa=modulus_Pa,
            # By noise alone, as the twin is synchronized: what its model may lack makes the present tension wrong as
            # well, and no future of it differs by that.
            modulus_sd_Pa=min(sd_Pa, self._synchronized * modulus_Pa),
            upstream_strain=strain,
            downstream_tension_N=behind_N,
            line_speed_m_s=line_speed,
            line_speed_before_m_s=line_speed - rise_m_s,
        )

    def _courses(self, present: LinePresent, asked: Asked) -> LineCourses:
        times_s = self.futures.times_s(present.now_s)
        course = partial(asked.course, now_s=present.now_s, times_s=times_s)
        set_points = np.tile(present.set_points_N, (len(times_s), 1))
        for span, path in self._paths.items():
            set_points[:, span - 1] = course(path, float(present.set_points_N[span - 1]))
        factors = [course(path, 1.0) / asked.present.get(path, 1.0) for path in self._moduli]
        return LineCourses(course(LINE_SPEED, present.line_speed_m_s), set_points, np.stack(factors, axis=1))


def _control(config: BenchConfig, step_s: float) -> LineControl:
    """The bench's controllers at a step of futures."""
    model, cycle_s, loops = config.web_line, config.cycle_time_s, {}
    for span, control in config.tension_controls.items():
        strains = strains_around(config, span)
        # What a future knows of a strain at the start of a step acts in that step, and is that of the step before in
        # the mean; its drives act on the motion at the same instant.
        plant = SwingPlant.of_model(model, cycle_s, span, strains)
        plant = replace(plant, cycle_s=step_s, sample_time_s=0.0, delay_cycles=0)
        of_web, trajectory = (model.span_length_m(span), model.section_m2(span)), None
        if control.feed_forward == "twin":
            trajectory = strain_trajectory(control.set_point_rise_s, step_s, *of_web)
        loops[span] = (
            tension_controller(control.bandwidth_rad_per_s, control.correction_limit_m_s, model, span, strains),
            SwingDamping(plant, control.swing_damping_ratio, model.youngs_modulus_Pa(span)).vector,
            trajectory,
        )
    has_leads = any(control.feed_forward == "twin" for control in config.tension_controls.values())
    nothing = [np.zeros(ROLLER.itemsize // 8)] * model.axis_count
    return LineControl(rollers_of(model, step_s) if has_leads else nothing, loops)


look = LineLook
