"""Estimation of obstacle positions from measured ranges, as single points and as a local map."""
