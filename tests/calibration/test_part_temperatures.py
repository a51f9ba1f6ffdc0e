"""Temperatures of a heated part are not the room's, and a unit that is stated is believed."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.paths import ROOT

from ppmcal.calibration.interpretation.obvious_mistakes import recorded_units
from ppmcal.io import read_mechanism
from ppmcal.model.dataset import ZERO_CELSIUS, Dataset


@pytest.mark.parametrize(("name", "celsius", "units", "told"), [
    ("temperature", (65.0, 75.0), {}, "F"),
    ("temperature", (65.0, 75.0), {"temperature": "C"}, ""),
    ("temperature_bed", (65.0, 75.0), {}, ""),
    ("temperature_bed", (295.0, 300.0), {}, "K")])
def test_no_bed_is_a_workshop(name: str, celsius: tuple[float, ...], units: dict[str, str],
                              told: str) -> None:
    mechanism = read_mechanism(ROOT / "sample_data" / "hexapod.yaml")
    data = Dataset.__new__(Dataset)
    object.__setattr__(data, "columns", {name: np.array(celsius) + ZERO_CELSIUS})
    object.__setattr__(data, "read", {"units": units} if units else {})
    found = list(recorded_units(data, mechanism))
    assert [unit for _, unit in found] == [told] * bool(told)
    if found:
        assert f"`units: {{{name}: C}}`" in found[0][0].text
