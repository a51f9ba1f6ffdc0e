"""Independent simulator of measurement campaigns, with what goes wrong in real ones.

Nothing here comes from the package under study: only its file formats are shared. Inside,
lengths are mm, angles rad, forces N, moments N·mm, times s, temperatures °C.
"""
