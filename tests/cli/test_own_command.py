"""A command is a folder: put beside the others, it is in help, Python, docs and verify."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from helpers.commands import environment
from helpers.paths import ROOT

from ppmcal import commands

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CODE = """
import json, sys
import ppmcal.commands
ppmcal.commands.__path__.append(sys.argv[1])

import ppmcal
from click.testing import CliRunner
from ppmcal.cli import cli

def typed(*words):
    run = CliRunner().invoke(cli, words)
    assert run.exit_code == 0, (run.output, run.exception)
    return run.output

listed, own = typed("--help"), typed("home", "--help")
assert "numpy" not in sys.modules
from generators.api import api_page
from generators.commands import command_page
from generators.stub import stub
told = typed("home", "m.yaml", "--digits", "3")
asked = json.loads(typed("home", "m.yaml", "--digits", "3", "--json"))
found = ppmcal.home("m.yaml", digits=3)
same = typed("verify", "home")
print(json.dumps({"listed": listed, "own": own, "told": told, "asked": asked["joints"],
                  "recorded": asked["provenance"]["function"], "doc": ppmcal.home.__doc__,
                  "options": asked["provenance"]["options"], "found": found.joints, "same": same,
                  "named": ppmcal.__all__,
                  "commands": command_page(), "python": api_page(), "stub": stub()}))
"""


def command_of_the_page(folder: Path) -> Path:
    """Write the files of the page's example into a folder of commands."""
    section = re.search(r"^## Add a command$(.*?)^## ", PAGE, re.M | re.S)[1]
    blocks = re.findall(r"^```python\n# (home/\w+\.py)\n(.*?)^```", section, re.M | re.S)
    assert [name for name, _ in blocks] == ["home/__init__.py", "home/options.py", "home/run.py"]
    (folder / "home").mkdir(parents=True)
    for name, code in blocks:
        (folder / name).write_text(code, encoding="utf-8")
    return folder


def test_every_command_has_a_place_of_its_own_in_the_list() -> None:
    places = [import_module(f"ppmcal.commands.{commands.folder(name)}").ORDER
              for name in commands.names()]
    assert sorted(set(places)) == places


@pytest.mark.long
def test_a_folder_is_a_command_in_every_way_to_call_it(tmp_path: Path) -> None:
    import json

    (tmp_path / "m.yaml").write_text((ROOT / "configs" / "3-RPR.yaml").read_text())
    site = command_of_the_page(tmp_path / "site")
    done = subprocess.run([sys.executable, "-c", CODE, str(site)], cwd=tmp_path, text=True,
                          capture_output=True, check=False, env=environment())
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    assert re.search(r"^  home +Joint values at home\.$", got["listed"], re.M)
    assert "Tell the joint values of MECH at home." in got["own"]
    assert "Digits of a joint value.  [default: 7; 1<=x<=16]" in " ".join(
        got["own"].split()).replace(". [", ".  [")
    assert "3-RPR at home:" in got["told"] and "Written to home: home.csv" in got["told"]
    assert got["asked"] == got["found"] and set(got["found"]) == {"leg1", "leg2", "leg3"}
    assert got["recorded"] == "home.home"
    assert got["options"] == {"mechanism": "m.yaml", "digits": 3}
    assert "digits: Digits of a joint value." in got["doc"] and "of a machine" in got["doc"]
    assert "same" in got["same"] and "home.csv" in got["same"]
    for page, words in (("commands", "`--digits INTEGER RANGE`"), ("python", "### HomeResult")):
        assert re.search(r"^##+ home$", got[page], re.M) and words in got[page], page
    assert "home" in got["named"]
    assert "def home(mechanism: Machine, *, digits: int = ...," in got["stub"]
