"""What every room uses: validation, atomic files, progress, signals, text in messages."""
