"""Monte Carlo campaigns: many random runs of a scenario, and their statistics."""
