"""Criteria: what a run has to show to pass, as a config states it, and their verdicts as `result.json` holds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from hilbench.block import Block, Strict
from hilbench.did_you_mean import expected_one_of
from hilbench.runs.figures import LEAST_SETTLED_S
from hilbench.runs.metrics import Judgement, all_metrics, find_metric, reasons
from hilbench.runs.segment import Figure, Metric


class Criterion(Block):
    """A bound on one metric: `min`, `max` or both (inclusive), or a `target` with its `tolerance`.

    `unit`, where given, must be the metric's own: it is there for the reader, nothing is converted. A value that
    holds by less than `margin` (unit of the metric) is *marginal*: it passes, and is shown to be close to its bound.
    Every step of the run must hold it, or the one that `step` names; shown is the one that is nearest to its bound.
    """

    name: str = Field(min_length=1, description="what report and JUnit XML call it")
    metric: str = Field(description="name of a metric")
    min: float | None = Field(default=None, description="least value that passes")
    max: float | None = Field(default=None, description="largest value that passes")
    target: float | None = Field(default=None, description="value that the metric should have")
    tolerance: float | None = Field(default=None, ge=0, description="how far from the target it may be")
    margin: float | None = Field(default=None, gt=0, description="a value that holds by less is marginal")
    unit: str | None = Field(default=None, description="must be the metric's own, where given")
    step: int | None = Field(
        default=None, ge=1, description="judge this step of the run only, counted from 1 as the report does"
    )

    verifies: list[Annotated[str, Field(min_length=1)]] = Field(
        default=[], description="ids of the requirements that it verifies, as a specification has them"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        metric = find_metric(self.metric)
        if metric is None:
            raise ValueError(f"metric '{self.metric}' is not known{expected_one_of(self.metric, all_metrics())}")
        if self.unit is not None and self.unit != metric.unit:
            raise ValueError(f"unit '{self.unit}' of metric {self.metric}, which is in '{metric.unit}'")
        if self.step is not None and not metric.of_steps:
            raise ValueError(f"no step with metric {self.metric}, which is of the whole run")
        if (self.target is None) != (self.tolerance is None):
            raise ValueError("target and tolerance together")
        bounded = self.min is not None or self.max is not None
        if bounded == (self.target is not None):
            raise ValueError("either min and/or max, or target and tolerance")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min {self.min:g} at most max {self.max:g}")
        return self

    @property
    def meaning(self) -> Metric:
        """Meaning of the metric."""
        metric = find_metric(self.metric)
        assert metric is not None, "as it was checked"
        return metric

    @property
    def limit(self) -> str:
        """The bound as text: ``≤ 25``, ``≥ 3``, ``3 … 5`` or ``80 ± 1``."""
        if self.target is not None:
            return f"{_text(self.target)} ± {_text(self.tolerance)}"
        if self.min is not None and self.max is not None:
            return f"{_text(self.min)} … {_text(self.max)}"
        return f"≥ {_text(self.min)}" if self.min is not None else f"≤ {_text(self.max)}"

    def distance(self, value: float) -> float:
        """Margin of a finite value within the nearer bound; negative outside."""
        if self.target is not None and self.tolerance is not None:
            return self.tolerance - abs(value - self.target)
        below = inf if self.max is None else self.max - value
        return min(below, inf if self.min is None else value - self.min)


def _text(bound: float | None) -> str:
    return f"{bound:g}".replace("e-0", "e-").replace("e+0", "e")


Verdict = Literal["passed", "marginal", "failed", "error"]


class CriterionResult(Strict):
    """Verdict on one criterion.

    `value` is None where the run has no such value, and `reason` states why: an *error*, which, other than a failure,
    is no statement on what was tested; with `never`, the awaited event did not come: a failure. With a value `reason`
    states what was not judged. `step`: which step of the run the value is of.
    """

    name: str
    value: float | None
    limit: str
    unit: str
    passed: bool
    marginal: bool = False  #: passed, by less than the criterion's margin
    never: bool = False  #: failed without a value: what was waited for did not come
    step: int | None = None
    reason: str | None = None
    verifies: list[str] = Field(default_factory=list)  #: ids of requirements

    @property
    def verdict(self) -> Verdict:
        """Verdict in one word."""
        if self.passed:
            return "marginal" if self.marginal else "passed"
        return "error" if self.value is None and not self.never else "failed"

    def of_cut_off_run(self) -> Self:
        """Verdict for a run that was cut off: what holds until then proves nothing of what was tested."""
        if not self.passed:
            return self
        until = "" if self.value is None else f", {self.value:.6g} until then"
        as_json = {
            "value": None,
            "passed": False,
            "marginal": False,
            "reason": f"not judged: the run was cut off{until}",
        }
        return self.model_copy(update=as_json)

    @model_serializer(mode="wrap")
    def _without_empty_fields(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = serialize(self)
        silent = ("reason", "marginal", "never", "step", "verifies")
        return {name: value for name, value in fields.items() if value or name not in silent}


def failed_or_passed(name: str, reason: str = "") -> CriterionResult:
    """A verdict without a number: failed for a `reason`, passed without one."""
    return CriterionResult(
        name=name, value=float(not reason), limit="≥ 1", unit="", passed=not reason, reason=reason or None
    )


def evaluate(
    criteria: Sequence[Criterion], metrics: Mapping[str, float | None], judged: Judgement | None = None
) -> list[CriterionResult]:
    """Judge a run's metrics, and with `judged` each of its steps. A metric the run does not have, or that is no finite
    number, fails."""
    return [
        _judge_steps(criterion, judged)
        if judged is not None and criterion.meaning.of_steps
        else _judge_run(criterion, metrics)
        for criterion in criteria
    ]


def _judge_run(criterion: Criterion, metrics: Mapping[str, float | None]) -> CriterionResult:
    value = metrics.get(criterion.metric)
    if criterion.metric not in metrics:
        return _result(criterion, reason=f"metric {criterion.metric} was not evaluated in this run")
    if value is None:
        return _result(criterion, reason=f"the run has no {criterion.metric}: {criterion.meaning.absent}")
    if not isfinite(value):
        return _result(criterion, reason=f"{criterion.metric} is {value}, expected a finite number")
    return _result(criterion, value)


def _judge_steps(criterion: Criterion, judged: Judgement) -> CriterionResult:
    """The verdict on the step that is nearest to the bound, or beyond it; a step that never got there is beyond."""
    metric, wanted = criterion.metric, criterion.step
    found = [(step, figure) for step, figure in judged.figures(metric) if wanted in (None, step.number)]
    if not found:
        return _result(criterion, reason=_why_none(criterion, judged))
    never = [entry for entry in found if _never(criterion, entry[1])]
    if never:
        return _result(criterion, never=True, step=never[0][0].number, reason=reasons(never))
    known = [(step, figure.value) for step, figure in found if figure.value is not None and isfinite(figure.value)]
    reason = reasons([entry for entry in found if entry[1].value is None])
    if not known:
        return _result(criterion, reason=f"the run has no {metric}: {reason}")
    nearest, value = min(known, key=lambda entry: criterion.distance(entry[1]))
    return _result(criterion, value, step=nearest.number, reason=f"not judged: {reason}" if reason else None)


def _never(criterion: Criterion, figure: Figure) -> bool:
    """True if the awaited event did not come, and the wait was long enough to state so."""
    waited_s = figure.longer_than_s
    return waited_s is not None and (waited_s >= LEAST_SETTLED_S or criterion.distance(waited_s) < 0)


def _why_none(criterion: Criterion, judged: Judgement) -> str:
    absent = f"the run has no {criterion.metric}"
    if criterion.step is None:
        return f"{absent}: {judged.absent(criterion.metric)}"
    step = next((step for step in judged.steps if step.number == criterion.step), None)
    if step is not None:
        return f"{step} has no {criterion.metric}"
    return f"{absent} of step {criterion.step}: it has {sum(step.number > 0 for step in judged.steps)} steps"


def _result(
    criterion: Criterion,
    value: float | None = None,
    *,
    reason: str | None = None,
    never: bool = False,
    step: int | None = None,
) -> CriterionResult:
    inside = None if value is None else criterion.distance(value)
    return CriterionResult(
        name=criterion.name,
        value=value,
        limit=criterion.limit,
        unit=criterion.meaning.unit,
        passed=inside is not None and inside >= 0,
        marginal=inside is not None and 0 <= inside < (criterion.margin or 0.0),
        never=never,
        step=step or None,
        reason=reason,
        verifies=criterion.verifies,
    )


#: Completed: to its end, without a criterion that says anything of it.
RunVerdict = Literal["passed", "failed", "completed", "fault", "interrupted"]
#: Source of the fault of a run that its operator has ended.
BY_OPERATOR: Final = "operator"


def verdict_of(first_fault: str | None, *, judged: bool, passed: bool | None) -> RunVerdict:
    """Verdict by the source of the first fault, if any; also of an older file, whose `passed` is true where nothing was
    judged."""
    if first_fault is not None:
        return "interrupted" if first_fault == BY_OPERATOR else "fault"
    if not judged:
        return "completed"
    return "passed" if passed else "failed"
