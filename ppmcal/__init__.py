"""ppmcal: kinematic calibration of parallel mechanisms."""

__version__ = "0.3.0"
