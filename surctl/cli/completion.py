"""`surctl completion`: shell completion of commands and options."""

from __future__ import annotations

import sys

import click
from click.shell_completion import get_completion_class

__all__ = ["completion"]


@click.command
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print a script with which a shell completes commands, options and choices.

    For bash, add this line to ~/.bashrc: eval "$(surctl completion bash)".

    Examples: surctl completion bash; surctl completion fish > ~/.config/fish/completions/surctl.fish
    """
    completer = get_completion_class(shell)
    assert completer is not None  # click supports all three shells
    root = click.get_current_context().find_root().command
    sys.stdout.write(completer(root, {}, "surctl", "_SURCTL_COMPLETE").source() + "\n")
