"""`surctl completion`: completion of commands and options by the shell."""

from __future__ import annotations

import sys

import click
from click.shell_completion import get_completion_class

__all__ = ["completion"]


@click.command
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print what makes a shell complete commands, options and choices.

    In ~/.bashrc: eval "$(surctl completion bash)".

    Examples: surctl completion bash; surctl completion fish > ~/.config/fish/completions/surctl.fish
    """
    completer = get_completion_class(shell)
    assert completer is not None  # click knows the three
    root = click.get_current_context().find_root().command
    sys.stdout.write(completer(root, {}, "surctl", "_SURCTL_COMPLETE").source() + "\n")
