"""Text about the priors that a twin begins with: how old they are, and what they are."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final

from hilbench.estimation.web_line.config import Prior

_NORMAL_95: Final = 1.959964
#: What a quantity is called, its unit, and how many of that unit are one of the prior's.
_NAMES: Final = {
    "torque_offset_Nm": ("torque offset", "N·m", 1.0),
    "dry_friction_N": ("dry friction", "N", 1.0),
    "viscous_friction_N_s_per_m": ("viscous friction", "N·s/m", 1.0),
    "torque_scale": ("torque scale", "%", 100.0),
    "inertia_share": ("inertia", "%", 100.0),
    "creep_per_N": ("creep", "ppm/N", 1e6),
}
_AGES: Final = ((86400.0, "day"), (3600.0, "hour"), (60.0, "minute"))


def commissioned_text(priors: Sequence[Prior], now: datetime) -> str | None:
    """One line on measured priors, values beyond the model with half their 95 % interval; None where none is measured.

    ``commissioned 3 days ago: dry friction of axis 2 1.8 ± 0.2 N, …``
    """
    measured = [(prior.measured_at, prior) for prior in priors if prior.measured_at is not None]
    if not measured:
        return None
    oldest = min(_in_utc(time) for time, _ in measured)
    values = ", ".join(_value(prior) for _, prior in measured)
    return f"commissioned {_age((_in_utc(now) - oldest).total_seconds())}: {values}"


def _in_utc(time: datetime) -> datetime:
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def _age(age_s: float) -> str:
    for unit_s, unit in _AGES:
        count = int(age_s // unit_s)
        if count > 0:
            return f"{count} {unit}{'s' if count > 1 else ''} ago"
    return "less than a minute ago"


def _value(prior: Prior) -> str:
    name, unit, factor = _NAMES[prior.quantity]
    half = _NORMAL_95 * factor * prior.deviation
    digits = max(0, 1 - int(f"{half:e}".split("e")[1]))  # two of the half width
    return f"{name} of axis {prior.axis} {factor * prior.value:.{digits}f} ± {half:.{digits}f} {unit}"
