"""The command line: made of what commands say that they take; the only place that prints.

``ppmcal --help`` imports neither NumPy nor SciPy: commands are loaded by name, and each
imports what it needs when it runs.
"""

import sys

try:
    import io
    import os

    from ppmcal.cli.streams import Stopped, interruptible, is_entry, loading, steady, stopped

    loaded = loading()

    import click

    from ppmcal import __version__
except KeyboardInterrupt:    # there is nothing to stop yet
    sys.stderr.write("Stopped.\n")
    raise SystemExit(130) from None

class LazyGroup(click.Group):
    """A group that knows its commands' names and loads each on use."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all command names, in the order of the work."""
        from ppmcal.commands import names

        return list(names())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load one command."""
        from ppmcal.commands import exists

        if not exists(cmd_name):
            return None
        from ppmcal.cli.built import built

        return built(cmd_name)

    def resolve_command(self, ctx: click.Context, args: list[str]
                        ) -> tuple[str | None, click.Command | None, list[str]]:
        """Name the nearest command when there is no such one."""
        from ppmcal.commands import exists

        if args and not args[0].startswith("-") and not exists(args[0]):
            import difflib

            known = self.list_commands(ctx)
            near = difflib.get_close_matches(args[0], known, n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
            raise click.UsageError(f"No such command '{args[0]}'. There are: "
                                   f"{', '.join(known)}.{hint}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without loading them."""
        from ppmcal.commands import line

        with formatter.section("Commands"):
            formatter.write_dl([(name, line(name)) for name in self.list_commands(ctx)])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="ppmcal")
def cli() -> None:
    """Calibrate parallel mechanisms: hexapods, planar stages, 3-RPS, delta robots.

    Start with `ppmcal init 6-UPS`, then `ppmcal check`, `simulate` or measure,
    `identify`, `diagnose`, `compensate` and `report`.
    """


def main() -> None:
    """Run a command; every refusal is one message and an exit code, never a traceback."""
    try:
        code = _main(is_entry())
    except (KeyboardInterrupt, Stopped) as stop:    # a moment before its handler was there
        sys.stderr.write("Stopped.\n")
        code = getattr(stop, "exit_code", 130)
    sys.exit(code)


def _main(entry: bool) -> int:
    """Run a command with steady streams; ``entry``: the process ends with it."""
    # threads slow the small matrices of a fit down; must be set before NumPy loads
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with interruptible(entry), steady() as (out, err):
        try:
            code = _run()
            out.flush()
        except (KeyboardInterrupt, Stopped) as stop:
            click.echo("\n" * sys.stderr.isatty() + "Stopped.", err=True)
            code = getattr(stop, "exit_code", 130)
        if out.lost:
            refuse(f"Error: standard output cannot be written ({out.lost}); files in "
                   "--out are not affected. Check the space where it is redirected to.")
        if (out.lost or err.lost) and code in (0, 1):
            code = 2
    return code


def refuse(message: str) -> None:
    """Print a message on standard error: wrapped at a terminal, else a line for ``grep``."""
    from ppmcal.cli.display import wrapped

    click.echo(wrapped(message, sys.argv) if sys.stderr.isatty() else message, err=True)


def _run() -> int:
    """Run a command and return its exit code."""
    from ppmcal.errors import BadInput, PpmcalError

    try:
        code = cli(standalone_mode=False)
        return code if isinstance(code, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.Abort:
        click.echo("Stopped.", err=True)
        return 130
    except click.ClickException as error:
        message = io.StringIO()
        error.show(message)
        refuse(message.getvalue().rstrip("\n"))
        return 2
    except PpmcalError as error:
        refuse(f"Error: {error}")
        return error.exit_code
    except MemoryError:
        refuse("Error: not enough memory for this many rows.")
        return 3
    except Exception as error:
        if (signal := stopped()) is not None:
            raise signal from error
        if os.environ.get("PPMCAL_DEBUG"):
            raise
        if isinstance(error, OSError) and error.filename is not None:
            # a name that is too long, links in a circle, wherever they were met
            met = BadInput(f"cannot be used ({error.strerror})", str(error.filename),
                           "Check the path")
            refuse(f"Error: {met}")
            return met.exit_code
        refuse(f"Error: ppmcal failed: {type(error).__name__}: {error}\nThis is a fault of "
               "ppmcal. Set PPMCAL_DEBUG=1 to see where, and report it.")
        return 3


loaded()
