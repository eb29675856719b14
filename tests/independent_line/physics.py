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
(CYCLE_S, TENSION_KP, TENSION_KI, SENSOR_S, SENSES_FORCE) = range(22, 27)
WEB = 27
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
    web: Vector,
    axes: Vector,
    ripples: Vector,
    v2_cmd: Vector,
    f_ref: Vector,
    wander: Vector,
    sensor_noise: Vector,
    modulus_course: Vector,
    friction_course: Vector,
    times: Vector,
    late: Vector,
) -> tuple[Vector, Vector]:
    """The line from rest.

    v2_cmd (m/s), f_ref (N), wander (of the speed ratio), sensor_noise (N), factors on E and on the friction of both
    rollers: (n,) one a cycle. times (s): (rows,), when
    motion is read; late (2, rows): when torques are. Returns (rows, 10): commands, x, v, torque by axis, tension,
    strain; and (rows,) E's factor.
    """
    h = STEP_S
    rows = len(times)
    out = np.zeros((rows, 10))
    modulus = np.zeros(rows)
    length = web[LENGTH] * (1.0 + web[LENGTH_ERROR])
    # The queue of pieces, unstretched length and compliance: the newest at `head`, the oldest at `tail`.
    piece, soft = np.zeros(MOST_PIECES), np.ones(MOST_PIECES)
    head, tail = 0, 0
    piece[0] = length / (1.0 + web[STRAIN_PREV])
    total, compliance, laid = piece[0], piece[0], 0.0
    x, v = np.zeros(2), np.zeros(2)  # of the motors, at the web
    xr, vr = np.zeros(2), np.zeros(2)  # of the rollers
    z, play = np.zeros(2), np.zeros(2)
    torque, command, integral, error = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    decay = np.ones(2)
    per_sample = np.ones(2, np.int64)
    for j in range(2):
        decay[j] = np.exp(-h / axes[j, LAG_S]) if axes[j, LAG_S] > 0.0 else 0.0
        per_sample[j] = max(1, round(axes[j, SAMPLE_S] / h))
    per_cycle = round(web[CYCLE_S] / h)
    late_steps = np.array([round(axes[0, LATE_S] / h), round(axes[1, LATE_S] / h)])
    setpoint = np.zeros((len(v2_cmd), 2))
    taken = np.zeros(2)
    sensed, correction, tension_integral = web[UPSTREAM_N], 0.0, 0.0
    tension, strain_before = web[UPSTREAM_N], web[STRAIN_PREV]
    motion_row, torque_row = 0, np.zeros(2, np.int64)
    acceleration = np.zeros(2)
    entered_m = 0.0
    x_before, v_before, torque_before, tension_before = np.zeros(2), np.zeros(2), np.zeros(2), tension
    for step in range(per_cycle * len(v2_cmd)):
        t = step * h
        stiffness = web[STIFFNESS] * _modulus_factor(web, t) * modulus_course[step // per_cycle]
        wave = web[WAVE_N] * np.sin(2.0 * np.pi * web[WAVE_HZ] * t + web[WAVE_PHASE])
        strain_prev = web[STRAIN_PREV] + wave / web[STIFFNESS]
        upstream = web[UPSTREAM_N] + wave
        # The tension is that at which all pieces together are as long as the span.
        strain = length / total - 1.0
        spring = stiffness * (length - total * (1.0 + web[STRAIN_OFFSET])) / compliance
        tension = spring
        if web[DAMPING_S] > 0.0:
            tension += stiffness * web[DAMPING_S] * (strain - strain_before) / h
        strain_before = strain
        tension = max(tension, 0.0)
        if step % per_cycle == 0:
            k = step // per_cycle
            shown = tension if web[SENSES_FORCE] != 0.0 else web[STIFFNESS] * strain
            sensed += (shown + sensor_noise[k] - sensed) * min(web[CYCLE_S] / web[SENSOR_S], 1.0)
            miss = (f_ref[k] - sensed) / web[STIFFNESS] if abs(v2_cmd[k]) > 0.02 else 0.0
            tension_integral += web[TENSION_KI] * miss * web[CYCLE_S]
            correction = web[TENSION_KP] * miss + tension_integral
            wanted = web[STRAIN_PREV] * (f_ref[k] / web[UPSTREAM_N] - 1.0) + correction + wander[k]
            setpoint[k, 0] = v2_cmd[k] - abs(v2_cmd[k]) * wanted
            setpoint[k, 1] = v2_cmd[k]
        while motion_row < rows and times[motion_row] <= t:
            share = 1.0 - (t - times[motion_row]) / h
            for j in range(2):
                out[motion_row, j] = setpoint[step // per_cycle, j]
                out[motion_row, 2 + j] = x_before[j] + share * (x[j] - x_before[j])
                out[motion_row, 4 + j] = v_before[j] + share * (v[j] - v_before[j])
            out[motion_row, 8] = tension_before + share * (tension - tension_before)
            out[motion_row, 9] = strain
            modulus[motion_row] = stiffness / web[STIFFNESS]
            motion_row += 1
        for j in range(2):
            while torque_row[j] < rows and late[j, torque_row[j]] <= t:
                share = 1.0 - (t - late[j, torque_row[j]]) / h
                out[torque_row[j], 6 + j] = torque_before[j] + share * (torque[j] - torque_before[j])
                torque_row[j] += 1
        for j in range(2):
            x_before[j], v_before[j], torque_before[j] = x[j], v[j], torque[j]
        tension_before = tension
        for j in range(2):
            axis = axes[j]
            ratio = axis[GEAR] / axis[RADIUS]
            if step % per_sample[j] == 0:
                taken[j] = setpoint[max(step - late_steps[j], 0) // per_cycle, j]
                now = (taken[j] - v[j]) * ratio
                mean = 0.5 * (now + error[j]) if axis[TRAPEZOID] != 0.0 else now
                new = integral[j] + axis[KI] * axis[SAMPLE_S] * mean
                error[j] = now
                wanted_Nm = axis[KP] * now + new
                command[j] = min(max(wanted_Nm, -axis[LIMIT]), axis[LIMIT])
                if command[j] == wanted_Nm or (wanted_Nm - command[j]) * now < 0.0:
                    integral[j] = new
            force = ratio * _shaft(axis, ripples[j], torque[j], x[j] * ratio)
            torque[j] = command[j] + (torque[j] - command[j]) * decay[j]
            before, behind = (upstream, tension) if j == 0 else (tension, web[DOWNSTREAM_N])
            pull = behind - before
            resistance, z[j] = _resistance(axis, vr[j], z[j], h, pull)
            resistance *= friction_course[step // per_cycle]
            if axis[PLAY_N] != 0.0:
                play[j] = min(max(play[j], vr[j] - axis[PLAY_WIDTH]), vr[j] + axis[PLAY_WIDTH])
                resistance += axis[PLAY_N] * (vr[j] - play[j]) / axis[PLAY_WIDTH]
            if axis[UNBALANCE] != 0.0:
                pull += axis[UNBALANCE] * np.sin(xr[j] / axis[RADIUS] + axis[UNBALANCE_PHASE]) / axis[RADIUS]
            if axis[GAP] > 0.0:
                half = 0.5 * axis[GAP] / ratio
                apart = x[j] - xr[j]
                bend = apart - min(max(apart, -half), half)
                contact = 0.0
                if bend != 0.0:
                    contact = 2e7 * bend + 2e3 * (v[j] - vr[j])
                roller_mass = axis[MASS] - axis[MOTOR_MASS]
                v[j] += h * (force - contact) / axis[MOTOR_MASS]
                vr[j] += h * (contact + pull - resistance) / roller_mass
                x[j] += h * v[j]
                xr[j] += h * vr[j]
            else:
                acceleration[j] = (force + pull - resistance) / axis[MASS]
                x[j] += h * (v[j] + 0.5 * h * acceleration[j])
                v[j] += h * acceleration[j]
                xr[j], vr[j] = x[j], v[j]
        # Web is laid into the span behind roller 1 and taken from it at roller 2; in reverse the other way round.
        into = h * _surface(axes[0], xr[0], 0.5 * (v_before[0] + vr[0]))
        into /= 1.0 + (strain_prev if into >= 0.0 else _exit_strain(web, tension * soft[head], stiffness, strain))
        out_of = h * _surface(axes[1], xr[1], 0.5 * (v_before[1] + vr[1]))
        # The web slips the way that the difference of the tensions pulls it.
        out_of -= web[CREEP] * (tension - web[DOWNSTREAM_N]) * abs(out_of)
        if out_of >= 0.0:
            out_of /= 1.0 + _exit_strain(web, tension * soft[tail], stiffness, strain)
        else:
            out_of /= 1.0 + web[DOWNSTREAM_N] / web[STIFFNESS]
        entered_m += into
        laid += into
        if laid > PIECE_SHARE * length:
            head = (head + 1) % MOST_PIECES
            piece[head], laid = 0.0, 0.0
            soft[head] = 1.0
            if web[SPLICE_EVERY] > 0.0 and entered_m % web[SPLICE_EVERY] < web[SPLICE_LENGTH]:
                soft[head] = 1.0 / (1.0 + web[SPLICE_CHANGE])
        piece[head] += into
        total += into
        compliance += into * soft[head]
        while piece[head] < 0.0 and head != tail:  # the newest went back
            newer, head = head, (head - 1) % MOST_PIECES
            compliance += piece[newer] * (soft[head] - soft[newer])
            piece[head] += piece[newer]
            laid = piece[head]
        if out_of < 0.0 and (soft[tail] != 1.0 or piece[tail] > PIECE_SHARE * length):
            tail = (tail - 1) % MOST_PIECES
            piece[tail], soft[tail] = 0.0, 1.0
        while out_of > piece[tail] and tail != head:
            total -= piece[tail]
            compliance -= piece[tail] * soft[tail]
            out_of -= piece[tail]
            tail = (tail + 1) % MOST_PIECES
        piece[tail] -= out_of
        total -= out_of
        compliance -= out_of * soft[tail]
        if step % 20000 == 0:  # what rounding adds up is taken out
            total, compliance, k = 0.0, 0.0, tail
            while True:
                total += piece[k]
                compliance += piece[k] * soft[k]
                if k == head:
                    break
                k = (k + 1) % MOST_PIECES
    return out, modulus
