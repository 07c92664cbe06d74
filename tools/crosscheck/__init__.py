"""What `tools/cross_check.py` judges by: long double, dense, none of the library's own code."""
