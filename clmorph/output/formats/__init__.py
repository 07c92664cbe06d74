"""Files that people open: one module for each kind."""
