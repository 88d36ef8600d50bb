"""`surctl verify` and `surctl check` with files about dynamics, as processes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.process import call, surctl
from tests.lyapunov.problems import DECAY, MAP, VAN_DER_POL, written
