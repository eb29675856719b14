"""Estimates of a twin of a web line, and history names of what belongs to no axis of it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from hilbench.apps.history.estimate import Estimate

#: In names of the history, for what is of no axis.
PLACE: Final = "web"
_MODULUS: Final = re.compile(r"E([1-9]\d*)?_sim_Pa")


def estimates(channels: Iterable[str]) -> Iterator[Estimate]:
    """Young's modulus of each span that a recording has, without its number where there is only one."""
    for name in channels:
        if match := _MODULUS.fullmatch(name):
            number = match[1] or ""
            place = f"span{number}" if number else PLACE
            yield Estimate(name, f"E{number}_sd_Pa", f"{place}.youngs_modulus_Pa", "Pa")


def place(effect: Mapping[str, Any]) -> str:
    """Place of an effect that is of no axis, as a diagnosis writes it."""
    return f"span{effect['span']}" if effect.get("span") else PLACE
