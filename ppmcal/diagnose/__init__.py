"""Find where machine and measurements disagree, name the missing effect, show the gap shrink."""
