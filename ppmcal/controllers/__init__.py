"""What a machine is to a controller: one folder for each, and nowhere a list of them.

A folder's ``__init__`` has ``CONTROLLER``, what help says of it (:class:`Controller`), without
NumPy. Its module ``controller`` does the work: ``export``, as
:class:`ppmcal.controllers.export.Exporter` says, ``patch`` where it can copy a file in use, and
``import_config`` where its files can be read (:class:`ppmcal.controllers.importing.Importer`), with
the options that ``CONTROLLER`` names.
Folders without ``CONTROLLER`` hold what several share.

Another package adds a format through the entry points ``ppmcal.controllers``, for ``export``, and
``ppmcal.imports``, for ``import``: an entry has the format's name in small letters and loads a
module, or an object, with these functions; it may have a ``CONTROLLER`` too.
"""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass, field, replace
from functools import cache

from ppmcal.errors import unknown

TYPE_CHECKING = False    # help needs the names alone
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from importlib.metadata import EntryPoint
    from typing import Any

    from ppmcal.model.mechanism import Mechanism

EXPORTS, IMPORTS = "ppmcal.controllers", "ppmcal.imports"
"""Groups of entry points: what writes a format, and what reads one."""


@dataclass(frozen=True)
class ImportOption:
    """One option of ``import``; controllers that take options of one name share it.

    Attributes:
        name: of the field of the command's arguments.
        kind: its annotation, as it is written.
        default: what is taken where nothing is given.
        help: what it is; ``{words}`` stands for the ``words`` of all controllers that have it.
        words: what it is to one controller.
        how: the rest of :class:`ppmcal.commands.spec.Option`, by name.
    """

    name: str
    kind: str
    default: Any
    help: str
    words: str = ""
    how: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Controller:
    """What is said of a controller's format.

    Attributes:
        order: place in lists.
        exports: what ``export`` writes; imports: what ``import`` reads, empty where it does not.
        unread: why files of it are not read, where one could think that they were.
        title: what people call it, where that is not its name.
        options: what ``import`` asks of it besides its file.
        copies: whether ``export --write`` copies a file of it.
        examples: command lines to copy, by their command.
        use: what somebody does with a calibrated machine who has this controller. ``{model}`` is
            the machine's file or folder, ``{old}`` the controller's own file that it was imported
            from: words with that are said of such machines alone.
        drives: whether it drives a machine.
        named: what its numbers call the parameters of a machine that was imported from it, in a
            sentence; empty where that is not said.
    """

    order: int
    exports: str
    imports: str = ""
    unread: str = ""
    title: str = ""
    options: tuple[ImportOption, ...] = ()
    copies: bool = False
    examples: tuple[tuple[str, str], ...] = ()
    use: str = ""
    drives: Callable[[Mechanism], bool] = lambda _: True
    named: Callable[[Mechanism], str] = lambda _: ""


@cache
def own() -> dict[str, Controller]:
    """Return the formats of ppmcal by name, in their order."""
    found = {one: getattr(importlib.import_module(f"{__name__}.{one}"), "CONTROLLER", None)
             for place in __path__ for one in os.listdir(place)
             if os.path.isfile(os.path.join(place, one, "__init__.py"))}
    known = {name: one for name, one in found.items() if one is not None}
    return dict(sorted(known.items(), key=lambda item: int(item[1].order)))


def formats(group: str) -> dict[str, EntryPoint]:
    """Return by name where each format's module is, those of other packages last.

    Raises:
        ValueError: a name is taken.
    """
    from importlib.metadata import EntryPoint, entry_points

    ours = [EntryPoint(name, f"{__name__}.{name}.controller", group)
            for name, one in own().items() if group == EXPORTS or one.imports]
    out: dict[str, EntryPoint] = {}
    for entry in (*ours, *entry_points(group=group)):
        if entry.name in out:
            raise ValueError(f"format '{entry.name}' is registered twice")
        out[entry.name] = entry
    return out


def exported() -> dict[str, EntryPoint]:
    """Return the formats that can be written."""
    return formats(EXPORTS)


def imported() -> dict[str, EntryPoint]:
    """Return the formats that can be read."""
    return formats(IMPORTS)


def loaded(name: str, group: str = EXPORTS) -> Any:
    """Return what writes or reads format ``name``, whatever its case; no other module is loaded.

    Raises:
        BadInput: there is no such format.
    """
    known = formats(group)
    if name.lower() not in known:
        raise unknown("format", name, known)
    return known[name.lower()].load()


def about(group: str = EXPORTS) -> Iterator[str]:
    """Yield ``klipper: what is written or read`` of each format; see :func:`_docstring`."""
    for name, entry in formats(group).items():
        one = own().get(name)
        yield f"{name}: " + (_docstring(entry.module) if one is None else
                             one.exports if group == EXPORTS else one.imports)


def uses(mechanism: Mechanism, model: str, form: str = "", old: str = "") -> list[str]:
    """Return what may be done with a calibrated machine on the controllers that drive it, in words.

    Of ppmcal's own formats no module is loaded.

    Args:
        mechanism: the machine.
        model: path of its file, or of the folder.
        form: the format that it was imported from, which is then its controller.
        old: the controller's file that it was imported from.
    """
    known = exported()
    asked = {form: known[form]} if form in known else known
    found = (own().get(name) or getattr(entry.load(), "CONTROLLER", None)
             for name, entry in asked.items())
    return [one.use.format(model=model, old=old) for one in found
            if one is not None and one.use and (old or "{old}" not in one.use)
            and one.drives(mechanism)]


def own_words(mechanism: Mechanism, form: str) -> str:
    """Return what the format ``form`` calls the parameters of a machine imported from it."""
    known = own().get(form)
    return "" if known is None else known.named(mechanism)


def examples(command: str) -> tuple[str, ...]:
    """Return command lines to copy of ``export`` or ``import``."""
    return tuple(line for one in own().values() for of, line in one.examples if of == command)


def import_options() -> dict[str, ImportOption]:
    """Return by name the options that ``import`` has, as help says them.

    A controller of another package takes those of them that its ``CONTROLLER`` names.
    """
    known: dict[str, list[ImportOption]] = {}
    for controller in own().values():
        for one in controller.options:
            known.setdefault(one.name, []).append(one)
    return {name: replace(first, help=first.help.replace(
        "{words}", ", or ".join(dict.fromkeys(one.words for one in (first, *others)))))
        for name, (first, *others) in known.items()}


def options_of(name: str) -> tuple[ImportOption, ...]:
    """Return the options that ``import`` takes for a format.

    Raises:
        BadInput: there is no such format.
    """
    if name.lower() in own():
        return own()[name.lower()].options
    found = getattr(loaded(name, IMPORTS), "CONTROLLER", None)
    return () if found is None else tuple(found.options)


def _docstring(module: str) -> str:
    """Return the first line of a module's docstring, without running it."""
    import ast
    from importlib.util import find_spec

    found = find_spec(module)
    source = None if found is None or found.loader is None else getattr(
        found.loader, "get_source", lambda _: None)(module)
    return ((ast.get_docstring(ast.parse(source)) if source else "") or "").partition("\n")[0]
