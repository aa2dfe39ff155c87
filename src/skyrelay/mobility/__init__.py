"""Where vehicles are: trace replay and synthetic models."""

from skyrelay.mobility.streets import read_streets
from skyrelay.mobility.trace import Trace, read_trace
from skyrelay.mobility.tracks import Tracks, builtin_traces, load_tracks, replay

__all__ = ["Trace", "Tracks", "builtin_traces", "load_tracks", "read_streets", "read_trace", "replay"]
