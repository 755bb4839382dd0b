"""The default solver: extended position-based dynamics with small steps and a multigrid."""
