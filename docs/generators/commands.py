"""The page of all commands, from their own help."""

from __future__ import annotations

import click

from generators.markdown import code, fenced, plain, table
from ppmcal.cli import cli
from ppmcal.commands import line, names

EXIT_CODES = """## Exit codes

| code | means | what to do |
|---|---|---|
| 0 | done | |
| 1 | done, with findings, such as rows left out | read the lines that begin with `!` |
| 2 | bad input: nothing was written | one message gives file, place and hint |
| 3 | no result; only a record of the reason is written | the message has the remedy |
| 130 | stopped with Ctrl-C | |

No result (3) means: singular, not converged, measurements that, as the files are read, are not of
this machine, corrections that are worse than none. Findings (1) are also under `findings`
in the JSON file.
"""
INTRODUCTION = """# Commands

`ppmcal COMMAND --help` prints the same. Every command that writes files has `--out`, every one
that prints a result has `--json` (one object on standard output, for other programs) and `--quiet`.
[Exit codes](#exit-codes) are the same for all of them.
"""


def command_page() -> str:
    """Return the page: a table of all commands, each command, then exit codes."""
    listed = table(["command", "what it does"],
                   [(f"[`{name}`](#{name})", plain(line(name))) for name in names()])
    return "\n".join([INTRODUCTION, listed, *map(_section, names()), EXIT_CODES])


def _section(name: str) -> str:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    context = click.Context(command, info_name=f"ppmcal {name}", terminal_width=100)
    usage = command.get_usage(context).removeprefix("Usage: ")
    options = [p for p in command.params if isinstance(p, click.Option) and not p.hidden]
    return "\n".join([
        f"## {name}\n", fenced(usage, "text"), _help(command.help or "") + "\n",
        table(["option", "default", "what it does"],
              [(_names(o), _default(o), plain(_what(o))) for o in options]),
        "Examples:\n", fenced("\n".join(examples_of(command, context)), "text")])


def examples_of(command: click.Command, context: click.Context) -> list[str]:
    """Return the lines that stand behind the word in a command's help."""
    _, _, end = command.get_help(context).partition("Examples:")
    return [line.strip() for line in end.splitlines() if line.strip()]


def _help(text: str) -> str:
    return "\n\n".join(plain(" ".join(part.split())) for part in text.split("\n\n")
                       if "Examples:" not in part)


def _names(option: click.Option) -> str:
    metavar = "" if option.is_flag else f" {option.make_metavar(click.Context(click.Command('')))}"
    names = ", ".join([*option.opts, *option.secondary_opts])
    return code(f"{names}{metavar}")


def _default(option: click.Option) -> str:
    shown = option.show_default
    if isinstance(shown, str):
        return plain(shown)
    if option.default is None or option.is_flag or not isinstance(option.default, str | float):
        return ""
    return code(option.default)


def _what(option: click.Option) -> str:
    return " ".join((option.help or "").split())
