"""The independent line with several spans: pieces of web that wander from one span into the next.

    line = LineOfSpans(lengths_m=(1.2, 2.5, 1.8), hidden=[effect("splice", time_s=9.0, relative_change=0.3)])
    line.record("identification", seed=1).channels["tau3_Nm"]

An effect of a span says which (`at_span`); without, it is in all of them. Each span is the queue of pieces of
`tests.independent_line.physics`, and what leaves one is laid into the next with its own compliance: a splice passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from tests.independent_line import physics as ph
from tests.independent_line.line import CYCLE_S, PROFILES, Hidden, Line, Loops, Record

Array = NDArray[np.float64]

#: Effects of the web before the first roller, and what enters with it: they are no span's.
_ENTERS = ("upstream_disturbance", "splice")
#: Of a splice: time, unstretched length, relative change.
_SPLICE = ("time_s", "length_m", "relative_change")


def at_span(item: Hidden, span: int | None) -> Hidden:
    """An effect in one span (None: in all of them)."""
    return {**item, "span": span}


def of_drives(kp: tuple[float, ...], ki: tuple[float, ...], lag_s: tuple[float, ...]) -> Loops:
    """Loops of as many drives, each sampled every millisecond and told at once."""
    return Loops(kp, ki, lag_s, (1e-3,) * len(kp), (0.0,) * len(kp))


@dataclass(frozen=True)
class LineOfSpans(Line):
    """A line of as many driven rollers as spans and one."""

    lengths_m: Sequence[float] = (1.2, 2.5, 1.8)
    loops: Loops = field(default_factory=lambda: of_drives((1.0,) * 4, (1.0,) * 4, (1e-3,) * 4))

    @property
    def rollers(self) -> int:
        """Driven ones."""
        return len(self.lengths_m) + 1

    @property
    def model(self) -> dict[str, Any]:
        """What a model file knows of this line."""
        known = super().model
        return {**known, "web": {**known["web"], "span_length_m": list(self.lengths_m)}}

    def record(self, profile: str = "identification", seed: int = 0, duration_s: float | None = None) -> Record:
        """Run a profile from rest, each tension with set points and a controller of its own."""
        duration_s = PROFILES[profile] if duration_s is None else duration_s
        rng = np.random.default_rng([seed, 17])
        each = [self._experiment(profile, duration_s, rng) for _ in self.lengths_m]
        speed = each[-1][0]
        wanted, wander, sensor = (np.array([one[k] for one in each]) for k in (1, 2, 3))
        rows = int(np.floor((len(speed) - 1) * CYCLE_S / self.row_s + 1e-9)) + 1
        t = np.arange(rows) * self.row_s
        read = t + (np.clip(rng.standard_normal(rows), -3.0, 3.0) * self.jitter_s if self.jitter_s else 0.0)
        read = np.clip(read, 0.0, (len(speed) - 1) * CYCLE_S)
        axes, ripples = self._axes()
        late = np.stack([np.maximum(read - axis[ph.DELAY_S], 0.0) for axis in axes])
        webs = np.array([self._of_span(span) for span in range(1, self.rollers)])
        out, tension = run(webs, self._splice(), axes, ripples, speed, wanted, wander, sensor, read, late)
        return self._as_recorded(np.asarray(t, np.float64), out, tension, axes, rng)

    def _of_span(self, span: int) -> Array:
        """What `physics` knows of a web, for one span."""
        here = [
            {key: value for key, value in item.items() if key != "span"}
            for item in self.hidden
            if item["effect"] != "splice" and item.get("span") in (None, span)
        ]
        return replace(self, length_m=self.lengths_m[span - 1], hidden=here)._web()

    def _splice(self) -> Array:
        for item in self.hidden:
            if item["effect"] == "splice":
                return np.array([item["parameters"][name] for name in _SPLICE])
        return np.array([np.inf, 0.0, 0.0])

    def _as_recorded(self, t: Array, out: Array, tension: Array, axes: Array, rng: np.random.Generator) -> Record:
        count_m = 2.0 * np.pi * self.radius_m / self.gear_ratio / self.encoder_counts
        channels: dict[str, Array] = {"t_s": np.round(t, 9)}

        def noisy(values: Array, deviation: float) -> Array:
            return np.asarray(values + self.noise * deviation * rng.standard_normal(len(values)))

        for k in range(self.rollers):
            channels[f"v{k + 1}_cmd_m_s"] = out[0, k].copy()
            channels[f"x{k + 1}_m"] = np.round(noisy(out[1, k], self.position_noise_m) / count_m) * count_m
            channels[f"v{k + 1}_m_s"] = np.round(noisy(out[2, k], self.speed_noise_m_s), 6)
            torque = out[3, k] + axes[k, ph.OFFSET]
            channels[f"tau{k + 1}_Nm"] = np.round(noisy(torque, self.torque_noise_Nm), 4)
        channels["strain_prev"] = np.full(len(t), self._strain_prev)
        channels["F_next_N"] = np.full(len(t), self.downstream_N)
        truth = {f"F{span + 1}_true_N": values.copy() for span, values in enumerate(tension)}
        if self.measured_tension_N is not None:
            for span, values in enumerate(tension):
                channels[f"F{span + 1}_meas_N"] = noisy(values, self.measured_tension_N)
        for name in self.without:
            del channels[name]
        return Record(channels, truth)


@numba.njit(cache=True)
def run(
    webs: Array,
    splice: Array,
    axes: Array,
    ripples: Array,
    speed: Array,
    wanted: Array,
    wander: Array,
    noise: Array,
    times: Array,
    late: Array,
) -> tuple[Array, Array]:
    """The line from rest.

    webs (K, WEB), axes (N, AXIS); speed of the last roller (n,), wanted tensions, wander of the speed ratios and noise
    of the tension sensors (K, n): one a cycle. times (rows,): when motion is read; late (N, rows): when torques are.
    Returns commands, x, v, torques (4, N, rows), and tensions (K, rows).
    """
    h, spans, rollers, rows = ph.STEP_S, webs.shape[0], axes.shape[0], len(times)
    out, tensions = np.zeros((4, rollers, rows)), np.zeros((spans, rows))
    lengths, total, compliance = np.zeros(spans), np.zeros(spans), np.zeros(spans)
    piece, soft = np.zeros((spans, ph.MOST_PIECES)), np.ones((spans, ph.MOST_PIECES))
    head, tail = np.zeros(spans, np.int64), np.zeros(spans, np.int64)
    for j in range(spans):
        lengths[j] = webs[j, ph.LENGTH] * (1.0 + webs[j, ph.LENGTH_ERROR])
        piece[j, 0] = total[j] = compliance[j] = lengths[j] / (1.0 + webs[j, ph.STRAIN_PREV])
    x, v, z, play = np.zeros(rollers), np.zeros(rollers), np.zeros(rollers), np.zeros(rollers)
    torque, command, integral = np.zeros(rollers), np.zeros(rollers), np.zeros(rollers)
    error, taken, decay = np.zeros(rollers), np.zeros(rollers), np.zeros(rollers)
    per_sample, late_steps = np.ones(rollers, np.int64), np.zeros(rollers, np.int64)
    for i in range(rollers):
        decay[i] = np.exp(-h / axes[i, ph.LAG_S]) if axes[i, ph.LAG_S] > 0.0 else 0.0
        per_sample[i], late_steps[i] = max(1, round(axes[i, ph.SAMPLE_S] / h)), round(axes[i, ph.LATE_S] / h)
    per_cycle = round(webs[0, ph.CYCLE_S] / h)
    setpoint = np.zeros((len(speed), rollers))
    sensed, tension_integral = webs[:, ph.UPSTREAM_N].copy(), np.zeros(spans)
    tension, strain_before = webs[:, ph.UPSTREAM_N].copy(), webs[:, ph.STRAIN_PREV].copy()
    x_before, v_before, torque_before, tension_before = x.copy(), v.copy(), torque.copy(), tension.copy()
    stiffness, leaving = np.zeros(spans), np.zeros(spans)
    motion_row, torque_row, spliced_m = 0, np.zeros(rollers, np.int64), 0.0
    for step in range(per_cycle * len(speed)):
        t = step * h
        first = webs[0]
        wave = first[ph.WAVE_N] * np.sin(2.0 * np.pi * first[ph.WAVE_HZ] * t + first[ph.WAVE_PHASE])
        strain_prev, upstream = first[ph.STRAIN_PREV] + wave / first[ph.STIFFNESS], first[ph.UPSTREAM_N] + wave
        for j in range(spans):
            web = webs[j]
            stiffness[j] = web[ph.STIFFNESS] * ph._modulus_factor(web, t)
            strain = lengths[j] / total[j] - 1.0
            tension[j] = stiffness[j] * (lengths[j] - total[j] * (1.0 + web[ph.STRAIN_OFFSET])) / compliance[j]
            if web[ph.DAMPING_S] > 0.0:
                tension[j] += stiffness[j] * web[ph.DAMPING_S] * (strain - strain_before[j]) / h
            strain_before[j], tension[j] = strain, max(tension[j], 0.0)
        if step % per_cycle == 0:
            k = step // per_cycle
            setpoint[k, rollers - 1] = speed[k]
            for j in range(spans - 1, -1, -1):
                web = webs[j]
                strain = strain_before[j]
                sensed[j] += (web[ph.STIFFNESS] * strain + noise[j, k] - sensed[j]) * min(
                    web[ph.CYCLE_S] / web[ph.SENSOR_S], 1.0
                )
                miss = (wanted[j, k] - sensed[j]) / web[ph.STIFFNESS] if abs(speed[k]) > 0.02 else 0.0
                tension_integral[j] += web[ph.TENSION_KI] * miss * web[ph.CYCLE_S]
                asked = web[ph.STRAIN_PREV] * (wanted[j, k] / web[ph.UPSTREAM_N] - 1.0) + wander[j, k]
                asked += web[ph.TENSION_KP] * miss + tension_integral[j]
                entering, comes_from = 0.0, j - 1 if speed[k] >= 0.0 else j + 1
                if 0 <= comes_from < spans:
                    other = webs[comes_from]
                    entering = other[ph.STRAIN_PREV] * (wanted[comes_from, k] / other[ph.UPSTREAM_N] - 1.0)
                setpoint[k, j] = setpoint[k, j + 1] - abs(setpoint[k, j + 1]) * (asked - entering)
        while motion_row < rows and times[motion_row] <= t:
            share = 1.0 - (t - times[motion_row]) / h
            for i in range(rollers):
                out[0, i, motion_row] = setpoint[step // per_cycle, i]
                out[1, i, motion_row] = x_before[i] + share * (x[i] - x_before[i])
                out[2, i, motion_row] = v_before[i] + share * (v[i] - v_before[i])
            for j in range(spans):
                tensions[j, motion_row] = tension_before[j] + share * (tension[j] - tension_before[j])
            motion_row += 1
        for i in range(rollers):
            while torque_row[i] < rows and late[i, torque_row[i]] <= t:
                share = 1.0 - (t - late[i, torque_row[i]]) / h
                out[3, i, torque_row[i]] = torque_before[i] + share * (torque[i] - torque_before[i])
                torque_row[i] += 1
        x_before[:], v_before[:], torque_before[:], tension_before[:] = x, v, torque, tension
        for i in range(rollers):
            axis = axes[i]
            ratio = axis[ph.GEAR] / axis[ph.RADIUS]
            if step % per_sample[i] == 0:
                taken[i] = setpoint[max(step - late_steps[i], 0) // per_cycle, i]
                now = (taken[i] - v[i]) * ratio
                mean = 0.5 * (now + error[i]) if axis[ph.TRAPEZOID] != 0.0 else now
                new = integral[i] + axis[ph.KI] * axis[ph.SAMPLE_S] * mean
                error[i] = now
                asked = axis[ph.KP] * now + new
                command[i] = min(max(asked, -axis[ph.LIMIT]), axis[ph.LIMIT])
                if command[i] == asked or (asked - command[i]) * now < 0.0:
                    integral[i] = new
            force = ratio * ph._shaft(axis, ripples[i], torque[i], x[i] * ratio)
            torque[i] = command[i] + (torque[i] - command[i]) * decay[i]
            pull = tension[i] if i < spans else webs[spans - 1, ph.DOWNSTREAM_N]
            pull -= tension[i - 1] if i > 0 else upstream
            resistance, z[i] = ph._resistance(axis, v[i], z[i], h, pull)
            if axis[ph.PLAY_N] != 0.0:
                play[i] = min(max(play[i], v[i] - axis[ph.PLAY_WIDTH]), v[i] + axis[ph.PLAY_WIDTH])
                resistance += axis[ph.PLAY_N] * (v[i] - play[i]) / axis[ph.PLAY_WIDTH]
            if axis[ph.UNBALANCE] != 0.0:
                pull += axis[ph.UNBALANCE] * np.sin(x[i] / axis[ph.RADIUS] + axis[ph.UNBALANCE_PHASE]) / axis[ph.RADIUS]
            acceleration = (force + pull - resistance) / axis[ph.MASS]
            x[i] += h * (v[i] + 0.5 * h * acceleration)
            v[i] += h * acceleration
        # What leaves a span is laid into the next one, the oldest piece with its own compliance; in reverse the newest
        # one into the span before.
        for j in range(spans):
            behind = tension[j + 1] if j + 1 < spans else webs[j, ph.DOWNSTREAM_N]
            way = h * ph._surface(axes[j + 1], x[j + 1], 0.5 * (v_before[j + 1] + v[j + 1]))
            way -= webs[j, ph.CREEP] * (tension[j] - behind) * abs(way)
            if way >= 0.0:
                pull = tension[j] * soft[j, tail[j]]
                strain = ph._exit_strain(webs[j], pull, stiffness[j], strain_before[j])
            elif j + 1 < spans:
                pull = tension[j + 1] * soft[j + 1, head[j + 1]]
                strain = ph._exit_strain(webs[j + 1], pull, stiffness[j + 1], strain_before[j + 1])
            else:
                strain = webs[j, ph.DOWNSTREAM_N] / webs[j, ph.STIFFNESS]
            leaving[j] = way / (1.0 + strain)
        into = h * ph._surface(axes[0], x[0], 0.5 * (v_before[0] + v[0]))
        pull = tension[0] * soft[0, head[0]]
        into /= 1.0 + (strain_prev if into >= 0.0 else ph._exit_strain(webs[0], pull, stiffness[0], strain_before[0]))
        its_soft = 1.0
        if t >= splice[0] and spliced_m < splice[1] and into > 0.0:
            its_soft = 1.0 / (1.0 + splice[2])
            spliced_m += into
        for j in range(spans):
            at = head[j]
            if into >= 0.0:
                if piece[j, at] > ph.PIECE_SHARE * lengths[j] or (its_soft != soft[j, at] and piece[j, at] > 0.0):
                    at = head[j] = (at + 1) % ph.MOST_PIECES
                    piece[j, at] = 0.0
                soft[j, at] = its_soft
            piece[j, at] += into
            total[j] += into
            compliance[j] += into * soft[j, at]
            while piece[j, at] < 0.0 and at != tail[j]:  # the newest went back
                newer, at = at, (at - 1) % ph.MOST_PIECES
                compliance[j] += piece[j, newer] * (soft[j, at] - soft[j, newer])
                piece[j, at] += piece[j, newer]
                head[j] = at
            out_of, its_soft = leaving[j], soft[j, tail[j]]
            into = out_of
            if out_of < 0.0:
                coming = soft[j + 1, head[j + 1]] if j + 1 < spans else 1.0
                if soft[j, tail[j]] != coming or piece[j, tail[j]] > ph.PIECE_SHARE * lengths[j]:
                    tail[j] = (tail[j] - 1) % ph.MOST_PIECES
                    piece[j, tail[j]], soft[j, tail[j]] = 0.0, coming
            while out_of > piece[j, tail[j]] and tail[j] != head[j]:
                total[j] -= piece[j, tail[j]]
                compliance[j] -= piece[j, tail[j]] * soft[j, tail[j]]
                out_of -= piece[j, tail[j]]
                tail[j] = (tail[j] + 1) % ph.MOST_PIECES
            piece[j, tail[j]] -= out_of
            total[j] -= out_of
            compliance[j] -= out_of * soft[j, tail[j]]
            if step % 20000 == 0:  # what rounding adds up is taken out
                total[j], compliance[j], k = 0.0, 0.0, tail[j]
                while True:
                    total[j] += piece[j, k]
                    compliance[j] += piece[j, k] * soft[j, k]
                    if k == head[j]:
                        break
                    k = (k + 1) % ph.MOST_PIECES
    return out, tensions
