"""Generation of block.c: C99 code of the symbolic functions, and tables for the runtime.

The C code is straight-line code in static single assignment form. It has one operation per line, in
the order of the CasADi function. With -ffp-contract=off, the compiler must not combine a product
and a sum into one operation. Therefore every platform computes the same bits, except for some
functions of the C library (see `operations`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache

import casadi as ca

from freeflyer_fmus.blocks.block import Block, Requirement
from freeflyer_fmus.errors import BlockError
from freeflyer_fmus.export.layout import Layout, layout

ARGUMENTS = ("t", "p", "u", "x")
SENSITIVITY = (*ARGUMENTS, "seed")


@lru_cache(maxsize=1)
def operations() -> dict[int, str]:
    """Return the C expression of each CasADi operation, with the operands {0} and {1}.

    sin and cos are not in the table, because `print_function` computes them together.
    """
    infix = {"ADD": "+", "SUB": "-", "MUL": "*", "DIV": "/"}
    compared = {"LT": "<", "LE": "<=", "EQ": "==", "NE": "!="}
    called = {"FABS": "fabs", "SQRT": "sqrt", "FLOOR": "floor", "CEIL": "ceil"}
    # These functions are in the C library of the platform. Their results on two platforms agree to
    # about 1e-12, but not to the last bit.
    library = {
        "EXP": "exp",
        "LOG": "log",
        "TAN": "tan",
        "ASIN": "asin",
        "ACOS": "acos",
        "ATAN": "atan",
        "SINH": "sinh",
    }
    library |= {"COSH": "cosh", "TANH": "tanh"}
    # Patterns by name of the operation.
    table = {f"OP_{name}": f"{{0}} {sign} {{1}}" for name, sign in infix.items()}
    table |= {f"OP_{name}": f"(double)({{0}} {sign} {{1}})" for name, sign in compared.items()}
    table |= {f"OP_{name}": f"{function}({{0}})" for name, function in (called | library).items()}
    table |= {
        f"OP_{name}": f"{function}({{0}}, {{1}})"
        for name, function in {
            "POW": "pow",
            "CONSTPOW": "pow",
            "ATAN2": "atan2",
            "FMOD": "fmod",
        }.items()
    }
    table |= {
        "OP_ASSIGN": "{0}",
        "OP_NEG": "-{0}",
        "OP_SQ": "{0} * {0}",
        "OP_TWICE": "2.0 * {0}",
        "OP_INV": "1.0 / {0}",
        "OP_NOT": "(double)({0} == 0.0)",
        "OP_AND": "(double)({0} != 0.0 && {1} != 0.0)",
        "OP_OR": "(double)({0} != 0.0 || {1} != 0.0)",
        "OP_SIGN": "(double)(({0} > 0.0) - ({0} < 0.0))",
        "OP_FMIN": "({0} < {1} ? {0} : {1})",
        "OP_FMAX": "({0} > {1} ? {0} : {1})",
        "OP_IF_ELSE_ZERO": "({0} != 0.0 ? {1} : 0.0)",
    }
    return {getattr(ca, name): pattern for name, pattern in table.items()}


def number(value: float) -> str:
    """Return a C literal that is exactly equal to `value`.

    Raises BlockError if there is no such literal.
    """
    if value != value or value in (float("inf"), float("-inf")):
        raise BlockError(
            f"the equations contain the constant {value}; a finite constant is expected"
        )
    text = repr(float(value))
    return text if len(text) <= 6 else float(value).hex()


def print_function(
    function: ca.Function, name: str, arguments: Sequence[str], results: Sequence[str]
) -> str:
    """Return a static C function with the signature of `Equations` or `Sensitivity` in block.h.

    `arguments` and `results` are the names of the C parameters. Raises BlockError if an operation
    has no C expression.
    """
    table = operations()
    held: dict[int, str] = {}  # C expression of each element of CasADi's work vector
    pairs: dict[str, tuple[str, str]] = {}
    lines: list[str] = []
    count = 0

    def fresh() -> str:
        nonlocal count
        count += 1
        return f"a{count}"

    # One statement per operation. sin and cos of the same angle share one call of sin_cos.
    for k in range(function.n_instructions()):
        operation, inputs, outputs = (
            function.instruction_id(k),
            function.instruction_input(k),
            function.instruction_output(k),
        )
        if operation == ca.OP_CONST:
            held[outputs[0]] = number(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            held[outputs[0]] = f"{arguments[inputs[0]]}[{inputs[1]}]"
        elif operation == ca.OP_OUTPUT:
            lines.append(f"{results[outputs[0]]}[{outputs[1]}] = {held[inputs[0]]};")
        elif operation in (ca.OP_SIN, ca.OP_COS):
            angle = held[inputs[0]]
            if angle not in pairs:
                pairs[angle] = (fresh(), fresh())
                lines.append("double {}, {};".format(*pairs[angle]))
                lines.append("sin_cos({2}, &{0}, &{1});".format(*pairs[angle], angle))
            held[outputs[0]] = pairs[angle][operation == ca.OP_COS]
        elif operation in table:
            operands = [
                f"({text})" if text.startswith("-") else text for text in (held[i] for i in inputs)
            ]
            variable = fresh()
            lines.append(f"const double {variable} = {table[operation].format(*operands)};")
            held[outputs[0]] = variable
        else:
            raise BlockError(
                f"{name}: the equations use CasADi operation number {operation}, which code generation does not support; use another function"
            )
    # Write the signature. Cast unused arguments to void.
    used = "\n".join(lines)
    unused = [name for name in (*arguments, *results) if not re.search(rf"\b{name}\[", used)]
    given = [f"const double *{argument}" for argument in arguments] + [
        f"double *{result}" for result in results
    ]
    head = f"static void {name}({', '.join(given)})"
    body = [f"(void){argument};" for argument in unused] + lines
    return head + "\n{\n" + "".join(f"    {line}\n" for line in body) + "}\n"


def c_text(text: str) -> str:
    escaped = text.encode("ascii", "replace").decode().replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def print_requirements(name: str, requirements: Sequence[Requirement]) -> str:
    rows = [
        f"    {{{c_text(r.subject)}, {c_text(r.remedy)}, {int(r.strict)}, {int(r.connection)}}},"
        for r in requirements
    ]
    return (
        f"static const Requirement {name}[] = {{\n"
        + "\n".join(rows or ['    {"", "", 0, 0},'])
        + "\n};\n"
    )


def print_values(plan: Layout) -> str:
    rows = [
        f"    {{{c_text(value.element)}, {value.kind.upper()}, {value.access.upper()}, {value.maximum}, {value.extent}}},"
        for value in plan.values
    ]
    return "static const Value values[] = {\n" + "\n".join(rows) + "\n};\n"


def print_numbers(name: str, numbers: Iterable[float]) -> str:
    return (
        f"static const double {name}[] = {{\n"
        + "".join(f"    {number(value)},\n" for value in numbers)
        + "};\n"
    )


def print_block(block: Block, token: str) -> str:
    """Return the complete text of block.c."""
    plan = layout(block)
    functions = block.functions
    equations = (
        functions if block.is_sampled else functions | {"linked_outputs": block.linked_outputs}
    )
    # Functions and tables that the table `block` refers to.
    parts = [
        f"/* Generated from the block {block.name}; do not edit. */\n",
        '#include "block.h"\n#include "sincos.h"\n',
        *(
            print_function(function, key, ARGUMENTS, ("r0", "r1", "r2"))
            for key, function in equations.items()
        ),
        *(
            print_function(function, key, SENSITIVITY, ("result",))
            for key, function in block.sensitivities.items()
        ),
        print_values(plan),
        print_numbers("start", plan.start),
        print_numbers("nominal", plan.nominal or (1.0,)),
        print_requirements("static_requirement", block.static_requirements),
        print_requirements("running_requirement", block.running_requirements),
    ]
    # The table `block`. Its fields are declared in block.h.
    period = plan.reference[block.period] if block.period else -1
    step_parameter = plan.reference[block.step_parameter] if block.step_parameter else -1
    ranges = "\n".join(
        f"    .{name} = {{{first}, {count}}}," for name, (first, count) in plan.ranges.items()
    )
    field = {
        "derivatives": "rates",
        "outputs": "outputs_",
        "forward_derivatives": "forward_rates",
        "reverse_derivatives": "reverse_rates",
    }
    pointers = "\n".join(
        f"    .{field.get(name, name)} = {name}," for name in (*equations, *block.sensitivities)
    )
    parts.append(
        f"""const Block block = {{
    .name = {c_text(block.name)},
    .token = {c_text(token)},
    .values = {len(plan.values)},
{ranges}
    .value = values,
    .start = start,
    .period = {period},
    .step = {number(block.default_step)},
    .step_parameter = {step_parameter},
    .linked = {block.linked},
    .nominal = nominal,
{pointers}
    .static_requirements = {len(block.static_requirements)},
    .running_requirements = {len(block.running_requirements)},
    .static_requirement = static_requirement,
    .running_requirement = running_requirement,
}};
"""
    )
    return "\n".join(parts)
