"""ppmcal: kinematic calibration of parallel mechanisms.

One function per command, loaded on first use (``import ppmcal`` loads neither NumPy nor SciPy):

>>> import ppmcal
>>> machine = ppmcal.load(ppmcal.shipped("6-UPS"))
>>> run = ppmcal.simulate(machine, ppmcal.shipped("6-UPS", scenario=True))
>>> fit = ppmcal.identify(machine, run.data)
>>> fit.converged
True

Files, data frames, mappings of columns and arrays are all accepted; tables use the units of the
mechanism file, attributes of results SI. Every result has ``save(folder)``, ``to_frame()`` and
``findings``. Errors are :class:`BadInput` and :class:`NoResult`; their messages give the file, the
place in it and a hint.
"""

TYPE_CHECKING = False    # importing typing takes milliseconds in which Ctrl-C gives a traceback
if TYPE_CHECKING:
    from typing import Any

__version__ = "0.3.0"

_HOME = {"BadInput": "errors", "NoResult": "errors", "PpmcalError": "errors",
         "load": "commands.inputs", "read_data": "commands.inputs", "shipped": "commands.inputs"}
"""Modules of the public names that are not commands."""


def __getattr__(name: str) -> "Any":
    """Load the module that holds ``name`` on first use."""
    import importlib
    import os

    if name == "__all__":
        return sorted([*_HOME, *importlib.import_module(f"{__name__}.commands").functions()])
    if name in _HOME:
        return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    # `from ppmcal import linalg` comes here first; no command shares a submodule's name
    room = any(os.path.exists(os.path.join(place, name + end)) for place in __path__
               for end in ("", ".py"))
    if name.startswith("_") or room or name not in importlib.import_module(
            f"{__name__}.commands").functions():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module(f"{__name__}.commands.face").function(name)


def __dir__() -> list[str]:
    """Return the public names."""
    return [*__getattr__("__all__"), "__version__"]
