"""ppmcal: kinematic calibration of parallel mechanisms.

One function per command, loaded on first use (``import ppmcal`` loads neither NumPy nor SciPy):

>>> import ppmcal
>>> machine = ppmcal.load(ppmcal.shipped("6-UPS"))
>>> run = ppmcal.simulate(machine, ppmcal.shipped("6-UPS", scenario=True))
>>> fit = ppmcal.identify(machine, run.data)
>>> fit.converged
True

Files, data frames, mappings of columns and arrays are taken alike; tables are in the units of
the mechanism file, attributes of results in SI. Every result has ``save(folder)``, ``to_frame()``
and ``findings``. Refusals are :class:`BadInput` and :class:`NoResult`; their texts name file,
place and mend.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.3.0"

if TYPE_CHECKING:
    from ppmcal.api.check import check
    from ppmcal.api.compare import compare
    from ppmcal.api.compensate import compensate
    from ppmcal.api.diagnose import diagnose
    from ppmcal.api.identify import identify
    from ppmcal.api.inputs import load, read_data, shipped
    from ppmcal.api.kinematics import forward, inverse, velocity
    from ppmcal.api.schema import schema
    from ppmcal.api.simulate import simulate
    from ppmcal.errors import BadInput, NoResult, PpmcalError

_HOME = {
    "BadInput": "errors", "NoResult": "errors", "PpmcalError": "errors",
    "load": "api.inputs", "read_data": "api.inputs", "shipped": "api.inputs",
    "check": "api.check", "compare": "api.compare", "compensate": "api.compensate",
    "diagnose": "api.diagnose", "identify": "api.identify", "simulate": "api.simulate",
    "schema": "api.schema",
    "forward": "api.kinematics", "inverse": "api.kinematics",
    "velocity": "api.kinematics",
}

__all__ = [
    "BadInput",
    "NoResult",
    "PpmcalError",
    "check",
    "compare",
    "compensate",
    "diagnose",
    "forward",
    "identify",
    "inverse",
    "load",
    "read_data",
    "schema",
    "shipped",
    "simulate",
    "velocity",
]


def __getattr__(name: str) -> Any:
    """Load the module that holds ``name`` on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
