"""Adapters through which other libraries' tests of entropic transport run on clmorph."""
