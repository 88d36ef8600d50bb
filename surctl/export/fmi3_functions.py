"""Names and arguments of the FMI 3.0 functions that a unit must export although it does not support them."""

from __future__ import annotations

from typing import Any

__all__ = ["fmi3_values"]

_TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Boolean", "String")
"""Types of FMI 3.0 of which a unit has no variable, apart from binaries and clocks."""

_R = ("const fmi3ValueReference r[]", "size_t n")
_DERIVATIVE = (
    *("const fmi3ValueReference u[]", "size_t nu", "const fmi3ValueReference k[]", "size_t nk"),
    *("const fmi3Float64 s[]", "size_t ns", "fmi3Float64 d[]", "size_t nd"),
)
_NUMBERS = ("fmi3Float64 v[]", "size_t m")

_UNSUPPORTED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("fmi3EnterEventMode", ()),
    ("fmi3GetBinary", (*_R, "size_t s[]", "fmi3Binary v[]", "size_t m")),
    ("fmi3SetBinary", (*_R, "const size_t s[]", "const fmi3Binary v[]", "size_t m")),
    ("fmi3GetClock", (*_R, "fmi3Clock v[]")),
    ("fmi3SetClock", (*_R, "const fmi3Clock v[]")),
    ("fmi3GetNumberOfVariableDependencies", ("fmi3ValueReference r", "size_t *n")),
    (
        "fmi3GetVariableDependencies",
        (
            *("fmi3ValueReference r", "size_t d[]", "fmi3ValueReference u[]", "size_t i[]"),
            *("fmi3DependencyKind k[]", "size_t n"),
        ),
    ),
    ("fmi3GetDirectionalDerivative", _DERIVATIVE),
    ("fmi3GetAdjointDerivative", _DERIVATIVE),
    ("fmi3EnterConfigurationMode", ()),
    ("fmi3ExitConfigurationMode", ()),
    ("fmi3GetIntervalDecimal", (*_R, "fmi3Float64 v[]", "fmi3IntervalQualifier q[]")),
    ("fmi3GetIntervalFraction", (*_R, "fmi3UInt64 v[]", "fmi3UInt64 d[]", "fmi3IntervalQualifier q[]")),
    ("fmi3GetShiftDecimal", (*_R, "fmi3Float64 v[]")),
    ("fmi3GetShiftFraction", (*_R, "fmi3UInt64 v[]", "fmi3UInt64 d[]")),
    ("fmi3SetIntervalDecimal", (*_R, "const fmi3Float64 v[]")),
    ("fmi3SetIntervalFraction", (*_R, "const fmi3UInt64 v[]", "const fmi3UInt64 d[]")),
    ("fmi3SetShiftDecimal", (*_R, "const fmi3Float64 v[]")),
    ("fmi3SetShiftFraction", (*_R, "const fmi3UInt64 v[]", "const fmi3UInt64 d[]")),
    ("fmi3EvaluateDiscreteStates", ()),
    (
        "fmi3UpdateDiscreteStates",
        (
            *("fmi3Boolean *u", "fmi3Boolean *t", "fmi3Boolean *n", "fmi3Boolean *v", "fmi3Boolean *d"),
            "fmi3Float64 *e",
        ),
    ),
    ("fmi3EnterContinuousTimeMode", ()),
    ("fmi3CompletedIntegratorStep", ("fmi3Boolean b", "fmi3Boolean *e", "fmi3Boolean *t")),
    ("fmi3SetTime", ("fmi3Float64 t",)),
    ("fmi3SetContinuousStates", ("const fmi3Float64 v[]", "size_t m")),
    ("fmi3GetContinuousStateDerivatives", _NUMBERS),
    ("fmi3GetEventIndicators", _NUMBERS),
    ("fmi3GetContinuousStates", _NUMBERS),
    ("fmi3GetNominalsOfContinuousStates", _NUMBERS),
    ("fmi3GetNumberOfEventIndicators", ("size_t *n",)),
    ("fmi3GetNumberOfContinuousStates", ("size_t *n",)),
    ("fmi3EnterStepMode", ()),
    ("fmi3GetOutputDerivatives", (*_R, "const fmi3Int32 o[]", *_NUMBERS)),
    ("fmi3ActivateModelPartition", ("fmi3ValueReference r", "fmi3Float64 t")),
)
"""(name, arguments after the instance) of each function that returns an error."""

_SUPPORTED = (
    *("GetVersion", "SetDebugLogging", "InstantiateCoSimulation", "FreeInstance", "EnterInitializationMode"),
    *("ExitInitializationMode", "Terminate", "Reset", "GetFloat64", "SetFloat64", "GetInt32", "SetInt32", "DoStep"),
    *("GetFMUState", "SetFMUState", "FreeFMUState", "SerializedFMUStateSize", "SerializeFMUState"),
    *("DeserializeFMUState", "InstantiateModelExchange", "InstantiateScheduledExecution"),
)


def fmi3_values() -> dict[str, Any]:
    """Return the values of the template of FMI 3.0: names of all functions, and arguments of the unsupported ones."""
    names = [f"fmi3{name}" for name in (*_SUPPORTED, *(f"{do}{type_}" for type_ in _TYPES for do in ("Get", "Set")))]
    return {
        "fmi3_functions": sorted([*names, *(name for name, _ in _UNSUPPORTED)]),
        "fmi3_types": list(_TYPES),
        "fmi3_unsupported": _UNSUPPORTED,
    }
