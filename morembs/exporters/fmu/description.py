"""modelDescription.xml of both versions of the Functional Mock-up Interface, from one table of variables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import quoteattr

from morembs.exporters.fmu.sources import Code
from morembs.exporters.fmu.system import System, Variable
from morembs.exporters.tolerances import TOL
from morembs.version import VERSION

Version = Literal["2.0", "3.0"]
# Exponents of the base units of each unit.
UNITS: dict[str, dict[str, int]] = {
    "1": {},
    "m": {"m": 1},
    "rad": {"rad": 1},
    "m/s": {"m": 1, "s": -1},
    "rad/s": {"rad": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s2": {"rad": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N.m": {"kg": 1, "m": 2, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "s": {"s": 1},
}
# Units -> those of their rates; and those of them that are new.
_RATES = {
    "1": "1/s",
    "m": "m/s",
    "rad": "rad/s",
    "m/s": "m/s2",
    "rad/s": "rad/s2",
    "m/s2": "m/s3",
    "rad/s2": "rad/s3",
    "N": "N/s",
    "N.m": "N.m/s",
}
RATE_UNITS = {
    rate: UNITS[unit] | {"s": UNITS[unit].get("s", 0) - 1} for unit, rate in _RATES.items() if rate not in UNITS
}
_XML = '<?xml version="1.0" encoding="UTF-8"?>'


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """A variable of the description: ``rate_of`` is the reference of the state or the input whose rate this is."""

    variable: Variable
    causality: str
    variability: str = "continuous"
    initial: str = ""
    rate_of: int | None = None


def model_description(code: Code, name: str, token: str, version: Version) -> bytes:
    """The description of an FMU for model exchange and co-simulation; value references count as the C code does."""
    return "\n".join((_XML, *_lines(code, name, token, version), "")).encode()


def _entries(system: System, *, input_rates: bool) -> list[_Entry]:
    """All variables in the order of their value references, which are their places."""
    own = 1 + len(system.parameters)
    first = own + (1 + input_rates) * len(system.inputs)
    time = _Entry(variable=Variable(name="time", unit="s", about="time"), causality="independent")
    parameters = [
        _Entry(variable=v, causality="parameter", variability="tunable", initial="exact") for v in system.parameters
    ]
    states = [_Entry(variable=v, causality="local", initial="exact") for v in system.states]
    rates = [
        _Entry(variable=Variable(name=f"der({v.name})", unit="1"), causality="local", rate_of=first + k)
        for k, v in enumerate(system.states)
    ]
    inputs = [_Entry(variable=v, causality="input") for v in system.inputs]
    if input_rates:
        inputs += [_Entry(variable=_rate(v), causality="input", rate_of=own + k) for k, v in enumerate(system.inputs)]
    outputs = [_Entry(variable=v, causality="output") for v in system.outputs]
    return [time, *parameters, *inputs, *states, *rates, *outputs]


def _rate(variable: Variable) -> Variable:
    about = "over the next steps of co-simulation"
    return Variable(name=f"der({variable.name})", unit=_RATES[variable.unit], about=about, start=0.0)


def _lines(code: Code, name: str, token: str, version: Version) -> Iterator[str]:
    second = version == "2.0"
    system, identifier, input_rates = code.system, code.name, code.linear_inputs and not second
    entries = _entries(system, input_rates=input_rates)
    found = system.real_time
    about = "; ".join((f"Elastic body, {system.structure}", *(() if found is None else found.notes)))
    kind, indicators = ("guid", ' numberOfEventIndicators="0"') if second else ("instantiationToken", "")
    yield (
        f'<fmiModelDescription fmiVersion="{version}" modelName={quoteattr(name)} {kind}="{token}" '
        f'description={quoteattr(about)} generationTool="morembs {VERSION}" '
        f'variableNamingConvention="structured"{indicators}>'
    )
    states = (
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
        if second
        else 'canGetAndSetFMUState="true" canSerializeFMUState="true"'
    )
    memory = ' canNotUseMemoryManagementFunctions="true"' if second else ""
    steps = ' canHandleVariableCommunicationStepSize="true"'
    steps += ' canInterpolateInputs="true"' if second and code.linear_inputs else ""
    for element, more in (("ModelExchange", ""), ("CoSimulation", steps)):
        head = f'<{element} modelIdentifier="{identifier}" {states}{memory}{more}'
        if second:
            files = f'<File name="{identifier}.c"/><File name="fmi2.c"/>'
            yield f"{head}><SourceFiles>{files}</SourceFiles></{element}>"
        else:
            yield f"{head}/>"
    yield "<UnitDefinitions>"
    for unit, base in (UNITS | RATE_UNITS if input_rates else UNITS).items():
        powers = "".join(f' {key}="{power}"' for key, power in base.items())
        yield f'<Unit name="{unit}"><BaseUnit{powers}/></Unit>'
    yield "</UnitDefinitions>"
    yield f'<DefaultExperiment startTime="0" stopTime="1" stepSize="{found.step if found else TOL.proposed_step_s}"/>'
    yield "<ModelVariables>"
    for reference, entry in enumerate(entries):
        yield _variable(reference, entry, second=second)
    yield "</ModelVariables>"
    yield "<ModelStructure>"
    yield from _structure(entries, second=second)
    yield "</ModelStructure>"
    yield "</fmiModelDescription>"


def _variable(reference: int, entry: _Entry, *, second: bool) -> str:
    variable = entry.variable
    about = f" description={quoteattr(variable.about)}" if variable.about else ""
    initial = f' initial="{entry.initial}"' if entry.initial else ""
    general = (
        f'name={quoteattr(variable.name)} valueReference="{reference}"{about} causality="{entry.causality}" '
        f'variability="{entry.variability}"{initial}'
    )
    real = "" if variable.unit == "1" else f'unit="{variable.unit}"'
    if variable.start is not None:
        real += f' start="{variable.start!r}"'
    if variable.nominal != 1.0:
        real += f' nominal="{variable.nominal!r}"'
    if entry.causality == "parameter":
        real += ' min="0"'
    if entry.rate_of is not None:
        # Version 2 counts variables from one.
        real += f' derivative="{entry.rate_of + second}"'
    return f"<ScalarVariable {general}><Real {real}/></ScalarVariable>" if second else f"<Float64 {general} {real}/>"


def _structure(entries: list[_Entry], *, second: bool) -> Iterator[str]:
    """Outputs, rates, and variables calculated at the start, each with its dependencies, as some importers need."""
    # Version 2 counts variables from one.
    of = {
        kind: [k + second for k, entry in enumerate(entries) if entry.causality == kind and entry.rate_of is None]
        for kind in ("input", "local", "parameter", "output")
    }
    rates = [k + second for k, entry in enumerate(entries) if entry.rate_of is not None and entry.causality == "local"]
    slow, fast = of["local"], of["input"] + of["local"]
    outputs = [(k, fast if entries[k - second].variable.direct else slow) for k in of["output"]]
    groups = {
        ("Outputs", "Output"): outputs,
        ("Derivatives", "ContinuousStateDerivative"): [(k, fast) for k in rates],
        ("InitialUnknowns", "InitialUnknown"): [(k, of["parameter"] + fast) for k in of["output"] + rates],
    }
    for (group, element), unknowns in groups.items():
        head = "Unknown index" if second else f"{element} valueReference"
        lines = [f'<{head}="{k}" dependencies="{" ".join(map(str, known))}"/>' for k, known in unknowns]
        yield from [f"<{group}>", *lines, f"</{group}>"] if second and lines else lines


def build_description(identifier: str) -> bytes:
    """sources/buildDescription.xml of version 3."""
    return (
        f'{_XML}\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'<BuildConfiguration modelIdentifier="{identifier}">\n<SourceFileSet language="C99">\n'
        f'<SourceFile name="{identifier}.c"/>\n<SourceFile name="fmi3.c"/>\n</SourceFileSet>\n'
        "</BuildConfiguration>\n</fmiBuildDescription>\n"
    ).encode()
