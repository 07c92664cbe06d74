"""Files that people open: recording, playback, framing, formats, pages."""
