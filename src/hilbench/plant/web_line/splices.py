"""Pieces of other web in a line, outside the kernel: setting them, and their effect on each span."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hilbench.compiled import REAL, VECTOR, Vector, entry_point, record_at, record_in
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import splice_laws
from hilbench.plant.web_line.layout import WEB_PIECES


class Piece(NamedTuple):
    """Piece of web with another E·S: position of the web at roller 1 when it came in, m; its unstretched length, m; the
    relative change."""

    front_m: float
    length_m: float
    relative_change: float


class SplicedSpan(NamedTuple):
    """Effect of pieces on a span: factor on E·S of the whole, as of springs in series, and on that of the web leaving
    it."""

    factor: float
    at_end: float


WHOLE = SplicedSpan(1.0, 1.0)


@entry_point(VECTOR, REAL, REAL, VECTOR, VECTOR)
def _put_factors(s: Vector, x_m: float, stretch: float, unstretched_m: Vector, out: Vector) -> None:
    """Factor and factor at the end of each span into `out` (2·K,). s: `WEB_PIECES`; x_m: travel of the web at roller 1,
    m; stretch: 1 + strain of the entering web; unstretched_m (K,): web in the spans."""
    begin, pieces = 0.0, record_in(s, 0, WEB_PIECES)
    for k in range(len(unstretched_m)):
        out[2 * k] = splice_laws.series_factor(pieces, x_m, begin, unstretched_m[k], stretch)
        begin += unstretched_m[k]
        out[2 * k + 1] = 1.0 + splice_laws.change_at(pieces, x_m, begin, stretch, lay.LEAST_BLUR_M)


def has_pieces(state: Vector) -> bool:
    """True if the `state` of a line or follower has pieces."""
    return state.item(len(state) - lay.PIECES_SIZE + 1) > 0.0


def spliced_spans(state: Vector, x_m: float, stretch: float, unstretched_m: Sequence[float]) -> list[SplicedSpan]:
    """Effect of the pieces in the `state` of a line or follower on its spans; arguments as `put_factors`."""
    out = np.empty(2 * len(unstretched_m))
    _put_factors(state[-lay.PIECES_SIZE :], x_m, stretch, np.array(unstretched_m), out)
    return [SplicedSpan(factor, at_end) for factor, at_end in out.reshape(-1, 2).tolist()]


def put_pieces(state: Vector, pieces: Sequence[Piece]) -> None:
    """Set the pieces in a line or follower, in the order in which they came in; the last ones if they exceed the
    capacity."""
    kept, of_state = pieces[-lay.PIECES :], record_at(state[-lay.PIECES_SIZE :], WEB_PIECES)
    of_state.count = len(kept)
    for number, piece in enumerate(kept):
        of_state.ring[number] = piece
