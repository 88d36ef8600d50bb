"""Sessions of `surctl fly`: the exported law with an ArduSub by MAVLink, and rehearsals (extra `field`)."""

from surctl.marine.bridge.autopilot import SimulatedSub
from surctl.marine.bridge.bridge import Bridge, Moment, Plan
from surctl.marine.bridge.inputs import Site
from surctl.marine.bridge.live import Address, Ended, SessionLog
from surctl.marine.bridge.log import FrameLog, SessionRecord
from surctl.marine.bridge.rehearsal import ACTIONS, Act, Channel, LinkQuality, Rehearsal, RehearsalResult
from surctl.marine.bridge.session import Clock, Limits, Session, sending
from surctl.marine.bridge.wire import (
    MODES,
    SENDS,
    Attitude,
    Axes,
    Beat,
    Gone,
    Mapping,
    Mode,
    Position,
    Ranges,
    Reply,
    Text,
    Wire,
)

__all__ = [
    "ACTIONS",
    "MODES",
    "SENDS",
    "Act",
    "Address",
    "Attitude",
    "Axes",
    "Beat",
    "Bridge",
    "Channel",
    "Clock",
    "Ended",
    "FrameLog",
    "Gone",
    "Limits",
    "LinkQuality",
    "Mapping",
    "Mode",
    "Moment",
    "Plan",
    "Position",
    "Ranges",
    "Rehearsal",
    "RehearsalResult",
    "Reply",
    "Session",
    "SessionLog",
    "SessionRecord",
    "SimulatedSub",
    "Site",
    "Text",
    "Wire",
    "sending",
]
