"""What controllers of ropes to one point share: the machine's file, readings, the export."""
