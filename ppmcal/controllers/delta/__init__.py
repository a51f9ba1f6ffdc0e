"""What firmwares of linear delta printers share: numbers, arithmetic, fit, files of a printer."""
