"""Sections of a line: the web between two driven rollers, with all idlers, dancers and accumulators that it runs over.

To drives and controllers a section is a span: its strands in total length, as springs in series. Rollers and carriages
between its ends without a motor are left out.
"""

from __future__ import annotations

from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters


def axes_before_spans(model: ModelParameters) -> tuple[int, ...]:
    """Number of the driven axis before each span (K,), from 1; 0 before the first."""
    found, axis = [], 0
    for roller in model.line_rollers[:-1]:
        axis = roller.axis or axis
        found.append(axis)
    return tuple(found)


def section_spans(model: ModelParameters, axis: int) -> list[int]:
    """Indices, from 0, of the spans of the section after a driven axis."""
    return [k for k, of in enumerate(axes_before_spans(model)) if of == axis]


def section_length_m(model: ModelParameters, axis: int) -> float:
    """Length of the section after a driven axis, carriages at their positions of the model."""
    return sum(model.span_length_m(k + 1) for k in section_spans(model, axis))


def axes_before_carriages(model: ModelParameters) -> list[int]:
    """Number of the driven axis before the section of each carriage, from 1."""
    before = axes_before_spans(model)
    return [before[carriage.first_span - 1] for carriage in model.carriages]


def first_spans(model: ModelParameters) -> tuple[int, ...]:
    """First span of each section, right after a driven roller."""
    rollers = model.line_rollers
    return tuple(number for number, roller in enumerate(rollers[:-1], 1) if roller.axis is not None)


def section_model(model: ModelParameters) -> ModelParameters:
    """Line whose spans are the sections of another; a line of driven rollers alone is returned unchanged.

    Raises ValueError for a line that does not begin and end with a driven roller.
    """
    if model.stations is None:
        return model
    rollers, web = model.line_rollers, model.required_web
    if rollers[0].axis is None or rollers[-1].axis is None:
        raise ValueError("a line that does not begin and end with a driven roller")
    lengths_m, moduli_Pa, sections_m2 = [], [], []
    for axis in range(1, model.axis_count):
        spans, length_m = [k + 1 for k in section_spans(model, axis)], section_length_m(model, axis)
        yields_per_N = sum(model.span_length_m(span) / model.stiffness_N(span) for span in spans)
        section_m2 = model.section_m2(spans[0])
        lengths_m.append(length_m)
        sections_m2.append(section_m2)
        moduli_Pa.append(length_m / yields_per_N / section_m2)
    widths_m = [model.section_m2(span) / _thickness_m(model, span) for span in first_spans(model)]
    sections = web.model_copy(
        update={
            "youngs_modulus_Pa": moduli_Pa,
            "span_length_m": lengths_m,
            "width_m": widths_m,
            "thickness_m": [S / width_m for S, width_m in zip(sections_m2, widths_m, strict=True)],
        }
    )
    boundary = model.boundary.model_copy(
        update={"upstream_strain": model.upstream_strain, "downstream_strain": model.downstream_strain}
    )
    turned = [
        per_item(model.rollers.inertia_kg_m2, axis) + model.wound_inertia_kg_m2(axis)
        for axis in range(1, model.axis_count + 1)
    ]
    drawn = model.rollers.model_copy(update={"inertia_kg_m2": turned})
    of_axes = tuple(entry for entry in model.effects if entry.axis is not None)
    changes = {"stations": None, "web": sections, "rollers": drawn, "boundary": boundary, "effects": of_axes}
    return ModelParameters.model_validate(model.model_copy(update=changes).model_dump())


def _thickness_m(model: ModelParameters, span: int) -> float:
    return per_item(model.required_web.thickness_m, span)
