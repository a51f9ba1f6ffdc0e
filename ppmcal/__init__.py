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
    from ppmcal.api.export import export
    from ppmcal.api.identify import identify
    from ppmcal.api.import_ import import_config
    from ppmcal.api.inputs import load, read_data, shipped
    from ppmcal.api.kinematics import forward, inverse, velocity
    from ppmcal.api.plan import plan
    from ppmcal.api.report import make_report
    from ppmcal.api.schema import schema
    from ppmcal.api.sensitivity import sensitivity
    from ppmcal.api.simulate import simulate
    from ppmcal.api.stiffness import stiffness
    from ppmcal.api.tolerances import tolerances
    from ppmcal.api.workspace import workspace
    from ppmcal.errors import BadInput, NoResult, PpmcalError

_HOME = {"BadInput": "errors", "NoResult": "errors", "PpmcalError": "errors",
         "load": "api.inputs", "read_data": "api.inputs", "shipped": "api.inputs",
         "forward": "api.kinematics", "inverse": "api.kinematics", "velocity": "api.kinematics",
         "import_config": "api.import_", "make_report": "api.report"}
"""Where names are that are not in the module of ``api`` that is called like them."""

__all__ = [
    "BadInput",
    "NoResult",
    "PpmcalError",
    "check",
    "compare",
    "compensate",
    "diagnose",
    "export",
    "forward",
    "identify",
    "import_config",
    "inverse",
    "load",
    "make_report",
    "plan",
    "read_data",
    "schema",
    "sensitivity",
    "shipped",
    "simulate",
    "stiffness",
    "tolerances",
    "velocity",
    "workspace",
]


def __getattr__(name: str) -> Any:
    """Load the module that holds ``name`` on first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_HOME.get(name, f'api.{name}')}"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__all__, "__version__"]
