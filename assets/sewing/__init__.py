"""Sewing: panels are arranged around a body, sewn together, draped and checked."""
