"""The trials of `tools/fuzz.py`: damaged images, odd settings, odd calls."""
