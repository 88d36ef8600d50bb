"""Design, tune, verify and export the controller of a small underwater robot."""

__version__ = "0.1.0"

__all__ = ["__version__"]
