"""Sewing: panels are arranged around a body, sewn together, draped and checked."""

DEFAULT_EDGE = 0.02
"""Length of the edges of a garment that a game simulates [m]."""
