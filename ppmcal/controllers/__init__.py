"""What motion controllers compute: their own kinematics, and how well they fit a machine."""
