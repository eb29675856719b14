"""Prediction on the measured motion: the torque that it needs, whatever loops made the axis move so."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.misfit import Condition
from hilbench.diagnosis.noise import floor
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]

#: Speed below which an axis stands.
_STANDSTILL_M_S: Final = 5.0 * FRICTION_WIDTH_M_S
#: Corner of the filter that differentiates measured motion, Hz.
_CORNER_HZ: Final = 60.0


class OnMeasuredMotion:
    """The torque that the measured motion of a lone axis needs; no control loop has to be known.

    Motion and torque pass the same zero-phase filter, as in identification of robots by inverse dynamics (Gautier,
    Janot): differentiation does not drown in noise, and nothing is shifted in time.
    """

    def __init__(self, model: ModelParameters, data: Measured) -> None:
        self.names = ("tau1_Nm",)
        self.imitation = None
        self._period_s = data.period_s
        nyquist = 0.5 / data.period_s
        self._filter = butter(4, min(_CORNER_HZ, 0.8 * nyquist) / nyquist, output="sos")
        smooth = self._smooth(data.x_m[1])
        self._x = smooth
        self._v = np.gradient(smooth, data.period_s)
        self._a = np.gradient(self._v, data.period_s)
        self.exact = False
        self.tolerances = np.zeros(1)
        self.every = max(1, round(1.0 / (4.0 * _CORNER_HZ) / data.period_s))
        smooth_torque = self._smooth(data.tau_Nm[1])
        self.measured = smooth_torque[None, :: self.every]
        self._noise_Nm = floor(data.tau_Nm[1]) * float(np.sqrt(2.0 * _CORNER_HZ * data.period_s))
        self.rows = np.abs(self._v[:: self.every]) >= _STANDSTILL_M_S
        edge = round(0.1 / data.period_s / self.every)
        self.rows[:edge] = self.rows[-edge:] = False
        self._layout = lay.Layout.of(lay.pack(model))

        self._t_s = data.t_s

    def floor(self, signal: int) -> float:
        """What of the measured torque is above the band in which motion is known, carried into the band as white."""
        return self._noise_Nm

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time and motion."""
        step = slice(None, None, self.every)
        return [
            Condition("time", "s", self._t_s[step], spectral=True),
            Condition("speed of axis 1", "m/s", self._v[step]),
            Condition("acceleration of axis 1", "m/s²", self._a[step]),
            Condition("position of axis 1", "m", self._x[step], spectral=True),
        ]

    def _smooth(self, values: Array) -> Array:
        return np.asarray(sosfiltfilt(self._filter, values))

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, 1, n): torque by the laws, filtered as the measurement is."""
        many = np.atleast_2d(parameters)
        out = np.empty((len(many), 1, self.measured.shape[1]))
        for k, vector in enumerate(many):
            torque = np.empty(len(self._x))
            required_torque_Nm(vector, self._x, self._v, self._a, self._period_s, torque)
            out[k, 0] = self._smooth(torque)[:: self.every]
        return out
