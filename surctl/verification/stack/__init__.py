"""Conditions under which every task of a null-space-based stack converges."""

from surctl.verification.stack.conditions import LevelCondition, PairCondition, StackConditions, stack_conditions
from surctl.verification.stack.shipped import SHIPPED_STACKS, shipped_stack

__all__ = [
    "SHIPPED_STACKS",
    "LevelCondition",
    "PairCondition",
    "StackConditions",
    "shipped_stack",
    "stack_conditions",
]
