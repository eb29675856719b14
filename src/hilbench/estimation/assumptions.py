"""Assumptions that estimators and tests share: what noise does, what is certain, what sensors and models are off by."""

from __future__ import annotations

from typing import Final

#: Deviations of a certain change: normal noise exceeds them once in 16,000 samples, 31,000 on one side. Of block means
#: of 20 ms that is once in five minutes, so that what follows has to be shown by more than one of them; 5 would hide a
#: break from drives that take late SYNCs for the next one, whose blocks scatter.
CERTAIN: Final = 4.0
#: Most that a square counts, over the variance that it is averaged into: that of three deviations. A step then moves a
#: variance by no more than so much noise, and the variance of normal noise comes out 0.5 % too small.
MOST_SQUARE: Final = 9.0
#: A parameter counts as separable when the data have shrunk its prior deviation to this share: they know as much as the
#: prior did then (half of its variance, 0.71 of its deviation).
SEPARABLE: Final = 0.7
#: Noise of an encoder at the web until it is measured: the step of one with 20 bits at a motor with 25 rad/m; and its
#: least value, a tenth of that: innovations of a simulation without noise would else count as exact, m.
POSITION_NOISE_M, POSITION_FLOOR_M = 2e-7, 2e-8
#: Least noise of a torque: the step of the feedback (0.1 % of the rated torque) of a motor with 0.1 N·m, N·m.
TORQUE_FLOOR_NM: Final = 1e-4
#: Share of the inertial force that counts as noise: while a roller shakes, torque, load and position are less
#: simultaneous, and its mass is known to a tenth (`inertia_pct` of `model_errors`).
SHAKING: Final = 0.1
#: Change of tension from block to block that counts as noise, times this: torque and motion are of one instant to 3 ms
#: only, of a block of 20 ms.
LATE: Final = 0.15
