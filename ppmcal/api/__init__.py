"""One function per command: files, data frames or arrays in, a result out.

``ppmcal.identify`` and its like are loaded from here on first use; the command line calls the
same functions.
"""
