"""Is it in the data, given the rest? One linear-Gaussian evidence, on plain arrays."""
