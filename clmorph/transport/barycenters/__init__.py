"""Barycenters of measures."""
