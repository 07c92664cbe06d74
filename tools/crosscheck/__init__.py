"""The judge of `tools/cross_check.py`: dense, in long double, without code of the library."""
