"""The comparisons of a device's operations with NumPy, one row of a table each."""
