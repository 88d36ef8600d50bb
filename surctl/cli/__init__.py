"""The command line, with one module for each command; large libraries are imported only when a command runs."""

from surctl.cli.app import main

__all__ = ["main"]
