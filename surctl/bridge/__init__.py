"""Sessions of the exported law with an ArduSub autopilot by MAVLink, and rehearsals of them (extra `field`)."""

from surctl.bridge.autopilot import SimulatedSub
from surctl.bridge.axes import MODES, Axes, Mapping, Mode, mode_of
from surctl.bridge.bridge import Bridge, Moment, Plan
from surctl.bridge.channel import Channel, LinkQuality
from surctl.bridge.clock import Clock
from surctl.bridge.events import Attitude, Beat, Gone, Odometry, Position, Ranges, Reply, Text
from surctl.bridge.limits import Limits
from surctl.bridge.live import Address, Ended, SessionLog, parse_address, run_session
from surctl.bridge.log import FrameLog, SessionRecord
from surctl.bridge.plan import plan_session
from surctl.bridge.rehearsal import ACTIONS, Act, Rehearsal, RehearsalResult, rehearse
from surctl.bridge.session import Session, sending
from surctl.bridge.site import Site, parse_site
from surctl.bridge.wire import SENDS, Wire, dialect

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
    "Odometry",
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
    "dialect",
    "mode_of",
    "parse_address",
    "parse_site",
    "plan_session",
    "rehearse",
    "run_session",
    "sending",
]
