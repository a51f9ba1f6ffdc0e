"""ppmcal: kinematic calibration of parallel mechanisms."""

__version__ = "0.1.0"
