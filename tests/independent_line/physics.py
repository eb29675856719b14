"""The equations of the independent line, compiled. Nothing here comes from `hilbench.plant`.

Where the product integrates one strain per span with Runge-Kutta steps, here the web is a queue of pieces that were
laid into the span, each with an unstretched length and a compliance of its own: the tension follows from what lies in
the span, and what leaves is the oldest piece. Rollers move by velocity Verlet steps of 50 µs; dry friction is LuGre's
bristle (Canudas de Wit et al. 1995), which gives way elastically before it slides; gear play is a stiff spring with a
dead zone; a drive may integrate by the trapezoidal rule.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]

STEP_S = 5e-5
#: Unstretched length after which a new piece of web is begun, as a share of the span, and how many pieces there may be.
PIECE_SHARE = 0.02
MOST_PIECES = 256

# Of the machine and of the web.
(LENGTH, STIFFNESS, UPSTREAM_N, DOWNSTREAM_N, STRAIN_PREV, SHIFT, STEP_TIME, STEP_CHANGE) = range(8)
(DRIFT, RAMP_TIME, RAMP_S, RAMP_CHANGE, CREEP, STRAIN_OFFSET, LENGTH_ERROR, DAMPING_S) = range(8, 16)
(WAVE_N, WAVE_HZ, WAVE_PHASE, SPLICE_EVERY, SPLICE_LENGTH, SPLICE_CHANGE) = range(16, 22)
(CYCLE_S, TENSION_KP, TENSION_KI, SENSOR_S, SENSES_FORCE, SPLICE_TIME) = range(22, 28)
WEB = 28
# Of an axis.
(RADIUS, GEAR, MASS, MOTOR_MASS, COULOMB, VISCOUS, STRIBECK, STRIBECK_V, ASYMMETRY, QUADRATIC) = range(10)
(ECCENTRICITY, ECCENTRICITY_PHASE, SCALE, OFFSET, DELAY_S, GAP, UNBALANCE, UNBALANCE_PHASE, LOAD_SHARE) = range(10, 19)
(KP, KI, LIMIT, LAG_S, SAMPLE_S, LATE_S, TRAPEZOID, BRISTLE, PLAY_N, PLAY_WIDTH) = range(19, 29)
AXIS = 29
#: Torque ripples of an axis: amplitude (N·m), order, phase (rad), and whether the amplitude is a share of the torque.
RIPPLE = 4


@numba.njit(cache=True)
def _modulus_factor(web: Vector, t: float) -> float:
    factor = (1.0 + web[SHIFT]) * (1.0 + web[DRIFT] * t)
    if t >= web[STEP_TIME]:
        factor *= 1.0 + web[STEP_CHANGE]
    if web[RAMP_CHANGE] != 0.0:
        factor *= 1.0 + web[RAMP_CHANGE] * min(max((t - web[RAMP_TIME]) / web[RAMP_S], 0.0), 1.0)
    return float(factor)


@numba.njit(cache=True)
def _surface(axis: Vector, x: float, v: float) -> float:
    """Speed of the web on a roller whose centre is off its axis."""
    if axis[ECCENTRICITY] == 0.0:
        return v
    return float(v * (1.0 + axis[ECCENTRICITY] / axis[RADIUS] * np.cos(x / axis[RADIUS] + axis[ECCENTRICITY_PHASE])))


@numba.njit(cache=True)
def _resistance(axis: Vector, v: float, z: float, h: float, load: float) -> tuple[float, float]:
    """Force against a roller and the bristles' deflection (m) a step later."""
    force = axis[VISCOUS] * v + axis[ASYMMETRY] * abs(v) + axis[QUADRATIC] * v * abs(v)
    dry = axis[COULOMB] + axis[LOAD_SHARE] * abs(load)
    if axis[STRIBECK] != 0.0:
        dry += axis[STRIBECK] * np.exp(-((v / axis[STRIBECK_V]) ** 2))
    if dry > 0.0:
        # z' = v - bristle·|v|/dry·z, solved exactly over the step for a constant v.
        rate = axis[BRISTLE] * abs(v) / dry
        settled = np.sign(v) * dry / axis[BRISTLE]
        new = settled + (z - settled) * np.exp(-rate * h) if rate * h > 1e-9 else z + v * h
        return force + axis[BRISTLE] * new, new
    return force, 0.0


@numba.njit(cache=True)
def _shaft(axis: Vector, ripples: Vector, torque: float, angle: float) -> float:
    """Torque on the motor's shaft of the one that the drive makes."""
    out = (1.0 + axis[SCALE]) * torque
    for k in range(ripples.shape[0]):
        amplitude = ripples[k, 0] * (torque if ripples[k, 3] != 0.0 else 1.0)
        out += amplitude * np.sin(ripples[k, 1] * angle + ripples[k, 2])
    return float(out)


@numba.njit(cache=True)
def _exit_strain(web: Vector, pull: float, stiffness: float, strain: float) -> float:
    """Of a piece that leaves a span strained by `strain`; `pull`: tension times its softness, N."""
    return float(strain if web[DAMPING_S] > 0.0 else pull / stiffness + web[STRAIN_OFFSET])


@numba.njit(cache=True)
def run(
    webs: Vector,
    axes: Vector,
    ripples: Vector,
    speed: Vector,
    wanted: Vector,
    wander: Vector,
    noise: Vector,
    modulus_course: Vector,
    friction_course: Vector,
    times: Vector,
    late: Vector,
) -> tuple[Vector, Vector]:
    """The line from rest.

    webs (K, WEB), axes (N, AXIS); speed of the last roller (m/s) and factors on E and on the friction of all rollers
    (n,), wanted tensions (N), wander of the speed ratios and noise of the tension sensors (N) (K, n): one a cycle.
    times (s): (rows,), when motion is read; late (N, rows): when torques are. Returns (4, N, rows): commands, x, v,
    torques; and (3, K, rows): tension, strain, E's factor.
    """
    h, spans, rollers, rows = STEP_S, webs.shape[0], axes.shape[0], len(times)
    out, of_webs = np.zeros((4, rollers, rows)), np.zeros((3, spans, rows))
    # Queues of pieces, unstretched length and compliance: the newest at `head`, the oldest at `tail`.
    piece, soft = np.zeros((spans, MOST_PIECES)), np.ones((spans, MOST_PIECES))
    head, tail = np.zeros(spans, np.int64), np.zeros(spans, np.int64)
    lengths, total, compliance = np.zeros(spans), np.zeros(spans), np.zeros(spans)
    for j in range(spans):
        lengths[j] = webs[j, LENGTH] * (1.0 + webs[j, LENGTH_ERROR])
        piece[j, 0] = total[j] = compliance[j] = lengths[j] / (1.0 + webs[j, STRAIN_PREV])
    x, v = np.zeros(rollers), np.zeros(rollers)  # of the motors, at the web
    xr, vr = np.zeros(rollers), np.zeros(rollers)  # of the rollers
    z, play, taken = np.zeros(rollers), np.zeros(rollers), np.zeros(rollers)
    torque, command, integral, error = np.zeros(rollers), np.zeros(rollers), np.zeros(rollers), np.zeros(rollers)
    decay, per_sample, late_steps = np.zeros(rollers), np.ones(rollers, np.int64), np.zeros(rollers, np.int64)
    for i in range(rollers):
        decay[i] = np.exp(-h / axes[i, LAG_S]) if axes[i, LAG_S] > 0.0 else 0.0
        per_sample[i], late_steps[i] = max(1, round(axes[i, SAMPLE_S] / h)), round(axes[i, LATE_S] / h)
    per_cycle = round(webs[0, CYCLE_S] / h)
    setpoint = np.zeros((len(speed), rollers))
    sensed, tension_integral = webs[:, UPSTREAM_N].copy(), np.zeros(spans)
    tension, strain = webs[:, UPSTREAM_N].copy(), webs[:, STRAIN_PREV].copy()
    x_before, v_before, torque_before, tension_before = x.copy(), v.copy(), torque.copy(), tension.copy()
    stiffness, leaving = np.zeros(spans), np.zeros(spans)
    motion_row, torque_row, since_m = 0, np.zeros(rollers, np.int64), 0.0
    for step in range(per_cycle * len(speed)):
        t = step * h
        k = step // per_cycle
        first = webs[0]
        wave = first[WAVE_N] * np.sin(2.0 * np.pi * first[WAVE_HZ] * t + first[WAVE_PHASE])
        strain_prev, upstream = first[STRAIN_PREV] + wave / first[STIFFNESS], first[UPSTREAM_N] + wave
        for j in range(spans):
            web = webs[j]
            stiffness[j] = web[STIFFNESS] * _modulus_factor(web, t) * modulus_course[k]
            # The tension is that at which all pieces together are as long as the span.
            now = lengths[j] / total[j] - 1.0
            tension[j] = stiffness[j] * (lengths[j] - total[j] * (1.0 + web[STRAIN_OFFSET])) / compliance[j]
            if web[DAMPING_S] > 0.0:
                tension[j] += stiffness[j] * web[DAMPING_S] * (now - strain[j]) / h
            strain[j], tension[j] = now, max(tension[j], 0.0)
        if step % per_cycle == 0:
            setpoint[k, rollers - 1] = speed[k]
            for j in range(spans - 1, -1, -1):
                web = webs[j]
                shown = tension[j] if web[SENSES_FORCE] != 0.0 else web[STIFFNESS] * strain[j]
                sensed[j] += (shown + noise[j, k] - sensed[j]) * min(web[CYCLE_S] / web[SENSOR_S], 1.0)
                miss = (wanted[j, k] - sensed[j]) / web[STIFFNESS] if abs(speed[k]) > 0.02 else 0.0
                tension_integral[j] += web[TENSION_KI] * miss * web[CYCLE_S]
                correction = web[TENSION_KP] * miss + tension_integral[j]
                asked = web[STRAIN_PREV] * (wanted[j, k] / web[UPSTREAM_N] - 1.0) + correction + wander[j, k]
                entering, comes_from = 0.0, j - 1 if speed[k] >= 0.0 else j + 1
                if 0 <= comes_from < spans:
                    other = webs[comes_from]
                    entering = other[STRAIN_PREV] * (wanted[comes_from, k] / other[UPSTREAM_N] - 1.0)
                setpoint[k, j] = setpoint[k, j + 1] - abs(setpoint[k, j + 1]) * (asked - entering)
        while motion_row < rows and times[motion_row] <= t:
            share = 1.0 - (t - times[motion_row]) / h
            for i in range(rollers):
                out[0, i, motion_row] = setpoint[k, i]
                out[1, i, motion_row] = x_before[i] + share * (x[i] - x_before[i])
                out[2, i, motion_row] = v_before[i] + share * (v[i] - v_before[i])
            for j in range(spans):
                of_webs[0, j, motion_row] = tension_before[j] + share * (tension[j] - tension_before[j])
                of_webs[1, j, motion_row] = strain[j]
                of_webs[2, j, motion_row] = stiffness[j] / webs[j, STIFFNESS]
            motion_row += 1
        for i in range(rollers):
            while torque_row[i] < rows and late[i, torque_row[i]] <= t:
                share = 1.0 - (t - late[i, torque_row[i]]) / h
                out[3, i, torque_row[i]] = torque_before[i] + share * (torque[i] - torque_before[i])
                torque_row[i] += 1
        x_before[:], v_before[:], torque_before[:], tension_before[:] = x, v, torque, tension
        for i in range(rollers):
            axis = axes[i]
            ratio = axis[GEAR] / axis[RADIUS]
            if step % per_sample[i] == 0:
                taken[i] = setpoint[max(step - late_steps[i], 0) // per_cycle, i]
                now = (taken[i] - v[i]) * ratio
                mean = 0.5 * (now + error[i]) if axis[TRAPEZOID] != 0.0 else now
                new = integral[i] + axis[KI] * axis[SAMPLE_S] * mean
                error[i] = now
                asked_Nm = axis[KP] * now + new
                command[i] = min(max(asked_Nm, -axis[LIMIT]), axis[LIMIT])
                if command[i] == asked_Nm or (asked_Nm - command[i]) * now < 0.0:
                    integral[i] = new
            force = ratio * _shaft(axis, ripples[i], torque[i], x[i] * ratio)
            torque[i] = command[i] + (torque[i] - command[i]) * decay[i]
            pull = tension[i] if i < spans else webs[spans - 1, DOWNSTREAM_N]
            pull -= tension[i - 1] if i > 0 else upstream
            resistance, z[i] = _resistance(axis, vr[i], z[i], h, pull)
            resistance *= friction_course[k]
            if axis[PLAY_N] != 0.0:
                play[i] = min(max(play[i], vr[i] - axis[PLAY_WIDTH]), vr[i] + axis[PLAY_WIDTH])
                resistance += axis[PLAY_N] * (vr[i] - play[i]) / axis[PLAY_WIDTH]
            if axis[UNBALANCE] != 0.0:
                pull += axis[UNBALANCE] * np.sin(xr[i] / axis[RADIUS] + axis[UNBALANCE_PHASE]) / axis[RADIUS]
            if axis[GAP] > 0.0:
                half = 0.5 * axis[GAP] / ratio
                apart = x[i] - xr[i]
                bend = apart - min(max(apart, -half), half)
                contact = 2e7 * bend + 2e3 * (v[i] - vr[i]) if bend != 0.0 else 0.0
                v[i] += h * (force - contact) / axis[MOTOR_MASS]
                vr[i] += h * (contact + pull - resistance) / (axis[MASS] - axis[MOTOR_MASS])
                x[i] += h * v[i]
                xr[i] += h * vr[i]
            else:
                acceleration = (force + pull - resistance) / axis[MASS]
                x[i] += h * (v[i] + 0.5 * h * acceleration)
                v[i] += h * acceleration
                xr[i], vr[i] = x[i], v[i]
        # What leaves a span is laid into the next one, the oldest piece with its own compliance; in reverse the newest
        # one into the span before.
        for j in range(spans):
            behind = tension[j + 1] if j + 1 < spans else webs[j, DOWNSTREAM_N]
            way = h * _surface(axes[j + 1], xr[j + 1], 0.5 * (v_before[j + 1] + vr[j + 1]))
            # The web slips the way that the difference of the tensions pulls it.
            way -= webs[j, CREEP] * (tension[j] - behind) * abs(way)
            if way >= 0.0:
                leaves = _exit_strain(webs[j], tension[j] * soft[j, tail[j]], stiffness[j], strain[j])
            elif j + 1 < spans:
                pull = tension[j + 1] * soft[j + 1, head[j + 1]]
                leaves = _exit_strain(webs[j + 1], pull, stiffness[j + 1], strain[j + 1])
            else:
                leaves = webs[j, DOWNSTREAM_N] / webs[j, STIFFNESS]
            leaving[j] = way / (1.0 + leaves)
        into = h * _surface(axes[0], xr[0], 0.5 * (v_before[0] + vr[0]))
        pull = tension[0] * soft[0, head[0]]
        into /= 1.0 + (strain_prev if into >= 0.0 else _exit_strain(first, pull, stiffness[0], strain[0]))
        its_soft = 1.0
        if t >= first[SPLICE_TIME]:
            if since_m % first[SPLICE_EVERY] < first[SPLICE_LENGTH]:
                its_soft = 1.0 / (1.0 + first[SPLICE_CHANGE])
            since_m += into
        for j in range(spans):
            at = head[j]
            if into >= 0.0:
                if piece[j, at] > PIECE_SHARE * lengths[j] or (its_soft != soft[j, at] and piece[j, at] > 0.0):
                    at = head[j] = (at + 1) % MOST_PIECES
                    piece[j, at] = 0.0
                soft[j, at] = its_soft
            piece[j, at] += into
            total[j] += into
            compliance[j] += into * soft[j, at]
            while piece[j, at] < 0.0 and at != tail[j]:  # the newest went back
                newer, at = at, (at - 1) % MOST_PIECES
                compliance[j] += piece[j, newer] * (soft[j, at] - soft[j, newer])
                piece[j, at] += piece[j, newer]
                head[j] = at
            out_of, its_soft = leaving[j], soft[j, tail[j]]
            into = out_of
            if out_of < 0.0:
                coming = soft[j + 1, head[j + 1]] if j + 1 < spans else 1.0
                if soft[j, tail[j]] != coming or piece[j, tail[j]] > PIECE_SHARE * lengths[j]:
                    tail[j] = (tail[j] - 1) % MOST_PIECES
                    piece[j, tail[j]], soft[j, tail[j]] = 0.0, coming
            while out_of > piece[j, tail[j]] and tail[j] != head[j]:
                total[j] -= piece[j, tail[j]]
                compliance[j] -= piece[j, tail[j]] * soft[j, tail[j]]
                out_of -= piece[j, tail[j]]
                tail[j] = (tail[j] + 1) % MOST_PIECES
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
                    k = (k + 1) % MOST_PIECES
    return out, of_webs
