"""Models of robots are refused in one sentence that says why."""

import pytest
from helpers.commands import ppmcal as run


@pytest.mark.parametrize(("form", "says"), [
    ("urdf", "trees"), ("SDF", "loops"), ("mjcf", "drives")])
def test_models_of_robots_are_refused_with_the_reason(tmp_path, form, says):
    (tmp_path / "robot.xml").write_text("<robot/>")
    said = run("import", form, "robot.xml", cwd=tmp_path, expect=2).err
    assert says in said and "ppmcal init 6-UPS" in said
