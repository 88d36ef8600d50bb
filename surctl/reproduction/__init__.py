"""Reproduction of the paper: each claim, table, scenario and erratum as a row that compares print and computation."""

from surctl.reproduction.reproduction import Reproduction, items, reproduce, required
from surctl.reproduction.row import WORDS, Item, Result, Row, Word
from surctl.reproduction.simulations import Simulations

__all__ = ["WORDS", "Item", "Reproduction", "Result", "Row", "Simulations", "Word", "items", "reproduce", "required"]
