"""A web line."""

from __future__ import annotations

from hilbench.apps.commands.shown.machine import LiveRow, Shown
from hilbench.topology.signals import Shape
from hilbench.topology.web_line_signals import LINE_SPEED_SIGNAL


def shown(shape: Shape) -> Shown:
    """Of a line with so many spans; a row a span where there are several."""
    speed = LINE_SPEED_SIGNAL if shape.winds else f"v{shape.axes}_m_s"
    live = [LiveRow("line speed", (speed,), "m/s", ".3f")]
    for span in shape.simulated:
        k = shape.numbered(span)
        controlled = span in shape.controlled
        title = f"tension {k}".strip() + " true / simulated" + (" / set-point" if controlled else "")
        signals = (f"F{k}_true_N", f"F{k}_sim_N", *((f"F{k}_ref_N",) if controlled else ()))
        live.append(LiveRow(title, signals, "N", ".1f"))
    for span in shape.estimated:
        k = shape.numbered(span)
        signals = (f"E{k}_true_Pa", f"E{k}_sim_Pa")
        live.append(LiveRow(f"E{k} true", signals, "N/mm²", ".0f", 1e6, deviation=f"E{k}_sd_Pa"))
    of_steps = []
    for span in shape.estimated:
        k = shape.numbered(span)
        of_steps += [
            (f"E{k} in 1 %, s", f"E{k}_time_to_1pct_s"),
            (f"noise {k}, %".replace(" ,", ","), f"E{k}_noise_pct"),
        ]
    for span in shape.controlled:
        k = shape.numbered(span)
        of_steps += [
            (f"F{k} in 1 N, s", f"tension{k}_recovery_s"),
            (f"peak {k}, N".replace(" ,", ","), f"tension{k}_peak_error_N"),
        ]
    return Shown(tuple(live), tuple(of_steps))
