"""What a twin of a web line hands out of errors of its model."""

from __future__ import annotations

import pytest
from tests.plant.models import DEMONSTRATOR

from hilbench.estimation.nuisance import Nuisance
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.twin.estimated_errors import as_text, read_text
from hilbench.twin.machines.web_line_errors import as_effects


def test_an_error_of_the_mass_comes_on_top_of_the_one_that_the_model_has() -> None:
    own = {"effect": "inertia_mismatch", "axis": 2, "parameters": {"relative_change": 0.2}}
    model = ModelParameters.model_validate({**DEMONSTRATOR, "effects": [own]})
    (found,) = as_effects([Nuisance("inertia_share", 0.1, 0.01, True)], model, 1)
    assert (found.effect, found.parameter, found.place) == ("inertia_mismatch", "relative_change", "axis2")
    assert found.value == pytest.approx(1.2 * 1.1 - 1.0)
    assert found.deviation == pytest.approx(1.2 * 0.01)
    assert found.tied_with == ("torque_scale",)


def test_what_was_found_is_read_as_it_was_written_and_without_ties_as_it_was_before_there_were_any() -> None:
    model = ModelParameters.model_validate(DEMONSTRATOR)
    errors = [Nuisance("inertia_share", 0.1, 0.01, True), Nuisance("dry_friction_N", 3.0, 1.0, False)]
    found = list(as_effects(errors, model, 1))
    assert read_text(as_text(found)) == found
    before = '[{"effect":"web_slip","parameter":"creep_per_N","place":"web","value":1,"deviation":1,"separable":true}]'
    assert read_text(before)[0].tied_with == ()
