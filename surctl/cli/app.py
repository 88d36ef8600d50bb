"""Start of the command line: commands, completion, width of help, errors to exit status, streams, threads of BLAS."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import sys
import warnings
from collections.abc import MutableMapping
from functools import cached_property

import click
from click.shell_completion import get_completion_class

from surctl import __version__
from surctl.cli.application import applications, with_branches
from surctl.cli.check import check
from surctl.cli.export import export
from surctl.cli.lint import lint
from surctl.cli.listing import listing
from surctl.cli.new import new
from surctl.cli.output import (
    OutputLost,
    Stopped,
    discard,
    failed_write,
    guarded_stdout,
    interrupted,
    noting_interrupts,
    open_closed_streams,
    print_message,
    signs_of_life,
)
from surctl.cli.simulate import simulate
from surctl.cli.study import study
from surctl.cli.sweep import sweep
from surctl.cli.tune import tune
from surctl.cli.verify import verify
from surctl.errors import LOST, SurctlError


class _Commands(click.Group):
    """All commands in the order in which a newcomer needs them; applications are loaded when one is needed."""

    @cached_property
    def _all(self) -> dict[str, click.Command]:
        own = {command: text for one in applications() for command, text in one.commands.items()}
        every = {**_COMMANDS, **own, completion: "Print a script that completes commands in a shell."}
        named = {str(command.name): with_branches(command) for command in every}
        for command, description in zip(named.values(), every.values(), strict=True):
            command.short_help = description
        return named

    @property
    def commands(self) -> MutableMapping[str, click.Command]:
        """The commands by name."""
        return self._all

    @commands.setter
    def commands(self, _: object) -> None: ...

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command of the first word; without the applications if their options are not used."""
        name, *words = args
        own = next((command for command in _COMMANDS if command.name == name), None)
        if own is not None and any(":" in word for word in words):
            known = {option for parameter in own.params for option in (*parameter.opts, *parameter.secondary_opts)}
            from surctl.system.subjects import is_subject

            if any(map(is_subject, words)) and all(w.partition("=")[0] in known for w in words if w.startswith("-")):
                return name, own, words
        return super().resolve_command(ctx, args)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="surctl")
def app() -> None:
    """Write a control law once, then simulate, tune and prove it, and export it as C: a toolkit in Python, with an
    underwater robot as its reference application.

    Examples: surctl new system pendulum; surctl study pendulum.py:build; surctl simulate tank-static --out plots

    Exit status: 0 finished with the expected result, 1 finished with another result (a line says FAIL, or a claim that
    you name is not proved), 2 wrong input or no permission to write, 3 some output is lost (disk full, file system
    read-only, stdout lost), 130 stopped.
    """


@click.command
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print a script that lets a shell complete the names of commands, options and values.

    For bash, add this line to ~/.bashrc: eval "$(surctl completion bash)".

    Examples: surctl completion bash; surctl completion fish > ~/.config/fish/completions/surctl.fish
    """
    completer = get_completion_class(shell)
    assert completer is not None  # click supports all three shells
    root = click.get_current_context().find_root().command
    sys.stdout.write(completer(root, {}, "surctl", "_SURCTL_COMPLETE").source() + "\n")


_COMMANDS = {  # in the order in which a newcomer needs them; a description fits one line of 80 columns
    new: "Write a file to start from: a system, a vehicle, a law, …",
    study: "Sweep, margins, proofs, runs and C code in one report.",
    simulate: "Simulate a closed loop: one run, many seeds, campaigns.",
    verify: "Prove or refute stability and other claims; margins.",
    sweep: "Compute costs over a grid or a sample of parameters.",
    tune: "Search for gains that meet goals; --page shows sliders.",
    export: "Write the controller as C, and compare it with Python.",
    check: "Check a certificate without trusting the prover.",
    lint: "Find entries of a file that cannot work, and say why.",
    listing: "List built-in vehicles, scenarios, gains and claims.",
}


def main() -> None:
    """Run the command line on `sys.argv` and exit with its status.

    Raises:
        SystemExit: always. Status 0: success, 1: a claim, goal or run failed, 2: wrong input or no permission to write,
            3: some output is lost (disk full or read-only, stdout lost), 130: stopped by the user.

    Examples:
        >>> import sys
        >>> from surctl.cli import main
        >>> sys.argv = ["surctl", "--version"]
        >>> try:
        ...     main()
        ... except SystemExit as end:
        ...     print("status", end.code)
        surctl, version ...
        status 0
    """
    # set before NumPy is loaded: with small matrices, OpenBLAS's threads only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(50_000, 20, 20)  # the search for cycles takes a tenth of the time of a short command
    warnings.showwarning = lambda message, kind, file, line, *_: _show_warning(message, kind, f"{file}:{line}: ")
    os.environ["MPLBACKEND"] = "agg"  # an inherited one (of Jupyter, say) may not be installed; no window is opened
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it reports a folder for its own cache in several lines
    open_closed_streams()
    with noting_interrupts(), guarded_stdout(), signs_of_life():
        status = _status()
    try:
        sys.stderr.flush()
    except OSError:  # else Python tries again at its end, and changes the status to 120
        discard(sys.stderr)
    sys.exit(status)


def _show_warning(message: Warning | str, category: type[Warning], place: str) -> None:
    """Print a warning in one line; one that is not about the user's numbers, such as NumPy's, with its place."""
    print_message(f"warning: {'' if issubclass(category, UserWarning) else place}{message}")


def _status() -> int:
    try:
        columns = max(50, min(shutil.get_terminal_size().columns, 100))  # click leaves two of the terminal empty
        status = app(prog_name="surctl", standalone_mode=False, terminal_width=columns)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        status = 0
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        said = f"{error.format_message()}; see {context.command_path if context else 'surctl'} --help"
        print_message(said.replace("'. (", "' (").replace("?);", ");").replace(".;", ";"))
        status = 2
    except SurctlError as error:
        print_message(str(error))
        status = error.exit_status
    except Stopped as stop:
        print_message(f"stopped; {stop}")
        status = 130
    except OutputLost as lost:
        if str(lost):
            print_message(str(lost))
        discard(sys.stdout)
        status = LOST
    except OSError as error:
        lost_file = failed_write(error)
        if lost_file is None:
            raise
        print_message(lost_file)
        status = LOST
    except (Exception, KeyboardInterrupt) as error:
        if not (isinstance(error, click.Abort) or interrupted(error)):
            raise
        print_message("stopped before a result was finished")
        status = 130
    return status if isinstance(status, int) else 0
