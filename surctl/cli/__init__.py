"""The command line: one short file a command; heavy libraries are imported when a command runs."""

from surctl.cli.app import main

__all__ = ["main"]
