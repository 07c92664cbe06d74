"""Tools that every package uses: validation, atomic files, progress, signals, message texts."""
