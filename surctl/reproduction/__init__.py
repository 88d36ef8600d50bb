"""Reproduction of the paper: compare each printed claim, table, scenario and erratum with our computed result."""

from surctl.reproduction.reproduction import Reproduction, items, reproduce, required
from surctl.reproduction.row import WORDS, Item, Result, Row, Word
from surctl.reproduction.simulations import Simulations

__all__ = ["WORDS", "Item", "Reproduction", "Result", "Row", "Simulations", "Word", "items", "reproduce", "required"]
