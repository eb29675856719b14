"""Pieces of other web in a line, as seen from outside the kernel: which there are, and what they make of each span."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hilbench.compiled import REAL, VECTOR, entry_point
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import splice_laws
from hilbench.plant.web_line.layout import Vector


class Piece(NamedTuple):
    """A piece of web whose E·S is another: where the web at roller 1 was when it came in, m; its length, m
    unstretched; the relative change."""

    front_m: float
    length_m: float
    relative_change: float


class SplicedSpan(NamedTuple):
    """What pieces make of a span: factor on E·S of the whole, as of springs in series, and on that of the web that
    leaves it."""

    factor: float
    at_end: float


WHOLE = SplicedSpan(1.0, 1.0)


@entry_point(VECTOR, REAL, REAL, VECTOR, VECTOR)
def _put_factors(s: Vector, x_m: float, stretch: float, unstretched_m: Vector, out: Vector) -> None:
    """Into `out` (2·K,) factor and factor at the end of each span. s: pieces alone; x_m: way of the web at roller
    1, m; stretch: 1 + strain of what enters; unstretched_m (K,): web in the spans."""
    begin = 0.0
    for k in range(len(unstretched_m)):
        out[2 * k] = splice_laws.series_factor(s, 0, x_m, begin, unstretched_m[k], stretch)
        begin += unstretched_m[k]
        out[2 * k + 1] = 1.0 + splice_laws.change_at(s, 0, x_m, begin, stretch, lay.LEAST_BLUR_M)


def has_pieces(state: Vector) -> bool:
    """Whether the `state` of a line or follower has any."""
    return state.item(len(state) - lay.PIECES_SIZE + lay.PIECES_COUNT) > 0.0


def spliced_spans(state: Vector, x_m: float, stretch: float, unstretched_m: Sequence[float]) -> list[SplicedSpan]:
    """What the pieces in the `state` of a line or a follower make of its spans; arguments as `put_factors`."""
    out = np.empty(2 * len(unstretched_m))
    _put_factors(state[-lay.PIECES_SIZE :], x_m, stretch, np.array(unstretched_m), out)
    return [SplicedSpan(factor, at_end) for factor, at_end in out.reshape(-1, 2).tolist()]


def put_pieces(state: Vector, pieces: Sequence[Piece]) -> None:
    """Let these be the pieces in a line or follower, in the order in which they came in; the last ones if they are
    more than are kept."""
    kept = pieces[-lay.PIECES :]
    of_state = state[-lay.PIECES_SIZE :]
    of_state[lay.PIECES_COUNT] = len(kept)
    for number, piece in enumerate(kept):
        at = lay.PIECES_FIRST + number * lay.PIECE_SIZE
        of_state[at + lay.PIECE_FRONT_M] = piece.front_m
        of_state[at + lay.PIECE_LENGTH_M] = piece.length_m
        of_state[at + lay.PIECE_CHANGE] = piece.relative_change
