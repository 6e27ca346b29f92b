"""Recorded trajectories (inD, DUT, UCY/ETH, your tables) read into one `Recording` type.

Reading and writing inD and DUT needs the extra `evaluation` (pyarrow).
`open_recording` reads any of the formats, `Recording.from_dataframe` takes a table.
`Recording.window` gives arrays, `closest_crossings` finds pairs of agents that interact. No data
set is shipped: the writers make recordings in the same formats.
"""

from foresight_env.datasets.csv_table import read_csv_table
from foresight_env.datasets.dut import DUT_RATE, read_dut, write_dut
from foresight_env.datasets.errors import RecordingError
from foresight_env.datasets.ind import find_ind_recordings, read_ind, write_ind
from foresight_env.datasets.interactions import Interaction, closest_crossings, find_interaction
from foresight_env.datasets.observed import observed_window, past_velocities
from foresight_env.datasets.reader import Format, open_recording, recordings_below
from foresight_env.datasets.recording import Recording
from foresight_env.datasets.routes import Route, RouteMemory, ahead_of, learned_routes, routes_at
from foresight_env.datasets.track import Track, Window
from foresight_env.datasets.ucy import UCY_RATE, read_ucy, write_ucy

__all__ = [
    "DUT_RATE",
    "UCY_RATE",
    "Format",
    "Interaction",
    "Recording",
    "RecordingError",
    "Route",
    "RouteMemory",
    "Track",
    "Window",
    "ahead_of",
    "closest_crossings",
    "find_ind_recordings",
    "find_interaction",
    "learned_routes",
    "observed_window",
    "open_recording",
    "past_velocities",
    "read_csv_table",
    "read_dut",
    "read_ind",
    "read_ucy",
    "recordings_below",
    "routes_at",
    "write_dut",
    "write_ind",
    "write_ucy",
]
