"""Reproduction of the paper: compare each printed claim, table, scenario and erratum with our computed result."""

from surctl.marine.reproduction.reproduction import Reproduction, items, reproduce, required
from surctl.marine.reproduction.row import WORDS, Item, Result, Row, Word
from surctl.marine.reproduction.scenarios import Simulations

__all__ = ["WORDS", "Item", "Reproduction", "Result", "Row", "Simulations", "Word", "items", "reproduce", "required"]
