"""Contact of cloth: with bodies, primitives and distance fields, and with itself."""
