"""What `tools/fuzz.py` tries: damaged images, odd settings, odd calls."""
