"""Sessions of `surctl fly`: the exported law with an ArduSub by MAVLink, and rehearsals (extra `field`)."""

from surctl.marine.bridge.autopilot import SimulatedSub
from surctl.marine.bridge.bridge import Bridge, Plan
from surctl.marine.bridge.live import Ended
from surctl.marine.bridge.log import SessionRecord
from surctl.marine.bridge.rehearsal import Act, LinkQuality, Rehearsal, RehearsalResult
from surctl.marine.bridge.wire import Wire

__all__ = [
    "Act",
    "Bridge",
    "Ended",
    "LinkQuality",
    "Plan",
    "Rehearsal",
    "RehearsalResult",
    "SessionRecord",
    "SimulatedSub",
    "Wire",
]
