"""Write a commented mechanism file to start from."""

ORDER = 1
