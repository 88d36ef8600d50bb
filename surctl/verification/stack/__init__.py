"""Conditions under which every task of a null-space-based stack converges."""

from surctl.verification.stack.conditions import LevelCondition, PairCondition, StackConditions, stack_conditions

__all__ = [
    "LevelCondition",
    "PairCondition",
    "StackConditions",
    "stack_conditions",
]
