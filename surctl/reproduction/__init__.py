"""The paper side by side: every claim, table, scenario and erratum as a row, computed anew."""

from surctl.reproduction.flights import Flights
from surctl.reproduction.reproduction import Reproduction, items, reproduce, required
from surctl.reproduction.row import WORDS, Found, Item, Row, Word

__all__ = ["WORDS", "Flights", "Found", "Item", "Reproduction", "Row", "Word", "items", "reproduce", "required"]
