"""The analysis of a transport or a morph: numbers, times, figures, metrics, a baseline."""
