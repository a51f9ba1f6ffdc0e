"""``python -m ppmcal``."""

from ppmcal.cli import main

main()
