"""FMU file: model description, shared library, and their build."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
import zipfile
from importlib.metadata import version
from importlib.resources import files
from math import isinf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal
from xml.sax.saxutils import quoteattr

from hilbench.errors import UnusableInputError
from hilbench.files import written_whole
from hilbench.plant.fmu.export.machine import ExportedMachine, ExportedVariable
from hilbench.plant.fmu.export.object_code import object_code

Fmi = Literal[2, 3]

#: Folders of binaries of FMI 2 and 3, and suffix of a shared library, by system and processor.
_PLATFORMS: Final = {
    ("Linux", "x86_64"): ("linux64", "x86_64-linux", ".so"),
    ("Linux", "aarch64"): ("aarch64-linux", "aarch64-linux", ".so"),
    ("Darwin", "x86_64"): ("darwin64", "x86_64-darwin", ".dylib"),
    ("Darwin", "arm64"): ("aarch64-darwin", "aarch64-darwin", ".dylib"),
}
_COMPILERS: Final = ("cc", "gcc", "clang")
#: SI units as an FMU writes them, with exponents of base units.
_UNITS: Final = {
    "rad": ("rad", {"rad": 1}),
    "rad/s": ("rad/s", {"rad": 1, "s": -1}),
    "m": ("m", {"m": 1}),
    "m/s": ("m/s", {"m": 1, "s": -1}),
    "N": ("N", {"kg": 1, "m": 1, "s": -2}),
    "Pa": ("Pa", {"kg": 1, "m": -1, "s": -2}),
    "N·m": ("N.m", {"kg": 1, "m": 2, "s": -2}),
    "kg·m²": ("kg.m2", {"kg": 1, "m": 2}),
    "N·m·s/rad": ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
    "s": ("s", {"s": 1}),
}


def write_fmu(machine: ExportedMachine, fmi: Fmi, path: Path) -> None:
    """Compile a machine and write it as an FMU that needs nothing of Python.

    Raises UnusableInputError without a C compiler, on a system without FMU binaries, or for a file that can't be
    written.
    """
    known = _PLATFORMS.get((platform.system(), platform.machine()))
    if known is None:
        raise UnusableInputError("fmu export", f"{platform.system()} on {platform.machine()}, expected Linux or macOS")
    folder, suffix = known[fmi - 2], known[2]
    with TemporaryDirectory(prefix="hilbench-fmu-") as work:
        kernel = object_code(machine.kernel)
        token = _token(machine, fmi, kernel.code)
        library = Path(work) / f"{machine.name}{suffix}"
        header = _header(machine, fmi, token, kernel.symbol)
        _link(Path(work), header, kernel.code, library)
        described = _description_2(machine, token) if fmi == 2 else _description_3(machine, token)
        with written_whole(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(_entry("modelDescription.xml"), described)
            archive.writestr(_entry(f"binaries/{folder}/{library.name}", executable=True), library.read_bytes())


def _entry(name: str, *, executable: bool = False) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)  # of a fixed date: reproducible files
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = (0o755 if executable else 0o644) << 16
    return entry


def compiler() -> str | None:
    """First C compiler found; None without one."""
    return next(filter(None, map(shutil.which, _COMPILERS)), None)


def _link(work: Path, header: str, kernel: bytes, library: Path) -> None:
    found = compiler()
    if found is None:
        names = ", ".join(_COMPILERS)
        raise UnusableInputError("fmu export", f"no C compiler, expected one of {names} on the PATH: it links the FMU")
    (work / "machine.h").write_text(header, encoding="ascii")
    (work / "kernel.o").write_bytes(kernel)
    (work / "slave.c").write_text(files(__package__).joinpath("slave.c").read_text(encoding="utf-8"), encoding="utf-8")
    command = [
        found, "-shared", "-fPIC", "-O2", "-ffp-contract=off", "-fvisibility=hidden", "-o", str(library),
        "slave.c", "kernel.o", "-lm",
    ]  # fmt: skip
    ended = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
    if ended.returncode:
        lines = ended.stderr.strip().splitlines() or ["it printed nothing"]
        log = next((line for line in lines if "error" in line), lines[0])
        raise UnusableInputError("fmu export", f"{found} fails: {log}, expected a C compiler that links the FMU")


def _token(machine: ExportedMachine, fmi: int, code: bytes) -> str:
    parts = (repr(machine.variables).encode(), machine.p.tobytes(), machine.s.tobytes(), machine.u.tobytes(), code)
    digest = hashlib.sha256(b"|".join((str(fmi).encode(), *parts))).hexdigest()
    return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"


def _header(machine: ExportedMachine, fmi: int, token: str, symbol: str) -> str:
    rows = [
        f"{{{reference}, {place.vector}, {place.index}, {_number(place.scale)}}}"
        for reference, variable in enumerate(machine.variables, 1)
        for place in variable.places
    ]
    rows += [f"{{0, {place.vector}, {place.index}, 1.0}}" for place in machine.forgotten]
    place, scale = machine.time
    sizes = {"P": len(machine.p), "S": len(machine.s), "U": len(machine.u), "W": machine.work, "OUT": machine.out}
    vectors = {"P0": machine.p, "S0": machine.s, "U0": machine.u}
    lines = [f"HB_FMI {fmi}", f'HB_TOKEN "{token}"', f"HB_KERNEL {symbol}"]
    lines += [f"HB_{name} {size}" for name, size in sizes.items()]
    lines += [f"HB_{name} {{{', '.join(_number(float(each)) for each in vector)}}}" for name, vector in vectors.items()]
    lines += [f"HB_ROWS {{{', '.join(rows)}}}", f"HB_TIME_PLACE {place}", f"HB_TIME_SCALE {_number(scale)}"]
    lines += [f"HB_SAMPLE_S {_number(machine.sample_s)}", f'HB_SAMPLE_TEXT "({machine.sample_s!r} s)"']
    return "".join(f"#define {line}\n" for line in lines)


def _number(value: float) -> str:
    """C literal of the same bits."""
    if isinf(value):
        return "HUGE_VAL" if value > 0.0 else "-HUGE_VAL"
    return float(value).hex()


def _unit_definitions(machine: ExportedMachine) -> list[str]:
    used = sorted({each.quantity.unit for each in machine.variables if each.quantity.unit != "1"} | {"s"})
    lines = ["  <UnitDefinitions>"]
    for unit in used:
        name, exponents = _UNITS[unit]
        base = " ".join(f'{key}="{exponent}"' for key, exponent in exponents.items())
        lines.append(f'    <Unit name="{name}"><BaseUnit {base}/></Unit>')
    return [*lines, "  </UnitDefinitions>"]


def _attributes(machine: ExportedMachine, variable: ExportedVariable) -> tuple[str, str]:
    """Attributes of a variable: causality and variability as in FMI 2 and 3, and its start."""
    if variable.causality == "output":
        return 'causality="output" variability="continuous"', ""
    start = f' start="{machine.start(variable)!r}"'
    if variable.causality == "input":
        return 'causality="input" variability="continuous"', start
    return 'causality="parameter" variability="tunable"', start


def _unit(quantity_unit: str) -> str:
    return "" if quantity_unit == "1" else f' unit="{_UNITS[quantity_unit][0]}"'


def _head(machine: ExportedMachine, fmi: str, token: str) -> str:
    attribute = "guid" if fmi == "2.0" else "instantiationToken"
    return (
        f'<fmiModelDescription fmiVersion="{fmi}" modelName="{machine.name}" {attribute}="{token}" '
        f"description={quoteattr(machine.description)} generationTool={quoteattr('hilbench ' + version('hilbench'))} "
        f'variableNamingConvention="flat"'
    )


def _step(machine: ExportedMachine) -> str:
    return f' stepSize="{machine.sample_s!r}"' if machine.sample_s else ""


def _described(head: str, state: str, machine: ExportedMachine, variables: list[str], structure: list[str]) -> str:
    """Model description; `state`: spelling of this FMI version for saving and restoring the state."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        head,
        f'  <CoSimulation modelIdentifier="{machine.name}" canHandleVariableCommunicationStepSize="true" '
        f'canGetAndSet{state}="true" canSerialize{state}="true"/>',
        *_unit_definitions(machine),
        '  <LogCategories><Category name="logStatusError"/></LogCategories>',
        f'  <DefaultExperiment startTime="0" stopTime="1"{_step(machine)}/>',
        "  <ModelVariables>",
        *variables,
        "  </ModelVariables>",
        "  <ModelStructure>",
        *structure,
        "  </ModelStructure>",
        "</fmiModelDescription>",
        "",
    ]
    return "\n".join(lines)


def _outputs(machine: ExportedMachine) -> list[int]:
    """Value references of the outputs."""
    return [at for at, each in enumerate(machine.variables, 1) if each.causality == "output"]


def _description_2(machine: ExportedMachine, token: str) -> str:
    variables, structure = [], []
    for reference, variable in enumerate(machine.variables, 1):
        kinds, start = _attributes(machine, variable)
        variables.append(
            f'    <ScalarVariable name="{variable.quantity.name}" valueReference="{reference}" {kinds} '
            f"description={quoteattr(variable.quantity.meaning)}><Real{_unit(variable.quantity.unit)}{start}/>"
            "</ScalarVariable>"
        )
    for name in ("Outputs", "InitialUnknowns"):
        unknown = [f'      <Unknown index="{at}"/>' for at in _outputs(machine)]
        structure += [f"    <{name}>", *unknown, f"    </{name}>"]
    head = f'{_head(machine, "2.0", token)} numberOfEventIndicators="0">'
    return _described(head, "FMUstate", machine, variables, structure)


def _description_3(machine: ExportedMachine, token: str) -> str:
    variables = [
        '    <Float64 name="time" valueReference="0" causality="independent" variability="continuous" unit="s"/>'
    ]
    for reference, variable in enumerate(machine.variables, 1):
        kinds, start = _attributes(machine, variable)
        variables.append(
            f'    <Float64 name="{variable.quantity.name}" valueReference="{reference}" {kinds}'
            f"{_unit(variable.quantity.unit)}{start} description={quoteattr(variable.quantity.meaning)}/>"
        )
    structure = [
        f'    <{name} valueReference="{at}"/>' for name in ("Output", "InitialUnknown") for at in _outputs(machine)
    ]
    return _described(f"{_head(machine, '3.0', token)}>", "FMUState", machine, variables, structure)
