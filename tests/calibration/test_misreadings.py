"""Files that are read wrongly are named with the line that mends them; the mend is tried."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from calibration.test_gross_errors import (
    MACHINE,
    MISTAKES,
    SAMPLE,
    Row,
    inverse,
    scaled,
    session,
    swapped,
    turned,
)
from helpers.commands import ppmcal
from scipy.spatial.transform import Rotation

from ppmcal.api import load, read_data
from ppmcal.calibration.misreading import Misread, misfit, refuse_misread
from ppmcal.calibration.problem import Problem
