"""The same controller as C from several generators, within one bundle, so that one test program runs all versions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.export import Bundle, Exportable, Records
from surctl.ir import Real
from surctl.marine.control import Law, build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario, simulate
from surctl.marine.vehicle import Vehicle, load_vehicle

SCENARIO = "pool-ahead"


@dataclass(frozen=True)
class Contender:
    """The C of one generator.

    Attributes:
        name: as the table has it.
        law: what is computed.
        bundle: its files.
        guarded: whether bad inputs are refused in it.
    """

    name: str
    law: Exportable
    bundle: Bundle
    guarded: bool


def controller() -> tuple[Law, Vehicle, NDArray[np.float64], Records]:
    """The law, its vehicle and scenario, its parameters, and a run."""
    mission, law, gains = load_scenario(SCENARIO), build_law("closed_form"), load_gains("default")
    vehicle = load_vehicle(mission.vehicle)
    record = simulate(mission, vehicle, gains=gains, law=law, sensing="truth", seed=0).record
    flight = Records(record.law_state, record.law_input, np.zeros((len(record.law_state), 0)))
    return law, vehicle, law_numbers(mission, gains, vehicle), flight


def ours(law: Law, vehicle: Vehicle, numbers: NDArray[np.float64], real: Real) -> Contender:
    """Return the C of `surctl export --constant-gains`."""
    shipped = closed_form(law, real=real, constants=numbers)
    within = operating_envelope(law, load_scenario(SCENARIO), vehicle, shipped.gains)
    bundle = build_bundle(shipped, {}, real=real, envelope=within)
    return Contender(f"surctl, {real}", shipped, bundle, True)


def casadi_c(law: Law, base: Contender, numbers: NDArray[np.float64], *, shim: bool = False) -> Contender:
    """Return CasADi's C for the same expressions and constants; with `shim`, sin is replaced by sinf, and so on."""
    real = base.bundle.real
    x, u = ca.SX.sym("x", law.state.size), ca.SX.sym("u", law.inputs.size)
    function = ca.Function("generated", [x, u], law.function.call([x, u, ca.DM(numbers)]), {"cse": True})
    kind = "double" if real == "float64" else "float"
    generator = ca.CodeGenerator("generated", {"casadi_real": kind, "casadi_int": "int"})
    generator.add(function)
    words = ("sin", "cos", "sqrt", "fabs", "floor", "fmin", "fmax", "atan2")
    macros = "".join(f"#define {word} {word}f\n" for word in words) if shim else ""
    text = f"#include <math.h>\n{macros}{generator.dump()}\n{_frame(base.bundle.name, kind, function)}"
    kept = {file: code for file, code in base.bundle.files.items() if file not in base.bundle.sources}
    alone = {f"{base.bundle.name}.c": text, base.bundle.selftest: _selftest(base.bundle.name)}
    files = MappingProxyType({**kept, **alone})
    told = f"CasADi, {real}" + (" with sinf and the like" if shim else "")
    return Contender(told, base.law, replace(base.bundle, files=files, envelope=None), False)


def _frame(name: str, kind: str, function: ca.Function) -> str:
    """Return the bundle's functions around the generated one; the structs have their fields in the order of the
    vectors.
    """
    return f"""
#include "{name}.h"
#include <stddef.h>
int {name}_initialize({name}_state_t *s, {name}_gains_t *g) {{ (void)g; s->x[0] = 0; return 0; }}
void {name}_terminate({name}_state_t *s) {{ (void)s; }}
const char *{name}_id(void) {{ return ""; }}
int {name}_step({name}_state_t *s, const {name}_gains_t *g, const {name}_input_t *in, {name}_output_t *out)
{{
    const {kind} *arg[{function.sz_arg()}] = {{ s->x, in->eta }};
    {kind} status, w[{function.sz_w() + 1}];
    {kind} *res[{function.sz_res()}] = {{ out->tau, s->next, &status, out->nu_reference }};
    int iw[{function.sz_iw() + 1}];
    (void)g;
    if (generated(arg, res, iw, w, 0) != 0) {{ return -2; }}
    for (int k = 0; k < {function.size1_in(0)}; ++k) {{ s->x[k] = s->next[k]; }}
    return (int)status;
}}
"""


def _selftest(name: str) -> str:
    return f'#include "{name}.h"\nint {name}_selftest({name}_state_t *s) {{ (void)s; return 0; }}\n'
