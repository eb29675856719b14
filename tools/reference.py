"""The reference pages of the docs, made from the code: config, objects, effects, metrics, signals, commands.

`tools/docs_hook.py` puts them into the site when mkdocs builds it; nothing of them is committed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import typer
from canopen.objectdictionary import ODVariable

import canopen
from hilbench.apps.cli.main import command_line
from hilbench.canopen.data_types import DataType
from hilbench.canopen.eds import all_variables, load_eds
from hilbench.canopen.eds import variable as find_variable
from hilbench.cia402.object_units import has_drive_unit, si_unit
from hilbench.plant.effect import Effect, EffectPlace, MachineKind, Parameter
from hilbench.plant.effects import EFFECTS, STATION_EFFECTS
from hilbench.runs import estimated_errors
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.config_text import json_schema
from hilbench.runs.metrics import OF_RUNS, of_steps
from hilbench.runs.segment import Metric
from hilbench.topology.quantities import permitted, single_paths
from hilbench.topology.signal_kinds import Signal
from hilbench.topology.signals import signals_of, smallest_shapes

ROOT: Final = Path(__file__).resolve().parent.parent

Schema = Mapping[str, Any]

#: Node id with which EDS files are read (and the next one); taken off again where a default depends on it.
_NODE_ID: Final = 1
#: Words of a key that are units, and how they are printed.
_UNITS: Final = {
    "Pa": "Pa", "N": "N", "Nm": "N·m", "N2": "N²", "m": "m", "m2": "m²", "s": "s", "s2": "s²", "ms": "ms", "us": "µs",
    "rad": "rad", "kg": "kg", "pct": "%", "Hz": "Hz", "cycles": "cycles", "count": "count", "sqrt": "√",
}  # fmt: skip
#: A velocity is written `m_s`, without the `per` of other quotients.
_QUOTIENTS: Final = (("m", "s"), ("m", "s2"), ("rad", "s"))
#: All that a reference page has, those of stations behind the others.
_ALL_EFFECTS: Final = EFFECTS + STATION_EFFECTS


def pages() -> dict[str, str]:
    """Every generated page: its path in the docs and its Markdown."""
    makers: dict[str, Callable[[], str]] = {
        "config": config_page,
        "objects": objects_page,
        "effects": effects_page,
        "metrics": metrics_page,
        "signals": signals_page,
        "commands": commands_page,
        "packages": packages_page,
    }
    return {f"reference/{name}.md": maker() for name, maker in makers.items()}


def _table(headings: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(headings)} |"
    yield "|" + "---|" * len(headings)
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
    yield ""


def _sentence(text: str) -> str:
    """Text of a docstring in one line; its code stays code."""
    return re.sub(r"\s+", " ", text.replace("``", "`")).strip()


# -- config ----------------------------------------------------------------------------------------------------


def unit_of_key(key: str) -> str:
    """The unit that a config key ends in: ``m/s``, ``N·m·s/rad``; "" for none."""
    words = key.split("_")
    start = len(words)
    while start > 1 and (words[start - 1] in _UNITS or words[start - 1] == "per"):
        start -= 1
    tail = words[start:]
    if not tail or tail == ["per"]:
        return ""
    if tuple(tail) in _QUOTIENTS:
        return f"{_UNITS[tail[0]]}/{_UNITS[tail[1]]}"
    above, _, below = "_".join(tail).partition("per_")
    parts = [_product(part) for part in (above, below)]
    if not parts[1]:
        return parts[0]
    return f"{parts[0] or '1'}/{f'({parts[1]})' if '·' in parts[1] else parts[1]}"


def _product(words: str) -> str:
    if tuple(words.strip("_").split("_")) in _QUOTIENTS:
        above, below = words.strip("_").split("_")
        return f"{_UNITS[above]}/{_UNITS[below]}"
    return "·".join(_UNITS[word] for word in words.split("_") if word).replace("√·", "√")


def config_page() -> str:
    """Every key of a bench config, from its pydantic models."""
    schema = _schema()
    lines = [
        "# Bench config",
        "",
        "Every key of a config file, from the models that check it. A unit stands at the end of a key's name. "
        "`hilbench config schema` writes the same as a JSON Schema, with which an editor completes and checks; "
        "`hilbench config new` asks its way to a file. A model file (`--model`) holds what "
        "[`model`](#ModelParameters) does.",
        "",
    ]
    places = _places(schema)
    for name, where in {"": ["The file"], **places}.items():
        block = schema["$defs"][name] if name else schema
        lines += [f"## {where[0]} {{#{name or 'file'}}}", "", _first_paragraph(block), ""]
        if len(where) > 1:
            lines += [f"Also {', '.join(f'`{path}`' for path in where[1:])}.", ""]
        required = block.get("required", ())
        fields = block.get("properties", {})
        rows = (_key_row(key, field, schema, key in required) for key, field in fields.items())
        if fields:
            lines += _table(("key", "type", "unit", "default", "meaning"), rows)
    return "\n".join(lines)


def _schema() -> Schema:
    schema: dict[str, Any] = ExperimentConfig.model_json_schema()
    schema["properties"]["include"] = json_schema()["properties"]["include"]
    return schema


def _places(schema: Schema) -> dict[str, list[str]]:
    """Every block, and the keys that hold it; a block that others choose from with what it is chosen by."""
    places: dict[str, list[str]] = {}

    def enter(fields: Schema, path: str) -> None:
        for key, field in fields.items():
            for name in dict.fromkeys(_references(field)):
                block = schema["$defs"][name]
                chosen = block.get("properties", {}).get("method", {}).get("const")
                where = f"{path}{key}" + (f" ({chosen})" if chosen else "")
                if name in places:
                    places[name].append(where)
                else:
                    places[name] = [where]
                    enter(block.get("properties", {}), f"{path}{key}.")

    enter(schema["properties"], "")
    return places


def _references(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        if isinstance(value.get("$ref"), str):
            yield value["$ref"].rpartition("/")[2]
        for key, entry in value.items():
            if key != "discriminator":
                yield from _references(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _references(entry)


def _first_paragraph(block: Schema) -> str:
    return _sentence(str(block.get("description", "")).partition("\n\n")[0])


def _key_row(key: str, field: Schema, schema: Schema, required: bool) -> tuple[str, ...]:
    default = "required" if required else _default(field)
    return f"`{key}`", _type(field), unit_of_key(key), default, _sentence(_meaning(field, schema))


def _meaning(field: Schema, schema: Schema) -> str:
    if "const" in field:
        return "chooses this method"
    names = list(_references(field))
    of_block = _first_paragraph(schema["$defs"][names[0]]) if len(names) == 1 else ""
    return str(field.get("description") or of_block)


def _type(field: Schema) -> str:
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{re.sub('(Config|Parameters)$', '', name)}](#{name})"
    if "const" in field:
        return f"`{field['const']}`"
    if "enum" in field:
        return " or ".join(f"`{value}`" for value in field["enum"])
    choices = field.get("anyOf") or field.get("oneOf")
    if choices:
        texts = [_type(choice) for choice in choices if choice.get("type") != "null"]
        return " or ".join(dict.fromkeys(texts))
    if field.get("type") == "array":
        return f"list of {_type(field.get('items', {}))}"
    if field.get("type") == "object":
        (values,) = field.get("patternProperties", {"": field.get("additionalProperties")}).values()
        return f"mapping of names to {_type(values)}" if "patternProperties" in field else f"mapping to {_type(values)}"
    if field.get("type") == "string":
        return "path" if field.get("format") in ("path", "file-path") else "text"
    names = {"number": "number", "integer": "whole number", "boolean": "true or false"}
    limits = [
        f"{sign} {_number(field[name])}"
        for name, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
        if name in field
    ]
    return " ".join([names.get(field.get("type", ""), "any"), ", ".join(limits)]).strip()


def _number(value: float) -> str:
    return str(round(value)) if value == round(value) and abs(value) < 1e8 else f"{value:g}"


def _default(field: Schema) -> str:
    if "default" not in field:
        return "–"
    value = field["default"]
    if isinstance(value, Mapping) and value:
        method = value.get("method")
        if "$ref" in field and set(value) == {"warning", "trip"}:
            return f"`{{warning: {value['warning']:g}, trip: {value['trip']:g}}}`"
        return f"`{method}`" if method else "its keys' defaults"
    if value is None:
        return "–"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{_number(value)}`" if isinstance(value, float) else f"`{value}`" if value != "" else "empty"


# -- objects ---------------------------------------------------------------------------------------------------


def objects_page() -> str:
    """The object dictionaries of the simulated devices, from their EDS files."""
    lines = [
        "# Object dictionary",
        "",
        "What the simulated devices have, from their EDS files (CiA 306). The unit is that of one count: *drive* "
        "means that 608Fh, 6091h, 6076h and 60A9h of the drive say what a count is. `hilbench sdo read NODE OBJECT` "
        "reads any of them by index or name and shows it in SI units; `$NODEID` in a default is the node's id.",
        "",
    ]
    for path in sorted((ROOT / "eds").glob("*.eds")):
        od, other = load_eds(path, _NODE_ID), load_eds(path, _NODE_ID + 1)
        lines += [f"## {path.name}", "", f"{od.device_information.product_name}.", ""]
        rows = (_object_row(od, other, variable) for variable in all_variables(od))
        lines += _table(("object", "name", "type", "access", "PDO", "default", "unit"), rows)
    return "\n".join(lines)


def _object_row(od: canopen.ObjectDictionary, other: canopen.ObjectDictionary, variable: ODVariable) -> tuple[str, ...]:
    parent = od[variable.index]
    name = variable.name if parent is variable else f"{parent.name}: {variable.name}"
    address = f"{variable.index:04X}h" + ("" if parent is variable else f":{variable.subindex}")
    default = "" if variable.default is None else f"`{_default_of_object(variable, other)}`"
    unit = si_unit(variable.index, None)
    unit_text = "drive" if has_drive_unit(variable.index) else f"{unit[0]:g} {unit[1]}" if unit else ""
    mapped = "yes" if variable.pdo_mappable else ""
    return address, name, DataType(variable.data_type or 0).name, variable.access_type, mapped, default, unit_text


def _default_of_object(variable: ODVariable, other: canopen.ObjectDictionary) -> str:
    """As it is in every node; `other` is the dictionary of the next node id."""
    value: Any = variable.default
    if value != find_variable(other, variable.index, variable.subindex).default:
        return f"$NODEID + {value - _NODE_ID:X}h"
    if isinstance(value, int) and value >= 0x10000:
        return f"{value:X}h"
    return value.hex(" ") if isinstance(value, bytes) else str(value)


# -- effects ---------------------------------------------------------------------------------------------------


def effects_page() -> str:
    """The vocabulary of effects."""
    lines = [
        "# Effects",
        "",
        "What a model may lack. Every effect is in the one model kernel, neutral until it is given parameters. The "
        "ids stand in `effects:` of a model, of `load:` (hidden in the emulated web) and of `hardware:` (hidden in "
        "the simulated axes), in the paths of steps (`load.effects.elasticity_drift.rate_per_s`, "
        "`hardware.effects.coulomb_friction.axis1.force_N`), and in what `hilbench diagnose` names. Values lie "
        "between *least* and *largest*; at the *neutral* ones the effect is not there.",
        "",
        *_table(
            ("effect", "law", "of", "enters", "hidden in"),
            ((f"[`{e.id}`](#{e.id})", e.law, _place(e), _domain(e), _hidden_in(e)) for e in _ALL_EFFECTS),
        ),
    ]
    for effect in _ALL_EFFECTS:
        several = f" Up to {effect.slots} at one place." if effect.slots > 1 else ""
        lines += [f"## {effect.id}", "", f"{effect.law}. Of {_place(effect)}; enters: {_domain(effect)}.{several}", ""]
        kinds = " and ".join(f"`{kind}`" for kind in MachineKind if kind in effect.kinds)
        bus = (
            f"Object {effect.object_index:04X}h of the drive, on its bus. "
            if effect.enters(EffectPlace.HARDWARE)
            else ""
        )
        lines += [f"Machines: {kinds}. {bus}Shown best: {effect.shown_by}.", ""]
        if effect.nuisance:
            lines += ["No missing mechanics: `hilbench diagnose` lists it under `nuisance`, and corrects for it.", ""]
        for other, experiment in effect.alike:
            lines += [f"Told from [`{other}`](#{other}) by: {experiment}.", ""]
        lines += _parameters(effect)
        if effect.rotary is not None:
            turned = effect.in_kind(MachineKind.SERVO_AXIS)
            lines += [f"On a machine that only turns, object {turned.object_index:04X}h: {turned.law}.", ""]
            lines += _parameters(turned)
    return "\n".join(lines)


def _parameters(effect: Effect) -> Iterator[str]:
    return _table(("parameter", "unit", "neutral", "least", "largest", ""), (_effect_row(p) for p in effect.parameters))


def _place(effect: Effect) -> str:
    if effect.per_axis:
        return "an axis"
    if effect.stations:
        return f"a station ({', '.join(sorted(effect.stations))})"
    return "a span, or of every one" if effect.per_section else "the web"


def _domain(effect: Effect) -> str:
    return effect.domain.value.replace("_", " ")


def _hidden_in(effect: Effect) -> str:
    return ", ".join(f"`{place}:`" for place in (EffectPlace.LOAD, EffectPlace.HARDWARE) if effect.enters(place))


def _effect_row(parameter: Parameter) -> tuple[str, ...]:
    unit = "" if parameter.unit == "1" else parameter.unit
    limits = (f"{value:g}".replace("inf", "∞") for value in (parameter.neutral, parameter.lower, parameter.upper))
    return f"`{parameter.name}`", unit, *limits, "" if parameter.required else "may be left out"


# -- metrics and signals ---------------------------------------------------------------------------------------


def metrics_page() -> str:
    """What criteria can bound."""
    lines = [
        "# Metrics",
        "",
        "What a run is judged by: `criteria:` of a config bound them, `result.json` has them all. Those *of steps* "
        "each step of the run has for itself, from when it acts to the next event; of the run they are the worst of "
        "all its steps. What a step, the *settled part* and noise are: [Results and report](../results.md).",
    ]
    for kind, machine in of_steps().items():
        lines += ["", f"## Of steps, `kind: {kind}`", "", *_metrics_table(machine.metrics)]
    lines += ["", "## Of the whole run, any machine", "", *_metrics_table(OF_RUNS)]
    lines += ["", "## Of what is found while the bench runs (`twin: live_diagnosis:`)", ""]
    lines += [*_metrics_table({**estimated_errors.METRICS, **estimated_errors.FIGURES})]
    lines += [
        "",
        "`gone` in the place of `found`: of an effect that was in the model and has gone again. A parameter of the",
    ]
    lines += ["effect can stand for the figure, too: `estimated_errors.coulomb_friction.axis2.force_N`."]
    return "\n".join(lines)


def _metrics_table(metrics: Mapping[str, Metric]) -> Iterator[str]:
    rows = ((f"`{name}`", metric.unit, metric.description, metric.absent) for name, metric in metrics.items())
    return _table(("metric", "unit", "what", "a run does not have it when"), rows)


def signals_page() -> str:
    """The channels of a recording."""
    lines = [
        "# Signals of a recording",
        "",
        "The channels of `recording.mf4`, one value a cycle, in SI units. The group says who knows the value; *truth* "
        "only a simulated bench has, and diagnosis never reads it. Conditions (`wait_until:`) and expectations of a "
        "scenario table use the same names. What steps and tables can set: "
        + ", ".join(f"`{path}` ({permitted(path)})" for path in single_paths())
        + ", and every parameter of every [effect](effects.md) within its bounds.",
        "",
        *_signals_table(
            "A web line of two axes and one span",
            signals_of(MachineKind.WEB_LINE, smallest_shapes()[MachineKind.WEB_LINE]),
        ),
        "",
        *_signals_table("A servo axis", signals_of(MachineKind.SERVO_AXIS, smallest_shapes()[MachineKind.SERVO_AXIS])),
    ]
    return "\n".join(lines)


def _signals_table(title: str, signals: Iterable[Signal]) -> list[str]:
    rows = ((f"`{s.name}`", s.unit, s.group, s.description) for s in signals)
    return [f"## {title}", "", *_table(("signal", "unit", "group", "what"), rows)]


# -- commands --------------------------------------------------------------------------------------------------


def commands_page() -> str:
    """Every command with its arguments, options and examples."""
    lines = [
        "# Commands",
        "",
        "What `--help` of each command says. `hilbench --install-completion` completes commands and options in the "
        "shell. Exit codes: 0 passed, 1 ran and a criterion failed, 2 unusable input, 3 bench fault, 130 interrupted; "
        "in each case with the drives in the safe state.",
        "",
    ]
    for name, command in _commands(typer.main.get_command(command_line()), "hilbench"):
        lines += [f"## {name}", "", *_command(name, command)]
    return "\n".join(lines)


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every command that does something; groups only hold others. (typer may bring a click of its own.)"""
    if hasattr(command, "commands"):
        for key, inner in command.commands.items():
            yield from _commands(inner, f"{name} {key}")
    else:
        yield name, command


def _command(name: str, command: Any) -> Iterator[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    pieces = " ".join(command.collect_usage_pieces(context))
    yield f"    {name} {re.sub('[{}]', '', pieces).replace('[[', '[').replace(']]', ']')}"
    yield ""
    paragraphs = [_sentence(text) for text in (command.help or "").split("\n\n")]
    examples = [text.removeprefix("Example: ") for text in paragraphs if text.startswith("Example: ")]
    for text in paragraphs:
        if not text.startswith("Example: "):
            yield from (text, "")
    yield from _table(("parameter", "meaning", "default"), (_parameter_row(p, context) for p in command.params))
    if examples:
        yield from ("For example:", "", *(f"    {example}" for example in examples), "")


def _parameter_row(parameter: Any, context: Any) -> tuple[str, ...]:
    record = parameter.get_help_record(context)
    given, text = record if record is not None else (parameter.human_readable_name, "")
    text = re.sub(r"\s*\[(default: [^\]]*|required|x[<>=]+[^\]]*)\]", "", text).strip()
    default = parameter.default
    if parameter.required:
        shown = "required"
    elif default is None or default is False or default == [] or callable(default):
        shown = ""
    else:
        shown = f"`{str(default).lower() if isinstance(default, bool) else default}`"
    return f"`{given}`", text, shown


# -- packages ----------------------------------------------------------------------------------------------------------


def packages_page() -> str:
    """Every module of the code by its package, with the first sentence of its docstring."""
    sources = ROOT / "src" / "hilbench"
    found: dict[str, list[Path]] = {}
    for path in sorted(sources.rglob("*.py")):
        inside = path.relative_to(sources).parts[:-1]
        found.setdefault(".".join(inside[: 2 if inside[:1] == ("apps",) else 1]), []).append(path)
    lines = [
        "# Packages",
        "",
        "What each module of `src/hilbench` is, by its docstring. How they belong together: "
        "[Architecture](../architecture.md).",
        "",
    ]
    for package, paths in found.items():
        lines += [f"## {package or 'Single modules'}", ""]
        own = sources.joinpath(*package.split("."), "__init__.py") if package else None
        if own in paths:
            lines += [_first_sentence(own), ""]
        modules = [path for path in paths if path.name[0] != "_"]
        if modules:
            lines += _table(
                ("module", "is"), ((_module(path, sources, package), _first_sentence(path)) for path in modules)
            )
    return "\n".join(lines)


def _module(path: Path, sources: Path, package: str) -> str:
    name = ".".join(path.relative_to(sources).with_suffix("").parts)
    return f"`{name.removeprefix(f'{package}.')}`"


def _first_sentence(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split())
