"""Attitudes in files of the Consultative Committee for Space Data Systems (CCSDS).

    ml.spacecraft.attitudes.write(
        path, "run.aem", epoch="2026-04-13T21:45:00", time_system="UTC", time_unit="s", object_name="CUBE",
        object_id="2026-001A", originator="LAB", ref_frame_a="EME2000", ref_frame_b="SC_BODY_1",
    )
    seen = ml.spacecraft.attitudes.read("run.aem")
    ml.fitting.Attitudes(seen.times, seen.attitudes, sigma=1e-3)

The format is the Attitude Ephemeris Message (AEM) as text of keywords and values (KVN), of both versions of the
standard: CCSDS 504.0-B-1 (2008) and 504.0-B-2 (2024).
"""

from .message import AttitudeFile as AttitudeFile
from .message import Segment as Segment
from .reader import read as read
from .writer import write as write
