"""The commented mechanism files that ``ppmcal init`` hands out."""

from __future__ import annotations

from pathlib import Path

from ppmcal.errors import BadInput, unknown


def shipped(name: str) -> Path:
    """Return a shipped folder: inside the package, or beside it in a checkout."""
    here = Path(__file__).resolve().parents[1]
    for place in (here / name, here.parent / name):
        if place.is_dir():
            return place
    raise BadInput(f"the folder {name} is missing from this installation", str(here),
                   "Install ppmcal again")


def sample_data() -> Path:
    """Return the folder of the sample campaign."""
    return shipped("sample_data")


def templates() -> dict[str, str]:
    """Return name -> first comment line of every file."""
    out = {}
    for path in sorted(shipped("configs").glob("*.yaml")):
        first = path.read_text(encoding="utf-8").split("\n", 1)[0]
        out[path.stem] = first.lstrip("# ").rstrip()
    return out


def find_template(name: str) -> Path:
    """Return the file for a kind, whatever its case.

    Raises:
        BadInput: no such kind; lists them all.
    """
    by_name = {n.lower(): n for n in templates()}
    asked = name.lower().removesuffix(".yaml")
    wanted = by_name.get(asked)
    # 3-PRR does not say which joint is driven: the slides come first
    several = [n for n in templates() if n.lower().startswith(f"{asked}-")]
    if wanted is None and several:
        listed = "; ".join(f"{n} ({templates()[n].partition(':')[0]})" for n in several)
        raise BadInput(f"there is more than one '{name}'" if len(several) > 1 else
                       f"'{name}' does not say which joint is driven", "init", f"Give {listed}")
    if wanted is None:
        raise unknown("mechanism", name, templates(), "init")
    return shipped("configs") / f"{wanted}.yaml"


def for_editors(path: Path, kind: str, stem: str) -> str:
    """Return a template's text with the line by which editors find the schema of its kind.

    The commands in it name the files as they will be called: ``stem.yaml``, ``stem.scenario.yaml``;
    a name that a comment cannot hold (one with a line break) is left out.
    """
    schema = Path(__file__).with_name("schemas") / f"{kind}.json"
    text = path.read_text("utf-8")
    for ending in (".yaml", ".scenario.yaml") if stem.isprintable() else ():
        text = text.replace(f" {path.stem}{ending}", f" {stem}{ending}")
    return f"# yaml-language-server: $schema={schema.as_uri()}\n{text}"
