"""The command-line application, which registers the commands and turns every error into a line and an exit status."""

from __future__ import annotations

import gc
import logging
import os
import sys
import warnings

import click

from surctl import __version__
from surctl.cli.activity import signs_of_life
from surctl.cli.calibrate import calibrate
from surctl.cli.check import check
from surctl.cli.completion import completion
from surctl.cli.export import export
from surctl.cli.fly import fly
from surctl.cli.gains import gains
from surctl.cli.lint import lint
from surctl.cli.listing import listing
from surctl.cli.mission import scenario
from surctl.cli.new import new
from surctl.cli.output import LOST, Stopped, interrupted, noting_interrupts, print_message
from surctl.cli.reproduce import reproduce
from surctl.cli.simulate import simulate
from surctl.cli.sonar_replay import sonar_replay
from surctl.cli.streams import OutputLost, discard_stdout, failed_write, guarded_stdout, open_closed_streams
from surctl.cli.study import study
from surctl.cli.sweep import sweep
from surctl.cli.tune import tune
from surctl.cli.vehicle import vehicle
from surctl.cli.verify import verify
from surctl.errors import SurctlError

__all__ = ["app", "main"]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="surctl")
def app() -> None:
    """Design, tune, verify and export the controller of a small underwater robot.

    Examples: surctl new vehicle my-robot; surctl study my-robot.toml; surctl simulate tank-static --out plots

    Exit status: 0 finished with the expected result, 1 finished with another result, 2 wrong input, 3 some output
    could not be written.
    """


_COMMANDS = (
    study, reproduce, simulate, sweep, tune, verify, check, export, vehicle, gains, scenario, calibrate, sonar_replay,
    fly, new, lint, listing, completion,
)  # fmt: skip
for _command in _COMMANDS:
    app.add_command(_command)


def main() -> None:
    """Run the command line on `sys.argv` and exit with its status.

    Raises:
        SystemExit: always. Status 0: success, 1: a claim, goal or run failed, 2: wrong input, 3: some output could not
            be written, 130: stopped by the user.

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
    warnings.showwarning = lambda message, *_: print_message(str(message))
    os.environ["MPLBACKEND"] = "agg"  # an inherited one (of Jupyter, say) may not be installed; no window is opened
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it reports a folder for its own cache in several lines
    open_closed_streams()
    with noting_interrupts(), guarded_stdout(), signs_of_life():
        status = _status()
    sys.exit(status)


def _status() -> int:
    try:
        status = app(prog_name="surctl", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        status = 0
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        print_message(f"{error.format_message()}; see {context.command_path if context else 'surctl'} --help")
        status = 2
    except SurctlError as error:
        print_message(str(error))
        cause = error.__context__
        status = LOST if isinstance(cause, OSError) and failed_write(cause) else error.exit_status
    except Stopped as stop:
        print_message(f"stopped; {stop}")
        status = 130
    except OutputLost as lost:
        if str(lost):
            print_message(str(lost))
        discard_stdout()
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
