"""The task stacks of the built-in laws, for the conditions of convergence."""

from surctl.marine.verification.stack.shipped import SHIPPED_STACKS, shipped_stack

__all__ = [
    "SHIPPED_STACKS",
    "shipped_stack",
]
