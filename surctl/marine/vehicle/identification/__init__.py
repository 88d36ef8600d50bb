"""Identification of a vehicle from a log: the model that is fitted, the fit, its intervals, and its predictions."""
