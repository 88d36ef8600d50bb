"""Obstacle positions from measured ranges: contacts, and the local map."""
