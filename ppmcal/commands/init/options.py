"""What ``ppmcal init`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import CONSOLE, Arguments, Command, Path_, argument, option


@dataclass(frozen=True)
class InitArguments(Arguments):
    """Which kind of machine, and where to."""

    kind: str | None = argument("", "The kind of machine.", None,
                                complete="ppmcal.io.templates:templates")
    out: Path_ | None = option(None, "File to write [default: KIND.yaml].", only=CONSOLE)
    force: bool = option(False, "Overwrite a file that exists.", only=CONSOLE)


COMMAND = Command(
    "init", InitArguments,
    about=("Write a commented mechanism file for KIND (none: list the kinds).",),
    examples=("ppmcal init", "ppmcal init 6-UPS --out my-hexapod.yaml"), files=True,
    recorded=False)
