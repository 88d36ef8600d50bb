"""Estimation of obstacle positions from measured ranges, as contacts and as a local map."""
