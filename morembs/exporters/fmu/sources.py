"""C text of a body: a header that a program includes, and the source, from the files in ``c`` and generated tables."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

import numpy as np

from morembs.base.errors import InputError
from morembs.base.types import Floats
from morembs.exporters.fmu.system import System, Variable, identifier
from morembs.exporters.tolerances import TOL

Precision = Literal["double", "single"]
# Files of each structure, in their order: what both targets have, then steps of any size or of one size.
_COMMON = {
    "linear": ("common", "stresses", "linear_accelerations", "linear"),
    "floating": ("common", "stresses", "dense", "floating", "gauss"),
    "member": ("common", "dense", "member", "gauss"),
}
_FREE = {
    "linear": ("linear_rates", "linear_free"),
    "floating": ("floating_rates", "gauss_free"),
    "member": ("member_rates", "gauss_free"),
}
_FIXED = {"linear": ("linear_fixed",), "floating": ("gauss_fixed",), "member": ("gauss_fixed",)}
# Parts of the files in ``c`` that are of this body, or are not: resolved here, so that others stay as they are.
_SECTION = re.compile(r"#if (LINEAR_INPUTS|COMPLIANCE)\n(.*?)(?:#else\n(.*?))?#endif\n", re.DOTALL)
_SINGLE = "".join(f"#define {name} {name}f\n" for name in ("sqrt", "sin", "cos", "fabs"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Code:
    """A body as C: functions and types begin with ``name``; ``fixed`` holds tables of steps of one size, if any.

    Inputs are held over a step, or go in a line where there are ``linear_inputs``.
    """

    name: str
    system: System
    precision: Precision = "double"
    fixed: Mapping[str, Floats | float] | None = None
    stages: int = 2
    linear_inputs: bool = False

    @property
    def sizes(self) -> dict[str, int]:
        """How many of each there are."""
        system = self.system
        return {
            "PARAMETERS": len(system.parameters),
            "INPUTS": len(system.inputs),
            "STATES": len(system.states),
            "OUTPUTS": len(system.outputs),
        }

    def header(self) -> str:
        """What a program includes: sizes, places of all variables by name, the type and the functions."""
        system, upper = self.system, self.name.upper()
        kinds = {"P": system.parameters, "U": system.inputs, "X": system.states, "Y": system.outputs}
        sizes = ", ".join(f"{upper}_{key} = {size}" for key, size in self.sizes.items())
        places = "\n".join(_places(f"{upper}_{kind}", variables) for kind, variables in kinds.items() if variables)
        fields = "".join(f"    {kind} {key}[{size}];\n" for key, (kind, size) in self.fields().items())
        real_time = () if system.real_time is None else system.real_time.notes
        comments = "".join(f"/* {note}. */\n" for note in real_time)
        return comments + _HEADER.format(
            name=self.name,
            upper=upper,
            real="double" if self.precision == "double" else "float",
            sizes=sizes,
            places=places,
            fields=fields,
            functions="".join(f"{head};\n" for head in self._functions()),
        )

    def source(self) -> str:
        """The equations with their tables."""
        system, free = self.system, self.fixed is None
        constants = {**self.sizes, **system.constants, "STAGES": self.stages}
        tables = {
            **system.tables,
            "START_P": _starts(system.parameters),
            "START_U": _starts(system.inputs),
            "START_X": _starts(system.states),
        }
        for key, value in (self.fixed or {}).items():
            (constants if isinstance(value, float) else tables).update({key: value})  # type: ignore[dict-item]
        names = [*_COMMON[system.structure], *(_FREE if free else _FIXED)[system.structure]]
        if self.linear_inputs:
            names.insert(1, "linear_inputs")
        if system.structure == "linear" and not free and not system.constants["REACTIONS"]:
            names.remove("linear_accelerations")
            for key in ("OMEGA", "MINUS_D", "B"):
                del tables[key]
        if not system.constants.get("REACTIONS", 1):
            tables.pop("YA", None)
        parts = [f'#include <math.h>\n#include <string.h>\n#include "{self.name}.h"\n']
        parts += [_SINGLE] if self.precision == "single" else []
        parts.append(f"typedef {self.name}_real real;\ntypedef {self.name}_body Body;\n")
        parts += [f"#define {key} {self._constant(value)}\n" for key, value in constants.items()]
        parts += [self._table(key, np.asarray(value)) for key, value in tables.items()]
        parts += [self.resolve(_file(f"{name}.c")) for name in names]
        parts += [f"{head}\n{{\n{text}\n}}\n" for head, text in self._functions().items()]
        return "\n".join(parts)

    def fields(self) -> dict[str, tuple[str, int]]:
        """Type and length of the arrays of a body: its variables, then what the functions work with."""
        system, S, free = self.system, self.stages, self.fixed is None
        n, states = int(system.constants["MODES"]), len(system.states)
        rigid, places, inputs = 6 * (system.structure == "floating"), 1 + free, len(system.inputs)
        width, size = states * (states + (1 + self.linear_inputs) * inputs), rigid + n
        real = {"p": len(system.parameters), "u": inputs, "x": states, "y": len(system.outputs)}
        real |= {"u_start": inputs, "u_change": inputs, "part": 2} if self.linear_inputs else {}
        whole: dict[str, int] = {}
        if system.structure == "linear":
            real |= {"change": states}
            real |= {"A": width, "F": width, "work": width, "h": 1, "h_damping": 1} if free else {}
        else:
            real |= system.buffers | {
                "column": size,
                "residual": size,
                "stage": max(size, S) * size,
                "matrix": places * (S * size) ** 2,
                "h": places,
                "convergence": places,
                "a": S * size,
                "q": S * n,
                "rate": S * n,
            }
            real |= {"w": 3 * S, "turns": 4 * S} if rigid else {}
            real |= {"whole": states, "halves": states} if free else {}
            whole = {"pivot": places * S * size} | ({"level": 1} if free else {})
        typed = {key: (f"{self.name}_real", max(1, count)) for key, count in real.items()}
        return typed | {key: ("int", count) for key, count in whole.items()}

    def _functions(self) -> dict[str, str]:
        """Head of each function -> its statements."""
        name, free = self.name, self.fixed is None
        starts = "".join(
            f"    for (int i = 0; i < {key}; i++)\n        body->{short}[i] = START_{short.upper()}[i];\n"
            for short, key in (("p", "PARAMETERS"), ("u", "INPUTS"), ("x", "STATES"))
        )
        body, real = f"{name}_body *body", f"{name}_real"
        start = {f"void {name}_start({body})": f"    memset(body, 0, sizeof *body);\n{starts}    observe(body);"}
        begin, end = (
            ("    begin_inputs(body);\n", "    end_inputs(body, failed);\n") if self.linear_inputs else ("", "")
        )
        if not free:
            failed = "unsound(body) || advance(body) || unsound(body)"
            step = f"{begin}    int failed = {failed};\n{end}    observe(body);\n    return failed;"
            linear = {f"int {name}_step_linear({body}, const {real} *u_end)": _STEP_LINEAR.format(name=name)}
            return start | {f"int {name}_step({body})": step} | (linear if self.linear_inputs else {})
        advance = "    return unsound(body) || advance(body, time, h) || unsound(body);"
        if self.linear_inputs:
            advance = f"{begin}{advance.replace('return', 'int failed =')}\n{end}    return failed;"
        return start | {
            f"int {name}_rates({body}, {real} *x_rate)": "    return unsound(body) || rates(body, x_rate);",
            f"void {name}_observe({body})": "    observe(body);",
            f"int {name}_advance({body}, {real} time, {real} h)": advance,
        }

    def resolve(self, text: str) -> str:
        """``text`` of a C file without the parts that are not of this body."""
        there = {"LINEAR_INPUTS": self.linear_inputs, "COMPLIANCE": "COMPLIANCE" in self.system.tables}
        return _SECTION.sub(lambda found: found[2 if there[found[1]] else 3] or "", text)

    def _constant(self, value: float) -> str:
        return str(value) if isinstance(value, int) else f"((real){self._numbers(np.array([value]))[0]})"

    def _table(self, name: str, table: Floats) -> str:
        """A table by columns."""
        numbers = self._numbers(table.ravel(order="F")) or ["0"]
        count = TOL.table_numbers_per_line
        lines = (", ".join(numbers[k : k + count]) for k in range(0, len(numbers), count))
        return f"static const real {name}[{len(numbers)}] = {{\n" + ",\n".join(lines) + "};\n"

    def _numbers(self, values: Floats) -> list[str]:
        if self.precision == "double":
            return [repr(x) for x in values.tolist()]
        with np.errstate(over="ignore"):
            short = values.astype(np.float32)
        if not np.isfinite(short).all():
            raise InputError(
                f'precision = "single" was given, and the body has the number {np.abs(values).max():.3g}, which single '
                'precision cannot hold; take precision = "double"',
                kind="unsupported",
                keyword="precision",
            )
        return [repr(float(str(x))) for x in short]


def _starts(variables: Sequence[Variable]) -> Floats:
    return np.array([variable.start or 0.0 for variable in variables])


def _places(prefix: str, variables: Iterable[Variable]) -> str:
    lines = (
        f"    {prefix}_{identifier(v.name).strip('_').upper()} = {k}, /* {v.unit}: {v.about} */\n"
        for k, v in enumerate(variables)
    )
    return "enum {\n" + "".join(lines) + "};"


def _file(name: str) -> str:
    return (files("morembs.exporters.fmu") / "c" / name).read_text(encoding="utf-8")


def glue(code: Code, version: str) -> dict[str, str]:
    """Sources of the interface in this version, by their names; with them the token of the body."""
    own = {f"{code.name}.h": code.header(), f"{code.name}.c": code.source()}
    names = (f"fmi{version[0]}.c", "instance.h")
    shared = {name: code.resolve(_file(name)) for name in names}
    counts = code.sizes
    if code.linear_inputs:
        # Version 2 has a function for rates of inputs, in version 3 they are inputs.
        counts = counts | {"INPUT_RATES": len(code.system.inputs) if version == "3.0" else 0}
    sizes = "".join(f"#define {key} {size}\n" for key, size in counts.items())
    nominal = code._table("NOMINAL", np.array([variable.nominal for variable in code.system.states]))
    model = (
        f'#include "{code.name}.h"\ntypedef {code.name}_body Body;\n{sizes}'
        + "".join(f"#define body_{entry} {code.name}_{entry}\n" for entry in ("start", "rates", "observe", "advance"))
        + nominal.replace("const real", "const double")
    )
    text = "".join((*own.values(), *shared.values(), model))
    token = hashlib.sha256(text.encode()).hexdigest()[:32]
    token = "-".join(token[a:b] for a, b in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32)))
    return {**own, **shared, "model.h": f'{model}#define TOKEN "{{{token}}}"\n'}


def token_of(sources: Mapping[str, str]) -> str:
    """The token in the sources of ``glue``."""
    return sources["model.h"].rpartition('#define TOKEN "')[2].partition('"')[0]


_STEP_LINEAR = """\
    for (int i = 0; i < INPUTS; i++)
        body->u_change[i] = u_end[i] - body->u[i];
    int failed = {name}_step(body);
    for (int i = 0; i < INPUTS; i++)
        body->u_change[i] = 0;
    for (int i = 0; i < INPUTS && !failed; i++)
        body->u[i] = u_end[i];
    return failed;"""


_HEADER = """\
/* An elastic body, written by morembs; SI units. Allocates nothing. Functions that return int give 1 where a parameter
   is below zero, a parameter, an input or a state is no finite number, or the step does not succeed; else 0. */

#ifndef {upper}_H
#define {upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

typedef {real} {name}_real;

enum {{ {sizes} }};

/* Places of parameters in p, inputs in u, states in x and outputs in y. */
{places}

typedef struct {{
{fields}}} {name}_body;

{functions}
#ifdef __cplusplus
}}
#endif
#endif
"""
