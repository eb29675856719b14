"""The FMU of the tests (`mass.c`), built with the C compiler of this machine for FMI 2 or 3."""

from __future__ import annotations

import subprocess
import zipfile
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from hilbench.plant.fmu.export.archive import compiler

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler (cc, gcc or clang) to build an FMU with")

_SOURCE = Path(__file__).with_name("mass.c")
#: Reference, name, causality, variability, unit, start.
_VARIABLES = (
    (1, "torque", "input", "continuous", "N.m", 0.0),
    (2, "angle", "output", "continuous", "rad", None),
    (3, "rate", "output", "continuous", "rad/s", None),
    (4, "inertia", "parameter", "tunable", "kg.m2", 0.01),
    (5, "coulomb", "parameter", "tunable", "N.m", 0.0),
    (6, "failure", "parameter", "fixed", "", 0.0),
    (7, "failure_at_s", "parameter", "fixed", "s", 0.0),
    (8, "travel", "output", "continuous", "mm", None),
    (9, "speed", "input", "continuous", "rad/s", 0.0),
    (10, "pull", "output", "continuous", "N.m", None),
    (11, "stiffness", "parameter", "tunable", "", 2.0),
    (13, "steps", "output", "continuous", "", None),
)
_UNITS = """  <UnitDefinitions>
    <Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit>
    <Unit name="kg.m2"><BaseUnit kg="1" m="2"/></Unit>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
    <Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>
  </UnitDefinitions>"""


@cache
def _library(fmi: int) -> bytes:
    found = compiler()
    assert found is not None
    with TemporaryDirectory() as folder:
        out = Path(folder) / "mass.so"
        subprocess.run([found, "-shared", "-fPIC", "-O1", "-w", f"-DFMI={fmi}", "-o", out, _SOURCE, "-lm"], check=True)
        return out.read_bytes()


def build_fmu(
    path: Path,
    fmi: int = 2,
    *,
    any_step: bool = True,
    rollback: bool = True,
    step_s: float | None = None,
    fails: float = 0.0,
) -> Path:
    """Write the FMU with these abilities; `step_s`: the step that it asks for, `fails`: how it fails after 0.3 s."""
    outputs = [number for number, (_, _, causality, *_) in enumerate(_VARIABLES, 1) if causality == "output"]
    step = f' stepSize="{step_s}"' if step_s else ""
    state = "canGetAndSetFMUstate" if fmi == 2 else "canGetAndSetFMUState"
    token = "guid" if fmi == 2 else "instantiationToken"
    more = ' numberOfEventIndicators="0"' if fmi == 2 else ""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="{fmi}.0" modelName="mass" generationTool="tests" '
        f'{token}="{{mass {fails:g}}}"{more}>',
        f'  <CoSimulation modelIdentifier="mass" canHandleVariableCommunicationStepSize="{str(any_step).lower()}" '
        f'{state}="{str(rollback).lower()}"/>',
        _UNITS,
        f'  <DefaultExperiment startTime="0"{step}/>',
        "  <ModelVariables>",
    ]
    if fmi == 3:
        lines.append('<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>')
    for reference, name, causality, variability, unit, start in _VARIABLES:
        values = (f' unit="{unit}"' if unit else "") + (f' start="{start}"' if start is not None else "")
        common = f'name="{name}" valueReference="{reference}" causality="{causality}" variability="{variability}"'
        lines.append(
            f"<ScalarVariable {common}><Real{values}/></ScalarVariable>" if fmi == 2 else f"<Float64 {common}{values}/>"
        )
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    if fmi == 2:
        for name in ("Outputs", "InitialUnknowns"):
            lines += [f"<{name}>", *(f'<Unknown index="{at}"/>' for at in outputs), f"</{name}>"]
    else:
        references = [_VARIABLES[at - 1][0] for at in outputs]
        for name in ("Output", "InitialUnknown"):
            lines += [f'<{name} valueReference="{reference}"/>' for reference in references]
    lines += ["  </ModelStructure>", "</fmiModelDescription>"]
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", "\n".join(lines))
        archive.writestr(f"binaries/{'linux64' if fmi == 2 else 'x86_64-linux'}/mass.so", _library(fmi))
    return path
