"""Recorded readings through the range tracker of the law."""
