"""Pages from the templates in `templates/`; what comes from a file is escaped."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from starlette.responses import HTMLResponse, Response


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader("hilbench.apps.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def page(template: str, **shown: Any) -> Response:
    """A page of what is shown."""
    return HTMLResponse(_templates().get_template(template).render(**shown))
