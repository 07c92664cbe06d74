"""The transport problem: its solver, its plan, its divergence, and statistics of a plan."""
