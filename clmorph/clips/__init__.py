"""Clips: films that are read and written frame by frame, with their sound, times and colors."""
