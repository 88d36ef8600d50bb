"""The claim grammar: conversion between text, expression trees with exact numbers, and CasADi expressions."""

from surctl.verification.formula.derivative import derivative, substitute
from surctl.verification.formula.node import BRANCHING, Node, number, ordered, power, rebuilt, variable
from surctl.verification.formula.numeric import values_of
from surctl.verification.formula.parser import FUNCTIONS, IDENTIFIER, is_name, parse, parse_relation
from surctl.verification.formula.reader import from_casadi
from surctl.verification.formula.statement import Statement
from surctl.verification.formula.symbolic import to_casadi
from surctl.verification.formula.text import reads_back, text_of

__all__ = [
    "BRANCHING",
    "FUNCTIONS",
    "IDENTIFIER",
    "Node",
    "Statement",
    "derivative",
    "from_casadi",
    "is_name",
    "number",
    "ordered",
    "parse",
    "parse_relation",
    "power",
    "reads_back",
    "rebuilt",
    "substitute",
    "text_of",
    "to_casadi",
    "values_of",
    "variable",
]
