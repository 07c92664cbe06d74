"""The transport problem: solve it, its plan, its divergence, what a plan does."""
