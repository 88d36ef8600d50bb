"""The claim grammar: conversion between text, expression trees with exact numbers, and CasADi expressions."""

from surctl.verification.formula.node import (
    BRANCHING,
    Node,
    Statement,
    derivative,
    exact_values,
    number,
    ordered,
    power,
    rebuilt,
    substitute,
    to_casadi,
    values_of,
    variable,
)
from surctl.verification.formula.parser import (
    FUNCTIONS,
    IDENTIFIER,
    from_casadi,
    is_name,
    parse,
    parse_relation,
    reread,
    text_of,
)

__all__ = [
    "BRANCHING", "FUNCTIONS", "IDENTIFIER", "Node", "Statement", "derivative", "exact_values", "from_casadi", "is_name",
    "number", "ordered", "parse", "parse_relation", "power", "rebuilt", "reread", "substitute", "text_of", "to_casadi",
    "values_of", "variable",
]  # fmt: skip
