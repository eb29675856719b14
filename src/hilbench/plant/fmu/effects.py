"""An FMU has no effects of hilbench: what it does is in its own equations."""

from __future__ import annotations


class WithoutEffects:
    """The part of a machine, or of what a load motor emulates, that takes effects: here it takes none."""

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """It can have none. Raises ValueError."""
        raise _refused(effect_id)

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """It can have none. Raises ValueError."""
        raise _refused(effect_id)


def _refused(effect_id: str) -> ValueError:
    return ValueError(f"'{effect_id}' is an effect in an FMU, expected none: what it does is in its own equations")
