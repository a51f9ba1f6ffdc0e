"""Folders of results: what is written appears whole, replaces nobody's files, and says its source.

It is below the readers of files, not beside what writes results: whatever reads a file says so here
first, so that no run replaces what it has read and results name what that held.

``stage``: the hidden folder of a run and its lock. ``transaction``: files put in all or none, and
made good after a kill. ``output``: the files of a result. ``folder``: what a folder records, and
which of its files a run may replace. ``inputs``: what a run reads. ``provenance``: where results
come from. ``runs``: recorded runs, and a place to do them again. ``differences``: two versions of
a file, value by value.
"""
