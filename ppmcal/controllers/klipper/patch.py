"""A copy of a ``printer.cfg`` with new numbers of the geometry, as ``SAVE_CONFIG`` would leave it.

The numbers go into the ``#*#`` block. Lines of the body that would win over it are commented out,
so that they stay what the printer was meant to be; over a line of an included file, which belongs
to others, only a later line of the body wins.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from ppmcal.controllers.delta.geometry import DIGITS, DeltaGeometry
from ppmcal.controllers.klipper.config import Config, parse_config, read_config, read_geometry
from ppmcal.controllers.klipper.lines import BLOCK, HEADER, SAVED, split
from ppmcal.controllers.text import exact_text
from ppmcal.errors import BadInput, NoResult
from ppmcal.wording import pluralize

_KEY = re.compile(r"([A-Za-z0-9_]+)\s*[:=]")
_OWN = "# from here to the block: over numbers of included files"
Places = Mapping[tuple[str, str], str]


def patched(path: Path, wanted: DeltaGeometry) -> tuple[str, str]:
    """Return the text of a copy of ``path`` with new numbers, and what was changed in its body.

    Args:
        path: the ``printer.cfg`` in use.
        wanted: the geometry, as it is written.

    Raises:
        BadInput: Klipper does not read the file's ``#*#`` lines.
        NoResult: the copy would not be read as meant.
    """
    config = read_config(path)
    if config.unread:
        raise BadInput(f"Klipper reads nothing of the #*# lines: {config.unread}", str(path),
                       "Restore them as SAVE_CONFIG wrote them, or leave out --write and paste "
                       "klipper.cfg")
    body, block = _halves("\n".join(split(exact_text(path))))
    new = {(n.partition(".")[0], n.partition(".")[2]): f"{v:.{DIGITS}f}"
           for n, v in wanted.named().items()}
    body, quiet = _quiet(body, new)
    rest = parse_config("\n".join(body), str(path), path).sections
    over = {place: v for place, v in new.items() if place[1] in rest.get(place[0], {})}
    if over:
        body += ["", _OWN, *_sections(over, "")]
    copy = "\n".join([*body, "", *BLOCK, *_block(block, {k: v for k, v in new.items()
                                                         if k not in over})]) + "\n"
    _check(config, copy, path, wanted)
    return copy, _told(quiet, over)


def _halves(text: str) -> tuple[list[str], list[str]]:
    """Return the lines of the body and those below the block's header."""
    head = "\n" + "\n".join(BLOCK) + "\n"
    at = text.find(head)
    if at < 0:
        return text.rstrip("\n").split("\n"), []
    block = text[at + len(head):].strip()
    return text[:at].rstrip("\n").split("\n"), block.split("\n") if block else []


def _quiet(lines: list[str], new: Places) -> tuple[list[str], int]:
    """Return the body with the lines of these keys commented out, and how many keys."""
    out, section, inside, count = [], "", False, 0
    for line in lines:
        bare = re.sub("[#;].*", "", line).rstrip()
        header = HEADER.match(bare)
        if header:
            section, inside = header[1].strip(), False
        elif bare and not bare[0].isspace():
            key = _KEY.match(bare)
            inside = key is not None and (section, key[1].lower()) in new
            count += inside
        out.append(f"#{line}" if inside and bare and not header else line)
    return out, count


def _block(lines: list[str], new: Places) -> list[str]:
    """Return the block's lines with these numbers in their sections, or in new ones."""
    out: list[str] = []
    left = dict(new)
    section, inside = "", False
    for line in lines:
        bare = re.sub("[#;].*", "", line[4:]).rstrip()
        header = HEADER.match(bare)
        if header:
            _close(out, left, section)
            section, inside = header[1].strip(), False
        elif bare and not bare[0].isspace():
            key = _KEY.match(bare)
            place = (section, key[1].lower()) if key else ("", "")
            inside = place in new
            if place in left:
                out.append(f"{SAVED} {place[1]} = {left.pop(place)}")
        if not (inside and bare):
            out.append(line)
    _close(out, left, section)
    return out + _sections(left, f"{SAVED} ")


def _close(out: list[str], left: dict[tuple[str, str], str], section: str) -> None:
    """Put the numbers of a section that its lines did not hold to its end."""
    empty = 0
    while empty < len(out) and out[-1 - empty].strip() == SAVED:
        empty += 1
    own = [place for place in left if place[0] == section]
    out[len(out) - empty:len(out) - empty] = [
        f"{SAVED} {place[1]} = {left.pop(place)}" for place in own]


def _sections(places: Places, lead: str) -> list[str]:
    """Return whole sections, each line behind ``lead``."""
    out: list[str] = []
    for section in dict.fromkeys(place[0] for place in places):
        out += [lead.rstrip(), f"{lead}[{section}]"]
        out += [f"{lead}{key} = {v}" for (own, key), v in places.items() if own == section]
    return out


def _check(old: Config, copy: str, path: Path, wanted: DeltaGeometry) -> None:
    """Refuse a copy that does not read as the old file with the wanted geometry."""
    new = parse_config(copy, str(path), path)
    if new.unread or read_geometry(new) != wanted or _others(new) != _others(old):
        raise NoResult("the copy with the new numbers reads back as something else", str(path),
                       "Leave out --write, and paste klipper.cfg above the #*# lines")


def _others(config: Config) -> dict[tuple[str, str], str]:
    """Return section, key -> text of everything but the geometry."""
    own = {"delta_radius", "angle", "arm_length", "position_endstop"}
    return {(section, key): entry.text for section, keys in config.sections.items()
            for key, entry in keys.items()
            if key not in own or not (section == "printer" or section.startswith("stepper_"))}


def _told(quiet: int, over: Places) -> str:
    """Return what was done to the body, empty where nothing."""
    parts = [f"{pluralize(quiet, 'line')} above the #*# lines, which would win over them, "
             f"{'is' if quiet == 1 else 'are'} commented out"] if quiet else []
    parts += [f"{pluralize(len(over), 'number')} of included files stand{'s' * (len(over) == 1)} "
              "anew above the #*# lines, where it takes to win over them"] if over else []
    return "; ".join(parts)
