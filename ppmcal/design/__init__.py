"""Before the machine is built or measured: sensitivity, tolerances, stiffness, workspace, plans."""
