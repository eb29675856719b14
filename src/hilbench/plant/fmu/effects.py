"""Effects of an FMU: none of hilbench's, as its behaviour is in its own equations."""

from __future__ import annotations


class WithoutEffects:
    """Mixin of a machine, or of an emulated load, without effects."""

    def set_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0, **parameters: float
    ) -> None:
        """Raise ValueError: an FMU has no effects."""
        raise _refused(effect_id)

    def clear_effect(
        self, effect_id: str, axis: int | None = None, *, section: int | None = None, slot: int = 0
    ) -> None:
        """Raise ValueError: an FMU has no effects."""
        raise _refused(effect_id)


def _refused(effect_id: str) -> ValueError:
    return ValueError(f"'{effect_id}' is an effect in an FMU, expected none: what it does is in its own equations")
