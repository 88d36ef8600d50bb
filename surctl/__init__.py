"""Design, tune, verify and export the controller of a small underwater robot."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surctl.system import from_control, to_control

__version__ = "0.1.0"

__all__ = ["__version__", "from_control", "to_control"]


def __getattr__(name: str) -> Any:
    """Return `from_control` or `to_control` of `surctl.system`, which is imported only now."""
    if name not in ("from_control", "to_control"):
        raise AttributeError(f"module 'surctl' has no attribute {name!r}")
    from surctl import system

    return getattr(system, name)
