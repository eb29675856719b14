"""Config files for people and editors: YAML commented with each key's meaning, and the JSON Schema."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

from hilbench import strict_yaml
from hilbench.runs.config import ExperimentConfig

_COMMENT_COLUMN = 34


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a bench config file, its `include` too; nothing is required of a file that includes."""
    schema = ExperimentConfig.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "hilbench bench config"
    names = {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
    schema["properties"]["include"] = {
        **names,
        "description": "config files that this one stands on, by their path from here",
    }
    complete = {"required": schema.pop("required")}
    for block in schema["$defs"].values():
        block.pop("required", None)  # what a file includes may give it: `hilbench check` reports what is missing
    return {**_any_of(schema), "if": {"not": {"required": ["include"]}}, "then": complete}


def _any_of(node: Any) -> Any:
    """Replace `oneOf` by `anyOf`: where nothing is required a block may be one of several kinds."""
    if isinstance(node, list):
        return [_any_of(each) for each in node]
    if isinstance(node, dict):
        return {"anyOf" if key == "oneOf" else key: _any_of(each) for key, each in node.items()}
    return node


def commented_yaml(config: ExperimentConfig, folder: Path) -> str:
    """The config as YAML, every key with its description where it has one; EDS paths from `folder`."""
    return "\n".join(_lines(config, folder, 0)) + "\n"


def _lines(block: BaseModel, folder: Path, depth: int) -> Iterator[str]:
    for name, field in type(block).model_fields.items():
        value = getattr(block, name)
        if value is None:
            continue
        if isinstance(value, BaseModel):
            inner = list(_lines(value, folder, depth + 1))
            if inner:
                yield _line(depth, f"{name}:", field.description or _first_line(value))
                yield from inner
            continue
        if isinstance(value, Path):
            value = Path(os.path.relpath(value, folder))
        if value and isinstance(value, Mapping) and all(isinstance(part, BaseModel) for part in value.values()):
            yield _line(depth, f"{name}:", field.description)
            for key, part in value.items():
                yield _line(depth + 1, f"{key}:", _first_line(part))
                yield from _lines(part, folder, depth + 2)
            continue
        if value and isinstance(value, list | tuple) and isinstance(value[0], BaseModel):
            yield _line(depth, f"{name}:", field.description)
            yield from ("  " * (depth + 1) + "- " + _flow(_as_yaml(entry)) for entry in value)
            continue
        yield _line(depth, f"{name}: {_flow(_as_yaml(value))}", field.description)


def _line(depth: int, text: str, comment: str | None) -> str:
    left = "  " * depth + text
    return f"{left:<{_COMMENT_COLUMN}} # {comment}" if comment else left


def _first_line(block: BaseModel) -> str:
    return (type(block).__doc__ or "").strip().partition("\n")[0].rstrip(".")


def _as_yaml(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return _tag(value) | value.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, Mapping):
        return {key: _as_yaml(entry) for key, entry in value.items()}
    return [_as_yaml(entry) for entry in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def _tag(block: BaseModel) -> dict[str, Any]:
    """Keys that identify the kind of block: those that can have one value only, which is their default."""
    fields = type(block).model_fields
    return {
        name: getattr(block, name)
        for name, field in fields.items()
        if get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1
    }


def _flow(value: Any) -> str:
    text = strict_yaml.text_of(value, default_flow_style=True, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")
