"""Whether the tension swings: what its strain does quickly goes to and fro, each time for about as long and about as
far; compiled.

A change of E or of the speed moves the strain once; what goes round with a roller is told apart by its angle, and does
not count.
"""

from __future__ import annotations

from math import pi

from hilbench.compiled import compiled
from hilbench.estimation.bank import Array

# State, from a place of a vector on: side on which it is, for how long (s) and how far it has gone, the same of the
# half swing before, the roller's angle (rad) at its end, how many have been alike, and whether it swings.
(_SIDE, _LASTED_S, _SIZE, _LASTED_BEFORE_S, _SIZE_BEFORE, _ANGLE, _ALIKE, _SWINGS) = range(8)
SIZE = 8
#: Half a swing lasts so long, s.
_SHORTEST_S, _LONGEST_S = 0.15, 2.0
#: Half swings that are alike: one lasts at most so many times as long as the one before, and goes so many times as far.
_AS_LONG, _AS_FAR = 1.7, 2.0
#: It is on the other side when it is there by so much of how far it went.
_ACROSS = 0.25
#: So many in a row are a swing, and as many as are remembered.
_ENOUGH, _MOST = 4.0, 6.0
#: Of a turn of the roller, up to which a swing goes round with it.
_GOES_ROUND = 0.15


@compiled
def look(s: Array, at: int, x: float, least: float, angle: float, dt: float) -> bool:
    """Take x, that goes to and fro about zero, after `dt`; whether it swings, by more than `least`. `angle`: of the
    roller (rad)."""
    side = 1.0 if s[at + _SIDE] == 0.0 else s[at + _SIDE]
    s[at + _SIDE] = side
    s[at + _LASTED_S] += dt
    s[at + _SIZE] = max(s[at + _SIZE], x * side)
    if -x * side > max(_ACROSS * s[at + _SIZE], 0.5 * least):
        lasted_s, size = s[at + _LASTED_S], s[at + _SIZE]
        turned = abs(angle - s[at + _ANGLE]) / pi
        alike = (
            _is_about(lasted_s, s[at + _LASTED_BEFORE_S], _AS_LONG)
            and _is_about(size, s[at + _SIZE_BEFORE], _AS_FAR)
            and _SHORTEST_S < lasted_s < _LONGEST_S
            and size > least
            and abs(turned - 1.0) > _GOES_ROUND
        )
        s[at + _ALIKE] = min(s[at + _ALIKE] + 1.0, _MOST) if alike else max(s[at + _ALIKE] - 2.0, 0.0)
        s[at + _LASTED_BEFORE_S], s[at + _SIZE_BEFORE], s[at + _ANGLE] = lasted_s, size, angle
        s[at + _SIDE], s[at + _LASTED_S], s[at + _SIZE] = -side, 0.0, -x * side
    if s[at + _LASTED_S] > _LONGEST_S:  # it went there, and stays
        s[at + _LASTED_S] = s[at + _SIZE] = s[at + _ALIKE] = 0.0
    if s[at + _ALIKE] >= _ENOUGH:
        s[at + _SWINGS] = 1.0
    elif s[at + _ALIKE] == 0.0:
        s[at + _SWINGS] = 0.0
    return bool(s[at + _SWINGS] != 0.0)


@compiled
def _is_about(value: float, other: float, factor: float) -> bool:
    return other / factor < value < other * factor
