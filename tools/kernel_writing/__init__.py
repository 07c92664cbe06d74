"""What `make_half_steps.py` writes kernels with."""
