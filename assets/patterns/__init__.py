"""Sewing patterns: flat panels with seams, read from files or drafted, and cut into triangles."""
